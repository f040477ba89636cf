"""Wrong options are told before anything is connected or computed."""

from __future__ import annotations

from types import SimpleNamespace

import pytest
from typer.testing import CliRunner

from app.cli import app
from app.commands import launch_one, replay


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["launch", "--target", "nope"], "--target is one of still"),
        (["launch", "--target", "none.gpx"], "none.gpx"),
        (["launch", "--cot", "foo"], "sharing.cot: 'foo' is no address"),
        (["launch", "--beacon", "udp://127.0.0.1:70000"], "sharing.beacon"),
        (["launch", "--fleet", "2", "--beacon", "udp://127.0.0.1:6969"], "a beacon is heard by one aircraft"),
        (["launch", "--connect", "nope://x"], "'nope://x' is no link this can open"),
        (["launch", "--connect", "serial:///dev/none:57600"], "there is no device /dev/none"),
        (["launch", "--terrain", "none"], "none: there is no such folder of elevation data"),
        (["launch", "--signing-key", "none"], "signing key none cannot be read"),
        (["launch", "--side", "up"], "requirement.side: 'up' is none of left, right"),
        (["replay", "tests/data/arduplane-follow-bike.tlog", "--truth", "pyproject.toml"], "is no truth file"),
    ],
)
def test_a_wrong_option_is_told_at_once(monkeypatch, arguments, sentence):
    late = SimpleNamespace(called=False)

    def computed(*_arguments):
        late.called = True
        raise AssertionError

    monkeypatch.setattr(launch_one, "controller_of", computed)
    monkeypatch.setattr(replay, "controller_of", computed)
    ended = CliRunner().invoke(app, arguments)
    assert sentence in str(ended.exception)
    assert not late.called


def test_lengths_below_nothing_are_not_told_as_lengths(tmp_path, capsys):
    (tmp_path / "mission.toml").write_text("[aircraft]\nradius_m = 300\n[requirement]\nrange_max_m = 200.0\n")
    ended = CliRunner().invoke(app, ["check", str(tmp_path / "mission.toml")])
    assert "infeasible" in str(ended.exception)
    assert "a move of -" not in str(ended.exception)
    said = capsys.readouterr().out + ended.output
    assert "longest move of the circle" in said
    assert " -" not in said

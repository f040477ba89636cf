"""Wrong options are reported before anything is connected or computed."""

from __future__ import annotations

from types import SimpleNamespace

import pytest
from typer.testing import CliRunner

from sidelong.app.cli import app
from sidelong.app.commands import launch_one, replay


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["launch", "--target", "nope"], "--target is one of still"),
        (["launch", "--target", "none.gpx"], "none.gpx"),
        (["launch", "--cot", "foo"], "sharing.cot: 'foo' is no address"),
        (["launch", "--beacon", "udp://127.0.0.1:70000"], "sharing.beacon"),
        (["launch", "--fleet", "2", "--beacon", "udp://127.0.0.1:6969"], "a beacon is used by one aircraft"),
        (["launch", "--connect", "nope://x"], "'nope://x' is no link this can open"),
        (["launch", "--connect", "udpin://0.0.0.0:99999"], "a port is a number from 1 to 65535, not 99999"),
        (["connect", "tcpout://127.0.0.1:0"], "a port is a number from 1 to 65535, not 0"),
        (["sign", "tests"], "tests is a folder; name the key's file in it, such as tests/plane.key"),
        (["report", "none"], "none: there is no such run folder or log"),
        (["launch", "--connect", "serial:///dev/none:57600"], "there is no device /dev/none"),
        (["launch", "--terrain", "none"], "none: there is no such folder of elevation data"),
        (["launch", "--signing-key", "none"], "signing key none cannot be read"),
        (["launch", "--side", "up"], "requirement.side: 'up' is none of left, right"),
        (["launch", "--json", "tests"], "tests is a folder; give a file to --json"),
        (["replay", "tests/data/arduplane-follow-bike.tlog", "--truth", "pyproject.toml"], "is no truth file"),
        (["export", "tests/data/arduplane-follow-bike.tlog", "--out", "none/x.kml"], "there is no folder none"),
        (["study", "--scheduler", "here"], "--scheduler: 'here' is no address"),
        (["study", "--store", "tests"], "tests is a folder; give a file to --store"),
    ],
)
def test_a_wrong_option_is_reported_at_once(monkeypatch, arguments, sentence):
    late = SimpleNamespace(called=False)

    def computed(*_arguments):
        late.called = True
        raise AssertionError

    monkeypatch.setattr(launch_one, "controller_of", computed)
    monkeypatch.setattr(replay, "controller_of", computed)
    ended = CliRunner().invoke(app, arguments)
    assert sentence in str(ended.exception)
    assert not late.called


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["lanch"], "No such command 'lanch'. Did you mean 'launch'?"),
        (["launch", "--speeed", "3"], "No such option: --speeed (Possible options: --seed, --speed"),
        (["export", "run", "--format", "gpxx"], "Invalid value for '--format': 'gpxx' is not one of 'plan'"),
        (["check", "--radius", "wide"], "'wide' is neither a number of metres nor auto"),
    ],
)
def test_what_is_mistyped_is_named_with_what_there_is(arguments, sentence):
    ended = CliRunner().invoke(app, arguments)
    assert ended.exit_code == 2
    assert sentence in ended.output
    assert "Value error" not in ended.output


def test_lengths_below_nothing_are_not_reported_as_lengths(tmp_path, capsys):
    (tmp_path / "mission.toml").write_text("[aircraft]\nradius_m = 300\n[requirement]\nrange_max_m = 200.0\n")
    ended = CliRunner().invoke(app, ["check", "--planner", "paper", str(tmp_path / "mission.toml")])
    assert "infeasible" in str(ended.exception)
    assert "a move of -" not in str(ended.exception)
    announced = capsys.readouterr().out + ended.output
    assert "longest move of the circle" in announced
    assert " -" not in announced

"""Wrong options are told before anything is connected or computed."""

from __future__ import annotations

from types import SimpleNamespace

import pytest
from typer.testing import CliRunner

from app.cli import app
from app.commands import launch, replay


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["launch", "--target", "nope"], "--target is one of still"),
        (["launch", "--target", "none.gpx"], "none.gpx"),
        (["launch", "--connect", "nope://x"], "'nope://x' is no link this can open"),
        (["replay", "tests/data/arduplane-follow-bike.tlog", "--truth", "pyproject.toml"], "is no truth file"),
    ],
)
def test_a_wrong_option_is_told_at_once(monkeypatch, arguments, sentence):
    late = SimpleNamespace(called=False)

    def computed(*_arguments):
        late.called = True
        raise AssertionError

    monkeypatch.setattr(launch, "controller_of", computed)
    monkeypatch.setattr(replay, "controller_of", computed)
    ended = CliRunner().invoke(app, arguments)
    assert sentence in str(ended.exception)
    assert not late.called

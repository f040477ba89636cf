"""The layout of a run's folder."""

from __future__ import annotations

import json
from datetime import UTC, datetime, timedelta, timezone

import pytest

from sidelong.app.errors import InputError
from sidelong.app.records.run_folder import RunFolder

NOW = datetime(2026, 11, 21, 9, 35, 12, tzinfo=UTC)


def test_runs_of_the_same_second_get_folders_of_their_own(tmp_path):
    names = [RunFolder.create(tmp_path / "runs", NOW).path.name for _ in range(3)]
    assert names == ["20261121T093512Z", "20261121T093512Z-2", "20261121T093512Z-3"]


def test_the_name_is_in_utc(tmp_path):
    here = NOW.astimezone(timezone(timedelta(hours=9)))
    assert RunFolder.create(tmp_path, here).path.name == "20261121T093512Z"


def test_a_place_that_cannot_be_written_is_an_input_error(tmp_path):
    (tmp_path / "runs").write_text("a file in the way")
    with pytest.raises(InputError, match="no run folder can be made"):
        RunFolder.create(tmp_path / "runs", NOW)


def test_only_a_folder_with_a_journal_is_a_run(tmp_path):
    run = RunFolder.create(tmp_path, NOW)
    with pytest.raises(InputError, match="has no journal"):
        RunFolder.open(run.path)
    run.journal.touch()
    assert RunFolder.open(run.path) == run


def test_a_summary_that_fails_half_way_leaves_the_one_before(tmp_path):
    run = RunFolder.create(tmp_path, NOW)
    run.write_summary({"moves": 3})
    with pytest.raises(TypeError):
        run.write_summary({"moves": 4, "wrong": object()})
    assert json.loads(run.summary.read_text()) == {"moves": 3}
    assert run.read_summary() == {"moves": 3}


def test_a_run_without_a_summary_is_an_input_error(tmp_path):
    with pytest.raises(InputError, match="not ended in order"):
        RunFolder.create(tmp_path, NOW).read_summary()

"""Inputs that used to be answered poorly: each is accepted, or refused in one sentence with the way out."""

from __future__ import annotations

import json
import shutil
import socket

import pytest
from typer.testing import CliRunner

from sidelong.app import cli
from sidelong.app.cli import app
from sidelong.app.commands.output import share_progress
from sidelong.app.config import Config, load_config
from sidelong.app.errors import InputError, missing_package
from sidelong.app.link.raw_links import opened_links
from sidelong.app.link.vehicle import LinkError
from sidelong.app.records.journal import encode
from sidelong.app.records.run_folder import RunFolder
from sidelong.mission.exchange.reports import ShutdownRequested
from sidelong.sitl.world.track import read_track
from sidelong.sitl.world.track_file import TrackError
from tests.app.conftest import recorded

MISSION = "[requirement]\nrange_max_m = 480.0\n"


def file(tmp_path, data):
    path = tmp_path / "mission.toml"
    path.write_bytes(data)
    return path


def refused(*arguments):
    ended = CliRunner().invoke(app, [str(one) for one in arguments])
    assert isinstance(ended.exception, InputError), ended.output
    assert "\n" not in str(ended.exception)
    return str(ended.exception)


def test_a_byte_order_mark_is_read_over(tmp_path):
    assert load_config(file(tmp_path, MISSION.encode("utf-8-sig"))).requirement.range_max_m == 480.0


@pytest.mark.parametrize("encoding", ["utf-16-le", "utf-16-be"])
def test_utf_16_is_named(tmp_path, encoding):
    with pytest.raises(InputError, match="is text in UTF-16; save it as UTF-8"):
        load_config(file(tmp_path, ("\ufeff" + MISSION).encode(encoding)))


@pytest.mark.parametrize("line", ["range_max_m = 500,0", "range_max_m 500"])
def test_a_mistake_is_shown_with_its_line(tmp_path, line):
    with pytest.raises(InputError, match=r"not valid TOML: .*line 2.*; correct it"):
        load_config(file(tmp_path, f"[requirement]\n{line}\n".encode()))


def test_a_picture_is_not_a_track(tmp_path):
    path = tmp_path / "target.csv"
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + bytes(100))
    with pytest.raises(TrackError, match=r"is not text in UTF-8; a track is a \.gpx or a \.csv file"):
        read_track(path)


def test_a_refused_tcp_connection_is_reported_without_waiting():
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
    with (
        pytest.raises(InputError, match="connection refused; start the autopilot first"),
        opened_links([f"tcpout://127.0.0.1:{port}"], (245, 190), None),
    ):
        pass


def test_a_fleet_s_study_takes_no_planner():
    answer = refused("study", "--fleet", 2, "--planner", "predictive")
    assert "--planner: --fleet compares those of fleets" in answer
    assert "leave it out" in answer


def test_a_missing_map_is_named_before_the_page_is_asked_for(tmp_path):
    assert "there is no file" in refused("launch", "--set", f"display.map_file={tmp_path / 'none.mbtiles'}")


def test_an_optional_package_is_installed_where_this_program_runs():
    text = str(missing_package("KLV", "stanag4609", "write a .csv"))
    assert text.endswith("-m pip install stanag4609, or write a .csv.")
    assert "sidelong[" not in text


def test_a_replay_with_values_that_cannot_be_flown_is_refused(run_folder):
    assert "radius_m must be at least" in refused("replay", run_folder, "--set", "aircraft.radius_m=15")


def test_a_run_that_would_be_refused_today_is_still_replayed(tmp_path):
    run = tmp_path / "run"
    run.mkdir()
    recorded(RunFolder(run), Config.model_validate({"fences": {"ceiling_m": 50.0}}), 60.0, {})
    ended = CliRunner().invoke(app, ["replay", str(run), "--quiet"])
    assert ended.exception is None, ended.exception
    assert "above fences.ceiling_m" in refused("replay", run, "--set", "requirement.side=right")


@pytest.mark.parametrize("lost", [None, "the disk was full"])
def test_a_truncated_record_is_reported(run_folder, tmp_path, lost):
    run = tmp_path / "run"
    shutil.copytree(run_folder, run)
    if lost is not None:
        RunFolder(run).write_summary({"records_lost": lost})
    ended = CliRunner().invoke(app, ["replay", str(run), "--quiet"])
    assert ended.exception is None, ended.exception
    assert RunFolder(run).truncated() == (
        lost or "the program was killed, the disk was full, or the flight still goes on"
    )
    ended = CliRunner().invoke(app, ["report", str(run)])
    assert ended.exception is None, ended.exception
    page = (run / "report.html").read_text()
    assert "the record ends early, at " in page
    assert (lost or "the program was killed") in page


def test_a_long_task_reports_its_progress_without_a_terminal(capsys):
    times_s = iter([0.0, 5.0, 11.0, 11.0, 12.0])
    with share_progress("reading run", lambda: next(times_s)) as advance:
        for share in (0.2, 0.5, 0.6):
            advance(share)
    assert capsys.readouterr().err == "sidelong: reading run: 50 %\n"


def test_a_whole_record_is_not_called_truncated(tmp_path):
    (tmp_path / "summary.json").write_text(json.dumps({"records_lost": ""}))
    assert RunFolder(tmp_path).truncated() == ""


def test_a_journal_without_its_end_is_called_truncated(run_folder, tmp_path):
    run = tmp_path / "run"
    shutil.copytree(run_folder, run)
    RunFolder(run).write_summary({"records_lost": ""})
    assert RunFolder(run).truncated() == "the end of the journal is missing"
    with RunFolder(run).journal.open("ab") as journal:
        journal.write(encode(ShutdownRequested(200.0, 100.0)))
    assert RunFolder(run).truncated() == ""


def test_a_damaged_journal_is_not_verified(run_folder, tmp_path):
    run = tmp_path / "run"
    shutil.copytree(run_folder, run)
    lines = RunFolder(run).journal.read_bytes().splitlines(keepends=True)
    lines[50] = lines[50].replace(b"time_s", b"tame_s")
    RunFolder(run).journal.write_bytes(b"".join(lines))
    ended = CliRunner().invoke(app, ["replay", str(run), "--verify"])
    assert "1 damaged lines were passed over, so the flight cannot be verified" in str(ended.exception)
    ended = CliRunner().invoke(app, ["replay", str(run), "--quiet"])
    assert "1 damaged lines of the journal were passed over" in ended.output


def test_damaged_lines_that_change_decisions_are_reported_before_the_differences(run_folder, tmp_path):
    run = tmp_path / "run"
    shutil.copytree(run_folder, run)
    lines = RunFolder(run).journal.read_bytes().splitlines(keepends=True)
    damaged = [line.replace(b"time_s", b"tame_s") if b"RangeReading" in line else line for line in lines]
    RunFolder(run).journal.write_bytes(b"".join(damaged))
    ended = CliRunner().invoke(app, ["replay", str(run), "--verify"])
    assert "damaged lines were passed over, so the flight cannot be verified" in str(ended.exception)


def test_a_link_that_takes_no_message_ends_in_one_sentence(monkeypatch, capsys):
    def launch(_arguments):
        raise LinkError("PARAM_REQUEST_READ could not be sent: MAVSDK did not take it")

    monkeypatch.setattr(cli, "app", launch)
    assert cli.run([]) == 1
    assert capsys.readouterr().err == "sidelong: PARAM_REQUEST_READ could not be sent: MAVSDK did not take it\n"

"""The command line as a person uses it, against the simulated vehicle over UDP on loopback."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.command_line import new_process, sidelong

pytestmark = pytest.mark.udp


@pytest.fixture(scope="module", params=["arduplane", "px4"])
def flown(request, tmp_path_factory) -> tuple[Path, dict]:
    """A run folder and the summary of a short flight."""
    folder = tmp_path_factory.mktemp(request.param)
    summary = folder / "summary.json"
    done = new_process(
        *("launch", "--autopilot", request.param, "--duration", 150, "--set", "simulation.speed=20", "--seed", 3),
        *("--target", "walk"),
        *("--planner", "paper", "--out", folder / "runs", "--json", summary),
    )
    assert done.returncode == 0, done.stdout + done.stderr
    (run,) = (folder / "runs").iterdir()
    return run, json.loads(summary.read_text())


def test_a_flight_watches_the_target(flown):
    _, summary = flown
    assert summary["outcome"] == "completed"
    assert summary["source"] == "truth"
    assert summary["duration_s"] > 140.0
    assert summary["time_in_band"] >= 0.9
    assert summary["moves"] >= 1
    assert summary["upload_failures"] == 0
    assert summary["sightings"] > 1000
    assert summary["estimate_rmse_m"] < 8.0
    assert 0.0 <= summary["time_on_side"] <= 1.0
    assert summary["min_range_m"] < summary["max_range_m"]


def test_a_flight_leaves_its_records(flown):
    run, summary = flown
    assert json.loads((run / "summary.json").read_text()) == summary
    for name in ("journal.jsonl", "flight.tlog", "truth.csv"):
        assert (run / name).stat().st_size > 10_000


def test_a_replay_decides_the_same_to_the_last_bit(flown, tmp_path):
    run, summary = flown
    done = sidelong("replay", run, "--verify", "--json", tmp_path / "replay.json")
    assert done.returncode == 0, done.stderr
    assert "same to the last bit" in done.stdout
    replayed = json.loads((tmp_path / "replay.json").read_text())
    for key in ("time_in_band", "time_on_side", "moves", "estimate_rmse_m"):
        assert replayed[key] == pytest.approx(summary[key], abs=2e-3)


def test_a_replay_with_another_value_states_that_the_path_is_as_flown(flown):
    run, _ = flown
    stated = "the summary is of the path as flown"
    assert stated in sidelong("replay", run, "--set", "aircraft.radius_m=80", "--quiet").stdout
    assert stated not in sidelong("replay", run, "--quiet").stdout


def test_the_recorded_tlog_replays_like_a_foreign_one(flown, tmp_path):
    run, _ = flown
    done = sidelong(
        *("replay", run / "flight.tlog", "--truth", run / "truth.csv", "--planner", "paper", "--quiet"),
        *("--json", tmp_path / "tlog.json"),
    )
    assert done.returncode == 0, done.stderr
    assert json.loads((tmp_path / "tlog.json").read_text())["estimate_rmse_m"] < 8.0


def test_a_flight_exports_its_mission_and_its_tracks(flown, tmp_path):
    run, _ = flown
    for wanted, mark in (("plan", '"fileType": "Plan"'), ("waypoints", "QGC WPL 110"), ("gpx", "<trkpt")):
        out = tmp_path / f"flight.{wanted}"
        done = sidelong(
            "export", run if wanted == "plan" else run / "journal.jsonl", "--format", wanted, "--out", out
        )
        assert done.returncode == 0, done.stderr
        assert mark in out.read_text()

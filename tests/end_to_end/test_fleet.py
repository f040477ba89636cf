"""A fleet as a person flies it: one ArduPlane and one PX4, simulated, over UDP on loopback."""

from __future__ import annotations

import json
import re
import signal
import subprocess

import pytest

from tests.command_line import PROGRAM, new_process, sidelong
from tests.end_to_end.test_route import written

pytestmark = pytest.mark.udp
FLEET = """
[simulation]
speed = 10.0
target = "{track}"
[route]
file = "{route}"
[[aircraft]]
name = "plane"
[[aircraft]]
name = "wing"
autopilot = "px4"
"""


@pytest.fixture(scope="module")
def flown(tmp_path_factory):
    """Return the run folder and the summary of a short flight."""
    folder = tmp_path_factory.mktemp("fleet")
    track, route = written(folder, speed_m_s=2.0)
    (folder / "fleet.toml").write_text(FLEET.format(track=track, route=route), encoding="utf-8")
    done = new_process(
        *("launch", folder / "fleet.toml", "--duration", 60, "--out", folder / "runs"),
        *("--json", folder / "summary.json"),
    )
    assert done.returncode == 0, done.stdout + done.stderr
    (run,) = (folder / "runs").iterdir()
    return run, json.loads((folder / "summary.json").read_text())


def test_both_watch_and_stay_apart(flown):
    _, summary = flown
    assert summary["outcome"] == "completed"
    assert summary["source"] == "truth"
    assert [one["name"] for one in summary["aircraft"]] == ["plane", "wing"]
    assert all(one["sightings"] > 300 and one["time_in_band"] > 0.9 for one in summary["aircraft"])
    assert summary["min_separation_m"] >= 50.0
    assert summary["time_in_band_any"] > 0.9
    each = [one["time_on_side"] for one in summary["aircraft"]]
    assert 0.0 <= summary["time_on_side_any"] <= 1.0
    assert summary["duration_s"] <= max(one["duration_s"] for one in summary["aircraft"]) + 1.0, each


def test_both_follow_the_route_of_the_target(flown):
    run, _ = flown
    for name in ("plane", "wing"):
        journal = (run / name / "journal.jsonl").read_text()
        assert "the target is expected on a route of 1600 m" in journal
        assert "on route: the target is" in journal


def test_the_run_replays_to_the_last_bit(flown):
    run, _ = flown
    assert json.loads((run / "plane" / "summary.json").read_text())["outcome"] == "completed"
    done = sidelong("replay", run, "--verify", "--quiet")
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout.count("same to the last bit") == 3


def test_its_report_is_about_all_and_leads_to_each(flown, tmp_path):
    run, summary = flown
    done = sidelong("report", run, "--out", tmp_path / "report.html")
    assert done.returncode == 0, done.stderr
    page = (tmp_path / "report.html").read_text()
    for name in ("plane", "wing"):
        (link,) = re.findall(f'href="([^"]*)">{name}</a>', page)
        assert '<figure id="observation-angle"' in (tmp_path / link).read_text()
    assert "Announcements of the coordinator" in page
    assert f"<td>{summary['min_separation_m']:.0f} m</td>" in page
    assert f"<td>{100.0 * summary['time_on_side_any']:.1f} %</td>" in page


def test_its_tracks_go_into_one_file_and_its_missions_into_one_each(flown, tmp_path):
    run, _ = flown
    done = sidelong("export", run, "--format", "gpx", "--out", tmp_path / "flight.gpx")
    assert done.returncode == 0, done.stderr
    tracks = re.findall(r"<name>([^<]*)</name>", (tmp_path / "flight.gpx").read_text())
    assert tracks == ["plane aircraft", "plane target", "wing aircraft", "wing target"]
    done = sidelong("export", run, "--format", "plan", "--out", tmp_path / "flight.plan")
    assert (done.returncode, "leave out --out" in " ".join(done.stderr.split())) == (2, True)
    done = sidelong("export", run, "--format", "plan")
    assert done.returncode == 0, done.stderr
    assert (run / "plane" / "flight.plan").is_file()
    assert (run / "wing" / "flight.plan").is_file()


def test_its_mcap_has_the_topics_of_each_at_the_same_time(flown, tmp_path):
    reader = pytest.importorskip("mcap.reader")
    run, _ = flown
    done = sidelong("export", run, "--format", "mcap", "--out", tmp_path / "flight.mcap")
    assert done.returncode == 0, done.stderr
    times_ns: dict[str, list[int]] = {}
    with (tmp_path / "flight.mcap").open("rb") as file:
        for _, channel, message in reader.make_reader(file).iter_messages(topics=["/plane/target", "/wing/target"]):
            times_ns.setdefault(channel.topic, []).append(message.log_time)
    (a, b), (c, d) = ((min(own), max(own)) for own in times_ns.values())
    assert min(b, d) - max(a, c) > 30e9


def test_an_interrupt_winds_all_up(tmp_path):
    process = subprocess.Popen(
        [*PROGRAM, "launch", "--fleet", "2", "--set", "simulation.speed=15", "--out", str(tmp_path / "runs")],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    assert any("taking off" in line for line in process.stdout)
    process.send_signal(signal.SIGINT)
    rest, _ = process.communicate(timeout=90.0)
    assert process.returncode == 130, rest
    last = rest.splitlines()[-1]
    assert last.startswith("sidelong: interrupted by SIGINT: aircraft-1: ")
    assert "aircraft-2: " in last
    (run,) = (tmp_path / "runs").iterdir()
    assert json.loads((run / "summary.json").read_text())["outcome"] == "interrupted"

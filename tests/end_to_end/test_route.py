"""A flight that knows the target's route, from the command line to the replay."""

from __future__ import annotations

import json
import subprocess
import sys

import pytest
from mcap.reader import make_reader

from sidelong.estimators.frames import LocalPlane
from tests.command_line import new_process, sidelong

pytestmark = pytest.mark.udp
HOME = LocalPlane(-35.363262, 149.165237)
CORNERS_M = (250.0, 300.0), (250.0, 900.0), (1250.0, 900.0)  # east, north; simulated targets begin at the first one


def written(folder, speed_m_s=4.0):
    """Write a track around a corner, and its way points; return both files."""
    leg_s = round(600.0 / speed_m_s)
    places = [(250.0, 300.0 + speed_m_s * s) for s in range(leg_s)]
    places += [(250.0 + speed_m_s * s, 900.0) for s in range(leg_s)]
    track, route = folder / "track.csv", folder / "route.csv"
    for file, head, rows in ((track, "time,lat,lon", places), (route, "lat,lon", CORNERS_M)):
        degrees = [",".join(f"{angle:.8f}" for angle in HOME.latitude_longitude_deg(*row)) for row in rows]
        lines = [f"{second},{row}" for second, row in enumerate(degrees)] if file == track else degrees
        file.write_text("\n".join([head, *lines]))
    return track, route


def test_a_flight_along_a_route_reports_it_and_replays_the_same(tmp_path):
    track, route = written(tmp_path)
    done = new_process(
        *(
            "launch",
            "--target",
            track,
            "--target-speed",
            6,
            "--route",
            route,
            "--duration",
            150,
            "--set",
            "simulation.speed=14",
        ),
        *("--no-view", "--out", tmp_path / "runs", "--json", tmp_path / "summary.json"),
    )
    assert done.returncode == 0, done.stdout + done.stderr
    (run,) = (tmp_path / "runs").iterdir()
    journal = (run / "journal.jsonl").read_text()
    assert "the target is expected on a route of 1600 m" in journal
    assert "on route: the target is" in journal
    assert json.loads((tmp_path / "summary.json").read_text())["time_in_band"] >= 0.9
    for kind in ("kml", "geojson", "mcap"):
        assert sidelong("export", run, "--format", kind, "--out", tmp_path / f"out.{kind}").returncode == 0
    assert "route, 1600 m" in (tmp_path / "out.kml").read_text()
    features = json.loads((tmp_path / "out.geojson").read_text())["features"]
    assert sum(one["properties"]["name"] == "route" for one in features) == 1
    with (tmp_path / "out.mcap").open("rb") as file:
        progress = [json.loads(one.data) for *_, one in make_reader(file).iter_messages(["/route"])]
    assert len(progress) > 100
    assert progress[-1]["on_route"]
    assert progress[-1]["along_m"] > progress[60]["along_m"] + 100.0
    assert sidelong("report", run, "--out", tmp_path / "report.html").returncode == 0
    assert "Progress along the route" in (tmp_path / "report.html").read_text()
    replayed = sidelong("replay", run, "--verify", "--quiet")
    assert replayed.returncode == 0, replayed.stdout + replayed.stderr


def test_an_unreadable_route_ends_the_launch_before_anything_flies(tmp_path):
    route = tmp_path / "route.gpx"
    route.write_text("not a route")
    done = sidelong("launch", "--route", route)
    assert done.returncode == 2
    assert "route.gpx: is not a readable track or route" in " ".join(done.stderr.split())


def test_the_mission_of_another_vehicle_on_the_link_is_asked_for(free_port, tmp_path):
    port = free_port()
    command = [sys.executable, "-m", "sidelong.sitl", "--vehicles", "2", "--to", f"127.0.0.1:{port}", "--speed", "10"]
    vehicles = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    try:
        assert vehicles.stdout.readline().startswith("ready system 1")
        done = sidelong(
            *(
                "launch",
                "--connect",
                f"udpin://127.0.0.1:{port}",
                "--set",
                "link.system_id=1",
                "--route",
                "mavlink:2",
            ),
            *("--duration", 20, "--no-view", "--out", tmp_path / "runs"),
        )
    finally:
        vehicles.kill()
        vehicles.wait(10)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "no route: the mission of system 2 contains 0 way points" in " ".join(done.stdout.split())

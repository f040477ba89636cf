"""Every mistake of a person is one sentence that names the field or file, with exit code 2, and nothing is left."""

from __future__ import annotations

import socket
import subprocess
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from pymavlink.dialects.v20 import common as mavlink

from tests.command_line import SIDELONG, new_process, sidelong

DATA = Path(__file__).resolve().parent.parent / "data"


def refused(*arguments: object) -> str:
    """Run the command, and return its one sentence."""
    return sentence_of(sidelong(*arguments))


def sentence_of(done: subprocess.CompletedProcess[str]) -> str:
    assert done.returncode == 2, done.stdout + done.stderr
    lines = done.stderr.strip().splitlines()
    assert len(lines) == 1, done.stderr
    assert lines[0].startswith("sidelong: ")
    return lines[0]


@contextmanager
def heartbeats(port: int, kind: int, autopilot: int, text: bytes | None = None) -> Iterator[None]:
    """Something that reports ten times a second what it is, and a text, to a UDP port of the loopback."""
    encoder = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
    frame = mavlink.MAVLink_heartbeat_message(kind, autopilot, 81, 0, 3, 3).pack(encoder)
    if text is not None:
        frame += mavlink.MAVLink_statustext_message(4, text).pack(encoder)
    over = threading.Event()

    def talk() -> None:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
            while not over.wait(0.1):
                sender.sendto(frame, ("127.0.0.1", port))

    speaker = threading.Thread(target=talk)
    speaker.start()
    try:
        yield
    finally:
        over.set()
        speaker.join()


@pytest.mark.parametrize("url", ["udp:14540", "http://127.0.0.1:80", "udpin://:14540", "udpin://127.0.0.1:99999"])
def test_a_wrong_url(url):
    assert url in refused("connect", url)


def test_a_process_ends_with_the_exit_code():
    assert "'udp:14540'" in sentence_of(new_process("connect", "udp:14540"))


def test_a_busy_port():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as holder:
        holder.bind(("127.0.0.1", 0))
        port = holder.getsockname()[1]
        assert f"port {port}" in refused("connect", f"udpin://127.0.0.1:{port}")


@pytest.mark.udp
def test_no_heartbeat(free_port):
    announced = refused("connect", f"udpin://127.0.0.1:{free_port()}", "--set", "link.heartbeat_timeout_s=1")
    assert "no autopilot was received within 1 s" in announced


@pytest.mark.udp
@pytest.mark.parametrize(
    ("kind", "autopilot", "named"), [(2, 3, "no fixed wing"), (20, 12, "VTOL"), (1, 4, "ArduPlane and PX4")]
)
def test_a_vehicle_that_this_cannot_fly(kind, autopilot, named, free_port):
    port = free_port()
    with heartbeats(port, kind, autopilot):
        assert named in refused("connect", f"udpin://127.0.0.1:{port}", "--set", "link.heartbeat_timeout_s=5")


@pytest.mark.udp
def test_a_vehicle_s_texts_reach_the_terminal_as_words_only(free_port):
    port = free_port()
    command = [str(SIDELONG), "connect", f"udpin://127.0.0.1:{port}", "--set", "link.heartbeat_timeout_s=5"]
    with heartbeats(port, 2, 3, text=b"\xff\x1b[2Jgone"):
        done = subprocess.run(command, capture_output=True, timeout=60, check=False)
    assert b"no fixed wing" in done.stderr
    assert not [text for text in (b"\x1b", b"\xff", b"gone") if text in done.stdout + done.stderr]


@pytest.mark.parametrize("content", [b"", b"not a log at all\n" * 100])
def test_a_file_that_is_no_log(tmp_path, content):
    path = tmp_path / "flight.tlog"
    path.write_bytes(content)
    assert "flight.tlog" in refused("replay", path)


def test_a_log_that_is_not_there(tmp_path):
    assert "none.tlog" in refused("replay", tmp_path / "none.tlog")


def test_a_log_without_laser_reports_what_it_looked_for():
    announced = refused("replay", DATA / "no-laser-vtol.tlog")
    for name in ("no-laser-vtol.tlog", "DISTANCE_SENSOR", "GIMBAL_DEVICE_ATTITUDE_STATUS", "ATTITUDE"):
        assert name in announced


def test_an_unknown_key(tmp_path):
    config = tmp_path / "mission.toml"
    config.write_text("[aircraft]\nradius = 60\n")
    announced = refused("launch", config, "--out", tmp_path / "runs")
    assert "mission.toml" in announced
    assert "aircraft.radius" in announced
    assert not (tmp_path / "runs").exists()


@pytest.mark.parametrize(
    ("table", "line", "words"),
    [
        ("requirement", "range_mn_m = 100", "unknown key requirement.range_mn_m; known there: range_min_m, "),
        ("sensors", "latency_s = true", "sensors.latency_s: true is not allowed here"),
    ],
)
def test_a_key_or_value_that_is_meant_otherwise(tmp_path, table, line, words):
    config = tmp_path / "mission.toml"
    config.write_text(f"[{table}]\n{line}\n")
    assert words in refused("check", config)


def test_a_circle_tighter_than_the_aircraft_flies(tmp_path):
    config = tmp_path / "mission.toml"
    config.write_text("[aircraft]\nradius_m = 15\nairspeed_m_s = 22\n")
    assert "radius_m" in refused("launch", config, "--out", tmp_path / "runs")
    assert not (tmp_path / "runs").exists()


def test_an_infeasible_requirement():
    assert "range_max_m" in refused("check", "--set", "requirement.range_max_m=150")


@pytest.mark.parametrize("target", ["nowhere.gpx", "sideways"])
def test_a_target_that_does_not_exist(tmp_path, target):
    assert target in refused("launch", "--target", target, "--out", tmp_path / "runs", "--planner", "paper")
    assert not list((tmp_path / "runs").glob("*"))


def test_an_output_folder_that_does_not_exist(tmp_path):
    assert "--json" in refused("check", "--json", tmp_path / "no" / "such" / "x.json")

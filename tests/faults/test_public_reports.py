"""Inputs of public reports: each command gives the right value, or one sentence that says why not."""

from __future__ import annotations

import json
import math
import re
import socket
import struct
import threading
import time
import zipfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest
from pymavlink import mavutil
from pymavlink.dialects.v20 import all as mavlink

from tests.app.test_track_file import KML, LINE, gpx, iso, kmz, walk
from tests.command_line import sidelong
from tests.logs import dataflash_pieces, time_us, ulog_pieces
from tests.records.test_log import dataflash_with

AREA = [[[8.54, 47.39], [8.56, 47.39], [8.56, 47.41], [8.54, 47.39]]]
LINES = {"Trail": [[8.55, 47.4 + 1e-3 * k] for k in range(5)], "Road": [[8.57, 47.4 + 1e-3 * k] for k in range(11)]}


def feature(title: str, kind: str, coordinates: object) -> dict[str, object]:
    geometry = {"type": kind, "coordinates": coordinates}
    return {"type": "Feature", "properties": {"title": title}, "geometry": geometry}


FEATURES = [
    {"type": "Feature", "properties": {"title": "folder", "class": "Folder"}, "geometry": None},
    feature("area", "Polygon", AREA),
    *(feature(title, "LineString", line) for title, line in LINES.items()),
    feature("marker", "Point", [8.55, 47.4]),
]
EMPTY = "".join(f"<when>{iso(k)}</when>" for k in range(12)) + "".join(
    f"<gx:coord>{f'8.55 {47.4 + 1e-3 * k} 400' if k % 5 else ''}</gx:coord>" for k in range(12)
)
ROUTES: dict[str, tuple[str | bytes, int, float]] = {  # content, way points, length in m
    "zurich.gpx": (
        ("<?xml version='1.0' encoding='ISO-8859-1'?>" + gpx(("Zürich", 47.4, iso), count=40)).encode("latin-1"),
        *(40, 52.0),
    ),
    "track.kml": (KML.format(f"<gx:Track>{EMPTY}</gx:Track>"), 9, 1112.0),
    "line.kml": (
        KML.format(f"<gx:a>1</gx:a><LineString><coordinates>{LINE}</coordinates></LineString>"),
        *(12, 1223.0),
    ),
    "line.kmz": (kmz(), 12, 1223.0),
    "map.json": (json.dumps({"type": "FeatureCollection", "features": FEATURES}), 11, 1112.0),
}


def write(file: Path, content: str | bytes) -> Path:
    file.write_bytes(content.encode() if isinstance(content, str) else content)
    return file


def words(text: str) -> str:
    return " ".join(text.split())


@pytest.mark.parametrize("name", ROUTES)
def test_routes(tmp_path: Path, name: str) -> None:
    content, way_points, length_m = ROUTES[name]
    done = sidelong("route", write(tmp_path / name, content), "--json", tmp_path / "values.json")
    assert done.returncode == 0, done.stderr
    values = json.loads((tmp_path / "values.json").read_text())
    assert values["way_points"] == way_points
    assert values["length_m"] == pytest.approx(length_m, rel=0.01)
    noted = "'Road', the longest, is used, 3 further lines of the file are not used (area, Trail, 4)"
    assert (noted in " ".join(values["warnings"])) is (name == "map.json")


def two_walkers() -> str:
    return gpx(("A", 47.4, iso), ("B", 47.4002, iso))


def two_vessels() -> str:
    rows = [f"{iso(k)},{mmsi},{47.4 + 1.2e-5 * k + 4e-4 * mmsi},8.55" for k in range(120) for mmsi in (0, 1)]
    return "\n".join(["time,mmsi,lat,lon", *rows])


def nanoseconds() -> str:
    return walk(lambda k: f"{1_746_349_200 + k}000000000")


def year_0() -> str:
    return gpx(("walk", 47.4, lambda k: "0000-05-04T09:00:50Z" if k == 50 else iso(k)))


TRACKS = {"Location.csv": nanoseconds, "ais.csv": two_vessels, "walk.gpx": year_0, "two.gpx": two_walkers}


@pytest.mark.parametrize("name", TRACKS)
def test_targets_of_a_study(tmp_path: Path, name: str) -> None:
    write(tmp_path / name, TRACKS[name]())
    out = tmp_path / "study.json"
    done = sidelong("study", "--targets", tmp_path, "--planner", "lvfg", "--jobs", 1, "--json", out)
    assert done.returncode == 0, done.stderr
    values = json.loads(out.read_text())
    assert (values["targets"], values["skipped"]) == (1, 0)
    assert 110.0 < values["simulated_s"] < 121.0
    assert ("is used, 1 further line" in words(done.stdout + done.stderr)) is name.startswith(("ais", "two"))


@pytest.mark.udp
def test_the_selected_walker_is_the_target_of_a_launch(tmp_path: Path) -> None:
    track = write(tmp_path / "two.gpx", two_walkers())
    done = sidelong(
        *("launch", "--target", f"{track}#B", "--duration", 10, "--set", "simulation.speed=20", "--no-view"),
        *("--out", tmp_path / "runs"),
    )
    assert done.returncode == 0, done.stderr
    assert "'B' is used, 1 further line of the file is not used (A)" in words(done.stdout + done.stderr)
    (truth,) = (tmp_path / "runs").glob("*/*truth*.csv")
    rows = np.genfromtxt(truth, delimiter=",", names=True)
    east_m, north_m = rows["target_east_m"], rows["target_north_m"]
    assert np.ptp(east_m) < 1.0
    assert np.ptp(north_m) == pytest.approx(1.334 * np.ptp(rows["time_boot_s"]), rel=0.1)


def test_terrain_of_a_zipped_tile(tmp_path: Path) -> None:
    with zipfile.ZipFile(tmp_path / "N47E008.hgt.zip", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("srtm/N47E008.hgt", struct.pack(">h", 450) * 1201**2)
    done = sidelong("terrain", tmp_path)
    assert done.returncode == 0, done.stderr
    assert "450 to 450 m" in words(done.stdout)


COPTER = ("MSG", "QZ", "TimeUS,Message", "<Q64s", (time_us(0), b"ArduCopter V4.5.7 (2a3dc4b7)"))


def replayed(file: Path, pieces: list[bytes]) -> tuple[int, str]:
    done = sidelong("replay", write(file, b"".join(pieces)))
    return done.returncode, words(done.stdout + done.stderr)


def test_replay_of_a_copters_log_warns(tmp_path: Path) -> None:
    code, text = replayed(tmp_path / "copter.bin", dataflash_with(COPTER))
    assert code == 0, text
    assert "the vehicle is of MAV_TYPE 2, no fixed wing, which the results assume" in text


def test_replay_of_an_altimeter_names_the_key_that_would_use_it(tmp_path: Path) -> None:
    pieces = [piece[:-2] + b"\x19" + piece[-1:] if piece[2] == 5 else piece for piece in dataflash_pieces()]
    code, text = replayed(tmp_path / "flight.bin", pieces)
    assert code == 2
    assert "the only range looks down; sensors.range_component = 1 would use it" in text


def test_replay_of_a_clock_from_1970_sees_the_same(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    code, text = replayed(tmp_path / "boot.ulg", ulog_pieces())
    assert code == 0, text
    monkeypatch.setattr("tests.logs.time_us", lambda i: 1_746_352_800_000_000 + 100_000 * i)
    again, dated = replayed(tmp_path / "epoch.ulg", ulog_pieces())
    outcomes = [re.findall(r"sightings +(\d+), rejected (\d+)", one) for one in (text, dated)]
    assert again == 0
    assert outcomes[0] == outcomes[1]
    assert outcomes[0][0][0] == "300"


@contextmanager
def repeated(work: Callable[[int], object], every_s: float) -> Iterator[None]:
    """Do this with a rising number, each ``every_s``, while the context lasts."""
    ended = threading.Event()

    def loop() -> None:
        k = 0
        while not ended.wait(every_s):
            work(k)
            k += 1

    thread = threading.Thread(target=loop)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()


class Wing:
    """A fixed wing that circles, with a gimbal and a range: (distance in cm, type, id, orientation)."""

    def __init__(self, port: int, distance: tuple[int, int, int, int]) -> None:
        self._link = mavutil.mavlink_connection(
            f"udpout:127.0.0.1:{port}", source_system=1, source_component=1, dialect="ardupilotmega"
        )
        self._distance, self._begun_s = distance, time.monotonic()

    def step(self, k: int) -> None:
        send, t_s = self._link.mav, time.monotonic() - self._begun_s + 100.0
        ms, angle = int(1000 * t_s), t_s * 20.0 / 70.0
        if k % 10 == 0:
            send.heartbeat_send(1, 3, 129, 12, 4)
            send.gps_raw_int_send(1000 * ms, 3, 460_000_000, 80_000_000, 600_000, 80, 80, 2000, 0, 14)
        north, east = round(6300 * math.cos(angle)), round(9060 * math.sin(angle))  # 1e-7 degrees: 70 m
        v_north, v_east = round(-2000 * math.sin(angle)), round(2000 * math.cos(angle))
        place = 460_000_000 + north, 80_000_000 + east
        send.global_position_int_send(ms, *place, 600_000, 100_000, v_north, v_east, 0, 0)
        send.attitude_send(ms, 0.4, 0.02, math.atan2(v_east, v_north), 0, 0, 0)
        send.gimbal_device_attitude_status_send(0, 0, ms, 4 | 8 | 16 | 64, [0.97, 0.0, -0.24, 0.0], 0, 0, 0, 0)
        send.distance_sensor_send(ms, 500, 60_000, *self._distance, 0)
        while (message := self._link.recv_msg()) is not None:
            if message.get_type() == "COMMAND_LONG":
                send.command_ack_send(message.command, 0)
                if message.param1 == mavlink.MAVLINK_MSG_ID_HOME_POSITION:
                    send.home_position_send(460_000_000, 80_000_000, 500_000, 0, 0, 0, [1, 0, 0, 0], 0, 0, 0)
            if message.get_type() == "PARAM_REQUEST_READ":
                send.param_value_send(message.param_id.encode(), 0, 9, 1, 0)
            if message.get_type() == "MISSION_REQUEST_LIST":
                asked_by = message.get_srcSystem(), message.get_srcComponent()
                send.mission_count_send(*asked_by, 0, message.mission_type)


@pytest.mark.udp
def test_connect_names_a_range_that_is_not_usable(
    free_port: Callable[[], int], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("MAVLINK20", "1")
    port = free_port()
    with repeated(Wing(port, (60_100, 0, 1, 100)).step, 0.1):
        done = sidelong("connect", f"udpin://127.0.0.1:{port}", "--listen", 3)
    assert done.returncode == 1
    sentence = "range source NOT READY received: DISTANCE_SENSOR .* but no echo within its 600 m"
    assert re.search(sentence, words(done.stdout))
    assert "range source ready" not in words(done.stdout)


def cursor_on_target(uid: str, kind: str, detail: str = "") -> bytes:
    now = datetime.now(UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")
    return (
        f'<event version="2.0" uid="{uid}" type="{kind}" how="m-g" time="{now}" start="{now}" stale="{now}">'
        f'<point lat="-35.36056" lon="149.16799" hae="430" ce="4.9" le="9999999"/><detail>{detail}</detail></event>'
    ).encode()


def with_chat(k: int) -> list[bytes]:
    others = {2: cursor_on_target("GeoChat.PHONE.All", "b-t-f"), 4: cursor_on_target("PHONE-ping", "t-x-c-t")}
    own = cursor_on_target("PHONE", "a-f-G-U-C", '<contact callsign="WALKER"/>')
    return [own, *([others[k % 6]] if k % 6 in others else [])]


@pytest.mark.udp
def test_a_phone_is_the_beacon_of_a_launch(tmp_path: Path, free_port: Callable[[], int]) -> None:
    port = free_port()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as phone:

        def send(k: int) -> None:
            for datagram in with_chat(k):
                phone.sendto(datagram, ("127.0.0.1", port))

        with repeated(send, 0.5):
            done = sidelong(
                *("launch", "--set", f"sharing.beacon=udp://127.0.0.1:{port}", "--duration", 10, "--no-view"),
                *("--set", "simulation.speed=10", "--out", tmp_path / "runs"),
            )
    text = words(done.stdout + done.stderr)
    assert done.returncode == 0, text
    assert "the beacon WALKER reports the target's position" in text
    assert "several beacons" not in text

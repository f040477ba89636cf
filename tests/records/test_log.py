"""One flight written as tlog, ULog and DataFlash log gives the same readings; damage costs only what it hits."""

from __future__ import annotations

import gzip
import math
import random
import struct
from collections.abc import Iterable
from dataclasses import replace
from itertools import accumulate
from pathlib import Path

import pytest
from pymavlink import DFReader
from pyulog import ULog

from sidelong.app.analysis.replay import require_sightings
from sidelong.app.assembly import tracker_of
from sidelong.app.config import Config
from sidelong.app.errors import InputError
from sidelong.app.link.telemetry import Telemetry
from sidelong.app.records.autopilot_logs import read_dataflash, read_ulog
from sidelong.app.records.log import open_log
from sidelong.estimators.sensing.readings import AttitudeReading, GimbalReading, PositionReading, RangeReading
from sidelong.estimators.tracking.tracker import Tracker, TrackerSettings
from sidelong.mission.core.events import WindReported
from tests.logs import (
    DATAFLASH_KINDS,
    HEIGHT_M,
    PITCH_RAD,
    RANGE_M,
    ROLL_RAD,
    STEPS,
    ULOG_TOPICS,
    WIND_EAST_M_S,
    WIND_NORTH_M_S,
    YAW_RAD,
    dataflash_entry,
    dataflash_pieces,
    time_us,
    tlog_pieces,
    ulog_message,
    ulog_pieces,
)

# -- what they come to --------------------------------------------------------------------------------------


def readings(path: Path) -> dict[type, list]:
    telemetry = Telemetry()
    found: dict[type, list] = {}
    for message in open_log(path).messages(telemetry.wanted):
        event = telemetry.event(message)
        if event is not None:
            found.setdefault(type(event), []).append(event)
    return found


@pytest.fixture
def tlog(tmp_path, sender, stamped) -> Path:
    return write(tmp_path / "flight.tlog", tlog_pieces(sender, stamped))


@pytest.fixture
def ulog(tmp_path) -> Path:
    return write(tmp_path / "flight.ulg", ulog_pieces())


@pytest.fixture
def dataflash(tmp_path) -> Path:
    return write(tmp_path / "flight.bin", dataflash_pieces())


def write(path: Path, pieces: Iterable[bytes]) -> Path:
    path.write_bytes(b"".join(pieces))
    return path


@pytest.mark.parametrize("kind", ["tlog", "ulog", "dataflash"])
def test_every_kind_gives_the_readings_of_the_flight(kind, request):
    found = readings(request.getfixturevalue(kind))
    positions, attitudes, ranges, sights = (
        found[one] for one in (PositionReading, AttitudeReading, RangeReading, GimbalReading)
    )
    assert [len(one) for one in (positions, attitudes, ranges, sights)] == [STEPS] * 4
    times_s = [time_us(i) * 1e-6 for i in range(STEPS)]
    for several in (positions, attitudes, ranges, sights):
        assert [one.time_s for one in several] == pytest.approx(times_s, abs=1e-6)
    assert [p.north_m for p in positions] == pytest.approx([100 * i * 1e-7 * 111_180 for i in range(STEPS)], abs=0.02)
    last = positions[-1]
    assert (last.height_m, last.velocity_east_m_s, last.velocity_north_m_s, last.velocity_up_m_s) == pytest.approx(
        (HEIGHT_M, -2.0, 15.0, -0.5), abs=1e-3
    )
    assert (attitudes[0].roll_rad, attitudes[0].pitch_rad, attitudes[0].yaw_rad) == pytest.approx(
        (ROLL_RAD, PITCH_RAD, YAW_RAD), abs=1e-4
    )
    assert {r.slant_range_m for r in ranges} == {RANGE_M}
    assert {r.quality for r in ranges} == {0.9}
    assert {r.source.orientation for r in ranges} == {100}
    assert {s.frame for s in sights} == {"earth"}
    wind = found[WindReported][-1]
    assert (wind.north_m_s, wind.east_m_s) == pytest.approx((WIND_NORTH_M_S, WIND_EAST_M_S))


def test_px4_without_global_positions_gives_them_from_the_local_ones(tmp_path):
    number = list(ULOG_TOPICS).index("vehicle_global_position")
    logged = [piece for piece in ulog_pieces() if piece[2:5] != b"D" + struct.pack("<H", number)]
    positions = readings(write(tmp_path / "flight.ulg", logged))[PositionReading]
    assert len(positions) == STEPS - 11  # the first second it could still come
    assert (positions[0].east_m, positions[0].north_m, positions[0].height_m) == pytest.approx(
        (0, 0, HEIGHT_M), abs=0.02
    )


def test_a_sight_from_mount_angles_is_the_rotation_by_yaw_pitch_roll(dataflash):
    # Yaw 90 deg, then roll 90 deg: q = (cos 45, 0, 0, sin 45) * (cos 45, sin 45, 0, 0) = (1, 1, 1, 1) / 2.
    assert readings(dataflash)[GimbalReading][0].quaternion_wxyz == pytest.approx((0.5, 0.5, 0.5, 0.5))


def test_a_definition_that_turns_numbers_into_text_costs_its_type(dataflash):
    content = dataflash.read_bytes()
    assert content.count(b"QBff\0") == 1  # the wind's letters; n is text of as many bytes
    dataflash.write_bytes(content.replace(b"QBff\0", b"QBnf\0"))
    assert {*readings(dataflash)} >= {PositionReading, GimbalReading}
    assert [entry.name for entry in read_dataflash(dataflash, ["XKF2", "POS"])] == ["POS"] * STEPS


def test_entries_are_those_of_pyulog(ulog):
    topics = ["vehicle_attitude", "distance_sensor"]
    ours = list(read_ulog(ulog, topics))
    for topic in ULog(str(ulog), topics).data_list:
        found = [entry.fields for entry in ours if entry.name == topic.name]
        assert len(found) == STEPS
        for name, column in topic.data.items():
            assert [repr(fields[name]) for fields in found] == [repr(value) for value in column.tolist()]


def test_entries_are_those_of_pymavlinks_dataflash_reader(dataflash):
    ours = [(entry.name, dict(entry.fields)) for entry in read_dataflash(dataflash, ["POS", "ATT", "RFND"])]
    reader = DFReader.DFReader_binary(str(dataflash))
    theirs = []
    while (m := reader.recv_match(type=["POS", "ATT", "RFND"])) is not None:
        theirs.append((m.get_type(), {name: getattr(m, name) for name in m.get_fieldnames()}))
    assert len(ours) == 3 * STEPS
    assert ours == theirs


@pytest.mark.parametrize(
    ("pieces", "read", "topics"),
    [
        (ulog_pieces, read_ulog, list(ULOG_TOPICS)),
        (dataflash_pieces, read_dataflash, [name for name in DATAFLASH_KINDS if name != "FMT"]),
    ],
    ids=["ulog", "dataflash"],
)
class TestDamage:
    """Neither format has checksums: a frame that was hit may come back changed, a whole one never goes."""

    def test_cut_at_any_byte_all_whole_entries_are_read(self, tmp_path, pieces, read, topics):
        rng = random.Random(1)
        several = pieces(60)
        whole, path = b"".join(several), tmp_path / "log"
        every = read_all(read, write(path, several), topics)
        ends = [end for piece, end in zip(several, accumulate(map(len, several)), strict=True) if is_data(piece)]
        assert len(every) == len(ends)
        for cut in rng.sample(range(len(whole)), 200):
            path.write_bytes(whole[:cut])
            assert read_all(read, path, topics) == every[: sum(end <= cut for end in ends)]

    def test_damage_costs_only_the_entries_it_hits(self, tmp_path, pieces, read, topics):
        rng = random.Random(2)
        several = pieces(60)
        whole, path = b"".join(several), tmp_path / "log"
        every = read_all(read, write(path, several), topics)
        spans = [
            (end - len(piece), end)
            for piece, end in zip(several, accumulate(map(len, several)), strict=True)
            if is_data(piece)
        ]
        for _ in range(200):
            begin, length = rng.randrange(spans[0][0], len(whole)), rng.choice([1, 1, 2, 8, 100])
            path.write_bytes(whole[:begin] + rng.randbytes(length) + whole[begin + length :])
            untouched = {
                entry
                for entry, (first, end) in zip(every, spans, strict=True)
                if end <= begin or begin + length <= first
            }
            found = set(read_all(read, path, topics))
            assert untouched <= found
            assert len(found - untouched) <= len(every) - len(untouched)

    def test_damage_to_the_definitions_is_no_traceback(self, tmp_path, pieces, read, topics):
        rng = random.Random(3)
        whole, path = b"".join(pieces(60)), tmp_path / "log"
        for _ in range(50):
            begin = rng.randrange(600)
            path.write_bytes(whole[:begin] + rng.randbytes(8) + whole[begin + 8 :])
            open_log(path)
            read_all(read, path, topics)

    def test_what_damage_leaves_does_not_trouble_the_estimation(self, tmp_path, pieces, read, topics):
        rng = random.Random(4)
        absurd = [struct.pack("<d", 1e300), struct.pack("<ff", 3e38, -3e38), struct.pack("<ff", math.inf, math.nan)]
        whole, path = b"".join(pieces(60)), tmp_path / "log"
        for _ in range(25):
            damaged = bytearray(whole)
            for _ in range(30):
                begin = rng.randrange(900, len(whole) - 8)
                damaged[begin : begin + 8] = rng.choice([*absurd, rng.randbytes(8)])
            path.write_bytes(damaged)
            telemetry, tracker = Telemetry(), Tracker(TrackerSettings())
            for message in open_log(path).messages(telemetry.wanted):
                event = telemetry.event(message)
                if isinstance(event, PositionReading | AttitudeReading | RangeReading | GimbalReading):
                    tracker.add(event)
                if isinstance(event, PositionReading):
                    tracker.estimate(event.time_s)
            assert tracker.sightings > 10


def read_all(read, path: Path, topics: list[str]) -> list[str]:
    return [repr(entry) for entry in read(path, topics)]


def is_data(piece: bytes) -> bool:
    return piece[2:3] == b"D" if piece[:2] != b"\xa3\x95" else piece[2] != 0x80


def test_an_entry_with_a_damaged_time_is_dropped(tmp_path):
    pieces = dataflash_pieces()
    changed = bytearray(pieces[100])
    changed[9] ^= 0x40  # of its time, in the 49th bit
    pieces[100] = bytes(changed)
    path = write(tmp_path / "flight.bin", pieces)
    assert len(list(read_dataflash(path, list(DATAFLASH_KINDS)))) == 8 * STEPS - 1


@pytest.mark.parametrize(("read", "pieces", "name"), [
    (read_dataflash, dataflash_pieces, "POS"),
    (read_ulog, ulog_pieces, "vehicle_global_position"),
])  # fmt: skip
def test_a_second_flight_in_a_log_is_not_mixed_into_the_first(tmp_path, read, pieces, name):
    times_us = [entry.time_us for entry in read(write(tmp_path / "flights", 2 * pieces()), [name])]
    assert times_us == 2 * [time_us(i) for i in range(STEPS)]


# -- what is no log -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["tlog", "ulog", "dataflash"])
def test_the_kind_is_seen_from_the_content(kind, request, tmp_path):
    original = request.getfixturevalue(kind)
    renamed = original.rename(tmp_path / "flight.txt")
    names = {"tlog": "tlog", "ulog": "ULog", "dataflash": "DataFlash log"}
    assert open_log(renamed).kind == names[kind]
    damaged = bytes(7) + renamed.read_bytes()[7:]
    renamed.write_bytes(damaged)
    assert open_log(renamed).kind == names[kind]


@pytest.mark.parametrize(("content", "words"), [
    (b"", "is empty"),
    (b"just some text\n" * 100, "is no log"),
    (random.Random(6).randbytes(50_000), "is no log"),
    (gzip.compress(b"a log", mtime=0), "is compressed; decompress it first"),
])  # fmt: skip
def test_what_is_no_log_is_an_input_error(tmp_path, content, words):
    path = write(tmp_path / "flight.tlog", [content])
    with pytest.raises(InputError, match=words):
        open_log(path)


def test_what_cannot_be_read_is_an_input_error(tmp_path):
    for path in (tmp_path / "missing.tlog", tmp_path):
        with pytest.raises(InputError, match="cannot be read"):
            open_log(path)


def test_a_log_reports_what_was_looked_for_and_what_it_has(ulog, tmp_path, sender, stamped):
    sentence = open_log(ulog).looked_for()
    assert "a slant range (distance_sensor) and a line of sight (gimbal_device_attitude_status);" in sentence
    assert "vehicle_attitude (300)" in sentence
    path = write(tmp_path / "b.tlog", stamped([sender().heartbeat(), sender(component=2).heartbeat()]))
    assert open_log(path).looked_for().endswith("the tlog has HEARTBEAT (2)")


# -- clocks, vehicles and payloads of other people's logs ------------------------------------------------------


@pytest.mark.parametrize("pieces", [ulog_pieces, dataflash_pieces])
def test_a_clock_that_counts_from_1970_changes_nothing_but_the_times(pieces, tmp_path, monkeypatch):
    booted = readings(write(tmp_path / "boot", pieces()))
    monkeypatch.setattr("tests.logs.time_us", lambda i: 1_746_352_800_000_000 + 100_000 * i)
    dated = readings(write(tmp_path / "epoch", pieces()))
    assert set(dated) == set(booted)
    for kind, several in booted.items():
        later_s = dated[kind][0].time_s - several[0].time_s
        assert [one.time_s - later_s for one in dated[kind]] == pytest.approx(
            [one.time_s for one in several], abs=1e-5
        )
        assert [replace(one, time_s=0.0) for one in dated[kind]] == [replace(one, time_s=0.0) for one in several]


def dataflash_with(*entries: tuple[str, str, str, str, tuple]) -> list[bytes]:
    """Return the flight with further entries before it: name, letters, columns, code and values of each."""
    further = []
    for number, (name, letters, columns, code, values) in enumerate(entries, 20):
        size = 3 + struct.calcsize(code)
        further.append(dataflash_entry("FMT", number, size, name.encode(), letters.encode(), columns.encode()))
        further.append(b"\xa3\x95" + bytes([number]) + struct.pack(code, *values))
    return further + dataflash_pieces()


@pytest.mark.parametrize(
    ("entry", "kind"),
    [
        (("MSG", "QZ", "TimeUS,Message", "<Q64s", (time_us(0), b"ArduCopter V4.5.7 (2a3dc4b7)")), 2),
        (("MSG", "QZ", "TimeUS,Message", "<Q64s", (time_us(0), b"ArduPlane V4.6.3 (3fc7011a)")), 1),
        (("MSG", "QZ", "TimeUS,Message", "<Q64s", (time_us(0), b"Copter is on its way")), 1),
        (("PARM", "QNf", "TimeUS,Name,Value", "<Q16sf", (time_us(0), b"Q_ENABLE", 1.0)), 22),
        (("PARM", "QNf", "TimeUS,Name,Value", "<Q16sf", (time_us(0), b"Q_ENABLE", 0.0)), 1),
    ],
)
def test_the_vehicle_of_a_dataflash_log_is_known_by_its_texts_and_parameters(entry, kind, tmp_path):
    context = open_log(write(tmp_path / "flight.bin", dataflash_with(entry))).context()
    assert (context.kind, context.autopilot.name) == (kind, "ArduPlane")
    assert ("no fixed wing" in context.warning) is (kind != 1)


@pytest.mark.parametrize("kind", [1, 2, 21])
def test_the_vehicle_of_a_ulog_is_known_by_its_parameter(kind, tmp_path):
    pieces = ulog_pieces()
    pieces.insert(1, ulog_message(b"P", b"\x10int32_t MAV_TYPE" + kind.to_bytes(4, "little")))
    context = open_log(write(tmp_path / "flight.ulg", pieces)).context()
    assert (context.kind, context.autopilot.name) == (kind, "PX4")


@pytest.mark.parametrize(("release", "firmware"), [(None, ""), (0x010F02FF, "PX4 v1.15.2")])
def test_the_firmware_of_a_ulog_is_known_by_its_information(release, firmware, tmp_path):
    pieces = ulog_pieces()
    pieces.insert(1, ulog_message(b"I", b"\x10char[3] sys_namePX4"))
    if release is not None:
        pieces.insert(2, ulog_message(b"I", b"\x17uint32_t ver_sw_release" + release.to_bytes(4, "little")))
    context = open_log(write(tmp_path / "flight.ulg", pieces)).context()
    assert (context.kind, context.autopilot.name, context.firmware) == (1, "PX4", firmware)


def test_stamps_of_a_tlog_need_not_count_from_1970(tmp_path, sender, stamped):
    frames = tlog_pieces(sender, stamped)
    pieces = [struct.pack(">Q", 10_000 * i) + frame[8:] for i, frame in enumerate(frames)]
    assert readings(write(tmp_path / "boot.tlog", pieces)) == readings(write(tmp_path / "flight.tlog", frames))
    assert open_log(tmp_path / "boot.tlog").context().booted is None


def test_a_tlog_of_mavlink_1_names_what_it_cannot_carry(tmp_path, sender, stamped):
    path = write(tmp_path / "old.tlog", stamped([sender(version=1).range(i) for i in range(3)]))
    words = "the tlog has DISTANCE_SENSOR (3), all of MAVLink 1, which cannot carry GIMBAL_DEVICE_ATTITUDE_STATUS"
    assert open_log(path).looked_for().endswith(words)


@pytest.mark.parametrize("unit_m", [1.0, 0.1, 0.01])
def test_the_range_of_a_mount_is_read_once_each_and_in_its_own_unit(unit_m, tmp_path):
    ranges_m = [200.0 + 10.0 * (i // 10) for i in range(STEPS)]  # measured each second, logged ten times as often
    pitch_deg = -math.degrees(math.asin(HEIGHT_M / 250.0))
    pieces = [piece for piece in dataflash_pieces() if piece[2] not in (5, 6)]
    columns = b"TimeUS,I,Roll,Pitch,YawE,Dist"
    pieces.insert(1, dataflash_entry("FMT", 20, 3 + struct.calcsize("<QBffff"), b"MNT", b"QBffff", columns))
    for i, range_m in enumerate(ranges_m):
        values = struct.pack("<QBffff", time_us(i), 0, 0.0, pitch_deg, 90.0, range_m / unit_m)
        pieces.append(b"\xa3\x95\x14" + values)
    found = readings(write(tmp_path / "flight.bin", pieces))
    assert [one.slant_range_m for one in found[RangeReading]] == pytest.approx(ranges_m[::10], rel=1e-4)
    assert {one.source.orientation for one in found[RangeReading]} == {100}
    assert len(found[GimbalReading]) == STEPS


def test_error_names_an_only_range_that_looks_down_or_has_no_echo(tmp_path):
    for orient, status, words in (
        (25, 4, "the only range looks down; sensors.range_component = 1"),
        (100, 2, "no echo"),
    ):
        code = DATAFLASH_KINDS["RFND"][3]
        pieces = [
            b"\xa3\x95\x05" + struct.pack(code, *struct.unpack(code, piece[3:])[:3], status, orient, 90)
            if piece[2] == 5
            else piece
            for piece in dataflash_pieces()
        ]
        log, telemetry, tracker = open_log(write(tmp_path / "flight.bin", pieces)), Telemetry(), tracker_of(Config())
        for message in log.messages(telemetry.wanted):
            event = telemetry.event(message)
            if isinstance(event, PositionReading | AttitudeReading | RangeReading | GimbalReading):
                tracker.add(event)
        with pytest.raises(InputError, match=words):
            require_sightings(tracker, telemetry, log)

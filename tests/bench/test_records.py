"""How fast records are read and written: python -m pytest tests/bench/test_records.py -s"""

from __future__ import annotations

import struct
import time
import tracemalloc
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import pytest
from pymavlink import mavutil
from pymavlink.dialects.v20 import all as dialect

from sidelong.app.link.message import Message
from sidelong.app.link.telemetry import Telemetry
from sidelong.app.records.journal import Header, JournalReader, JournalWriter
from sidelong.app.records.tlog import read_tlog, tlog_contents
from sidelong.estimators.sensing.readings import GimbalReading, PositionReading, RangeReading, Source
from tests.bench.size import size

MESSAGES = size(1_000_000, 20_000)
START_US = 1_700_000_000_000_000

# One second of a vehicle: messages per kind as PX4 sends them to a companion, with a payload at 10 Hz.
RATES = {
    "ATTITUDE_QUATERNION": 50,
    "SERVO_OUTPUT_RAW": 50,
    "LOCAL_POSITION_NED": 50,
    "ATTITUDE_TARGET": 50,
    "POSITION_TARGET_LOCAL_NED": 50,
    "DISTANCE_SENSOR": 26,
    "ATTITUDE": 20,
    "GLOBAL_POSITION_INT": 10,
    "GIMBAL_DEVICE_ATTITUDE_STATUS": 10,
    "GPS_RAW_INT": 5,
    "VFR_HUD": 4,
    "HEARTBEAT": 2,
    "SYS_STATUS": 1,
    "EXTENDED_SYS_STATE": 1,
    "WIND_COV": 1,
    "MISSION_CURRENT": 1,
}
WANTED = sorted(Telemetry().wanted)


def seconds(work: Callable[[], Any]) -> tuple[float, Any]:
    """Return the processor's time, which other programs do not change, and the result."""
    begin_s = time.process_time()
    result = work()
    return time.process_time() - begin_s, result


@pytest.fixture(scope="module")
def tlog(tmp_path_factory) -> Path:
    """A million frames that pymavlink packed: a hundred different seconds, over and over with running stamps."""
    by_name = {definition.msgname: definition for definition in dialect.mavlink_map.values()}
    mav = dialect.MAVLink(None, srcSystem=1, srcComponent=1)
    order = sorted((k / rate, name) for name, rate in RATES.items() for k in range(rate))
    frames = []
    for second in range(100):
        for part, name in order:
            definition = by_name[name]
            message = definition(*_values(definition, round(1000 * (second + part))))
            frames.append(message.pack(mav))
            mav.seq = (mav.seq + 1) % 256
    path = tmp_path_factory.mktemp("bench") / "flight.tlog"
    with path.open("wb") as file:
        for i in range(MESSAGES):
            file.write(struct.pack(">Q", START_US + 3_000 * i) + frames[i % len(frames)])
    return path


def _values(definition: Any, time_ms: int) -> Iterable[Any]:
    lengths = dict(zip(definition.ordered_fieldnames, definition.array_lengths, strict=True))
    for name, kind in zip(definition.fieldnames, definition.fieldtypes, strict=True):
        if name == "time_boot_ms":
            yield time_ms
        elif lengths[name]:
            yield [0.5] * lengths[name]
        else:
            yield 0.1 + time_ms % 97 if kind == "float" else 1 + time_ms % 100


def test_wanted_messages_ten_times_as_fast_as_pymavlink(tlog):
    def ours() -> int:
        return sum(1 for _ in read_tlog(tlog, WANTED))

    def theirs() -> int:
        log = mavutil.mavlink_connection(str(tlog))
        count = 0
        while log.recv_match(type=WANTED) is not None:
            count += 1
        return count

    theirs_s, their_count = seconds(theirs)
    ours_s, our_count = min(seconds(ours) for _ in range(3))
    print(
        f"\n{our_count} wanted of {MESSAGES} messages, {tlog.stat().st_size / 1e6:.0f} MB: "
        f"pymavlink {theirs_s:.2f} s, "
        f"ours {ours_s:.2f} s, {theirs_s / ours_s:.1f} times as fast"
    )
    assert our_count == their_count
    assert theirs_s / ours_s >= 10.0


def test_wanted_messages_are_identical_to_pymavlinks(tlog):
    log = mavutil.mavlink_connection(str(tlog))
    compared = 0
    for message in read_tlog(tlog, WANTED):
        m = log.recv_match(type=WANTED)
        fields = {name: getattr(m, name) for name in m.get_fieldnames()}
        expected = Message(m.get_type(), m.get_srcSystem(), m.get_srcComponent(), fields, m._timestamp)
        assert message == expected
        compared += 1
    assert log.recv_match(type=WANTED) is None
    print(f"\n{compared} messages identical")


def test_contents(tlog):
    took_s, counts = seconds(lambda: tlog_contents(tlog))
    print(f"\ncontents of {sum(counts.values())} messages, every checksum: {took_s:.2f} s")
    assert sum(counts.values()) == MESSAGES


def test_memory_is_flat(tlog):
    """What is allocated does not grow with the file."""
    peaks = []
    for part in (10, 1):
        short = tlog.with_name(f"part-{part}.tlog")
        with tlog.open("rb") as whole:
            short.write_bytes(whole.read(tlog.stat().st_size // part))
        tracemalloc.start()
        for _ in read_tlog(short, WANTED):
            pass
        peaks.append(tracemalloc.get_traced_memory()[1] / 1e6)
        tracemalloc.stop()
    print(f"\npeak memory: {peaks[0]:.1f} MB for a tenth of the file, {peaks[1]:.1f} MB for the whole")
    assert peaks[1] < 1.2 * peaks[0]


def test_journal(tmp_path):
    laser, gimbal = Source("DISTANCE_SENSOR", 154, 1, 100), Source("GIMBAL_DEVICE_ATTITUDE_STATUS", 154)
    events: list[Any] = []
    for i in range(size(30_000, 300)):
        time_s = 0.0371 * i
        events += [
            PositionReading(time_s, 0.1 + i, 0.2 - i, 119.73, 14.31, -3.77, 0.013),
            RangeReading(time_s, 233.642 + 0.001 * i, laser, 0.8, 0.9),
            GimbalReading(time_s, (0.7071, 0.1234567, -0.25, 0.001 * i), "earth", gimbal),
        ]

    def write() -> None:
        with JournalWriter(tmp_path / "journal.jsonl", Header("bench", {}, None, {}), pytest.fail) as journal:
            for event in events:
                journal.write(event)

    write_s, _ = seconds(write)
    types = [PositionReading, RangeReading, GimbalReading]
    read_s, read = seconds(lambda: list(JournalReader(tmp_path / "journal.jsonl", types)))
    print(f"\njournal: {len(events) / write_s:,.0f} events/s written, {len(events) / read_s:,.0f} events/s read")
    assert read == events
    assert len(events) / write_s >= 30_000
    assert len(events) / read_s >= 50_000

"""A recorded flight as MISB ST 0601 metadata, read back by a library that did not write it."""

from __future__ import annotations

import math
from datetime import UTC, datetime
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from sidelong.app.commands.export import write_export
from sidelong.app.errors import InputError
from sidelong.app.records.export import Format
from sidelong.app.records.klv import KlvLog, UasMetadata
from sidelong.estimators.frames import LocalPlane
from sidelong.estimators.sensing.readings import AttitudeReading, GimbalReading, PositionReading, RangeReading, Source
from sidelong.estimators.tracking.tracker import Tracker, TrackerSettings

klvdata = pytest.importorskip("klvdata", reason="klvdata is not installed (the dev extra has it)")
stanag4609 = pytest.importorskip("stanag4609")

PLANE = LocalPlane(47.4, 8.5)
BOOTED = datetime(2026, 11, 21, 9, 0, 0, tzinfo=UTC)
DATA = Path(__file__).parents[1] / "data"
_KEY, _STAMP = bytes.fromhex("060e2b34020b01010e01030101000000"), b"\x02\x08"  # of a set; its time stamp comes first
_BLACK = np.zeros((180, 320, 3), np.uint8)


def packets(path: Path) -> list[dict[int, str]]:
    """Return the values of each packet by their tags, as klvdata understands them."""
    return [
        {tag: value for tag, (*_, value) in packet.MetadataList().items()}
        | {48: str(packet.items[b"\x30"].items[b"\x01"].value.value)}
        for packet in klvdata.StreamParser(path.read_bytes())
    ]


@pytest.fixture
def flown(tmp_path) -> list[dict[int, str]]:
    """Five seconds eastward, banked to the right, next to a target that stands 200 m to the south."""
    metadata = UasMetadata("a flight", PLANE, BOOTED, 488.0, (math.radians(20.0), math.radians(11.3)))
    log = KlvLog(tmp_path / "flight.klv", metadata, Tracker(TrackerSettings()))
    laser, gimbal = Source("DISTANCE_SENSOR", 154, 1, 100), Source("GIMBAL_DEVICE_ATTITUDE_STATUS", 154)
    down_rad = math.atan2(120.0, 200.0)
    half_yaw, half_pitch = math.pi / 2, -down_rad / 2
    sight = (
        math.cos(half_yaw) * math.cos(half_pitch),
        -math.sin(half_yaw) * math.sin(half_pitch),
        math.cos(half_yaw) * math.sin(half_pitch),
        math.sin(half_yaw) * math.cos(half_pitch),
    )
    for tick in range(51):
        time_s = 10.0 + tick / 10.0
        log.event(AttitudeReading(time_s, math.radians(20.0), 0.0, math.pi / 2))
        log.event(PositionReading(time_s, 0.0, 0.0, 120.0, 10.0, 0.0, 0.0))
        log.event(GimbalReading(time_s, sight, "earth", gimbal))
        log.event(RangeReading(time_s, math.hypot(120.0, 200.0), laser, 0.8, 0.9))
    log.close()
    return packets(tmp_path / "flight.klv")


def test_the_metadata_reports_where_everything_was(flown):
    last = {tag: float(value) for tag, value in flown[-1].items() if tag not in {2, 3, 10, 11, 12, 48}}
    assert (last[13], last[14]) == pytest.approx((47.4, 8.5), abs=1e-6)
    assert last[15] == pytest.approx(488.0 + 120.0, abs=0.5)
    assert (last[5], last[91], last[56]) == pytest.approx((90.0, 20.0, 10.0), abs=0.01)
    assert last[21] == pytest.approx(math.hypot(120.0, 200.0), abs=0.5)
    for latitude, longitude in ((23, 24), (40, 41)):
        assert PLANE.east_north_m(last[latitude], last[longitude]) == pytest.approx((0.0, -200.0), abs=3.0)
    assert last[42] == pytest.approx(488.0, abs=3.0)
    assert 0.1 < last[45] < 10.0


def test_the_sensor_looks_off_the_right_wing_lower_than_the_wing_does(flown):
    # 31 degrees below the horizon abeam, in a bank of 20 degrees to that side: 11 degrees below the wing.
    azimuth_deg, elevation_deg = float(flown[-1][18]), float(flown[-1][19])
    assert azimuth_deg == pytest.approx(90.0, abs=0.1)
    assert elevation_deg == pytest.approx(20.0 - math.degrees(math.atan2(120.0, 200.0)), abs=0.1)


def test_the_metadata_has_the_minimum_of_st_0902(flown):
    minimum = {2, 3, 5, 10, 11, 12, 13, 14, 15, 16, 17, 18, 19, 20, 21, 22, 23, 24, 25, 48, 65, 90, 91}
    assert minimum - set(flown[-1]) == set()
    last = flown[-1]
    assert last[48] == str(b"\x01")  # unclassified
    assert float(last[22]) == pytest.approx(2.0 * float(last[21]) * math.tan(math.radians(10.0)), abs=0.5)


def test_a_verifier_of_the_standards_finds_no_error_in_an_export_next_to_pictures(flown, tmp_path):
    pytest.importorskip("av")
    from sidelong.app.camera.video import VideoOutput  # noqa: PLC0415  # an extra

    output, exported = VideoOutput(5.0, tmp_path / "a.ts"), (tmp_path / "flight.klv").read_bytes()
    for body in exported.split(_KEY)[1:]:
        stamp_us = int.from_bytes(body[body.index(_STAMP) + len(_STAMP) :][:8])
        output.put(_BLACK, stamp_us * 1e-6 - BOOTED.timestamp(), stamp_us, _KEY + body)
    output.close()
    verifier = stanag4609.FMVVerifier()
    verifier.feed((tmp_path / "a.ts").read_bytes())
    report = verifier.finish()
    assert [one.message for one in report.errors] == []
    assert "st0902.profile" in {one.code for one in report.findings}


def test_a_recorded_log_gives_a_packet_every_fifth_of_a_second(tmp_path):
    whole = (DATA / "px4-follow-walk-and-drive.tlog").read_bytes()
    (tmp_path / "cut.tlog").write_bytes(whole[: len(whole) // 2])
    write_export(tmp_path / "cut.tlog", Format.KLV, tmp_path / "flight.klv")
    found = packets(tmp_path / "flight.klv")
    times = [datetime.fromisoformat(values[2]) for values in found]
    assert 450 < (times[-1] - times[0]).total_seconds() < 480
    assert all(0.0 < (later - earlier).total_seconds() < 1.0 for earlier, later in pairwise(times))
    assert sum(40 in values for values in found) > 0.9 * len(found)


def test_a_log_without_the_time_of_day_is_refused(tmp_path, sender):
    pack = sender()
    (tmp_path / "bare.tlog").write_bytes(
        b"".join(
            bytes(8) + frame for i in range(1, 100) for frame in (pack.attitude(i * 100), pack.position(i * 100))
        )
    )
    with pytest.raises(InputError, match="time of day"):
        write_export(tmp_path / "bare.tlog", Format.KLV, tmp_path / "flight.klv")

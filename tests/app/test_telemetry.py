"""MAVLink fields into readings: units, signs, frames, and what is passed over."""

from __future__ import annotations

import math
from types import SimpleNamespace

import pytest

from sidelong.app.link.telemetry import Telemetry
from sidelong.app.link.vehicle import Vehicle
from sidelong.estimators.sensing.readings import (
    BEACON_MESSAGES,
    AttitudeReading,
    GimbalReading,
    PositionReading,
    RangeReading,
    TargetFixReading,
)
from sidelong.mission.core.events import ModeReported, WindReported
from tests.messages import gimbal, heartbeat, laser, message, position


@pytest.fixture
def telemetry() -> Telemetry:
    decoder = Telemetry(1)
    decoder.event(position())
    return decoder


def test_the_first_fix_is_the_origin_and_north_is_north():
    decoder = Telemetry()
    origin = decoder.event(position())
    assert isinstance(origin, PositionReading)
    assert (origin.east_m, origin.north_m, origin.height_m) == (0.0, 0.0, 120.0)
    assert (origin.velocity_east_m_s, origin.velocity_north_m_s, origin.velocity_up_m_s) == (-4.0, 3.0, -0.5)
    moved = decoder.event(position(10_100, lat=474_000_000 + 8_993))
    assert moved.north_m == pytest.approx(100.0, abs=0.1)
    assert moved.east_m == pytest.approx(0.0, abs=1e-6)


def test_who_begins_to_listen_between_two_positions_knows_the_place_at_once():
    vehicle, decoder = Vehicle(SimpleNamespace(system_id=1, own_id=(245, 190))), Telemetry(1)
    vehicle.take(position())
    vehicle.listen(decoder.event, "GLOBAL_POSITION_INT")
    assert decoder.plane is not None
    vehicle.take(position(10_100))
    assert decoder.now_s == 10.1


@pytest.mark.parametrize(("lat", "lon"), [(0, 0), (-312, 4_051)])
def test_no_fix_is_no_position(lat, lon):
    decoder = Telemetry()
    assert decoder.event(position(lat=lat, lon=lon)) is None
    assert decoder.plane is None


def test_another_vehicle_is_not_ours(telemetry):
    assert telemetry.event(position()._replace(system_id=2)) is None


@pytest.mark.parametrize(
    ("autopilot", "custom_mode", "name"),
    [(3, 10, "AUTO"), (3, 11, "RTL"), (12, 0x04040000, "MISSION"), (3, 99, "mode 99")],
)
def test_modes_have_their_autopilots_names(telemetry, autopilot, custom_mode, name):
    assert telemetry.event(heartbeat(autopilot, custom_mode)) == ModeReported(10.0, name, True)


def test_a_payloads_heartbeat_is_no_mode(telemetry):
    assert telemetry.event(heartbeat(8, 0, component=154)) is None


def test_a_slant_range_comes_in_metres_with_its_source(telemetry):
    reading = telemetry.event(laser())
    assert isinstance(reading, RangeReading)
    assert reading.slant_range_m == pytest.approx(234.62)
    assert reading.quality == pytest.approx(0.9)
    assert reading.sigma_m is None
    assert (reading.source.component_id, reading.source.sensor_id, reading.source.orientation) == (154, 1, 100)


@pytest.mark.parametrize(
    "nothing",
    [
        {"current_distance": 0},
        {"current_distance": 65_500},  # the greatest
        {"current_distance": 65_501},
        {"current_distance": 50},
        {"signal_quality": 1},
    ],
)
def test_a_laser_without_an_echo_is_no_range(telemetry, nothing):
    assert telemetry.event(laser(**nothing)) is None


def test_a_reported_covariance_is_a_sigma(telemetry):
    assert telemetry.event(laser(covariance=25)).sigma_m == pytest.approx(0.05)


def test_delta_yaw_turns_a_sight_to_north_unless_it_is_not_the_heading(telemetry):
    telemetry.event(message("ATTITUDE", time_boot_ms=10_000, roll=0.0, pitch=0.0, yaw=1.0))
    turned = telemetry.event(gimbal(4 | 8 | 32, delta_yaw=1.2))
    assert turned.frame == "earth"
    assert turned.quaternion_wxyz == pytest.approx((math.cos(0.6), 0.0, 0.0, math.sin(0.6)))
    for unknown in (0.0, math.nan, -2.0, None):  # left out, not known, another heading, not known in JSON
        assert telemetry.event(gimbal(4 | 8 | 32, delta_yaw=unknown)).frame == "vehicle"
    assert telemetry.event(gimbal(32, delta_yaw=1.2)).frame == "body"


def test_target_absolute_is_a_fix_like_a_beacons(telemetry):
    fields = {"id": 3, "sensor_capabilities": 1, "lat": 474_000_000 + 8_993, "lon": 85_000_000}
    fix = telemetry.event(message("TARGET_ABSOLUTE", position_std=[2.0, 3.0, 9.0], **fields))
    assert (fix.north_m, fix.sigma_m) == (pytest.approx(100.0, abs=0.1), 3.0)
    assert fix.source.message in BEACON_MESSAGES
    assert telemetry.event(message("TARGET_ABSOLUTE", position_std=[math.nan, 3.0, 9.0], **fields)) is None
    fields["sensor_capabilities"] = 2
    assert telemetry.event(message("TARGET_ABSOLUTE", position_std=[2.0, 3.0, 9.0], **fields)) is None


@pytest.mark.parametrize(
    ("flags", "frame"),
    [(92, "earth"), (16 | 12, "earth"), (32 | 12, "vehicle"), (12, "vehicle"), (32, "body"), (0, "body")],
)
def test_the_gimbals_frame_follows_its_flags(telemetry, flags, frame):
    reading = telemetry.event(gimbal(flags))
    assert isinstance(reading, GimbalReading)
    assert reading.frame == frame


@pytest.mark.parametrize("q", [[math.nan] * 4, [None] * 4, [0.0] * 4])
def test_an_unknown_line_of_sight_is_none(telemetry, q):
    assert telemetry.event(gimbal(92, q=q)) is None


def test_winds_blow_where_they_go(telemetry):
    arduplane = telemetry.event(message("WIND", direction=270.0, speed=5.0, speed_z=0.0))
    assert isinstance(arduplane, WindReported)
    assert (arduplane.east_m_s, arduplane.north_m_s) == (pytest.approx(5.0), pytest.approx(0.0, abs=1e-9))
    px4 = telemetry.event(message("WIND_COV", wind_x=2.0, wind_y=-1.0))
    assert (px4.east_m_s, px4.north_m_s) == (-1.0, 2.0)


def test_an_attitude_with_nan_is_none(telemetry):
    good = message("ATTITUDE", time_boot_ms=10_100, roll=0.1, pitch=0.2, yaw=0.3)
    assert telemetry.event(good) == AttitudeReading(10.1, 0.1, 0.2, 0.3)
    assert telemetry.event(message("ATTITUDE", time_boot_ms=10_100, roll=None, pitch=0.2, yaw=0.3)) is None


def test_a_single_stamp_does_not_move_the_clock(telemetry):
    telemetry.event(position(10_000 + 3_600_000))
    assert telemetry.now_s == 10.0


@pytest.mark.parametrize("boot_ms", [0xFFFFFFFF, 3_610_000])
def test_a_foreign_stamp_stays_what_it_is(telemetry, boot_ms):
    assert telemetry.event(laser(time_boot_ms=boot_ms)).time_s == pytest.approx(boot_ms * 1e-3, abs=1e-6)


def test_the_clock_goes_on_where_its_32_bits_begin_again():
    decoder = Telemetry(1)
    for boot_ms in range(2**32 - 1_000, 2**32 + 90_000, 100):
        reading = decoder.event(position(boot_ms % 2**32))
        assert reading.time_s == pytest.approx(boot_ms * 1e-3, abs=1e-6)
        if boot_ms == 2**32 + 900:
            assert decoder.event(laser(time_boot_ms=850)).time_s == pytest.approx(2**32 * 1e-3 + 0.85, abs=1e-6)
            late = decoder.event(position(2**32 - 500))
            assert late.time_s == pytest.approx((2**32 - 500) * 1e-3, abs=1e-6)


@pytest.mark.parametrize(
    ("name", "fields"),
    [
        ("WIND", {"direction": 270.0, "speed": 5.0, "speed_z": 0.0}),
        ("WIND_COV", {"wind_x": 2.0, "wind_y": -1.0}),
        ("GPS_RAW_INT", {"fix_type": 0}),
        ("EKF_STATUS_REPORT", {"flags": 0}),
        ("ESTIMATOR_STATUS", {"flags": 0}),
    ],
)
def test_only_the_autopilot_reports_how_it_flies(telemetry, name, fields):
    assert telemetry.event(message(name, **fields)) is not None
    assert telemetry.event(message(name, 154, **fields)) is None
    assert telemetry.event(message(name, system=2, **fields)) is None


@pytest.mark.parametrize(
    ("name", "fields", "fault"),
    [
        ("GPS_RAW_INT", {"fix_type": 3}, ""),
        ("GPS_RAW_INT", {"fix_type": 2}, "fix type 2"),
        ("EKF_STATUS_REPORT", {"flags": 831}, ""),
        ("EKF_STATUS_REPORT", {"flags": 831 | 32768}, "glitch"),
        ("EKF_STATUS_REPORT", {"flags": 167}, "does not know its position"),
        ("ESTIMATOR_STATUS", {"flags": 831}, ""),
        ("ESTIMATOR_STATUS", {"flags": 831 | 1024}, "glitch"),
        ("ESTIMATOR_STATUS", {"flags": 831 & ~16}, "does not know its position"),
        ("ESTIMATOR_STATUS", {"flags": 1023}, ""),  # PX4 on the ground
        ("ESTIMATOR_STATUS", {"flags": 1023 & ~512}, "does not know its position"),
    ],
)
def test_what_gps_and_ekf_say_is_reported_in_words(telemetry, name, fields, fault):
    announced = telemetry.event(message(name, **fields)).fault
    assert fault in announced
    assert bool(fault) == bool(announced)


def test_a_cameras_own_fix_is_used_while_it_tracks(telemetry):
    fields = {"lat": 474_000_000, "lon": 85_000_000, "h_acc": 4.0}
    active = telemetry.event(message("CAMERA_TRACKING_GEO_STATUS", 100, tracking_status=1, **fields))
    assert isinstance(active, TargetFixReading)
    assert active.sigma_m == 4.0
    assert telemetry.event(message("CAMERA_TRACKING_GEO_STATUS", 100, tracking_status=0, **fields)) is None
    assert telemetry.event(message("CAMERA_TRACKING_GEO_STATUS", 1, tracking_status=1, **fields)) is None

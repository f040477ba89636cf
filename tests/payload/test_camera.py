"""A camera that tracks the target: its place in the image is added to the gimbal's attitude."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from sidelong.app.link.telemetry import Telemetry
from sidelong.estimators.rotations import sight_direction
from sidelong.estimators.sensing.readings import GimbalReading
from tests.faulty_payload import FaultyPayload, PayloadFaults
from tests.messages import message

CAMERA = PayloadFaults(yaw_bias_rad=0.0, has_laser=False, view_deg=30.0)


def telemetry_with(**fields) -> tuple[Telemetry, list[GimbalReading]]:
    """Feed a view of 60 by 40 degrees, a gimbal that looks north-east and 20 degrees down, and a place in it."""
    telemetry = Telemetry(1)
    half_yaw, half_pitch = math.radians(45.0) / 2, math.radians(-20.0) / 2
    q = [
        math.cos(half_yaw) * math.cos(half_pitch),
        -math.sin(half_yaw) * math.sin(half_pitch),
        math.cos(half_yaw) * math.sin(half_pitch),
        math.sin(half_yaw) * math.cos(half_pitch),
    ]
    announced = [
        (
            "GLOBAL_POSITION_INT",
            1,
            {"lat": 474_000_000, "lon": 85_000_000, "relative_alt": 0, "vx": 0, "vy": 0, "vz": 0},
        ),
        ("CAMERA_FOV_STATUS", 100, {"hfov": 60.0, "vfov": 40.0}),
        ("GIMBAL_DEVICE_ATTITUDE_STATUS", 154, {"q": q, "flags": 92, "gimbal_device_id": 0}),
        ("CAMERA_TRACKING_IMAGE_STATUS", 100, {"tracking_status": 1, "tracking_mode": 1} | fields),
    ]
    events = [telemetry.event(message(name, part, time_boot_ms=5000, **one)) for name, part, one in announced]
    return telemetry, [one for one in events if isinstance(one, GimbalReading)]


def angles_deg(reading: GimbalReading) -> tuple[float, float]:
    north, east, down = sight_direction(reading.quaternion_wxyz)
    return math.degrees(math.atan2(east, north)), math.degrees(math.atan2(down, math.hypot(north, east)))


@pytest.mark.parametrize(
    ("x", "y", "expected_deg"),
    [(0.5, 0.5, (45.0, 20.0)), (0.5, 1.0, (45.0, 40.0)), (0.5, 0.0, (45.0, 0.0))],
)
def test_place_in_the_image_adds_to_the_gimbals_attitude(x, y, expected_deg):
    _, (gimbal, target) = telemetry_with(point_x=x, point_y=y)
    assert target.source.message == "CAMERA_TRACKING_IMAGE_STATUS"
    assert target.time_s == gimbal.time_s
    assert angles_deg(target) == pytest.approx(expected_deg, abs=1e-6)


def test_target_at_the_right_edge_is_half_the_view_to_the_right():
    _, (gimbal, target) = telemetry_with(point_x=1.0, point_y=0.5)
    first, second = (sight_direction(one.quaternion_wxyz) for one in (gimbal, target))
    assert math.degrees(math.acos(np.dot(first, second))) == pytest.approx(30.0, abs=1e-6)
    assert angles_deg(target)[0] > 45.0


def test_rectangle_counts_by_its_middle_and_a_lost_target_does_not_count():
    corners = {"rec_top_x": 0.4, "rec_bottom_x": 0.6, "rec_top_y": 0.9, "rec_bottom_y": 1.1}
    _, (_, target) = telemetry_with(tracking_mode=2, point_x=math.nan, point_y=math.nan, **corners)
    assert angles_deg(target) == pytest.approx((45.0, 40.0), abs=1e-6)
    assert len(telemetry_with(tracking_status=0, point_x=0.5, point_y=0.5)[1]) == 1
    assert len(telemetry_with(point_x=None, point_y=0.5)[1]) == 1


def test_simulated_image_and_gimbal_show_the_target_together():
    exact = replace(CAMERA, angle_sigma_rad=0.0)
    payload, telemetry = FaultyPayload(exact, np.random.default_rng(1)), telemetry_with(point_x=0.5, point_y=0.5)[0]
    for k in range(20):
        readings = [telemetry.event(one) for one in payload.measure(0.5 * k, 5000 + 100 * k, 150.0, -90.0, -100.0)]
        yaw_deg, depression_deg = angles_deg(readings[-1])
        assert yaw_deg == pytest.approx(math.degrees(math.atan2(150.0, -90.0)), abs=1e-6)
        assert depression_deg == pytest.approx(math.degrees(math.atan2(100.0, math.hypot(150.0, 90.0))), abs=1e-6)

"""A camera that tracks the target: its place in the image is added to the gimbal's attitude."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from sidelong.app.link.telemetry import Telemetry
from sidelong.estimators.rotations import sight_direction
from sidelong.estimators.sensing.readings import GimbalReading
from sidelong.mission.core.inputs import Input, InputState
from tests.faults.flight import FaultedFlight, Flown, Scenario
from tests.faults.flight_faults import Change, Fault, only, repeated, with_fields
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


TRACKER = ("CAMERA_TRACKING_IMAGE_STATUS",)
BEGIN_S = 30.0


def flown_with(change: Change, ground_m: float = 0.0, seed: int = 1) -> Flown:
    """Fly without a laser over flat ground; ``ground_m``: its true height against home."""

    class Flight(FaultedFlight):
        def payload(self, rng):
            payload = FaultyPayload(CAMERA, rng)
            measure = payload.measure
            payload.measure = lambda time_s, boot_ms, east_m, north_m, up_m, **how: measure(
                time_s, boot_ms, east_m, north_m, up_m + ground_m, **how
            )
            return payload

    fault = Fault("camera", BEGIN_S, math.inf, change)
    flat = {"terrain": {"flat": True, "sigma_m": 2.0}}
    return Flight(Scenario(seed, "px4", 120.0), [fault], configured=flat).fly()


def reported(flown: Flown) -> list[tuple[float, str]]:
    return [
        (time_s, one.text)
        for time_s, one in flown.health
        if one.input is Input.SIGHTINGS and one.state is InputState.INCONSISTENT
    ]


def twice_the_view(message, _since_s, _rng):
    return with_fields(message, hfov=60.0, vfov=60.0)


def mirrored(message, _since_s, _rng):
    return with_fields(message, point_x=1.0 - message.fields["point_x"])


CAMERA_FAULTS = {
    "twice the field of view": only(("CAMERA_FOV_STATUS",), twice_the_view),
    "image mirrored": only(TRACKER, mirrored),
    "place in the image frozen": repeated(TRACKER, "point_x"),
    "image 1.5 s late": lambda one, _since_s, _rng: iter([(1.5 if one.name in TRACKER else 0.0, one)]),
}


@pytest.mark.parametrize("name", CAMERA_FAULTS)
def test_camera_that_contradicts_the_ground_is_reported(name):
    flown = flown_with(CAMERA_FAULTS[name])
    time_s, text = reported(flown)[0]
    assert time_s <= BEGIN_S + 60.0
    assert "the camera's field of view" in text
    assert flown.unknown_s >= 120.0 - time_s - 1.0


def test_camera_that_locks_on_another_target_is_reported():
    """At the left edge of the image instead of its middle: about 60 m away."""

    def elsewhere(message, _since_s, _rng):
        return with_fields(message, point_x=message.fields["point_x"] - 0.35)

    announced = flown_with(only(TRACKER, elsewhere)).announced
    at_s = [time_s for time_s, text in announced if "the payload may follow another object" in text]
    assert at_s[0] == pytest.approx(BEGIN_S, abs=10.0)


def test_ground_at_another_height_is_reported_without_a_laser():
    flown = flown_with(lambda one, _since_s, _rng: iter([(0.0, one)]), ground_m=-50.0)
    (_, text), *_ = reported(flown)
    assert "degrees too low for a target on the ground" in text


@pytest.mark.parametrize("ground_m", [-4.0, 4.0])
def test_camera_over_ground_that_is_off_as_usual_is_not_reported(ground_m):
    flown = flown_with(lambda one, _since_s, _rng: iter([(0.0, one)]), ground_m)
    assert not flown.health


def test_axis_of_the_gimbal_does_not_replace_a_camera_that_has_lost_the_target():
    flown = flown_with(only(TRACKER, lambda one, _since_s, _rng: with_fields(one, tracking_status=0)))
    unseen_s = max(one.unseen_s for one in flown.decided if one.time_s > BEGIN_S)
    assert unseen_s > 15.0
    assert any("has not been seen" in text for _, text in flown.announced)
    assert flown.unknown_s >= 60.0

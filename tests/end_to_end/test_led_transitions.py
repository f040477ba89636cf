"""Transitions flown by one circle a second, with guidance laws of the simulator that share nothing with the core."""

import math

import numpy as np
import pytest

from sidelong.mission.core.circle import Circle
from sidelong.mission.core.plan import AircraftState, Plan
from sidelong.mission.exchange.orbit_command import leading_circle
from sidelong.mission.geometry.approach import turn_straight_turn
from sidelong.mission.paper.transition import abcd, stretched_lap
from sidelong.sitl.arduplane import L1Guidance
from sidelong.sitl.px4 import PathFollower
from sidelong.sitl.world.airframe import AirframeParameters, SimulatedAirframe, WindVector

STEP_S, GRAVITY_M_S2, AIRSPEED_M_S, RADIUS_M = 0.02, 9.80665, 15.0, 70.0
BANK_MAX_RAD = math.radians(45.0)
TOLERANCE_M = 12.0


def state_of(craft, time_s):
    speed_m_s = math.hypot(craft.velocity_east_m_s, craft.velocity_north_m_s)
    course_rad = math.atan2(craft.velocity_east_m_s, craft.velocity_north_m_s)
    curvature_per_m = GRAVITY_M_S2 * math.tan(craft.roll_rad) / speed_m_s**2
    return AircraftState(time_s, craft.east_m, craft.north_m, course_rad, speed_m_s, curvature_per_m)


def fly(plan, autopilot, wind):
    """Return the flown places, and the circles that were commanded."""
    path = plan.transition
    craft = SimulatedAirframe(AirframeParameters(), wind)
    craft.flying, craft.airspeed_m_s, craft.height_m = True, AIRSPEED_M_S, 100.0
    course_rad = float(path.course_rad[0])
    across_m_s = wind.east_m_s * math.cos(course_rad) - wind.north_m_s * math.sin(course_rad)
    along_m_s = wind.east_m_s * math.sin(course_rad) + wind.north_m_s * math.cos(course_rad)
    speed_m_s = along_m_s + math.sqrt(AIRSPEED_M_S**2 - across_m_s**2)
    craft.heading_rad = course_rad - math.asin(across_m_s / AIRSPEED_M_S)
    craft.east_m, craft.north_m = float(path.east_m[0]), float(path.north_m[0])
    craft.velocity_east_m_s = speed_m_s * math.sin(course_rad)
    craft.velocity_north_m_s = speed_m_s * math.cos(course_rad)
    craft.roll_rad = math.atan(speed_m_s**2 * float(path.curvature_per_m[0]) / GRAVITY_M_S2)
    circling = (L1Guidance() if autopilot == "arduplane" else PathFollower()).towards_circle
    places, circles = [], []
    for step in range(int(1.5 * path.length_m / AIRSPEED_M_S / STEP_S)):
        if step % 50 == 0 and (not circles or circles[-1] != plan.circle):
            circles.append(leading_circle(plan, state_of(craft, step * STEP_S), BANK_MAX_RAD) or plan.circle)
        circle = circles[-1]
        places.append((craft.east_m, craft.north_m))
        lateral_m_s2 = circling(craft, (circle.east_m, circle.north_m), circle.radius_m, circle.clockwise)
        roll_rad = max(-BANK_MAX_RAD, min(BANK_MAX_RAD, math.atan(lateral_m_s2 / GRAVITY_M_S2)))
        craft.fly(STEP_S, roll_rad, craft.airspeed_m_s, 0.0)
    return np.array(places), circles


def max_distance_m(places, plan):
    path, circle = plan.transition, plan.circle
    from_path_m = np.min(np.hypot(places[:, 0, None] - path.east_m, places[:, 1, None] - path.north_m), axis=1)
    from_circle_m = np.abs(np.hypot(places[:, 0] - circle.east_m, places[:, 1] - circle.north_m) - circle.radius_m)
    return float(np.max(np.minimum(from_path_m, from_circle_m)))


def plans():
    present = Circle(0.0, 0.0, RADIUS_M, True)
    for new, shape in (
        (Circle(300.0, 340.0, RADIUS_M, True), abcd),
        (Circle(-140.0, 60.0, RADIUS_M, True), stretched_lap),
    ):
        yield Plan(new, shape(present, new), 0.0)
    start = AircraftState(0.0, 0.0, RADIUS_M, math.pi / 2, AIRSPEED_M_S, 1.0 / RADIUS_M)
    far = Circle(700.0, -300.0, RADIUS_M, False)
    yield Plan(far, turn_straight_turn(start, far, RADIUS_M), 0.0)


@pytest.mark.parametrize("wind", [WindVector(), WindVector(3.0, -2.0)])
@pytest.mark.parametrize("autopilot", ["arduplane", "px4"])
@pytest.mark.parametrize("plan", list(plans()), ids=["abcd", "stretched", "turns"])
def test_the_flown_line_stays_next_to_the_plan_and_ends_on_its_circle(plan, autopilot, wind):
    places, circles = fly(plan, autopilot, wind)
    assert circles[-1] == plan.circle
    assert max_distance_m(places, plan) <= TOLERANCE_M
    min_m = AIRSPEED_M_S**2 / (GRAVITY_M_S2 * math.tan(BANK_MAX_RAD))
    for circle in circles:  # what is left to itself is near, and no wider than is useful
        assert 0.5 * min_m <= circle.radius_m <= 4.0 * RADIUS_M + 1.0


def test_a_plan_that_is_only_a_circle_is_commanded_as_it_is():
    here = AircraftState(0.0, 0.0, 0.0, 0.0, AIRSPEED_M_S, 0.0)
    assert leading_circle(Plan(Circle(50.0, 0.0, RADIUS_M, True)), here, BANK_MAX_RAD) is None

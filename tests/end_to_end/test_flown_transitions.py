"""Waypoints laid out by the core, flown by the simulator's own guidance laws, which share nothing with it."""

import math
from collections.abc import Callable

import numpy as np
import pytest

from sidelong.app.autopilots.arduplane import ArduPlane
from sidelong.app.autopilots.px4 import Px4
from sidelong.mission.core.circle import Circle
from sidelong.mission.core.path import Path
from sidelong.mission.core.requirement import Wind
from sidelong.mission.paper.transition import abcd, stretched_lap
from sidelong.mission.upload.items import lay_out
from sidelong.mission.upload.line_tracking import LineTracking
from sidelong.sitl.arduplane import L1Guidance
from sidelong.sitl.px4 import PathFollower
from sidelong.sitl.world.airframe import AirframeParameters, SimulatedAirframe
from sidelong.sitl.world.airframe import WindVector as Air

arduplane, px4 = ArduPlane().tracking, Px4().tracking

_STEP_S = 0.02
NAV_ACC_RAD_M = 10.0
_BANK_MAX_RAD = math.radians(45.0)

Point = tuple[float, float]


def airframe_at_start(path: Path, tracking: LineTracking) -> SimulatedAirframe:
    wind, course_rad, airspeed_m_s = tracking.wind, float(path.course_rad[0]), tracking.airspeed_m_s
    craft = SimulatedAirframe(AirframeParameters(), Air(wind.east_m_s, wind.north_m_s))
    across_m_s = wind.east_m_s * math.cos(course_rad) - wind.north_m_s * math.sin(course_rad)
    along_m_s = wind.east_m_s * math.sin(course_rad) + wind.north_m_s * math.cos(course_rad)
    speed_m_s = along_m_s + math.sqrt(airspeed_m_s**2 - across_m_s**2)
    craft.flying, craft.airspeed_m_s, craft.height_m = True, airspeed_m_s, 100.0
    craft.heading_rad = course_rad - math.asin(across_m_s / airspeed_m_s)
    craft.east_m, craft.north_m = float(path.east_m[0]), float(path.north_m[0])
    craft.velocity_east_m_s = speed_m_s * math.sin(course_rad)
    craft.velocity_north_m_s = speed_m_s * math.cos(course_rad)
    craft.roll_rad = math.atan(speed_m_s * airspeed_m_s * float(path.curvature_per_m[0]) / 9.80665)
    return craft


def fly(
    craft: SimulatedAirframe,
    autopilot: str,
    present: Circle,
    waypoints: tuple[Point, ...],
    new: Circle,
    reach_m: float,
    duration_s: float,
) -> np.ndarray:
    """Return the flown places. ArduPlane comes from the circle's centre, PX4 from where it is."""
    l1, follower = L1Guidance(), PathFollower()
    here = (craft.east_m, craft.north_m)
    previous, leg, places = ((present.east_m, present.north_m) if autopilot == "arduplane" else here), 0, []
    for _ in range(int(duration_s / _STEP_S)):
        here = (craft.east_m, craft.north_m)
        places.append(here)
        if leg == len(waypoints):
            centre_m = (new.east_m, new.north_m)
            circling = l1.towards_circle if autopilot == "arduplane" else follower.towards_circle
            lateral_m_s2 = circling(craft, centre_m, new.radius_m, new.clockwise)
        else:
            goal = waypoints[leg]
            passed = float(np.dot(np.subtract(goal, previous), np.subtract(here, goal))) >= 0.0
            if autopilot == "arduplane":
                lateral_m_s2 = l1.towards_line(craft, previous, goal, _STEP_S)
                done = passed or math.dist(here, goal) <= reach_m
            else:
                lateral_m_s2 = follower.towards_line(craft, previous if leg else here, goal)
                done = (passed and leg > 0) or math.dist(here, goal) <= NAV_ACC_RAD_M
            if done:
                previous, leg = goal, leg + 1
        roll_rad = max(-_BANK_MAX_RAD, min(_BANK_MAX_RAD, math.atan(lateral_m_s2 / 9.80665)))
        craft.fly(_STEP_S, roll_rad, craft.airspeed_m_s, 0.0)
    return np.array(places)


def max_distance_m(places: np.ndarray, path: Path, circle: Circle) -> float:
    from_path_m = np.min(np.hypot(places[:, 0, None] - path.east_m, places[:, 1, None] - path.north_m), axis=1)
    from_circle_m = np.abs(np.hypot(places[:, 0] - circle.east_m, places[:, 1] - circle.north_m) - circle.radius_m)
    late = np.arange(len(places)) > len(places) / 2
    return float(np.max(np.where(late, np.minimum(from_path_m, from_circle_m), from_path_m)))


@pytest.mark.parametrize("wind", [Wind(), Wind(3.0, -2.0)])
@pytest.mark.parametrize("clockwise", [True, False])
@pytest.mark.parametrize(("autopilot", "tracking_of"), [("arduplane", arduplane), ("px4", px4)])
def test_the_flown_line_keeps_the_tolerance(
    autopilot: str, tracking_of: Callable[[float, Wind], LineTracking], clockwise: bool, wind: Wind
) -> None:
    present = Circle(0.0, 0.0, 70.0, clockwise)
    tracking = tracking_of(15.0, wind)
    for new, shape in (
        (Circle(300.0, 340.0, 70.0, clockwise), abcd),
        (Circle(-140.0, 60.0, 70.0, clockwise), stretched_lap),
    ):
        path = shape(present, new)
        waypoints = lay_out(path, new, tracking, 8.0)
        duration_s = 1.2 * path.length_m / 15.0
        craft = airframe_at_start(path, tracking)
        places = fly(craft, autopilot, present, waypoints, new, round(tracking.switch_m), duration_s)
        assert max_distance_m(places, path, new) <= 10.0

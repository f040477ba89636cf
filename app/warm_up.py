"""Run every compiled function that a flight calls from Python, so that nothing compiles or loads in flight.

A test flies and fails if a kernel is called in flight with arguments that the warm-up has not run.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from sidelong.estimators.estimate import TargetEstimate, TrackQuality
from sidelong.estimators.sensing.sighting import Sighting
from sidelong.estimators.tracking.payload_kernel import EARTH, SHARED, Readings, fit_readings, look
from sidelong.estimators.tracking.track import Track
from sidelong.mission.core.circle import Circle
from sidelong.mission.core.path import Path
from sidelong.mission.core.plan import AircraftState, Plan, Planner
from sidelong.mission.core.requirement import Wind
from sidelong.mission.geometry.line_kernel import Trapezoid, laid_out, trapezoid
from sidelong.mission.geometry.progress import nearest_arc_m, point_at
from sidelong.mission.geometry.wind import ground_speeds_m_s
from sidelong.mission.route.progress import RoutePlanner
from sidelong.mission.route.progress_kernel import fresh_progress
from sidelong.mission.route.route import route_of
from sidelong.mission.upload.items import lay_out
from sidelong.mission.upload.line_tracking import LineTracking
from sidelong.mission.viewpoint.course_hold import TargetCourse, courses_made_good_rad

if TYPE_CHECKING:
    from sidelong.estimators.terrain.ground import Ground
    from sidelong.mission.terrain.heights import FlightHeights
    from sidelong.mission.terrain.sight import SightField

_CIRCLE = Circle(-250.0, 0.0, 60.0, clockwise=True)
_TARGET = TargetEstimate(1.0, 0.0, 0.0, 0.0, 0.0, np.eye(4), TrackQuality.GOOD, 1.0)
_HERE = AircraftState(1.0, *_CIRCLE.position_at_course(0.0), 0.0, 15.0, _CIRCLE.curvature_per_m)

MADE_UP_ROUTE = route_of(np.array([-300.0, 300.0]), np.zeros(2))


def warm_up_planner(planner: Planner, beyond_m: float, with_route: bool) -> None:
    """Run what decides and follows a plan.

    Args:
        planner: The planner, which must not be flown afterwards.
        beyond_m: In the last decisions the target is this much farther away, out of the band, so that the planner
            lays out a new circle as well.
        with_route: Whether the target's route is known.
    """
    if with_route and isinstance(planner, RoutePlanner):
        planner.follow(MADE_UP_ROUTE, fresh_progress(MADE_UP_ROUTE.east_m.size))
    shape, plan = _shape(), Plan(_CIRCLE)
    for time_s in (0.0, 0.5, 1.0):
        course_rad = 0.1 * time_s
        east_m, north_m = _CIRCLE.position_at_course(course_rad)
        aircraft = replace(_HERE, time_s=time_s, east_m=east_m, north_m=north_m, course_rad=course_rad)
        planner.decide(aircraft, replace(_TARGET, time_s=time_s, last_sighting_s=time_s), plan, Wind(), 0.5)
        point_at(plan, nearest_arc_m(plan, aircraft), aircraft)
        plan = Plan(_CIRCLE, Path(*laid_out(shape, east_m, north_m, course_rad)), time_s)
    far = replace(_TARGET, east_m=_TARGET.east_m + beyond_m)
    for course_rad in (1.6, 3.1, 4.7, 0.0):
        east_m, north_m = _CIRCLE.position_at_course(course_rad)
        aircraft = replace(_HERE, east_m=east_m, north_m=north_m, course_rad=course_rad)
        if planner.decide(aircraft, far, Plan(_CIRCLE), Wind(), 0.5).plan is not None:
            break


def warm_up_exchange() -> None:
    TargetCourse().update(_TARGET, 1.0)
    courses_made_good_rad(np.zeros(1), np.zeros((1, 2)), np.zeros((1, 2)), np.ones(1), 1.0)
    ground_speeds_m_s(np.zeros(2), 15.0, Wind(1.0, 0.0))
    lay_out(Path(*laid_out(_shape(), *_CIRCLE.position_at_course(0.0), 0.0)), _CIRCLE, LineTracking(), math.inf)


def _shape() -> Trapezoid:
    return trapezoid(_CIRCLE.curvature_per_m, 0.0, 300.0, _CIRCLE.curvature_per_m, 1e-3)


def warm_up_track(track: Track) -> None:
    """Run what estimates the target and the payload's delays. The track must not be flown afterwards."""
    times_s, zero, one = np.arange(4.0), np.zeros(4), np.ones(4)
    positions, sights = np.column_stack([times_s, zero, zero, one, zero]), np.column_stack([times_s, zero, one, zero])
    ranges, noise, none = np.column_stack([times_s, one]), (0.01, 1.0, 0.0, 0.0), (0.0, 0.0)
    readings = Readings(positions, sights, sights, ranges, EARTH, noise, none)
    fit_readings(readings, np.ones(SHARED), np.zeros(SHARED, np.bool_), np.zeros(SHARED), 0.0)
    look(readings, 0.0, np.empty((4, 3)))
    for time_s in (0.0, 0.5, 1.0):
        track.add(_sighting(time_s))
        track.estimate(time_s)
    track.begin_again()
    track.add(_sighting(1.5))


def warm_up_over(ground: Ground, track: Track, heights: FlightHeights, field: SightField) -> None:
    """Run what a flight calls over elevation data only. The track must not be flown afterwards."""
    track.stand_on(ground)
    for time_s in (0.0, 0.5):
        track.add(_sighting(time_s))
        track.estimate(time_s)
    track.begin_again()
    track.add(_sighting(1.0))
    here_m = 0.0, 0.0, 100.0
    ground.cut_m(*here_m, 0.0, 0.3, 500.0)
    ground.sees(here_m, here_m)
    ground.heights_at_m(np.zeros(2), np.zeros(2))
    field.sight(*here_m[:2], 1.0, 0.0, here_m[2])
    heights.expected_m(None, here_m[:2])
    heights.clearance_m(*here_m)
    path = Path(*laid_out(trapezoid(0.0, 0.0, 300.0, _CIRCLE.curvature_per_m, 1e-3), *here_m[:2], 0.0))
    for one in (heights, heights.at(0.0)):  # with a climb from far below
        one.levelled(Plan(_CIRCLE, path), -1e3)


def _sighting(time_s: float) -> Sighting:
    return Sighting(time_s, 270.0, math.pi / 2, 0.3, 1.0, 0.01, 0.01, -250.0, 0.0, 80.0)

"""What one decision looks at: the inner loops."""

from __future__ import annotations

import math
from typing import NamedTuple

from sidelong.estimators.compiled import compiled, inlined
from sidelong.mission.core.path import FloatArray
from sidelong.mission.core.requirement import GRAVITY_M_S2
from sidelong.mission.geometry.line_kernel import (
    OFF_TRACK_M,
    OFF_TRACK_RAD,
    Circling,
    Craft,
    LinePoint,
    arc_point,
    nearest_arc_m,
    point_at,
    remainder,
    turn_radius_m,
)
from sidelong.mission.predictive.rollout_kernel import Air, Doubt
from sidelong.mission.viewpoint.viewpoint_kernel import (
    AIRSPEED_S,
    AIRSPEED_SHARE,
    Estimates,
    Known,
    Wish,
    position_sigma_m,
    velocity_sigma_m_s,
    viewpoint,
)

# The flown airspeed differs from the commanded one by up to a tenth. It is estimated over several laps, so that an
# error of the wind averages out, and taken in steps, since lines are kept for an airspeed.
_AIRSPEED_S, _AIRSPEED_GAP_S, _AIRSPEED_STEP, _AIRSPEED_OFF = 60.0, 2.0, 0.02, 0.16


class Scene(NamedTuple):
    """What one decision looks at: where the present plan will have led by the departure, and the target from there.

    The frame has its origin at the target and its y axis along the watch course; mirror is -1 where left and right
    are swapped. velocity and air are in the frame; start, target, line (5, n), circle and the aircraft's place are in
    the plane. line and circle are those of the present plan, which departed age_s ago; arc_m counts along it as
    :mod:`sidelong.mission.geometry.progress` does. A new plan departs in latency_s. radius_m is that of the circles
    which moves end in, turn_radius_m that of the tightest turn on the way.
    """

    departure_s: float
    arc_m: float
    start: LinePoint
    frame_east_m: float
    frame_north_m: float
    course_rad: float
    mirror: float
    velocity_x_m_s: float
    velocity_y_m_s: float
    air: Air
    doubt: Doubt
    radius_m: float
    turn_radius_m: float
    target: Known
    line: FloatArray
    circle: Circling
    aircraft_east_m: float
    aircraft_north_m: float
    latency_s: float
    age_s: float


@compiled
def flown_airspeed_m_s(
    time_s: float, east_m_s: float, north_m_s: float, wind_m_s: float, craft: Craft, memory: FloatArray
) -> float:
    """Take the velocity through the air, in the order of time, and return the airspeed that is really flown."""
    share = math.hypot(east_m_s, north_m_s) / craft.airspeed_m_s
    since_s = time_s - memory[AIRSPEED_S]
    memory[AIRSPEED_S] = time_s
    if since_s > 0.0:
        share = min(max(share, 1.0 - _AIRSPEED_OFF), 1.0 + _AIRSPEED_OFF)
        new = 1.0 - math.exp(-min(since_s, _AIRSPEED_GAP_S) / _AIRSPEED_S)
        memory[AIRSPEED_SHARE] += new * (share - memory[AIRSPEED_SHARE])
    steps = round((memory[AIRSPEED_SHARE] - 1.0) / _AIRSPEED_STEP)
    flown_m_s = craft.airspeed_m_s * (1.0 + _AIRSPEED_STEP * steps)
    return flown_m_s if flown_m_s > wind_m_s else craft.airspeed_m_s


@compiled
def scene_of(
    time_s: float,
    aircraft: LinePoint,
    speed_m_s: float,
    estimates: Estimates,
    line: FloatArray,
    circle: Circling,
    wind_east_m_s: float,
    wind_north_m_s: float,
    latency_s: float,
    age_s: float,
    target_speed_max_m_s: float,
    craft: Craft,
    wish: Wish,
    memory: FloatArray,
) -> Scene:
    """Return what is to be decided about at time_s, with the aircraft's place, course and curvature.

    line (5, n), circle: of the present plan, which departed age_s ago. latency_s: until another one can depart.
    """
    wind_m_s = math.hypot(wind_east_m_s, wind_north_m_s)
    air_east_m_s = speed_m_s * math.sin(aircraft.course_rad) - wind_east_m_s
    air_north_m_s = speed_m_s * math.cos(aircraft.course_rad) - wind_north_m_s
    airspeed_m_s = flown_airspeed_m_s(time_s, air_east_m_s, air_north_m_s, wind_m_s, craft, memory)
    fastest_m_s = max(airspeed_m_s, craft.airspeed_m_s) + wind_m_s
    # The tightest circle over the ground whose bank stays within the limit where the wind is astern.
    radius_m = max(craft.radius_m, fastest_m_s * fastest_m_s / (GRAVITY_M_S2 * math.tan(craft.bank_max_rad)))
    turn_m = turn_radius_m(radius_m, fastest_m_s, craft)
    arc_m = nearest_arc_m(line, circle, aircraft.east_m, aircraft.north_m, aircraft.course_rad)
    start = point_at(line, circle, arc_m, aircraft.east_m, aircraft.north_m)
    off_m = math.hypot(aircraft.east_m - start.east_m, aircraft.north_m - start.north_m)
    flown_m = speed_m_s * latency_s
    if off_m > OFF_TRACK_M or abs(remainder(aircraft.course_rad - start.course_rad)) > OFF_TRACK_RAD:
        tight_per_m = min(max(aircraft.curvature_per_m, -1.0 / turn_m), 1.0 / turn_m)
        start = arc_point(
            LinePoint(aircraft.east_m, aircraft.north_m, aircraft.course_rad, tight_per_m), 0.0, flown_m
        )
    else:
        arc_m += flown_m
        start = point_at(line, circle, arc_m, aircraft.east_m, aircraft.north_m)
    departure_s, target = time_s + latency_s, estimates.now
    view = viewpoint(start.east_m, start.north_m, estimates, wish, memory)
    # An estimate overshoots when the target turns: a speed beyond the greatest of the target counts only
    # if it is certain.
    sigma_m_s = velocity_sigma_m_s(target)
    target_m_s = math.hypot(target.velocity_east_m_s, target.velocity_north_m_s)
    share = min(1.0, max(target_speed_max_m_s, target_m_s - 2.0 * sigma_m_s) / max(target_m_s, 1e-6))
    east_m_s, north_m_s = share * target.velocity_east_m_s, share * target.velocity_north_m_s
    lead_s = departure_s - target.time_s
    sin_c, cos_c = math.sin(view.course_rad), math.cos(view.course_rad)
    mirror = view.side
    return Scene(
        departure_s,
        arc_m,
        start,
        target.east_m + east_m_s * lead_s,
        target.north_m + north_m_s * lead_s,
        view.course_rad,
        mirror,
        mirror * (east_m_s * cos_c - north_m_s * sin_c),
        east_m_s * sin_c + north_m_s * cos_c,
        Air(
            airspeed_m_s,
            mirror * (wind_east_m_s * cos_c - wind_north_m_s * sin_c),
            wind_east_m_s * sin_c + wind_north_m_s * cos_c,
        ),
        Doubt(position_sigma_m(target), sigma_m_s, view.course_sigma_rad),
        radius_m,
        turn_m,
        target,
        line,
        circle,
        aircraft.east_m,
        aircraft.north_m,
        latency_s,
        age_s,
    )


@inlined
def in_frame(scene: Scene, east_m: float, north_m: float) -> tuple[float, float]:
    """Return a place of the plane as (x, y)."""
    sin_c, cos_c = math.sin(scene.course_rad), math.cos(scene.course_rad)
    east_m, north_m = east_m - scene.frame_east_m, north_m - scene.frame_north_m
    return scene.mirror * (east_m * cos_c - north_m * sin_c), east_m * sin_c + north_m * cos_c

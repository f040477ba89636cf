"""The scene of a decision: aircraft, wind and plan at the departure, and predicted futures of the target.

The target goes straight on or begins to turn. The course to watch from follows.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from sidelong.estimators.compiled import Record, compiled, inlined, inner
from sidelong.mission.core.path import FloatArray
from sidelong.mission.core.requirement import GRAVITY_M_S2
from sidelong.mission.geometry.line_kernel import (
    OFF_TRACK_M,
    OFF_TRACK_RAD,
    Air,
    Circling,
    Craft,
    LinePoint,
    arc_point,
    nearest_arc_m,
    point_at,
    remainder,
    turn_radius_m,
)
from sidelong.mission.predictive.rollout_kernel import STEP_S, Scenarios, Uncertainty
from sidelong.mission.viewpoint.viewpoint_kernel import (
    MIN_WAY_M,
    Estimates,
    SideRule,
    TargetState,
    made_good_sigma_rad,
    place_at,
    position_sigma_m,
    velocity_sigma_m_s,
    viewpoint,
)

# The flown airspeed differs from the commanded one by up to a tenth. It is estimated over several laps, so that an
# error of the wind averages out, and taken in steps, since lines are kept for an airspeed.
_AIRSPEED_S, _AIRSPEED_GAP_S, _AIRSPEED_STEP, _AIRSPEED_OFF = 60.0, 2.0, 0.02, 0.16


class FlownPlan(NamedTuple):
    """The present plan, which departed age_s ago: its transition (5, n), and its circle."""

    line: FloatArray
    circle: Circling
    age_s: float


class Watcher(NamedTuple):
    """The aircraft that watches, from where, and the target's greatest speed; memory (1,): of ``MEMORY``, changes."""

    craft: Craft
    rule: SideRule
    target_speed_max_m_s: float
    memory: Any


class Scene(NamedTuple):
    """What one decision looks at: where the present plan will have led by the departure, and the target from there.

    The frame has its origin at the target and its y axis along the watch course; mirror is -1 where left and right
    are swapped. velocity and air are in the frame; start, target, present and aircraft are in the plane. arc_m counts
    along the present plan as :mod:`sidelong.mission.geometry.progress` does. A new plan departs in latency_s.
    radius_m is that of the circles which moves end in, turn_radius_m that of the tightest turn on the way.
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
    doubt: Uncertainty
    radius_m: float
    turn_radius_m: float
    target: TargetState
    present: FlownPlan
    aircraft: LinePoint
    latency_s: float


@inner
def flown_airspeed_m_s(
    time_s: float, east_m_s: float, north_m_s: float, wind_m_s: float, craft: Craft, memory: Record
) -> float:
    """Process the velocity through the air (east, north), in order of time; return the mean airspeed in coarse steps.

    It is that of ``craft`` where the wind is as fast.
    """
    share = math.hypot(east_m_s, north_m_s) / craft.airspeed_m_s
    since_s = time_s - memory.airspeed_s
    memory.airspeed_s = time_s
    if since_s > 0.0:
        share = min(max(share, 1.0 - _AIRSPEED_OFF), 1.0 + _AIRSPEED_OFF)
        new = 1.0 - math.exp(-min(since_s, _AIRSPEED_GAP_S) / _AIRSPEED_S)
        memory.airspeed_share += new * (share - memory.airspeed_share)
    steps = round((memory.airspeed_share - 1.0) / _AIRSPEED_STEP)
    flown_m_s = craft.airspeed_m_s * (1.0 + _AIRSPEED_STEP * steps)
    return flown_m_s if flown_m_s > wind_m_s else craft.airspeed_m_s


@compiled
def scene_of(
    time_s: float,
    aircraft: LinePoint,
    speed_m_s: float,
    estimates: Estimates,
    present: FlownPlan,
    wind_m_s: tuple[float, float],
    latency_s: float,
    watcher: Watcher,
) -> Scene:
    """Return what is to be decided about in a wind (east, north); updates the watcher's memory."""
    line, circle, _ = present
    craft, rule, target_speed_max_m_s, memories = watcher
    memory = memories[0]
    wind_east_m_s, wind_north_m_s = wind_m_s
    blows_m_s = math.hypot(wind_east_m_s, wind_north_m_s)
    air_east_m_s = speed_m_s * math.sin(aircraft.course_rad) - wind_east_m_s
    air_north_m_s = speed_m_s * math.cos(aircraft.course_rad) - wind_north_m_s
    airspeed_m_s = flown_airspeed_m_s(time_s, air_east_m_s, air_north_m_s, blows_m_s, craft, memory)
    fastest_m_s = max(airspeed_m_s, craft.airspeed_m_s) + blows_m_s
    # The tightest circle over the ground whose bank stays within the limit where the wind is astern.
    radius_m = max(craft.radius_m, fastest_m_s * fastest_m_s / (GRAVITY_M_S2 * math.tan(craft.bank_max_rad)))
    turn_m = turn_radius_m(radius_m, fastest_m_s, craft)
    arc_m = nearest_arc_m(line, circle, aircraft.east_m, aircraft.north_m, aircraft.course_rad)
    start = point_at(line, circle, arc_m, aircraft.east_m, aircraft.north_m)
    off_m = math.hypot(aircraft.east_m - start.east_m, aircraft.north_m - start.north_m)
    flown_m = speed_m_s * latency_s
    if off_m > OFF_TRACK_M or abs(remainder(aircraft.course_rad - start.course_rad)) > OFF_TRACK_RAD:
        tight_per_m = min(max(aircraft.curvature_per_m, -1.0 / turn_m), 1.0 / turn_m)
        here = LinePoint(aircraft.east_m, aircraft.north_m, aircraft.course_rad, tight_per_m)
        start = arc_point(here, 0.0, flown_m)
    else:
        arc_m += flown_m
        start = point_at(line, circle, arc_m, aircraft.east_m, aircraft.north_m)
    departure_s, target = time_s + latency_s, estimates.now
    view = viewpoint(start.east_m, start.north_m, estimates, rule, memory)
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
        Uncertainty(position_sigma_m(target), sigma_m_s, view.course_sigma_rad),
        radius_m,
        turn_m,
        target,
        present,
        aircraft,
        latency_s,
    )


@inlined
def in_frame(scene: Scene, east_m: float, north_m: float) -> tuple[float, float]:
    """Return a place of the plane as (x, y)."""
    sin_c, cos_c = math.sin(scene.course_rad), math.cos(scene.course_rad)
    east_m, north_m = east_m - scene.frame_east_m, north_m - scene.frame_north_m
    return scene.mirror * (east_m * cos_c - north_m * sin_c), east_m * sin_c + north_m * cos_c


Four = tuple[float, float, float, float]

PREDICTED_S = 110  # longer than any line: after it the watch course is the target's
_SLOW_M_S = 0.5  # the course of such a slow target is meaningless
_SPEED_RINGS = 3  # of the table's classes: standing, half and full speed


class Motions(NamedTuple):
    """How the table's classes are arranged: see ``value_table.TableConfiguration.classes``."""

    follows_course: bool
    wind_speed_m_s: float
    target_speed_max_m_s: float
    wind_directions: int
    target_directions: int


class Turns(NamedTuple):
    """Rates at which the target may begin to turn (f,), the first 0; they fade with this time constant.

    stands: whether a target that has stopped stays where it is. Else it is predicted by what its estimate moves.
    """

    rate_rad_s: FloatArray
    fades_s: float
    stands: bool


@inlined
def classes_about(
    motions: Motions, velocity_x_m_s: float, velocity_y_m_s: float, wind_x_m_s: float, wind_y_m_s: float
) -> tuple[tuple[int, int, int, int], Four, Four]:
    """Return the table's classes about velocities of target and wind, and their shares in V and after a turn.

    Of the wind only the direction counts: its speed is the table's. After a turn the speed before it is forgotten,
    but for that of a target that stood in a sector's table: it has no direction to turn from.
    """
    # Numbers, as parts of arrays that are passed on in a loop count their references at each turn.
    speed_m_s = math.sqrt(velocity_x_m_s * velocity_x_m_s + velocity_y_m_s * velocity_y_m_s)
    speed = min(speed_m_s / motions.target_speed_max_m_s, 1.0) * (_SPEED_RINGS - 1)
    ring = min(int(speed), _SPEED_RINGS - 2)
    outer = speed - ring
    if motions.follows_course and motions.wind_speed_m_s == 0.0:
        return (ring, ring + 1, 0, 0), (1.0 - outer, outer, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0)
    if motions.follows_course:
        directions, angle_rad = motions.wind_directions, math.atan2(wind_x_m_s, wind_y_m_s)
    else:
        directions, angle_rad = motions.target_directions, math.atan2(velocity_x_m_s, velocity_y_m_s)
    direction = angle_rad / (2.0 * math.pi) * directions
    direction -= directions * math.floor(direction / directions)
    first = int(direction)
    past = direction - first
    near, far = first % directions, (first + 1) % directions
    share = (1.0 - outer) * (1.0 - past), (1.0 - outer) * past, outer * (1.0 - past), outer * past
    turned = 1.0 - past, past, 0.0, 0.0
    if motions.follows_course:
        inner, outside = ring * directions, (ring + 1) * directions
        return (inner + near, inner + far, outside + near, outside + far), share, turned
    # The first class is that of the standing target, which has no direction.
    outside = 1 + ring * directions
    if ring == 0:
        return (0, 0, outside + near, outside + far), share, share
    inner = outside - directions
    return (inner + near, inner + far, outside + near, outside + far), share, turned


@compiled
def winding(scene: Scene, motions: Motions, watcher: Watcher, turns: Turns) -> Scenarios:
    """Return futures in which the target keeps its speed and turns, and the course that is watched turns after it.

    There is one for each turn, the first straight on. The running cost is that of the course made good, of the
    present one, or of a fixed one; the table is asked in the frame of the velocity, in which it was computed, or of
    the fixed course.
    """
    memory = watcher.memory[0]
    k = min(PREDICTED_S, math.ceil(8.0 * scene.radius_m / scene.air.airspeed_m_s) + 25)
    speed_m_s = math.hypot(scene.velocity_x_m_s, scene.velocity_y_m_s)
    moving = not memory.standing and speed_m_s > _SLOW_M_S
    # The rest of its velocity is an error of the estimate, which would turn the course that is watched.
    if turns.stands and memory.standing and math.isnan(watcher.rule.fixed_course_rad):
        speed_m_s = 0.0
    f = len(turns.rate_rad_s)
    place, weight = np.zeros((f, k, 4)), np.full(f, 1.0 / f)
    faded_s = np.empty(k)
    for i in range(k):
        faded_s[i] = turns.fades_s * (1.0 - math.exp(-(i + 0.5) * STEP_S / turns.fades_s))
    for one in range(f):
        _turning(scene, speed_m_s, turns.rate_rad_s[one], faded_s, place[one])
    return watched(scene, motions, watcher, moving, weight, place)


@inner
def _turning(scene: Scene, speed_m_s: float, rate_rad_s: float, faded_s: FloatArray, place: FloatArray) -> None:
    """Fill in the places and velocities (k, 4) of a target that begins to turn: by the rate for faded_s (k,)."""
    course_rad = math.atan2(scene.velocity_x_m_s, scene.velocity_y_m_s)
    x_m = y_m = 0.0
    vx, vy = speed_m_s * math.sin(course_rad), speed_m_s * math.cos(course_rad)
    for i in range(len(place)):
        if rate_rad_s != 0.0:
            heading_rad = course_rad + rate_rad_s * faded_s[i]
            vx, vy = speed_m_s * math.sin(heading_rad), speed_m_s * math.cos(heading_rad)
        place[i, 0], place[i, 1], place[i, 2], place[i, 3] = x_m, y_m, vx, vy
        x_m, y_m = x_m + vx * STEP_S, y_m + vy * STEP_S


@compiled
def watched(
    scene: Scene, motions: Motions, watcher: Watcher, moving: bool, weight: FloatArray, place: FloatArray
) -> Scenarios:
    """Return futures of these weights (f,), places and velocities (f, k, 4), with the courses to watch from."""
    horizon_s, fixed = watcher.rule.course_horizon_s, not math.isnan(watcher.rule.fixed_course_rad)
    f, k = place.shape[:2]
    facing, course, classes = np.empty((f, k, 3)), np.empty((f, k, 3)), np.empty((f, k, 4), np.int64)
    found = Scenarios(weight, STEP_S, place, facing, course, classes, np.empty((f, k, 4)), np.empty((f, k, 4)))
    past = np.empty((math.ceil(horizon_s / STEP_S) + 1 if horizon_s > 0.0 and not fixed else 0, 2))
    _watch(scene, motions, watcher, moving, past, found)
    return found


@inner
def _watch(
    scene: Scene, motions: Motions, watcher: Watcher, moving: bool, past: FloatArray, found: Scenarios
) -> None:
    """Fill in the courses to watch from, and the classes. past (n, 2): room for where it was before."""
    horizon_s, place, facing, course = watcher.rule.course_horizon_s, found.place, found.facing, found.course
    classes, share, turn_share = found.classes, found.share, found.turn_share
    air, doubt, fixed = scene.air, scene.doubt, not math.isnan(watcher.rule.fixed_course_rad)
    course_rad = math.atan2(scene.velocity_x_m_s, scene.velocity_y_m_s)
    # Where it was one horizon before each of the first steps.
    for i in range(len(past)):
        east_m, north_m = place_at(watcher.memory[0], scene.departure_s + min(i * STEP_S - horizon_s, 0.0))
        past[i, 0], past[i, 1] = in_frame(scene, east_m, north_m)
    # No sine is taken where a way or a velocity has it: this is done for hundreds of places in each decision.
    position2, velocity2 = doubt.position_m * doubt.position_m, doubt.velocity_m_s * doubt.velocity_m_s
    for one in range(len(place)):
        sin_f, cos_f, facing_rad = 0.0, 1.0, 0.0
        sin_t, cos_t, table_rad = 0.0, 1.0, 0.0
        before_x = before_y = np.nan
        for i in range(place.shape[1]):
            since_s = i * STEP_S
            x_m, y_m, vx, vy = place[one, i, 0], place[one, i, 1], place[one, i, 2], place[one, i, 3]
            sigma_rad = doubt.course_rad
            turns = not fixed and (vx != before_x or vy != before_y)
            before_x, before_y = vx, vy
            if turns and horizon_s > 0.0 and moving:
                table_rad, speed_m_s = math.atan2(vx, vy), math.sqrt(vx * vx + vy * vy)
                sin_t, cos_t = (vx / speed_m_s, vy / speed_m_s) if speed_m_s > 0.0 else (0.0, 1.0)
            elif turns and horizon_s <= 0.0:
                facing_rad = table_rad = math.atan2(vx, vy) - course_rad
                sin_f, cos_f = math.sin(facing_rad), math.cos(facing_rad)
                sin_t, cos_t = sin_f, cos_f
            if horizon_s > 0.0 and not fixed:
                back_s = since_s - horizon_s
                if back_s > 0.0:
                    j = int(back_s / STEP_S)
                    rest_s = back_s - j * STEP_S
                    way_x_m = x_m - place[one, j, 0] - place[one, j, 2] * rest_s
                    way_y_m = y_m - place[one, j, 1] - place[one, j, 3] * rest_s
                else:
                    way_x_m, way_y_m = x_m - past[i, 0], y_m - past[i, 1]
                way_m = math.sqrt(way_x_m * way_x_m + way_y_m * way_y_m)
                if way_m > MIN_WAY_M:
                    sin_f, cos_f = way_x_m / way_m, way_y_m / way_m
                    if not moving:
                        sin_t, cos_t, table_rad = sin_f, cos_f, math.atan2(way_x_m, way_y_m)
                sigma_rad = made_good_sigma_rad(math.sqrt(position2 + velocity2 * since_s * since_s), way_m)
            facing[one, i, 0], facing[one, i, 1], facing[one, i, 2] = sin_f, cos_f, sigma_rad
            course[one, i, 0], course[one, i, 1], course[one, i, 2] = sin_t, cos_t, table_rad
            which, shares, turn_shares = classes_about(
                motions,
                vx * cos_t - vy * sin_t,
                vx * sin_t + vy * cos_t,
                air.wind_x_m_s * cos_t - air.wind_y_m_s * sin_t,
                air.wind_x_m_s * sin_t + air.wind_y_m_s * cos_t,
            )
            for c in range(4):
                classes[one, i, c], share[one, i, c], turn_share[one, i, c] = which[c], shares[c], turn_shares[c]


@compiled
def first_of(f: Scenarios, n: int) -> Scenarios:
    """Return the first n futures alone; the probability of the removed ones is added to the first."""
    weight = np.ones(n)
    weight[1:] = f.weight[1:n]
    others = 0.0
    for one in range(1, n):
        others += weight[one]
    weight[0] -= others
    return Scenarios(
        weight, f.step_s, f.place[:n], f.facing[:n], f.course[:n], f.classes[:n], f.share[:n], f.turn_share[:n]
    )

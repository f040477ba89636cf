"""The inner loops of :mod:`mission.predictive.planner`: a look ahead from a scene, and the move that comes of it."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from estimators.compiled import compiled
from mission.core.path import FloatArray
from mission.geometry._line_kernel import ARC, Circling, Craft, line_at
from mission.predictive._cost_kernel import CostTerms, IntArray, Table
from mission.predictive._moves_kernel import MOVES, STAY_LENGTHS, STEP_S, Kept, lines_from, move_line, ramp_on
from mission.predictive._rollout_kernel import Futures, line_cost, lines_costs, times_s
from mission.predictive._scene_kernel import Scene, in_frame, scene_of
from mission.predictive._sight_kernel import Sight, View, add_sight, sight_cost
from mission.viewpoint._viewpoint_kernel import MIN_WAY_M, STANDING, Known, Wish, made_good_sigma_rad, place_at

FORETOLD_S = 110  # longer than any line: after it the watch course is the target's
_SLOW_M_S = 0.5  # the course of so slow a target tells nothing
# A plan that leads so far beyond the cost's band within so long is no longer one to be committed to.
_THREAT_S, _THREAT_M = 14.0, 0.0
UNCERTAIN_M = 10.0
OTHER_WIND = 0.15  # of the airspeed
MIN_MOVE = 0.4  # of the radius: the length of a transition
# A transition within this of its end counts as flown.
NEARLY_FLOWN_S = 0.2
_SPEED_RINGS = 3  # of the table's classes: standing, half and full speed


class Motions(NamedTuple):
    """How the table's classes are arranged: see :meth:`mission.predictive.value_table.TableConfiguration.classes`."""

    follows_course: bool
    wind_speed_m_s: float
    target_speed_max_m_s: float
    wind_directions: int
    target_directions: int


class Prices(NamedTuple):
    """In seconds off side: of leaving the circle, of changing a plan under way, and of one younger than commit_s."""

    leave: float
    change: float
    commit: float = 0.0
    commit_s: float = 0.0


class Looker(NamedTuple):
    """What a planner knows beforehand, and the memory that it looks with: arrays that change."""

    craft: Craft
    target_speed_max_m_s: float
    wish: Wish
    terms: CostTerms
    table: Table
    motions: Motions
    prices: Prices
    memory: FloatArray
    kept: Kept


@compiled
def target_velocity(scene: Scene) -> tuple[float, float]:
    """Return the target's velocity towards east and north."""
    sin_c, cos_c = math.sin(scene.course_rad), math.cos(scene.course_rad)
    across_m_s, along_m_s = scene.mirror * scene.velocity_x_m_s, scene.velocity_y_m_s
    return across_m_s * cos_c + along_m_s * sin_c, along_m_s * cos_c - across_m_s * sin_c


@compiled
def fill_classes(
    motions: Motions,
    velocity_x_m_s: float,
    velocity_y_m_s: float,
    wind_x_m_s: float,
    wind_y_m_s: float,
    classes: IntArray,
    share: FloatArray,
    turn_share: FloatArray,
) -> None:
    """Fill in the table's classes (4,) about velocities of target and wind, and their shares in V and after a turn.

    Of the wind only the direction counts: its speed is the table's. After a turn the speed before it is forgotten,
    but for that of a target that stood in a sector's table: it has no direction to turn from.
    """
    speed = min(math.hypot(velocity_x_m_s, velocity_y_m_s) / motions.target_speed_max_m_s, 1.0) * (_SPEED_RINGS - 1)
    ring = min(int(speed), _SPEED_RINGS - 2)
    outer = speed - ring
    classes[:], share[:], turn_share[:] = 0, 0.0, 0.0
    if motions.follows_course and motions.wind_speed_m_s == 0.0:
        classes[0], classes[1] = ring, ring + 1
        share[0], share[1], turn_share[0] = 1.0 - outer, outer, 1.0
        return
    if motions.follows_course:
        directions, angle_rad = motions.wind_directions, math.atan2(wind_x_m_s, wind_y_m_s)
    else:
        directions, angle_rad = motions.target_directions, math.atan2(velocity_x_m_s, velocity_y_m_s)
    direction = angle_rad / (2.0 * math.pi) * directions
    direction -= directions * math.floor(direction / directions)
    first = int(direction)
    past = direction - first
    for i in range(4):
        a, b = ring + i // 2, (first + i % 2) % directions
        ring_share, part = outer if i // 2 else 1.0 - outer, past if i % 2 else 1.0 - past
        share[i] = ring_share * part
        if motions.follows_course:
            classes[i] = a * directions + b
            turn_share[i] = 0.0 if i // 2 else part
        else:
            classes[i] = 1 + (a - 1) * directions + b if a else 0
            turn_share[i] = share[i] if ring == 0 else 0.0 if i // 2 else part


@compiled
def going_straight(scene: Scene, motions: Motions) -> Futures:
    """Return the one future in which the target keeps its velocity."""
    place, facing, course = np.zeros((1, 1, 4)), np.zeros((1, 1, 3)), np.zeros((1, 1, 3))
    classes, share, turn_share = np.zeros((1, 1, 4), np.int64), np.zeros((1, 1, 4)), np.zeros((1, 1, 4))
    place[0, 0, 2], place[0, 0, 3] = scene.velocity_x_m_s, scene.velocity_y_m_s
    facing[0, 0, 1] = course[0, 0, 1] = 1.0
    facing[0, 0, 2] = scene.doubt.course_rad
    fill_classes(
        motions,
        scene.velocity_x_m_s,
        scene.velocity_y_m_s,
        scene.air.wind_x_m_s,
        scene.air.wind_y_m_s,
        classes[0, 0],
        share[0, 0],
        turn_share[0, 0],
    )
    return Futures(np.ones(1), STEP_S, place, facing, course, classes, share, turn_share)


@compiled
def winding(scene: Scene, motions: Motions, wish: Wish, memory: FloatArray) -> Futures:
    """Return the one future in which the target keeps its velocity, and the course that it made good turns to it.

    The running cost is that of the course made good; the table is asked in the frame of the velocity, in which it
    was computed.
    """
    k = FORETOLD_S
    place, facing, course = np.zeros((1, k, 4)), np.zeros((1, k, 3)), np.zeros((1, k, 3))
    classes, share, turn_share = np.zeros((1, k, 4), np.int64), np.zeros((1, k, 4)), np.zeros((1, k, 4))
    vx, vy, air, doubt = scene.velocity_x_m_s, scene.velocity_y_m_s, scene.air, scene.doubt
    speed_m_s, course_rad = math.hypot(vx, vy), math.atan2(vx, vy)
    moving = memory[STANDING] == 0.0 and speed_m_s > _SLOW_M_S
    facing_rad = 0.0
    for i in range(k):
        since_s = i * STEP_S
        x_m, y_m = vx * since_s, vy * since_s
        back_s = since_s - wish.course_horizon_s
        if back_s > 0.0:
            before_x_m, before_y_m = vx * back_s, vy * back_s
        else:
            east_m, north_m = place_at(memory, scene.departure_s + back_s)
            before_x_m, before_y_m = in_frame(scene, east_m, north_m)
        way_x_m, way_y_m = x_m - before_x_m, y_m - before_y_m
        way_m = math.hypot(way_x_m, way_y_m)
        if way_m > MIN_WAY_M:
            facing_rad = math.atan2(way_x_m, way_y_m)
        place[0, i, 0], place[0, i, 1], place[0, i, 2], place[0, i, 3] = x_m, y_m, vx, vy
        facing[0, i, 0], facing[0, i, 1] = math.sin(facing_rad), math.cos(facing_rad)
        facing[0, i, 2] = made_good_sigma_rad(math.hypot(doubt.position_m, doubt.velocity_m_s * since_s), way_m)
        table_rad = course_rad if moving else facing_rad
        sin_t, cos_t = math.sin(table_rad), math.cos(table_rad)
        course[0, i, 0], course[0, i, 1], course[0, i, 2] = sin_t, cos_t, table_rad
        fill_classes(
            motions,
            vx * cos_t - vy * sin_t,
            vx * sin_t + vy * cos_t,
            air.wind_x_m_s * cos_t - air.wind_y_m_s * sin_t,
            air.wind_x_m_s * sin_t + air.wind_y_m_s * cos_t,
            classes[0, i],
            share[0, i],
            turn_share[0, i],
        )
    return Futures(np.ones(1), STEP_S, place, facing, course, classes, share, turn_share)


@compiled
def future(scene: Scene, motions: Motions, wish: Wish, memory: FloatArray) -> Futures:
    """Return what is foretold of the target."""
    if wish.course_horizon_s > 0.0 and math.isnan(wish.fixed_course_rad):
        return winding(scene, motions, wish, memory)
    return going_straight(scene, motions)


@compiled
def flown_on(
    scene: Scene, line: FloatArray, circle: Circling, east_m: float, north_m: float, length_m: float
) -> tuple[FloatArray, FloatArray]:
    """Return (x, y, heading) (3, k) in the frame and the times (k,) of flying on along the present plan.

    The aircraft decides at (east, north).
    """
    size = max(2, math.ceil(length_m / (scene.air.airspeed_m_s * STEP_S)) + 1)
    arc = np.empty(size)
    for k in range(size):
        arc[k] = scene.arc_m + k * (length_m / (size - 1))
    found = np.empty((3, size))
    line_at(line, circle, arc, east_m, north_m, found)
    for k in range(size):
        found[0, k], found[1, k] = in_frame(scene, found[0, k], found[1, k])
        found[2, k] = scene.mirror * (found[2, k] - scene.course_rad)
    return found, times_s(found[2], arc, scene.air)


@compiled
def look_ahead(
    scene: Scene,
    east_m: float,
    north_m: float,
    line: FloatArray,
    circle: Circling,
    futures: Futures,
    looker: Looker,
    sight: Sight,
    costs: FloatArray,
) -> float:
    """Fill in what each move costs (MOVES,), its price included, and return what going on as planned costs.

    The aircraft decides at (east, north). A move that hardly leaves the circle is infinitely dear.
    """
    craft, terms, table, motions, kept = looker.craft, looker.terms, looker.table, looker.motions, looker.kept
    prices = looker.prices
    air, radius_m = scene.air, scene.radius_m
    # The table knows nothing of uncertainty, nor of another wind than its own. Where there is much of either, all
    # lines are followed for a lap more: else moves seem cheaper later than they ever turn out.
    wind_m_s = math.hypot(air.wind_x_m_s, air.wind_y_m_s)
    other_wind = abs(wind_m_s - motions.wind_speed_m_s) > OTHER_WIND * air.airspeed_m_s
    doubtful = other_wind or scene.doubt.position_m > UNCERTAIN_M
    beyond_m = 2.0 * math.pi * radius_m if doubtful else 0.0
    rate_per_s = table.discount_per_s + 1.0 / table.mean_leg_s
    x_m, y_m = in_frame(scene, scene.start.east_m, scene.start.north_m)
    heading_rad = scene.mirror * (scene.start.course_rad - scene.course_rad)
    ramp = ramp_on(heading_rad, air, craft)
    start_per_m = scene.mirror * scene.start.curvature_per_m
    lines = lines_from(0.0, scene, start_per_m, ramp, beyond_m, craft, heading_rad, rate_per_s, kept)
    lines_costs(lines, x_m, y_m, heading_rad, futures, scene.doubt, terms, table, costs)
    view = View(scene.course_rad, scene.mirror, scene.velocity_x_m_s, scene.velocity_y_m_s)
    lap_s = 2.0 * math.pi * radius_m / air.airspeed_m_s
    add_sight(lines, x_m, y_m, heading_rad, sight, view, radius_m, lap_s, rate_per_s, costs)
    left_m = line[ARC, line.shape[1] - 1] - scene.arc_m if line.shape[1] > 0 else 0.0
    if left_m > NEARLY_FLOWN_S * air.airspeed_m_s:
        ahead, time_s = flown_on(scene, line, circle, east_m, north_m, left_m + beyond_m)
        costs += prices.change
        hidden = sight_cost(ahead[0], ahead[1], ahead[2], time_s, sight, view, radius_m, lap_s, rate_per_s)
        return hidden + line_cost(ahead[0], ahead[1], ahead[2], time_s, futures, scene.doubt, terms, table)
    for i in range(MOVES):
        # "Back to the circle" is staying, and so is hardly leaving it: the table is not that fine.
        costs[i] = np.inf if lines.end_m[i] < MIN_MOVE * radius_m else costs[i] + prices.leave
    stays = lines_from(
        1.0, scene, scene.mirror / circle.radius_m, ramp, beyond_m, craft, heading_rad, rate_per_s, kept
    )
    stay_costs = np.empty(STAY_LENGTHS.size)
    lines_costs(stays, x_m, y_m, heading_rad, futures, scene.doubt, terms, table, stay_costs)
    add_sight(stays, x_m, y_m, heading_rad, sight, view, radius_m, lap_s, rate_per_s, stay_costs)
    return float(stay_costs.min())


@compiled
def commitment(
    scene: Scene, east_m: float, north_m: float, line: FloatArray, circle: Circling, age_s: float, looker: Looker
) -> float:
    """Return what a new plan must gain beyond its price because the present one departed only age_s ago."""
    if line.shape[1] == 0 or age_s >= looker.prices.commit_s:
        return 0.0
    ahead, time_s = flown_on(scene, line, circle, east_m, north_m, _THREAT_S * scene.air.airspeed_m_s)
    for k in range(len(time_s)):
        x_m, y_m = ahead[0, k] - scene.velocity_x_m_s * time_s[k], ahead[1, k] - scene.velocity_y_m_s * time_s[k]
        range_m = math.hypot(x_m, y_m)
        if range_m < looker.terms.near_m - _THREAT_M or range_m > looker.terms.far_m + _THREAT_M:
            return 0.0
    return looker.prices.commit


@compiled
def decide(
    time_s: float,
    east_m: float,
    north_m: float,
    course_rad: float,
    speed_m_s: float,
    curvature_per_m: float,
    target: Known,
    line: FloatArray,
    circle: Circling,
    wind_east_m_s: float,
    wind_north_m_s: float,
    latency_s: float,
    age_s: float,
    looker: Looker,
) -> tuple[float, float, FloatArray]:
    """Return (departure, radius, line (5, n)) of the best move where it is cheaper than staying, else n = 0.

    age_s: since the departure to the present plan. The ground hides nothing.
    """
    scene = scene_of(
        time_s,
        east_m,
        north_m,
        course_rad,
        speed_m_s,
        curvature_per_m,
        target,
        line,
        circle,
        wind_east_m_s,
        wind_north_m_s,
        latency_s,
        looker.target_speed_max_m_s,
        looker.craft,
        looker.wish,
        looker.memory,
    )
    costs = np.empty(MOVES)
    futures = future(scene, looker.motions, looker.wish, looker.memory)
    flat = Sight(np.zeros((0, 1, 1), np.float32), 1.0, 1.0, 0.0, 1.0, 0.0)
    stay_cost = look_ahead(scene, east_m, north_m, line, circle, futures, looker, flat, costs)
    best = int(np.argmin(costs))
    if costs[best] < stay_cost - commitment(scene, east_m, north_m, line, circle, age_s, looker):
        return scene.departure_s, scene.radius_m, move_line(scene, looker.craft, best)
    return scene.departure_s, scene.radius_m, np.empty((5, 0))

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
from mission.viewpoint._viewpoint_kernel import Known, Wish

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
    """In seconds off side: of leaving the circle, and of changing a plan under way."""

    leave: float
    change: float


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
    place, facing, course = np.zeros((1, 1, 4)), np.zeros((1, 1, 2)), np.zeros((1, 1, 3))
    classes, share, turn_share = np.zeros((1, 1, 4), np.int64), np.zeros((1, 1, 4)), np.zeros((1, 1, 4))
    place[0, 0, 2], place[0, 0, 3] = scene.velocity_x_m_s, scene.velocity_y_m_s
    facing[0, 0, 1] = course[0, 0, 1] = 1.0
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
    looker: Looker,
) -> tuple[float, float, FloatArray]:
    """Return (departure, radius, line (5, n)) of the best move where it is cheaper than staying, else n = 0.

    The ground hides nothing.
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
    futures = going_straight(scene, looker.motions)
    flat = Sight(np.zeros((0, 1, 1), np.float32), 1.0, 1.0, 0.0, 1.0, 0.0)
    stay_cost = look_ahead(scene, east_m, north_m, line, circle, futures, looker, flat, costs)
    best = int(np.argmin(costs))
    if costs[best] < stay_cost:
        return scene.departure_s, scene.radius_m, move_line(scene, looker.craft, best)
    return scene.departure_s, scene.radius_m, np.empty((5, 0))

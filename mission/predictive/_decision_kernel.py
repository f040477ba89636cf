"""The inner loops of :mod:`mission.predictive.planner`: a look ahead from a scene, and the move that comes of it."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from estimators.compiled import compiled
from mission.core.path import FloatArray
from mission.geometry._line_kernel import ARC, Circling, Craft, line_at, sharpness_per_m2
from mission.predictive._cost_kernel import CostTerms, Table
from mission.predictive._future_kernel import Motions, Turns, first_of, winding
from mission.predictive._moves_kernel import MOVES, STAY_LENGTHS, STEP_S, Kept, lines_from, move_line, ramp_on
from mission.predictive._rollout_kernel import Futures, line_cost, lines_costs, times_s
from mission.predictive._scene_kernel import Scene, in_frame, scene_of
from mission.predictive._second_kernel import (
    MOVE_BRANCHES,
    STAY_BRANCHES,
    Second,
    Seconds,
    deep_cost,
    foretold_of,
    lay_out_seconds,
    moving_ahead,
    staying_ahead,
)
from mission.predictive._sight_kernel import Sight, View, add_sight, sight_cost
from mission.viewpoint._viewpoint_kernel import Known, Wish

UNCERTAIN_M = 10.0
_WIND_STEP_M_S = 0.5  # second moves are laid out anew when the wind grows by so much
OTHER_WIND = 0.15  # of the airspeed
MIN_MOVE = 0.4  # of the radius: the length of a transition
# A transition within this of its end counts as flown.
NEARLY_FLOWN_S = 0.2


class Prices(NamedTuple):
    """In seconds off side: of leaving the circle, of changing a plan under way, and of one younger than commit_s.

    A plan that leads out of the cost's band within threat_s binds nobody.
    """

    leave: float
    change: float
    commit: float = 0.0
    commit_s: float = 0.0
    threat_s: float = 0.0


class Depth(NamedTuple):
    """How deep to look: so many of the best moves, 0 for none, over horizon_s at least.

    min_value, min_after_turn: the least that the table says, by which lines are passed over.
    """

    beam: int
    horizon_s: float
    min_value: float
    min_after_turn: float


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
    turns: Turns
    depth: Depth
    seconds: Seconds


@compiled
def target_velocity(scene: Scene) -> tuple[float, float]:
    """Return the target's velocity towards east and north."""
    sin_c, cos_c = math.sin(scene.course_rad), math.cos(scene.course_rad)
    across_m_s, along_m_s = scene.mirror * scene.velocity_x_m_s, scene.velocity_y_m_s
    return across_m_s * cos_c + along_m_s * sin_c, along_m_s * cos_c - across_m_s * sin_c


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
def doubtful(scene: Scene, motions: Motions) -> bool:
    """Tell whether there is much of what the table does not know: uncertainty, or another wind than its own."""
    wind_m_s = math.hypot(scene.air.wind_x_m_s, scene.air.wind_y_m_s)
    other_wind = abs(wind_m_s - motions.wind_speed_m_s) > OTHER_WIND * scene.air.airspeed_m_s
    return other_wind or scene.doubt.position_m > UNCERTAIN_M


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
    # In doubt all lines are followed for a lap more: else moves seem cheaper later than they ever turn out.
    beyond_m = 2.0 * math.pi * radius_m if doubtful(scene, motions) else 0.0
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
def look_deeper(
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
    """Do as :func:`look_ahead`, then look at the best moves again, two moves deep over several futures.

    All other moves become infinitely dear. That look is spared where staying would be cheaper than every move even
    if moves were free, and where the ground hides something: second moves know nothing of it.
    """
    stay_cost = look_ahead(scene, east_m, north_m, line, circle, first_of(futures), looker, sight, costs)
    depth, prices, air = looker.depth, looker.prices, scene.air
    if depth.beam == 0 or len(sight.needed_m) > 0 or doubtful(scene, looker.motions):
        return stay_cost
    left_m = line[ARC, line.shape[1] - 1] - scene.arc_m if line.shape[1] > 0 else 0.0
    under_way = left_m > NEARLY_FLOWN_S * air.airspeed_m_s
    price = prices.change if under_way else prices.leave
    if costs.min() - price > stay_cost:
        return stay_cost
    second = Second(
        foretold_of(futures, scene.doubt, looker.table, depth.min_value, depth.min_after_turn),
        looker.terms,
        looker.table,
        looker.seconds,
        prices.leave,
        prices.change,
        depth.horizon_s,
    )
    wind_m_s = math.hypot(air.wind_x_m_s, air.wind_y_m_s)
    ramp = sharpness_per_m2(air.airspeed_m_s + math.ceil(wind_m_s / _WIND_STEP_M_S) * _WIND_STEP_M_S, looker.craft)
    lay_out_seconds(looker.seconds, scene.radius_m, ramp, air.airspeed_m_s * STEP_S)
    ahead, end = staying_ahead(scene, line, circle, east_m, north_m, under_way)
    stay_cost = deep_cost(ahead, end, STAY_BRANCHES, scene, second)
    order = np.argsort(costs, kind="mergesort")
    for i in range(MOVES):
        move = order[i]
        if i >= depth.beam:
            costs[move] = np.inf
        elif costs[move] < np.inf:
            ahead, end = moving_ahead(scene, looker.craft, move)
            costs[move] = price + deep_cost(ahead, end, MOVE_BRANCHES, scene, second)
    return stay_cost


@compiled
def commitment(
    scene: Scene,
    east_m: float,
    north_m: float,
    line: FloatArray,
    circle: Circling,
    age_s: float,
    futures: Futures,
    looker: Looker,
) -> float:
    """Return what a new plan must gain beyond its price because the present one departed only age_s ago."""
    prices, terms, place = looker.prices, looker.terms, futures.place
    if line.shape[1] == 0 or age_s >= prices.commit_s:
        return 0.0
    ahead, time_s = flown_on(scene, line, circle, east_m, north_m, prices.threat_s * scene.air.airspeed_m_s)
    for k in range(len(time_s)):
        i = min(int(time_s[k] / STEP_S + 0.5), place.shape[1] - 1)
        for one in range(len(place)):
            range_m = math.hypot(ahead[0, k] - place[one, i, 0], ahead[1, k] - place[one, i, 1])
            if range_m < terms.near_m or range_m > terms.far_m:
                return 0.0
    return prices.commit


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
    flat = Sight(np.zeros((0, 1, 1), np.float32), 1.0, 1.0, 0.0, 1.0, 0.0)
    futures = winding(scene, looker.motions, looker.wish, looker.memory, looker.turns)
    stay_cost = look_deeper(scene, east_m, north_m, line, circle, futures, looker, flat, costs)
    best = int(np.argmin(costs))
    if costs[best] < stay_cost - commitment(scene, east_m, north_m, line, circle, age_s, futures, looker):
        return scene.departure_s, scene.radius_m, move_line(scene, looker.craft, best)
    return scene.departure_s, scene.radius_m, np.empty((5, 0))

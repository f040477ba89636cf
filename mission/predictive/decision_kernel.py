"""The decision of :mod:`mission.predictive.planner`: what staying and each move cost, and which move is taken.

On a known route one more scenario follows it, and the value table has layers of time. Scenarios in which the target
turns keep a fifth of the probability at least: a route does not exclude that the target leaves it.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from sidelong.estimators.compiled import compiled, inner, inner_inlined, record_type
from sidelong.mission.core.path import FloatArray
from sidelong.mission.core.sight import Sight
from sidelong.mission.geometry.line_kernel import ARC, Air, line_at, nose_rad, sharpness_per_m2, turn_radius_m
from sidelong.mission.predictive.moves_kernel import (
    MOVE_BRANCHES,
    MOVES,
    STAY_BRANCHES,
    LineCache,
    Second,
    SecondMoves,
    deep_cost,
    eights_from,
    lay_out_second_moves,
    lines_from,
    moving_ahead,
    ramp_anywhere,
    ramp_on,
    scenario_rows,
    staying_ahead,
    workspace_for,
)
from sidelong.mission.predictive.rollout_kernel import (
    STEP_S,
    CostTerms,
    Float32,
    IntArray,
    Lines,
    Pose,
    Sampling,
    Scenarios,
    Table,
    Uncertainty,
    WatchFrame,
    add_sight,
    blind_rate,
    blind_rates,
    cost_rate,
    fading_per_s,
    least,
    lines_costs,
    single_line,
    table_value,
    times_s,
)
from sidelong.mission.predictive.scene_kernel import (
    Motions,
    Scene,
    Turns,
    Watcher,
    classes_about,
    first_of,
    in_frame,
    watched,
    winding,
)
from sidelong.mission.route.progress_kernel import Progress, RouteArrays, forecast, update_progress

UNCERTAIN_M = 10.0
_WIND_STEP_M_S = 0.5  # second moves are recomputed when the wind grows by this much
OTHER_WIND = 0.15  # of the airspeed
MIN_MOVE = 0.4  # of the radius: the length of a transition
# A transition within this of its end counts as flown.
NEARLY_FLOWN_S = 0.2

HEADINGS = 16
CELLS = 22  # from the target to the edge of the grid
SIZE = 2 * CELLS + 1
_PAD = 8  # cells beyond the edge, equal to it: more than aircraft and target move apart in a step
_INNER = slice(_PAD, _PAD + SIZE)
_TURN = 2  # headings of a step on the circle
_MODES = 3  # on the circle, straight, the other way round
HORIZON_S = 45.0
LAYERS = record_type(
    computed_s="f8",  # when the layers were computed, for which mirror, part of the route and direction of the wind
    mirror="f8",
    part="i8",
    wind_rad="f8",
    known=("i1", (HEADINGS,)),  # 1 or 0: for which courses the values after a turn are computed
)


class RouteValues(NamedTuple):
    """A route and the layers of the value table along it; without points, no route.

    values: classes of the value table on the program's grid, then the layers. after_turn: the same classes, then one
    for each of HEADINGS courses. least (classes + layers,): of ``values``. state: one record of ``LAYERS``, (1,).
    """

    way: RouteArrays
    progress: Progress
    values: Float32
    after_turn: Float32
    cell_m: float
    least: FloatArray
    state: Any


class SwitchingCosts(NamedTuple):
    """In seconds off side: of leaving the circle, of changing a plan under way, and of one younger than commit_s.

    A young plan that leads out of the cost's band within threat_s in a likely future has no price.
    """

    leave: float
    change: float
    commit: float = 0.0
    commit_s: float = 0.0
    threat_s: float = 0.0


class LookaheadDepth(NamedTuple):
    """How deep to look: number of the best moves, 0 for none, over horizon_s at least.

    min_values (classes,), min_after_turn: the least that the table says, by which lines are passed over.
    every_future: whether the first look, too, is at all that the target may do.
    """

    beam: int
    horizon_s: float
    min_values: FloatArray
    min_after_turn: float
    every_future: bool


class PlannerContext(NamedTuple):
    """What a planner decides with in every decision; line_cache and second_moves change."""

    watcher: Watcher
    terms: CostTerms
    motions: Motions
    turns: Turns
    line_cache: LineCache
    second_moves: SecondMoves
    route: RouteValues


class Question(NamedTuple):
    """What a decision answers: by which value table, with which prices, and how deep it looks."""

    context: PlannerContext
    table: Table
    prices: SwitchingCosts
    depth: LookaheadDepth


class Alternatives(NamedTuple):
    """What a decision chooses among: all moves, or going on as planned, each set of lines from a start.

    stays: the rest of a line that is under way, else stretches of the circle before it is left.
    """

    moves: Lines
    start: Pose
    stays: Lines
    stays_start: Pose
    under_way: bool


@compiled
def flown_on(scene: Scene, length_m: float) -> tuple[FloatArray, FloatArray]:
    """Return (x, y, heading) (3, k) in the frame and the times (k,) of flying on along the present plan."""
    size = max(2, math.ceil(length_m / (scene.air.airspeed_m_s * STEP_S)) + 1)
    arc = np.empty(size)
    for k in range(size):
        arc[k] = scene.arc_m + k * (length_m / (size - 1))
    found = np.empty((3, size))
    line_at(scene.present.line, scene.present.circle, arc, scene.aircraft.east_m, scene.aircraft.north_m, found)
    for k in range(size):
        found[0, k], found[1, k] = in_frame(scene, found[0, k], found[1, k])
        found[2, k] = scene.mirror * (found[2, k] - scene.course_rad)
    return found, times_s(found[2], arc, scene.air)


@inner
def doubtful(scene: Scene, motions: Motions) -> bool:
    """Return whether there is much of what the table does not know: uncertainty, or another wind than its own."""
    wind_m_s = math.hypot(scene.air.wind_x_m_s, scene.air.wind_y_m_s)
    other_wind = abs(wind_m_s - motions.wind_speed_m_s) > OTHER_WIND * scene.air.airspeed_m_s
    return other_wind or scene.doubt.position_m > UNCERTAIN_M


@inner
def likely(futures: Scenarios) -> Scenarios:
    """Return the first future alone, with the second where that is more probable."""
    both = len(futures.weight) > 1 and futures.weight[1] > futures.weight[0]
    return first_of(futures, 2 if both else 1)


@inner
def left_m(scene: Scene) -> float:
    """Return how much of the present plan's line is left at the departure, 0 where it is nearly flown."""
    line = scene.present.line
    ahead_m = line[ARC, line.shape[1] - 1] - scene.arc_m if line.shape[1] > 0 else 0.0
    return ahead_m if ahead_m > NEARLY_FLOWN_S * scene.air.airspeed_m_s else 0.0


@inner
def alternatives(scene: Scene, question: Question, beyond_m: float) -> Alternatives:
    """Return what to choose among; each line is followed beyond_m further than its end."""
    kept, craft, air = question.context.line_cache, question.context.watcher.craft, scene.air
    rate_per_s = fading_per_s(question.table)
    x_m, y_m = in_frame(scene, scene.start.east_m, scene.start.north_m)
    heading_rad = scene.mirror * (scene.start.course_rad - scene.course_rad)
    start, start_per_m = Pose(x_m, y_m, heading_rad), scene.mirror * scene.start.curvature_per_m
    ramp_per_m2, sampling = ramp_on(heading_rad, air, craft), Sampling(beyond_m, heading_rad, air, rate_per_s)
    moves = lines_from(0.0, scene, start_per_m, ramp_per_m2, sampling, craft, kept)
    rest_m = left_m(scene)
    if rest_m > 0.0:
        ahead, time_s = flown_on(scene, rest_m + beyond_m)
        rest = single_line(ahead[0], ahead[1], ahead[2], time_s, rate_per_s)
        return Alternatives(moves, start, rest, Pose(0.0, 0.0, 0.0), True)
    circle_per_m = scene.mirror / scene.present.circle.radius_m
    stays = lines_from(1.0, scene, circle_per_m, ramp_per_m2, sampling, craft, kept)
    return Alternatives(moves, start, stays, start, False)


@inner
def add_prices(among: Alternatives, radius_m: float, leave: float, change: float, costs: FloatArray) -> None:
    """Add the prices, s, to the costs (moves,) of the moves; it is infinite for a move that hardly leaves the circle.

    "Back to the circle" is staying, and so is hardly leaving it: the table is not that fine.
    """
    if among.under_way:
        costs += change
        return
    for i in range(MOVES):
        costs[i] = np.inf if among.moves.end_m[i] < MIN_MOVE * radius_m else costs[i] + leave


@inner
def _line_costs(
    lines: Lines, start: Pose, scene: Scene, futures: Scenarios, question: Question, sight: Sight, costs: FloatArray
) -> None:
    """Fill in what lines (lines,) from a start cost, with what the ground hides."""
    table, radius_m = question.table, scene.radius_m
    lines_costs(lines, start, futures, scene.doubt, question.context.terms, table, scene.air, costs)
    view = WatchFrame(scene.course_rad, scene.mirror, scene.velocity_x_m_s, scene.velocity_y_m_s)
    lap_s = 2.0 * math.pi * radius_m / scene.air.airspeed_m_s
    add_sight(lines, start, sight, view, radius_m, lap_s, fading_per_s(table), costs)


@compiled
def look_ahead(scene: Scene, futures: Scenarios, question: Question, sight: Sight, costs: FloatArray) -> float:
    """Fill in the cost of each move (moves,), s off side, its price included; return that of going on as planned."""
    prices, radius_m = question.prices, scene.radius_m
    # In doubt all lines are followed for a lap more: else moves seem cheaper later than they ever turn out.
    beyond_m = 2.0 * math.pi * radius_m if doubtful(scene, question.context.motions) else 0.0
    among = alternatives(scene, question, beyond_m)
    stay_costs = np.empty(len(among.stays.trunk))
    _line_costs(among.moves, among.start, scene, futures, question, sight, costs)
    _line_costs(among.stays, among.stays_start, scene, futures, question, sight, stay_costs)
    add_prices(among, radius_m, prices.leave, prices.change, costs)
    if len(costs) > MOVES:
        ramp_per_m2 = ramp_anywhere(scene.air, question.context.watcher.craft)
        start_per_m = scene.mirror * scene.start.curvature_per_m
        sampling = Sampling(beyond_m, among.start.heading_rad, scene.air, fading_per_s(question.table))
        eights = eights_from(start_per_m, radius_m, ramp_per_m2, sampling)
        _line_costs(eights, among.start, scene, futures, question, sight, costs[MOVES:])
        costs[MOVES:] += prices.change if among.under_way else prices.leave
    return least(stay_costs)


@compiled
def lay_out(question: Question, radius_m: float, airspeed_m_s: float, wind_m_s: float) -> None:
    """Compute the second moves for a circle, an airspeed and a wind speed, unless they are those computed last."""
    # A wind of a whole step stays of that step, however its direction was rounded.
    steps = math.ceil(wind_m_s / _WIND_STEP_M_S - 1e-6)
    fastest_m_s = airspeed_m_s + steps * _WIND_STEP_M_S
    ramp_per_m2 = sharpness_per_m2(fastest_m_s, question.context.watcher.craft)
    turn_m = turn_radius_m(radius_m, fastest_m_s, question.context.watcher.craft)
    lay_out_second_moves(question.context.second_moves, radius_m, turn_m, ramp_per_m2, airspeed_m_s * STEP_S)


@compiled
def look_two_moves_ahead(
    scene: Scene, futures: Scenarios, question: Question, sight: Sight, min_gain: float, costs: FloatArray
) -> float:
    """Do as :func:`look_ahead`, then look at the best moves again, two moves deep over several futures.

    The cost of all other moves becomes infinite. That look is spared where staying would be cheaper than every move
    even if moves were free, and the target comes too near in none of the futures; and where the ground or the pan
    limits hide something: second moves know nothing of it. What gains less than min_gain may be given any cost above
    that.
    """
    # Turns that the target may begin only matter with a second move.
    seen = futures if question.depth.every_future else likely(futures)
    stay_cost = look_ahead(scene, seen, question, sight, costs)
    depth, prices, air = question.depth, question.prices, scene.air
    if depth.beam == 0 or len(costs) > MOVES or len(sight.needed_m) > 0 or doubtful(scene, question.context.motions):
        return stay_cost
    under_way = left_m(scene) > 0.0
    price = prices.change if under_way else prices.leave
    if least(costs) - price > stay_cost and not leaves(
        scene, futures, question, question.context.terms.near_m, np.inf
    ):
        return stay_cost
    second = Second(
        scenario_rows(futures, scene.doubt, question.table, depth.min_values, depth.min_after_turn),
        question.context.terms,
        question.table,
        question.context.second_moves,
        prices.leave,
        prices.change,
        depth.horizon_s,
        workspace_for(futures, air),
    )
    lay_out(question, scene.radius_m, air.airspeed_m_s, math.hypot(air.wind_x_m_s, air.wind_y_m_s))
    ahead, end = staying_ahead(scene, under_way)
    stay_cost = deep_cost(ahead, end, STAY_BRANCHES, scene, second, np.inf)
    deep_costs = np.full(MOVES, np.inf)
    for _ in range(depth.beam):
        move = int(np.argmin(costs))
        if costs[move] == np.inf:
            break
        ahead, end = moving_ahead(scene, question.context.watcher.craft, move)
        bar = stay_cost - price - min_gain
        deep_costs[move] = price + deep_cost(ahead, end, MOVE_BRANCHES, scene, second, bar)
        costs[move] = np.inf
    costs[:] = deep_costs
    return stay_cost


@inner
def leaves(scene: Scene, futures: Scenarios, question: Question, near_m: float, far_m: float) -> bool:
    """Return whether the present plan leaves a range band, or the pan limits, within threat_s in a future."""
    place, air, terms = futures.place, scene.air, question.context.terms
    ahead, time_s = flown_on(scene, question.prices.threat_s * scene.air.airspeed_m_s)
    for k in range(len(time_s)):
        i = min(int(time_s[k] / STEP_S + 0.5), place.shape[1] - 1)
        for one in range(len(place)):
            x_m, y_m = ahead[0, k] - place[one, i, 0], ahead[1, k] - place[one, i, 1]
            range_m = math.hypot(x_m, y_m)
            if range_m < near_m or range_m > far_m:
                return True
            if terms.blind > 0.0 and blind_rate(x_m, y_m, nose_rad(ahead[2, k], air), terms) >= terms.blind:
                return True
    return False


@compiled
def commitment(scene: Scene, futures: Scenarios, question: Question) -> float:
    """Return the gain, s, that a new plan needs beyond its price because the present one departed only just now.

    Nothing where the present one leads out of the band, or beyond the pan limits, in a likely future: for others it
    is not given up so early.
    """
    prices, terms = question.prices, question.context.terms
    if scene.present.line.shape[1] == 0 or scene.present.age_s >= prices.commit_s:
        return 0.0
    return 0.0 if leaves(scene, likely(futures), question, terms.near_m, terms.far_m) else prices.commit


_ROUTE = 0  # the future along the route is the first one
_TRUST = 0.8  # the most that it counts
_LEAST_TRUST = 0.3  # a less probable route is not planned along
_RENEW_S = 2.5  # how long the layers are used
_OTHER_WIND_RAD = 0.3
_PRICE_SHARE = 0.7  # of what moves cost without a route: along one fewer are needed, and they gain more


@compiled
def layer_s(airspeed_m_s: float, radius_m: float) -> float:
    """Return the duration of a layer's step: the flight over 45 degrees of the circle, s."""
    return _TURN * 2.0 * math.pi / HEADINGS * radius_m / airspeed_m_s


@inner_inlined
def _course_index(f: Scenarios, k: int, turn_rad: float) -> int:
    """Return which of HEADINGS directions of the plane the target moves in at a sample; turn_rad: of the plane."""
    motion_rad = math.atan2(f.place[_ROUTE, k, 2], f.place[_ROUTE, k, 3])
    return round((motion_rad - turn_rad) / (2.0 * math.pi) * HEADINGS) % HEADINGS


@compiled
def resample(
    values: Float32,
    from_cell_m: float,
    classes: IntArray,
    share: FloatArray,
    k: int,
    cell_m: float,
    turn_rad: float,
    found: Float32,
) -> None:
    """Fill in a table's values (HEADINGS, SIZE, SIZE) on the coarse grid, classes[0, k] mixed by their shares.

    turn_rad: course of the table's frame in the frame of the result.
    """
    sin_t, cos_t = math.sin(turn_rad), math.cos(turn_rad)
    for h in range(HEADINGS):
        heading_rad = h * 2.0 * math.pi / HEADINGS - turn_rad
        for i in range(SIZE):
            for j in range(SIZE):
                x, y = (i - CELLS) * cell_m, (j - CELLS) * cell_m
                across, along = x * cos_t - y * sin_t, x * sin_t + y * cos_t
                found[h, i, j] = np.float32(
                    table_value(values, from_cell_m, across, along, heading_rad, classes, share, 0, k)
                )


@inner
def _fill_rates(
    f: Scenarios, k: int, since_s: float, turn_rad: float, cell_m: float, d: Uncertainty, c: CostTerms, found: Float32
) -> None:
    """Fill in the running cost (SIZE, SIZE) about the target at sample k. turn_rad: of the plane in the frame."""
    sin_w, cos_w, sigma_rad = f.facing[_ROUTE, k, 0], f.facing[_ROUTE, k, 1], f.facing[_ROUTE, k, 2]
    sin_t, cos_t = math.sin(turn_rad), math.cos(turn_rad)
    # Of the watch course in the plane: its angle in the frame less that of the plane.
    sin_f, cos_f = sin_w * cos_t - cos_w * sin_t, cos_w * cos_t + sin_w * sin_t
    sigma_m = math.sqrt(d.position_m * d.position_m + (d.velocity_m_s * since_s) ** 2)
    for i in range(SIZE):
        for j in range(SIZE):
            x, y = (i - CELLS) * cell_m, (j - CELLS) * cell_m
            across, along = x * cos_f - y * sin_f, x * sin_f + y * cos_f
            aside_m = sigma_rad * along
            blur_m = max(1.0 + math.sqrt(sigma_m * sigma_m + aside_m * aside_m), 0.5 * cell_m)
            found[i, j] = np.float32(cost_rate(across, along, sigma_m, blur_m, c))


@inner
def _extend_edges(padded: Float32) -> None:
    """Give the cells beyond the grid the values of its edge."""
    for row in padded[_INNER]:
        row[:_PAD], row[-_PAD:] = row[_PAD], row[-_PAD - 1]
    padded[:_PAD], padded[-_PAD:] = padded[_PAD], padded[-_PAD - 1]


@inner
def _fill_layers(f: Scenarios, turn_rad: float, scene: Scene, question: Question, prices: SwitchingCosts) -> None:
    """Fill in the cost to go on the circle, in layers of :func:`layer_s` from the departure on, and their minima.

    A dynamic program that runs backward from the value table at the end of the expected path. A state is a place
    relative to the target on a coarse grid, one of 16 headings, and the manner of turning: on the circle, straight,
    or the other way round. A step lasts as long as the circle takes for 45 degrees, so that no heading is
    interpolated. Leaving the circle, or changing the manner of turning, costs what moves cost. The target may leave
    the path: the value after a turn counts at the same hazard as in the value table.

    Neglected: roll dynamics (a change of curvature is a shift in time), and the change of ground speed around a
    circle in wind. All layers lie in the local plane, east mirrored where the right side is required: they stay valid
    as the target, and with it the frame of a decision, turns. turn_rad: the plane's (mirrored) north in that frame.
    """
    s, table, terms = question.context.route, question.table, question.context.terms
    air, radius_m, cell_m, classes = scene.air, scene.radius_m, s.cell_m, len(table.values)
    after_turn, found, minima = s.after_turn[classes:], s.values[classes:], s.least[classes:]
    layers, n = len(found), SIZE + 2 * _PAD
    dt_s, turn_step_rad = layer_s(air.airspeed_m_s, radius_m), 2.0 * math.pi / HEADINGS
    rate, table_values = np.empty((SIZE, SIZE), np.float32), np.empty((HEADINGS, SIZE, SIZE), np.float32)
    # Planes of the padded grid. Their rows are processed as one long row, in which the padding is computed in vain.
    paid, here = np.zeros((HEADINGS, n * n), np.float32), np.empty(n * n, np.float32)
    values, best = np.zeros((_MODES, HEADINGS, n * n), np.float32), np.zeros((_MODES, HEADINGS, n * n), np.float32)
    first, last = _PAD * n, (_PAD + SIZE) * n
    hazard_per_s = 1.0 / table.mean_leg_s
    fading, half = math.exp(-(table.discount_per_s + hazard_per_s) * dt_s), np.float32(0.5 * dt_s)
    hazard, leave, change = np.float32(hazard_per_s), np.float32(prices.leave), np.float32(prices.change)
    sin_p, cos_p, last_k = math.sin(turn_rad), math.cos(turn_rad), f.place.shape[1] - 1
    wind_x = air.wind_x_m_s * cos_p - air.wind_y_m_s * sin_p
    wind_y = air.wind_x_m_s * sin_p + air.wind_y_m_s * cos_p
    chord_m, limit = 2.0 * radius_m * math.sin(0.5 * _TURN * turn_step_rad), _PAD - 1.01
    blind, unseen = np.empty((HEADINGS if terms.blind > 0.0 else 0, SIZE, SIZE), np.float32), np.empty((SIZE, SIZE))
    for h in range(len(blind)):  # where the gimbal cannot look
        nose = nose_rad(h * 2.0 * math.pi / HEADINGS, Air(air.airspeed_m_s, wind_x, wind_y))
        blind_rates((np.arange(SIZE, dtype=np.float64) - CELLS) * cell_m, nose, terms, unseen)
        blind[h] = unseen
    for layer in range(layers - 1, -1, -1):
        time_s = layer * dt_s
        k = min(int(time_s / f.step_s + 0.5), last_k)
        _fill_rates(f, k, time_s, turn_rad, cell_m, scene.doubt, terms, rate)
        course = _course_index(f, k, turn_rad)
        for h in range(HEADINGS):
            inner = paid[h].reshape(n, n)[_INNER, _INNER]
            inner[:] = rate + hazard * after_turn[course, h]
            if len(blind) > 0:
                inner += blind[h]
        if layer == layers - 1:
            table_rad = f.course[_ROUTE, k, 2] - turn_rad
            resample(table.values, table.cell_m, f.classes, f.share, k, cell_m, table_rad, table_values)
            for mode in range(_MODES):
                for h in range(HEADINGS):
                    values[mode, h].reshape(n, n)[_INNER, _INNER] = table_values[h]
        else:
            k, m = min(int(time_s / f.step_s), last_k), min(int((time_s + dt_s) / f.step_s), last_k)
            now, from_s = f.place[_ROUTE, k], time_s - k * f.step_s
            then, to_s = f.place[_ROUTE, m], time_s + dt_s - m * f.step_s
            gone_x = then[0] + then[2] * to_s - now[0] - now[2] * from_s
            gone_y = then[1] + then[3] * to_s - now[1] - now[3] * from_s
            gone_x, gone_y = gone_x * cos_p - gone_y * sin_p, gone_x * sin_p + gone_y * cos_p
            for mode in range(_MODES):
                turn = (1 - mode) * _TURN
                for h in range(HEADINGS):
                    middle_rad = (h + 0.5 * turn) * turn_step_rad
                    flown_x, flown_y = chord_m * math.sin(middle_rad), chord_m * math.cos(middle_rad)
                    if turn == 0:
                        flown_x = (air.airspeed_m_s * math.sin(middle_rad) + wind_x) * dt_s
                        flown_y = (air.airspeed_m_s * math.cos(middle_rad) + wind_y) * dt_s
                    x = min(max((flown_x - gone_x) / cell_m, -limit), limit)
                    y = min(max((flown_y - gone_y) / cell_m, -limit), limit)
                    i, j = math.floor(x), math.floor(y)
                    a, b = x - i, y - j
                    low_a, low_b = np.float32(fading * (1.0 - a) * (1.0 - b)), np.float32(fading * (1.0 - a) * b)
                    high_a, high_b = np.float32(fading * a * (1.0 - b)), np.float32(fading * a * b)
                    low = best[mode, (h + turn) % HEADINGS, first + i * n + j :]
                    high, own, found_here = low[n:], paid[h, first:last], values[mode, h, first:last]
                    for q in range(len(own)):
                        before = half * own[q] + low_a * low[q] + low_b * low[q + 1]
                        found_here[q] = before + high_a * high[q] + high_b * high[q + 1]
        for h in range(HEADINGS):
            circle, straight, other, own = values[0, h], values[1, h], values[2, h], paid[h]
            on_circle, ahead, back = best[0, h], best[1, h], best[2, h]
            for q in range(first, last):
                away, before = min(straight[q], other[q]), half * own[q]
                changed = min(away, circle[q]) + change
                here[q] = min(circle[q], away + leave)
                on_circle[q] = here[q] + before
                ahead[q] = min(straight[q], circle[q], changed) + before
                back[q] = min(other[q], circle[q], changed) + before
            found[layer, h] = here.reshape(n, n)[_INNER, _INNER]
            for mode in range(_MODES):
                _extend_edges(best[mode, h].reshape(n, n))
        lowest = found[layer, 0].copy()
        for h in range(1, HEADINGS):
            np.minimum(lowest, found[layer, h], lowest)
        minima[layer] = lowest.min()


@inner
def along_route(scene: Scene, question: Question, every: Scenarios) -> tuple[Scenarios, bool]:
    """Return futures of which the first follows the route, and True; the same and False where it is of no use."""
    way, progress = question.context.route.way, question.context.route.progress.state[0]
    if len(way.points) == 0 or not progress.on_route or not progress.of_use:
        return every, False
    chance, turns, k = _TRUST * progress.chance, len(question.context.turns.rate_rad_s), every.place.shape[1]
    if chance < _LEAST_TRUST:
        return every, False
    weight, place = np.full(turns + 1, (1.0 - chance) / turns), np.empty((turns + 1, k, 4))
    weight[_ROUTE] = chance
    place[1], place[2:] = every.place[0], every.place[len(every.weight) - turns + 1 :]
    points = np.empty((k + 1, 2))
    forecast(way, progress, scene.departure_s, points)
    off_e, off_n = scene.frame_east_m - points[0, 0], scene.frame_north_m - points[0, 1]
    for i in range(k + 1):
        points[i, 0], points[i, 1] = in_frame(scene, points[i, 0] + off_e, points[i, 1] + off_n)
    for i in range(k):
        place[_ROUTE, i, 0], place[_ROUTE, i, 1] = points[i, 0], points[i, 1]
        place[_ROUTE, i, 2], place[_ROUTE, i, 3] = points[i + 1, 0] - points[i, 0], points[i + 1, 1] - points[i, 1]
    moving = not question.context.watcher.memory[0].standing
    return watched(scene, question.context.motions, question.context.watcher, moving, weight, place), True


@inner
def _fill_after_turn(f: Scenarios, turn_rad: float, scene: Scene, question: Question) -> None:
    """Compute the values after a turn for the courses that the route takes, and for this wind, unless they are."""
    s, motions, table = question.context.route, question.context.motions, question.table
    wind_m_s = math.hypot(scene.air.wind_x_m_s, scene.air.wind_y_m_s)
    wind_rad = math.atan2(scene.air.wind_x_m_s, scene.air.wind_y_m_s) - turn_rad if wind_m_s > 0.0 else 0.0
    changed_rad = wind_rad - s.state[0].wind_rad
    changed_rad -= 2.0 * math.pi * round(changed_rad / (2.0 * math.pi))
    # The frame of a sector is fixed: its angle in the plane does not change.
    if motions.wind_speed_m_s > 0.0 and abs(changed_rad) > _OTHER_WIND_RAD:
        s.state[0].known[:] = 0
        s.state[0].wind_rad = wind_rad
    classes, turn_share = np.empty((1, 1, 4), np.int64), np.empty((1, 1, 4))
    for k in range(f.place.shape[1]):
        course = _course_index(f, k, turn_rad)
        if s.state[0].known[course] > 0:
            continue
        s.state[0].known[course] = 1
        course_rad = course * 2.0 * math.pi / HEADINGS
        table_rad = course_rad if motions.follows_course else f.course[_ROUTE, k, 2] - turn_rad
        to_rad, from_rad = course_rad - table_rad, s.state[0].wind_rad - table_rad
        fastest = motions.target_speed_max_m_s
        vx, vy = fastest * math.sin(to_rad), fastest * math.cos(to_rad)
        wx, wy = motions.wind_speed_m_s * math.sin(from_rad), motions.wind_speed_m_s * math.cos(from_rad)
        which, _, shares = classes_about(motions, vx, vy, wx, wy)
        for c in range(4):
            classes[0, 0, c], turn_share[0, 0, c] = which[c], shares[c]
        found = s.after_turn[len(table.values) + course]
        resample(table.after_turn, table.cell_m, classes, turn_share, 0, s.cell_m, table_rad, found)


@compiled
def foresee(scene: Scene, question: Question) -> tuple[Scenarios, Table, SwitchingCosts, LookaheadDepth]:
    """Return what the target may do near a route, and the table, prices and depth to answer the question with.

    Processes the target's estimate: call it once for each, in order of time.
    """
    context, table = question.context, question.table
    every, s = winding(scene, context.motions, context.watcher, context.turns), context.route
    update_progress(s.way, scene.target, s.progress)
    f, on_route = along_route(scene, question, every)
    part, state = s.progress.state[0].part, s.state[0]
    if not on_route:
        state.computed_s = -np.inf
        return f, table, question.prices, question.depth
    p = question.prices
    prices = SwitchingCosts(_PRICE_SHARE * p.leave, _PRICE_SHARE * p.change, p.commit, p.commit_s, p.threat_s)
    turn_rad, count = -scene.mirror * scene.course_rad, len(table.values)
    layers, dt_s = len(s.values) - count, layer_s(scene.air.airspeed_m_s, scene.radius_m)
    since_s = scene.departure_s - state.computed_s
    if not 0.0 <= since_s <= _RENEW_S or state.mirror != scene.mirror or state.part != part:
        _fill_after_turn(f, turn_rad, scene, question)
        _fill_layers(f, turn_rad, scene, question, prices)
        state.computed_s, state.mirror, state.part, since_s = scene.departure_s, scene.mirror, part, 0.0
    sin_t, cos_t = math.sin(turn_rad), math.cos(turn_rad)
    for k in range(f.place.shape[1]):
        at = min((k * f.step_s + since_s) / dt_s, layers - 1.001)
        layer, past = int(at), at - int(at)
        f.classes[_ROUTE, k, 0], f.classes[_ROUTE, k, 1] = count + layer, count + layer + 1
        f.share[_ROUTE, k, 0], f.share[_ROUTE, k, 1] = 1.0 - past, past
        f.share[_ROUTE, k, 2:] = 0.0
        f.classes[_ROUTE, k, 2] = count + _course_index(f, k, turn_rad)
        f.turn_share[_ROUTE, k, :] = 0.0
        f.turn_share[_ROUTE, k, 2] = 1.0
        f.course[_ROUTE, k, 0], f.course[_ROUTE, k, 1], f.course[_ROUTE, k, 2] = sin_t, cos_t, turn_rad
    timed = Table(s.values, s.after_turn, s.cell_m, table.discount_per_s, table.mean_leg_s)
    # Figures of eight have no second look, and the route alone would lead too near to a target that leaves it.
    every_future = question.context.terms.blind > 0.0
    depth = LookaheadDepth(
        question.depth.beam, question.depth.horizon_s, s.least, question.depth.min_after_turn, every_future
    )
    return f, timed, prices, depth

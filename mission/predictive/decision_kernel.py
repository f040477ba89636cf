"""The decision of :mod:`mission.predictive.planner`: what staying and each move cost, and which move is taken.

On a known route one more scenario follows it, and the value table has layers of time. Scenarios in which the target
turns keep a fifth of the probability at least: a route does not exclude that the target leaves it.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from sidelong.estimators.compiled import compiled
from sidelong.mission.core.path import FloatArray
from sidelong.mission.core.sight import Sight
from sidelong.mission.geometry.line_kernel import ARC, line_at, sharpness_per_m2, turn_radius_m
from sidelong.mission.predictive.cost_kernel import CostTerms, Table, blind_rate, fading_per_s, least
from sidelong.mission.predictive.foresight_kernel import (
    HEADINGS,
    RouteValues,
    course_index,
    fill_layers,
    layer_s,
    least_of,
    resample,
)
from sidelong.mission.predictive.moves_kernel import (
    EIGHTS,
    MOVES,
    LineCache,
    eights_from,
    lines_from,
    ramp_anywhere,
    ramp_on,
)
from sidelong.mission.predictive.rollout_kernel import (
    STEP_S,
    Lines,
    Pose,
    Sampling,
    Scenarios,
    WatchFrame,
    add_sight,
    lines_costs,
    nose_rad,
    single_line,
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
from sidelong.mission.predictive.second_kernel import (
    MOVE_BRANCHES,
    STAY_BRANCHES,
    Second,
    SecondMoves,
    deep_cost,
    lay_out_second_moves,
    moving_ahead,
    scenario_rows,
    staying_ahead,
    workspace_for,
)
from sidelong.mission.route.progress_kernel import forecast, update_progress

UNCERTAIN_M = 10.0
_WIND_STEP_M_S = 0.5  # second moves are recomputed when the wind grows by this much
OTHER_WIND = 0.15  # of the airspeed
MIN_MOVE = 0.4  # of the radius: the length of a transition
# A transition within this of its end counts as flown.
NEARLY_FLOWN_S = 0.2


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
    """What a planner decides with in every decision.

    Attributes:
        watcher: the aircraft, how it watches, and its memory.
        terms: running cost.
        motions: arrangement of the value table's classes.
        turns: how the target may turn.
        line_cache: lines of earlier decisions, which change.
        second_moves: laid out for one circle and airspeed; they change.
        route: the target's route, and the value table along it.
    """

    watcher: Watcher
    terms: CostTerms
    motions: Motions
    turns: Turns
    line_cache: LineCache
    second_moves: SecondMoves
    route: RouteValues


class Question(NamedTuple):
    """What a decision answers.

    Attributes:
        context: what the planner decides with.
        table: value table.
        prices: switching costs that go with the table.
        depth: how far the two-stage lookahead goes.
    """

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
def choices(question: Question) -> int:
    """Return the number of moves to choose among: figures of eight are for a gimbal that cannot pan all around."""
    return MOVES + EIGHTS if question.context.terms.blind > 0.0 else MOVES


@compiled
def flown_on(scene: Scene, length_m: float) -> tuple[FloatArray, FloatArray]:
    """Return (x, y, heading) (3, k) in the frame and the times (k,) of flying on along the present plan."""
    size = max(2, math.ceil(length_m / (scene.air.airspeed_m_s * STEP_S)) + 1)
    arc = np.empty(size)
    for k in range(size):
        arc[k] = scene.arc_m + k * (length_m / (size - 1))
    found = np.empty((3, size))
    line_at(scene.line, scene.circle, arc, scene.aircraft_east_m, scene.aircraft_north_m, found)
    for k in range(size):
        found[0, k], found[1, k] = in_frame(scene, found[0, k], found[1, k])
        found[2, k] = scene.mirror * (found[2, k] - scene.course_rad)
    return found, times_s(found[2], arc, scene.air)


@compiled
def doubtful(scene: Scene, motions: Motions) -> bool:
    """Return whether there is much of what the table does not know: uncertainty, or another wind than its own."""
    wind_m_s = math.hypot(scene.air.wind_x_m_s, scene.air.wind_y_m_s)
    other_wind = abs(wind_m_s - motions.wind_speed_m_s) > OTHER_WIND * scene.air.airspeed_m_s
    return other_wind or scene.doubt.position_m > UNCERTAIN_M


@compiled
def likely(futures: Scenarios) -> Scenarios:
    """Return the first future alone, with the second where that is more probable."""
    both = len(futures.weight) > 1 and futures.weight[1] > futures.weight[0]
    return first_of(futures, 2 if both else 1)


@compiled
def left_m(scene: Scene) -> float:
    """Return how much of the present plan's line is left at the departure, 0 where it is nearly flown."""
    line = scene.line
    ahead_m = line[ARC, line.shape[1] - 1] - scene.arc_m if line.shape[1] > 0 else 0.0
    return ahead_m if ahead_m > NEARLY_FLOWN_S * scene.air.airspeed_m_s else 0.0


@compiled
def alternatives(scene: Scene, question: Question, beyond_m: float) -> Alternatives:
    """Return what to choose among; each line is followed beyond_m further than its end."""
    kept, craft, air = question.context.line_cache, question.context.watcher.craft, scene.air
    rate_per_s = fading_per_s(question.table)
    x_m, y_m = in_frame(scene, scene.start.east_m, scene.start.north_m)
    heading_rad = scene.mirror * (scene.start.course_rad - scene.course_rad)
    start, start_per_m = Pose(x_m, y_m, heading_rad), scene.mirror * scene.start.curvature_per_m
    ramp, sampling = ramp_on(heading_rad, air, craft), Sampling(beyond_m, heading_rad, air, rate_per_s)
    moves = lines_from(0.0, scene, start_per_m, ramp, sampling, craft, kept)
    rest_m = left_m(scene)
    if rest_m > 0.0:
        ahead, time_s = flown_on(scene, rest_m + beyond_m)
        rest = single_line(ahead[0], ahead[1], ahead[2], time_s, rate_per_s)
        return Alternatives(moves, start, rest, Pose(0.0, 0.0, 0.0), True)
    circle_per_m = scene.mirror / scene.circle.radius_m
    stays = lines_from(1.0, scene, circle_per_m, ramp, sampling, craft, kept)
    return Alternatives(moves, start, stays, start, False)


@compiled
def add_prices(among: Alternatives, radius_m: float, leave: float, change: float, costs: FloatArray) -> None:
    """Add the prices of the moves; the price is infinite for a move that hardly leaves the circle.

    "Back to the circle" is staying, and so is hardly leaving it: the table is not that fine.
    """
    if among.under_way:
        costs += change
        return
    for i in range(MOVES):
        costs[i] = np.inf if among.moves.end_m[i] < MIN_MOVE * radius_m else costs[i] + leave


@compiled
def look_ahead(scene: Scene, futures: Scenarios, question: Question, sight: Sight, costs: FloatArray) -> float:
    """Fill in what each move costs (choices,), its price included, and return what going on as planned costs."""
    table, prices, radius_m = question.table, question.prices, scene.radius_m
    terms = question.context.terms
    # In doubt all lines are followed for a lap more: else moves seem cheaper later than they ever turn out.
    beyond_m = 2.0 * math.pi * radius_m if doubtful(scene, question.context.motions) else 0.0
    among = alternatives(scene, question, beyond_m)
    stay_costs = np.empty(len(among.stays.trunk))
    view = WatchFrame(scene.course_rad, scene.mirror, scene.velocity_x_m_s, scene.velocity_y_m_s)
    lap_s, rate_per_s = 2.0 * math.pi * radius_m / scene.air.airspeed_m_s, fading_per_s(table)
    lines_costs(among.moves, among.start, futures, scene.doubt, terms, table, scene.air, costs)
    add_sight(among.moves, among.start, sight, view, radius_m, lap_s, rate_per_s, costs)
    lines_costs(among.stays, among.stays_start, futures, scene.doubt, terms, table, scene.air, stay_costs)
    add_sight(among.stays, among.stays_start, sight, view, radius_m, lap_s, rate_per_s, stay_costs)
    add_prices(among, radius_m, prices.leave, prices.change, costs)
    if len(costs) > MOVES:
        ramp = ramp_anywhere(scene.air, question.context.watcher.craft)
        start_per_m = scene.mirror * scene.start.curvature_per_m
        sampling = Sampling(beyond_m, among.start.heading_rad, scene.air, rate_per_s)
        eights = eights_from(start_per_m, radius_m, ramp, sampling)
        lines_costs(eights, among.start, futures, scene.doubt, terms, table, scene.air, costs[MOVES:])
        add_sight(eights, among.start, sight, view, radius_m, lap_s, rate_per_s, costs[MOVES:])
        costs[MOVES:] += prices.change if among.under_way else prices.leave
    return least(stay_costs)


@compiled
def lay_out(question: Question, radius_m: float, airspeed_m_s: float, wind_m_s: float) -> None:
    """Have the second moves at hand for a circle, an airspeed and a wind: the first time takes half a millisecond."""
    # A wind of a whole step stays of that step, however its direction was rounded.
    steps = math.ceil(wind_m_s / _WIND_STEP_M_S - 1e-6)
    fastest_m_s = airspeed_m_s + steps * _WIND_STEP_M_S
    ramp = sharpness_per_m2(fastest_m_s, question.context.watcher.craft)
    turn_m = turn_radius_m(radius_m, fastest_m_s, question.context.watcher.craft)
    lay_out_second_moves(question.context.second_moves, radius_m, turn_m, ramp, airspeed_m_s * STEP_S)


@compiled
def look_two_moves_ahead(
    scene: Scene,
    futures: Scenarios,
    question: Question,
    sight: Sight,
    min_gain: float,
    costs: FloatArray,
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
    order = np.argsort(costs, kind="mergesort")
    for i in range(MOVES):
        move = order[i]
        if i >= depth.beam:
            costs[move] = np.inf
        elif costs[move] < np.inf:
            ahead, end = moving_ahead(scene, question.context.watcher.craft, move)
            costs[move] = price + deep_cost(ahead, end, MOVE_BRANCHES, scene, second, stay_cost - price - min_gain)
    return stay_cost


@compiled
def leaves(scene: Scene, futures: Scenarios, question: Question, near_m: float, far_m: float) -> bool:
    """Return whether the present plan leads out of a band, or beyond the pan limits, within threat_s in a future."""
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
    """Return what a new plan must gain beyond its price because the present one departed only just now.

    Nothing where the present one leads out of the band, or beyond the pan limits, in a likely future: for others it
    is not given up so early.
    """
    prices, terms = question.prices, question.context.terms
    if scene.line.shape[1] == 0 or scene.age_s >= prices.commit_s:
        return 0.0
    return 0.0 if leaves(scene, likely(futures), question, terms.near_m, terms.far_m) else prices.commit


_ROUTE = 0  # the future along the route is the first one
_TRUST = 0.8  # the most that it counts
_LEAST_TRUST = 0.3  # a less probable route is not planned along
_RENEW_S = 2.5  # how long the layers are used
_OTHER_WIND_RAD = 0.3
_PRICE_SHARE = 0.7  # of what moves cost without a route: along one fewer are needed, and they gain more


@compiled
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


@compiled
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
        course = course_index(f, _ROUTE, k, turn_rad)
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
        resample(table.after_turn, table.cell_m, classes, turn_share, 0, 0, s.cell_m, table_rad, found)


@compiled
def foresee(scene: Scene, question: Question) -> tuple[Scenarios, Table, SwitchingCosts, LookaheadDepth]:
    """Return what the target may do, and the table, prices and depth to answer the question with.

    Processes the target's estimate: call it once for each, in order of time.
    """
    context, table = question.context, question.table
    every, s = winding(scene, context.motions, context.watcher, context.turns), context.route
    if len(s.way.points) == 0:
        return every, table, question.prices, question.depth
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
        terms = question.context.terms
        fill_layers(f, _ROUTE, turn_rad, scene, terms, table, prices.leave, prices.change, s)
        least_of(s.values[count:], s.least[count:])
        state.computed_s, state.mirror, state.part, since_s = scene.departure_s, scene.mirror, part, 0.0
    sin_t, cos_t = math.sin(turn_rad), math.cos(turn_rad)
    for k in range(f.place.shape[1]):
        at = min((k * f.step_s + since_s) / dt_s, layers - 1.001)
        layer, past = int(at), at - int(at)
        f.classes[_ROUTE, k, 0], f.classes[_ROUTE, k, 1] = count + layer, count + layer + 1
        f.share[_ROUTE, k, 0], f.share[_ROUTE, k, 1] = 1.0 - past, past
        f.share[_ROUTE, k, 2:] = 0.0
        f.classes[_ROUTE, k, 2] = count + course_index(f, _ROUTE, k, turn_rad)
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


@compiled
def weigh(scene: Scene, question: Question, sight: Sight) -> tuple[float, float, FloatArray]:
    """Return what staying costs, what a move must gain beyond its price, and what each move costs (choices,).

    Processes the target's estimate, as :func:`foresee` does.
    """
    futures, table, prices, depth = foresee(scene, question)
    answered_by = Question(question.context, table, prices, depth)
    min_gain, costs = commitment(scene, futures, answered_by), np.empty(choices(question))
    return look_two_moves_ahead(scene, futures, answered_by, sight, min_gain, costs), min_gain, costs

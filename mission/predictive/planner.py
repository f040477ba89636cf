"""The planner that never loses the side or the band: looks ahead every second, and may change a plan under way.

Rules
-----
1. It plans from where the present plan has brought the aircraft by the time a new plan can depart.
2. All moves are rolled out from there against the estimate. The best of them, and going on as planned, are looked at
   again with a second move on the way, over several things that the target may do: the cheapest move departs if it
   beats going on by more than a change costs.
3. A move that breaks a fence gives way to the next cheapest.
4. Uploads are not free and contradict each other when they come too often: what leaving the circle costs is the price
   that the table was computed with, and a plan just begun is left only for the band or a large gain.
5. A target unseen for lost_after_s is not moved after: the circle is held.

Source: docs/explanation/planners.md#the-predictive-planner.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from sidelong.estimators.compiled import new_record
from sidelong.estimators.estimate import TargetEstimate, TrackQuality
from sidelong.mission.core.path import FloatArray, Path
from sidelong.mission.core.plan import AircraftState, Decision, Plan
from sidelong.mission.core.requirement import Aircraft, Requirement, Side, Wind
from sidelong.mission.core.sight import NOTHING_HIDDEN, Sight, SightAt
from sidelong.mission.geometry.line_kernel import LinePoint, craft_of, sharpness_per_m2, turn_radius_m
from sidelong.mission.geometry.progress import end_circle, line_of
from sidelong.mission.predictive import decision_kernel as kernel
from sidelong.mission.predictive.decision_kernel import (
    CELLS,
    HEADINGS,
    HORIZON_S,
    LAYERS,
    SIZE,
    LookaheadDepth,
    PlannerContext,
    Question,
    RouteValues,
    SwitchingCosts,
    commitment,
    foresee,
    layer_s,
    look_two_moves_ahead,
    resample,
)
from sidelong.mission.predictive.moves_kernel import EIGHTS, MOVES, move_line, new_line_cache, new_second_moves
from sidelong.mission.predictive.rollout_kernel import Scenarios, Table
from sidelong.mission.predictive.scene_kernel import FlownPlan, Scene, Turns, Watcher, scene_of, winding
from sidelong.mission.predictive.value_table import TableConfiguration, ValueTable, WatchCost, compute
from sidelong.mission.route.progress_kernel import Progress, RouteArrays, fresh_progress
from sidelong.mission.route.route import Route, way_of
from sidelong.mission.viewpoint.watch_course import SidePolicy, describe_new_circle, estimates_of

_OFF_SIDE_MIN_S = 2.0  # shorter visits to the other side are not worth a word


class Outlook(NamedTuple):
    """Places to the right of the watch course, ranges, and times since departure along a line: arrays (k,)."""

    x_m: FloatArray
    range_m: FloatArray
    time_s: FloatArray


def describe_breach(seen: Outlook, side: Side, requirement: Requirement, lead_s: float) -> str | None:
    """Return the first breach of the requirement on the line of ``seen``, which begins in lead_s; None if none."""
    x_m, range_m, time_s = seen
    (out,) = ((range_m < requirement.range_min_m) | (range_m > requirement.range_max_m)).nonzero()
    off = (x_m > 0.0).nonzero()[0] if requirement.sector is None else np.empty(0, np.intp)
    if off.size and float(time_s[off[-1]] - time_s[off[0]]) < _OFF_SIDE_MIN_S:
        off = off[:0]
    if out.size and (not off.size or out[0] <= off[0]):
        first = out[0]
        extreme_m = range_m.max() if range_m[first] > requirement.range_max_m else range_m.min()
        when_s = float(time_s[np.flatnonzero(range_m == extreme_m)[0]]) + lead_s
        return f"in {when_s:.0f} s the target would be {extreme_m:.0f} m away"
    if off.size:
        when_s = float(time_s[off[0]]) + lead_s
        if when_s < 1.0:
            return f"the aircraft is on the target's {side.opposite}"
        return f"in {when_s:.0f} s the aircraft would be on the target's {side.opposite}"
    return None


_NOTHING = np.zeros((1, 1, 1, 1), np.float32)


def route_values(route: Route | None, own: Table, c: TableConfiguration, progress: Progress) -> RouteValues:
    """Return arrays for the value layers along a route, if any, with the table's classes on their coarse grid.

    progress: state of the progress filter, which tables for several winds share.
    """
    if route is None:
        way = RouteArrays(np.zeros((0, 2)), 1.0, False, 1.0, math.nan, 0.0)
        return RouteValues(way, progress, _NOTHING, _NOTHING, 1.0, np.zeros(1), new_record(LAYERS))
    classes = len(own.values)
    layers = math.ceil(HORIZON_S / layer_s(c.airspeed_m_s, c.radius_m)) + 1
    cell_m = c.half_width_m / CELLS
    values = np.zeros((classes + layers, HEADINGS, SIZE, SIZE), np.float32)
    after_turn = np.zeros((classes + HEADINGS, HEADINGS, SIZE, SIZE), np.float32)
    share = np.array([[[1.0, 0.0, 0.0, 0.0]]])
    for k in range(classes):
        mixed = np.array([[[k, 0, 0, 0]]])
        resample(own.values, own.cell_m, mixed, share, 0, cell_m, 0.0, values[k])
        resample(own.after_turn, own.cell_m, mixed, share, 0, cell_m, 0.0, after_turn[k])
    least = values.min(axis=(1, 2, 3)).astype(np.float64)
    state = new_record(LAYERS)
    state[0].computed_s = -np.inf
    return RouteValues(way_of(route), progress, values, after_turn, cell_m, least, state)


# This many moves are tried against fences and other aircraft, the cheapest first.
_MAX_TRIES = 30
# What a move must gain, in seconds off side. The wider the circle is in its band the more moves are needed, and the
# more each has to be worth if no hour is to have too many: from a share of the band on, up to the widest circle that
# leaves room in it. Figures of eight take two moves each, whatever their width: they have the least price.
_PRICE_S, PRICE_SHARE, _PRICE_POWER = 4.0, 0.175, 1.7
_MIN_SHARE, _MAX_SHARE = 1.0 / 8.0, 1.0 / 3.8
_NO_BREACH = "a better place should the target turn"
_EIGHT = "half a figure of eight keeps the target within the pan limits"
# The table's classes need some speed, even for a target that is reported as stationary.
_MIN_TARGET_SPEED_M_S = 0.5


@dataclass(frozen=True, slots=True)
class PredictiveSettings:
    """change_cost: what a change of a plan under way must gain, in seconds off side; None: as much as any move.

    Within commit_s of a departure it must gain commit_cost more, unless in a likely future the plan leads out of the
    band in threat_s.
    beam: how many of the best moves are looked at two moves deep over horizon_s at least, in futures in which the
    target keeps its course or begins to turn at turn_rate_rad_s either way, which fades with turn_fades_s.
    min_share: share of the band below which a narrower circle makes no move cheaper. turn_share: tightest turn of a
    transition, in radii of the circle; tighter ones come nearer to the target. keeps_pan_limits: whether to plan for
    the gimbal's pan limit.
    """

    change_cost: float | None = None
    commit_s: float = 10.0
    commit_cost: float = 40.0
    threat_s: float = 14.0
    beam: int = 6
    horizon_s: float = 15.0
    turn_rate_rad_s: float = math.radians(3.0)
    turn_fades_s: float = 10.0
    lost_after_s: float = 60.0
    min_share: float = _MIN_SHARE
    turn_share: float = 1.0
    keeps_pan_limits: bool = True


USUAL = PredictiveSettings()


def price_s(aircraft: Aircraft, requirement: Requirement, settings: PredictiveSettings = USUAL) -> float:
    """Return the switching cost of a move, s off the side: a move has to gain more, as uploads are not free."""
    share = aircraft.radius_m / (requirement.range_max_m - requirement.range_min_m)
    if settings.keeps_pan_limits and aircraft.has_pan_limit:
        share = _MIN_SHARE
    return _PRICE_S * float((min(max(share, settings.min_share), _MAX_SHARE) / PRICE_SHARE) ** _PRICE_POWER)


def table_configuration(
    aircraft: Aircraft, requirement: Requirement, wind_speed_m_s: float = 0.0, settings: PredictiveSettings = USUAL
) -> TableConfiguration:
    """Return the configuration of the value table that a planner for this aircraft and requirement needs."""
    sector = requirement.sector
    pan_rad = aircraft.pan_limit_rad if settings.keeps_pan_limits else math.pi
    fine = sector is None and (wind_speed_m_s == 0.0 or pan_rad < math.pi)
    half_width_rad = math.pi / 2 if sector is None else sector.half_width_rad
    craft, fastest_m_s = craft_of(aircraft, settings.turn_share), aircraft.airspeed_m_s + wind_speed_m_s
    band_m, target_m_s = (requirement.range_min_m, requirement.range_max_m), requirement.target_speed_max_m_s
    return TableConfiguration(
        aircraft.airspeed_m_s,
        aircraft.radius_m,
        turn_radius_m(aircraft.radius_m, fastest_m_s, craft),
        sharpness_per_m2(fastest_m_s, craft),
        max(target_m_s, _MIN_TARGET_SPEED_M_S),
        WatchCost.inside(*band_m, half_width_rad, wind_speed_m_s, target_m_s, pan_rad, aircraft.radius_m),
        follows_course=sector is None,
        # A sector or wind needs classes for every direction; fewer cells keep the table's cost in bounds. Figures of
        # eight need them.
        wind_speed_m_s=wind_speed_m_s,
        leave_cost=price_s(aircraft, requirement, settings),
        cells=28 if fine else 20,
        improvements=(8, 5) if fine else (5, 3),
    )


class PredictivePlanner:
    """Implements :class:`sidelong.mission.core.plan.Planner`.

    table is that of :func:`table_configuration` with the settings; windy are more of them, for other winds. The one
    nearest to the present wind is used. check returns a plan as it can be flown, or which fence it would break: the
    best plan that breaks none is taken. sight returns what the ground hides about a target of this place and velocity
    (east, north, m and m/s). table_at returns the table for another wind speed, which has to be at hand when it is
    prepared for. route: the target's expected route.
    """

    def __init__(
        self,
        aircraft: Aircraft,
        requirement: Requirement,
        table: ValueTable,
        settings: PredictiveSettings = USUAL,
        windy: Sequence[ValueTable] = (),
        check: Callable[[Plan], Plan | str] = lambda plan: plan,
        sight: SightAt = lambda *_target: NOTHING_HIDDEN,
        table_at: Callable[[float], ValueTable] | None = None,
        route: Route | None = None,
    ) -> None:
        self.aircraft, self.requirement, self.tables = aircraft, requirement, [table, *windy]
        self.settings = settings
        self.check, self._sight, self._table_at = check, sight, table_at
        self.price_share = 1.0  # of what moves cost, in its own decisions
        self._policy = SidePolicy(requirement, aircraft.radius_m, requirement.course_horizon_s)
        self._line_cache, self._second_moves = new_line_cache(), new_second_moves()
        self._route, self._progress = route, fresh_progress(0 if route is None else route.east_m.size)
        self.questions = [self._question(own) for own in self.tables]
        if settings.beam > 0:  # else the first decisions would wait for it
            kernel.lay_out(self.questions[0], aircraft.radius_m, aircraft.airspeed_m_s, 0.0)

    def _question(self, table: ValueTable) -> Question:
        """Return the question that decisions answer with a table; all share one memory."""
        own, price = self.settings, table.configuration.leave_cost
        least_of_class = table.values.min(axis=(1, 2, 3)).astype(np.float64)
        change = price if own.change_cost is None else own.change_cost
        craft, fastest_m_s = craft_of(self.aircraft, own.turn_share), self.requirement.target_speed_max_m_s
        watcher = Watcher(craft, self._policy.wish, fastest_m_s, self._policy.memory)
        terms = table.configuration.cost.terms
        turns = Turns(own.turn_rate_rad_s * np.array([0.0, -1.0, 1.0]), own.turn_fades_s, terms.blind > 0.0)
        route = route_values(self._route, table.arrays, table.configuration, self._progress)
        return Question(
            PlannerContext(watcher, terms, table.motions, turns, self._line_cache, self._second_moves, route),
            table.arrays,
            SwitchingCosts(price, change, own.commit_cost, own.commit_s, own.threat_s),
            LookaheadDepth(own.beam, own.horizon_s, least_of_class, float(table.after_turn.min()), False),
        )

    @property
    def plans_pan_limits(self) -> bool:
        """See :class:`sidelong.mission.core.plan.PanLimitPlanner`."""
        return self.settings.keeps_pan_limits

    def prepare(self, wind_speed_m_s: float) -> None:
        """See :class:`sidelong.mission.core.plan.WindPlanner`.

        Nothing to do for a sector, whose table knows no wind.
        """
        prepared = any(own.configuration.wind_speed_m_s == wind_speed_m_s for own in self.tables)
        if self._table_at is not None and self.requirement.sector is None and not prepared:
            self.tables.append(self._table_at(wind_speed_m_s))
            self.questions.append(self._question(self.tables[-1]))

    def follow(self, route: Route | None, progress: Progress) -> None:
        """See :class:`sidelong.mission.route.route.RoutePlanner`."""
        self._route, self._progress = route, progress
        for k, (question, table) in enumerate(zip(self.questions, self.tables, strict=True)):
            values = route_values(route, table.arrays, table.configuration, progress)
            self.questions[k] = question._replace(context=question.context._replace(route=values))

    @classmethod
    def for_(cls, aircraft: Aircraft, requirement: Requirement) -> PredictivePlanner:
        """Return a planner with the value table for still air, which takes a second or so to compute."""
        return cls(aircraft, requirement, compute(table_configuration(aircraft, requirement)))

    def decide(
        self, aircraft: AircraftState, target: TargetEstimate, present: Plan, wind: Wind, latency_s: float
    ) -> Decision:
        """Decide at ``aircraft.time_s``; see :class:`sidelong.mission.core.plan.Planner`."""
        unseen_s = aircraft.time_s - target.last_sighting_s
        if target.quality is TrackQuality.LOST or unseen_s > self.settings.lost_after_s:
            reason = f"holding the circle: the target has not been seen for {unseen_s:.0f} s"
            return Decision(aircraft.time_s, None, reason)
        if wind.speed_m_s >= self.aircraft.airspeed_m_s:
            words = f"a wind of {wind.speed_m_s:.1f} m/s is too strong"
            reason = f"holding the circle: {words} for an airspeed of {self.aircraft.airspeed_m_s:.1f} m/s"
            return Decision(aircraft.time_s, None, reason)
        question = min(self.questions, key=lambda own: abs(own.context.motions.wind_speed_m_s - wind.speed_m_s))
        full, share = question.prices, self.price_share
        prices = full._replace(leave=share * full.leave, change=share * full.change)
        scene = scene_at(aircraft, target, present, wind, latency_s, question)
        question = question._replace(prices=prices)
        # The cheapest move that breaks no fence is taken, if it is cheaper than staying.
        stay_cost, min_gain_s, costs = weigh(scene, question, self.sight_in(scene))
        places, time_s = kernel.flown_on(scene, 4.0 * math.pi * scene.radius_m)
        x_m, y_m = places[0] - scene.velocity_x_m_s * time_s, places[1] - scene.velocity_y_m_s * time_s
        ahead = Outlook(x_m, np.hypot(x_m, y_m), time_s)
        side = Side.LEFT if scene.mirror > 0.0 else Side.RIGHT
        breach = describe_breach(ahead, side, self.requirement, scene.departure_s - aircraft.time_s)
        bar = stay_cost - min_gain_s
        move, plan, broken = cheapest_allowed(scene, question, costs, bar, self.check)
        if plan is not None:
            moved = describe_new_circle(present.circle, plan.circle)
            why = breach or (_EIGHT if move >= MOVES else _NO_BREACH)
            reason = f"moving {moved}: {why}"
        elif broken is not None:
            reason = f"staying: {broken}"
        elif bar <= costs[move] < stay_cost:
            age, gain_s = f"the plan is {scene.present.age_s:.0f} s old", stay_cost - costs[move]
            reason = f"staying: {age}, and another would gain {gain_s:.0f} s on the side at most"
        elif breach is not None:
            reason = f"staying until a better moment: {breach}"
        else:
            band = f"{ahead.range_m.min():.0f} to {ahead.range_m.max():.0f} m"
            reason = f"staying: the target stays {band} away for {time_s[-1]:.0f} s"
        values = {"stay_cost_s": stay_cost, "move_cost_s": float(costs[move]), "move": float(move)}
        return Decision(aircraft.time_s, plan, reason, values)

    def sight_in(self, scene: Scene) -> Sight:
        """Return from where the ground lets the target of a scene be seen."""
        sin_c, cos_c = math.sin(scene.course_rad), math.cos(scene.course_rad)
        across_m_s, along_m_s = scene.mirror * scene.velocity_x_m_s, scene.velocity_y_m_s
        velocity_m_s = across_m_s * cos_c + along_m_s * sin_c, along_m_s * cos_c - across_m_s * sin_c
        return self._sight(scene.frame_east_m, scene.frame_north_m, *velocity_m_s)


def foreseen(scene: Scene, question: Question) -> tuple[Scenarios, Question]:
    """Return what the target may do, and the question completed by the table, prices and depth to answer it with.

    Processes the target's estimate: call it once for each, in order of time.
    """
    context = question.context
    if len(context.route.way.points) == 0:
        return winding(scene, context.motions, context.watcher, context.turns), question
    futures, table, prices, depth = foresee(scene, question)
    return futures, Question(context, table, prices, depth)


def weigh(scene: Scene, question: Question, sight: Sight) -> tuple[float, float, FloatArray]:
    """Return the cost of staying, the gain a move needs beyond its price, and each move's cost (moves,), all s."""
    # One kernel of all would contain the machine code of each once more: a tenth of the first compilation.
    futures, answered_by = foreseen(scene, question)
    # Figures of eight are for a gimbal that cannot pan all around.
    costs = np.empty(MOVES + EIGHTS if question.context.terms.blind > 0.0 else MOVES)
    min_gain = commitment(scene, futures, answered_by)
    return look_two_moves_ahead(scene, futures, answered_by, sight, min_gain, costs), min_gain, costs


def scene_at(
    aircraft: AircraftState, target: TargetEstimate, present: Plan, wind: Wind, latency_s: float, question: Question
) -> Scene:
    """Return the scene of a decision: aircraft and plan at the departure, and the target as predicted from there."""
    return scene_of(
        aircraft.time_s,
        LinePoint(aircraft.east_m, aircraft.north_m, aircraft.course_rad, aircraft.curvature_per_m),
        aircraft.ground_speed_m_s,
        estimates_of(target),
        FlownPlan(*line_of(present), aircraft.time_s - present.departure_s),
        (wind.east_m_s, wind.north_m_s),
        latency_s,
        question.context.watcher,
    )


def cheapest_allowed(
    scene: Scene, question: Question, costs: FloatArray, bar: float, check: Callable[[Plan], Plan | str]
) -> tuple[int, Plan | None, str | None]:
    """Return the cheapest move that costs less than the bar and passes the check, and its plan.

    Where there is none, the move is the cheapest of all, without a plan; last why the cheapest below the bar failed.
    """
    order, broken = costs.argsort(kind="stable"), None
    for move in order[: min(np.count_nonzero(costs < bar), _MAX_TRIES)].tolist():
        path = Path(*move_line(scene, question.context.watcher.craft, move))
        precise = question.context.terms.blind > 0.0
        checked = check(Plan(end_circle(path, scene.radius_m), path, scene.departure_s, precise=precise))
        if isinstance(checked, Plan):
            return move, checked, broken
        broken = broken or checked
    return int(order[0]), None, broken

"""The planner that never loses the side or the band: looks ahead every second, and may change a plan under way.

Rules
-----
1. It plans from where the present plan has brought the aircraft by the time a new plan can depart.
2. All moves are rolled out from there against the estimate; the cheapest departs if it beats going on as planned by
   more than a change costs.
3. A move that breaks a fence gives way to the next cheapest.
4. A target unseen for lost_after_s is not moved after: the circle is held.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from estimators.estimate import TargetEstimate, TrackQuality
from mission.core.path import FloatArray
from mission.core.plan import AircraftState, Decision, Plan
from mission.core.requirement import Aircraft, Requirement, Side, Wind
from mission.geometry.progress import LinePoint, dead_reckoned, line_at, nearest_arc_m, off_track, point_at
from mission.geometry.trapezoid import Trapezoids, end_circle, sharpness_per_m2, sharpnesses_per_m2
from mission.geometry.wind import WindError, ground_speeds_m_s, min_radius_m
from mission.predictive.cost import WatchCost
from mission.predictive.forecast import describe_breach, describe_range
from mission.predictive.moves import moves_from, staying_on
from mission.predictive.rollout import Outlook, RollOut, Situation, Start, WatchFrame, outlook
from mission.predictive.value_table import TableConfiguration, ValueTable
from mission.viewpoint.course_hold import velocity_sigma_m_s
from mission.viewpoint.descriptions import describe_move
from mission.viewpoint.side_policy import SidePolicy

_STEP_S = 1.0
_UNCERTAIN_M = 10.0
_WINDY, _OTHER_WIND = 0.25, 0.15  # of the airspeed
# So many moves are tried against the fences, the cheapest first.
_MAX_TRIES = 30
_NO_BREACH = "a better place should the target turn"
# A ramp turns the aircraft by less than this either way.
_RAMP_TURNS_RAD = np.linspace(-0.5, 0.5, 5)
# The table's classes need some speed, even for a target that is said to stand.
_MIN_TARGET_SPEED_M_S = 0.5
_MIN_MOVE = 0.4  # of the radius: the length of a transition
# A transition within this of its end counts as flown.
_NEARLY_FLOWN_S = 0.2


@dataclass(frozen=True, slots=True)
class PredictiveSettings:
    """change_cost: what a change of a plan under way must gain, in seconds off side. Uploads are not free."""

    change_cost: float = 1.0
    lost_after_s: float = 60.0


def table_configuration(
    aircraft: Aircraft, requirement: Requirement, wind_speed_m_s: float = 0.0
) -> TableConfiguration:
    """Return the configuration of the value table that a planner for this aircraft and requirement needs."""
    sector = requirement.sector
    simple = sector is None and wind_speed_m_s == 0.0
    half_width_rad = math.pi / 2 if sector is None else sector.half_width_rad
    return TableConfiguration(
        aircraft.airspeed_m_s,
        aircraft.radius_m,
        sharpness_per_m2(aircraft, aircraft.airspeed_m_s + wind_speed_m_s),
        max(requirement.target_speed_max_m_s, _MIN_TARGET_SPEED_M_S),
        WatchCost.inside(requirement.range_min_m, requirement.range_max_m, half_width_rad),
        follows_course=sector is None,
        # A sector or wind needs classes for every direction; fewer cells keep the table's cost in bounds.
        wind_speed_m_s=wind_speed_m_s,
        cells=28 if simple else 20,
        improvements=(8, 5) if simple else (5, 3),
    )


def table_configurations(aircraft: Aircraft, requirement: Requirement) -> tuple[TableConfiguration, ...]:
    """Return the configurations that serve in any wind: still air first, then a wind of a quarter of the airspeed.

    Of a sector there is the first only.
    """
    calm = table_configuration(aircraft, requirement)
    if requirement.sector is not None:
        return (calm,)
    return calm, table_configuration(aircraft, requirement, _WINDY * aircraft.airspeed_m_s)


@dataclass(frozen=True, slots=True, eq=False)
class _Scene:
    """What one decision looks at: where the present plan will have led by the departure, and the target from there.

    arc_m counts along the present plan as :mod:`mission.geometry.progress` does.
    """

    aircraft: AircraftState
    present: Plan
    departure_s: float
    arc_m: float
    start: LinePoint
    side: Side
    frame: WatchFrame
    situation: Situation
    radius_m: float

    @property
    def here(self) -> Start:
        return Start(
            *self.frame.place(self.start.east_m, self.start.north_m), self.frame.heading_rad(self.start.course_rad)
        )

    @property
    def left_m(self) -> float:
        """Return what is left of the transition under way; 0 on the circle."""
        path = self.present.transition
        left_m = 0.0 if path is None else path.length_m - self.arc_m
        return left_m if left_m > _NEARLY_FLOWN_S * self.situation.airspeed_m_s else 0.0

    def going_on(self, length_m: float) -> Outlook:
        """Return the outlook of flying on along the present plan for a length."""
        arc = np.linspace(0.0, length_m, max(2, math.ceil(length_m / (self.situation.airspeed_m_s * _STEP_S)) + 1))
        east_m, north_m, course_rad = line_at(self.present, self.arc_m + arc, self.aircraft)
        x_m, y_m = self.frame.places(east_m, north_m)
        heading_rad = self.frame.mirror * (course_rad - self.frame.course_rad)
        return outlook(x_m[None, :], y_m[None, :], heading_rad[None, :], arc[None, :], self.situation)


class PredictivePlanner:
    """Implements :class:`mission.core.plan.Planner`.

    table is that of :func:`table_configuration`; windy are more of them, for other winds. The one nearest to the
    present wind is used. check tells which fence a plan would break, or None: the best plan that breaks none is
    taken.
    """

    def __init__(
        self,
        aircraft: Aircraft,
        requirement: Requirement,
        table: ValueTable,
        settings: PredictiveSettings | None = None,
        windy: Sequence[ValueTable] = (),
        check: Callable[[Plan], str | None] = lambda _plan: None,
    ) -> None:
        self._aircraft, self._requirement, self._tables = aircraft, requirement, (table, *windy)
        self._settings = settings or PredictiveSettings()
        self._policy = SidePolicy(requirement, aircraft.radius_m)
        self._check = check

    @classmethod
    def for_(cls, aircraft: Aircraft, requirement: Requirement) -> PredictivePlanner:
        """Return a planner with the value table for still air, which takes a second or so to compute.

        aircraft, requirement: what is flown and what is asked for, as they are given to every planner.
        """
        from mission.predictive.value_iteration import compute  # noqa: PLC0415  # what is compiled loads slowly

        return cls(aircraft, requirement, compute(table_configuration(aircraft, requirement)))

    def decide(
        self, aircraft: AircraftState, target: TargetEstimate, present: Plan, wind: Wind, latency_s: float
    ) -> Decision:
        """Decide at ``aircraft.time_s``; see :class:`mission.core.plan.Planner`."""
        unseen_s = aircraft.time_s - target.last_sighting_s
        if target.quality is TrackQuality.LOST or unseen_s > self._settings.lost_after_s:
            reason = f"holding the circle: the target has not been seen for {unseen_s:.0f} s"
            return Decision(aircraft.time_s, None, reason)
        try:
            return self._look_ahead(self._scene(aircraft, target, present, wind, latency_s), wind)
        except WindError as error:
            return Decision(aircraft.time_s, None, f"holding the circle: {error}")

    def _scene(
        self, aircraft: AircraftState, target: TargetEstimate, present: Plan, wind: Wind, latency_s: float
    ) -> _Scene:
        airspeed_m_s = self._aircraft.airspeed_m_s
        radius_m = max(self._aircraft.radius_m, min_radius_m(airspeed_m_s, wind, self._aircraft.bank_max_rad))
        arc_m = nearest_arc_m(present, aircraft)
        if off_track(aircraft, point_at(present, arc_m, aircraft)):
            start = dead_reckoned(aircraft, latency_s, 1.0 / radius_m)
        else:
            arc_m += aircraft.ground_speed_m_s * latency_s
            start = point_at(present, arc_m, aircraft)
        departure_s = aircraft.time_s + latency_s
        view = self._policy.viewpoint(start.east_m, start.north_m, target)
        # An estimate overshoots when the target turns: it is not believed to be faster than the target can be, unless
        # it is sure of it.
        sigma_m_s = velocity_sigma_m_s(target)
        fastest_m_s = max(self._requirement.target_speed_max_m_s, target.speed_m_s - 2.0 * sigma_m_s)
        share = min(1.0, fastest_m_s / max(target.speed_m_s, 1e-6))
        east_m_s, north_m_s = share * target.velocity_east_m_s, share * target.velocity_north_m_s
        lead_s = departure_s - target.time_s
        frame = WatchFrame(
            target.east_m + east_m_s * lead_s,
            target.north_m + north_m_s * lead_s,
            view.course_rad,
            1.0 if view.side is Side.LEFT else -1.0,
        )
        situation = Situation(
            frame.vector(east_m_s, north_m_s),
            Wind(*frame.vector(wind.east_m_s, wind.north_m_s)),
            airspeed_m_s,
            math.sqrt(max(float(target.covariance[0, 0]), float(target.covariance[1, 1]), 0.0)),
            sigma_m_s,
            view.course_sigma_rad,
        )
        return _Scene(aircraft, present, departure_s, arc_m, start, view.side, frame, situation, radius_m)

    def _look_ahead(self, scene: _Scene, wind: Wind) -> Decision:
        situation, here, radius_m = scene.situation, scene.here, scene.radius_m
        airspeed_m_s = situation.airspeed_m_s
        table = min(self._tables, key=lambda t: abs(t.configuration.wind_speed_m_s - wind.speed_m_s))
        c = table.configuration
        # The table knows nothing of uncertainty, nor of another wind than its own. Where there is much of either,
        # all lines are followed for a lap more: else moves seem cheaper later than they ever turn out.
        other_wind = abs(wind.speed_m_s - c.wind_speed_m_s) > _OTHER_WIND * airspeed_m_s
        doubtful = other_wind or situation.sigma_position_m > _UNCERTAIN_M
        beyond_m = 2.0 * math.pi * radius_m if doubtful else 0.0
        motion = table.under(situation.velocity_m_s, (situation.wind.east_m_s, situation.wind.north_m_s))
        roll_out = RollOut(situation, c.cost, motion, airspeed_m_s * _STEP_S, beyond_m)

        ramp = float(self._sharpnesses_per_m2(np.array([here.heading_rad]), situation.wind)[0])
        moves = moves_from(scene.frame.mirror * scene.start.curvature_per_m, radius_m, ramp)
        last_rad = here.heading_rad + moves.turned_rad(moves.last_start_m[:, None])[:, 0]
        moves = moves.with_last_ramps(self._sharpnesses_per_m2(last_rad, situation.wind))
        costs = roll_out.costs(moves, here)
        if scene.left_m > 0.0:
            stay_cost = float(roll_out.costs_of(scene.going_on(scene.left_m + beyond_m))[0])
            price = self._settings.change_cost
        else:
            stays = staying_on(scene.frame.mirror * scene.present.circle.curvature_per_m, radius_m, ramp)
            stay_cost, price = float(roll_out.costs(stays, here).min()), c.leave_cost
            # "Back to the circle" is staying, and so is hardly leaving it: the table is not that fine.
            costs[moves.last_end_m < _MIN_MOVE * radius_m] = np.inf
        return self._choice(scene, moves, costs + price, stay_cost)

    def _sharpnesses_per_m2(self, heading_rad: FloatArray, wind: Wind) -> FloatArray:
        """Return the ramps (n,) for the greatest ground speed met on them when they begin on headings (n,)."""
        around_rad = heading_rad[:, None] + _RAMP_TURNS_RAD
        speed_m_s = ground_speeds_m_s(around_rad, self._aircraft.airspeed_m_s, wind).max(axis=1)
        return sharpnesses_per_m2(self._aircraft, speed_m_s)

    def _choice(self, scene: _Scene, moves: Trapezoids, costs: FloatArray, stay_cost: float) -> Decision:
        """Take the cheapest move that breaks no fence, if one is cheaper than staying."""
        now_s, start, present = scene.aircraft.time_s, scene.start, scene.present
        ahead = scene.going_on(4.0 * math.pi * scene.radius_m)
        breach = describe_breach(ahead, scene.side, self._requirement, scene.departure_s - now_s)
        lines = moves if scene.frame.mirror > 0.0 else moves.mirrored()
        order = np.argsort(costs, kind="stable")
        broken: str | None = None
        for move in order[: min(np.count_nonzero(costs < stay_cost), _MAX_TRIES)].tolist():
            line = lines.path(move, start.east_m, start.north_m, start.course_rad)
            plan = Plan(end_circle(line, scene.radius_m), line, scene.departure_s)
            rejection = self._check(plan)
            if rejection is None:
                east_m, north_m = (
                    plan.circle.east_m - present.circle.east_m,
                    plan.circle.north_m - present.circle.north_m,
                )
                reason = f"moving {describe_move(east_m, north_m)}: {breach or _NO_BREACH}"
                return Decision(now_s, plan, reason, _values(stay_cost, costs, move))
            broken = broken or rejection
        if broken is not None:
            reason = f"staying: {broken}"
        elif breach is not None:
            reason = f"staying until a better moment: {breach}"
        else:
            reason = f"staying: {describe_range(ahead)}"
        return Decision(now_s, None, reason, _values(stay_cost, costs, int(order[0])))


def _values(stay_cost: float, costs: FloatArray, move: int) -> dict[str, float]:
    return {"stay_cost_s": stay_cost, "move_cost_s": float(costs[move]), "move": float(move)}

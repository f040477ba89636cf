"""The planner that never loses the side or the band: looks ahead every second, and may change a plan under way.

Rules
-----
1. It plans from where the present plan has brought the aircraft by the time a new plan can depart.
2. All moves are rolled out from there against the estimate; the cheapest departs if it beats going on as planned by
   more than a change costs.
3. A target unseen for lost_after_s is not moved after: the circle is held.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from estimators.estimate import TargetEstimate, TrackQuality
from mission.cost import WatchCost
from mission.course_hold import velocity_sigma_m_s
from mission.forecast import breach_words, range_words
from mission.moves import moves_from, staying_on
from mission.plan import AircraftState, Decision, Plan
from mission.progress import dead_reckoned, line_at, nearest_arc_m, point_at, strayed
from mission.requirement import Aircraft, Requirement, Side, Wind
from mission.rollout import Outlook, RollOut, Situation, Start, WatchFrame, outlook
from mission.side_policy import SidePolicy, Viewpoint
from mission.trapezoid import end_circle, ramp_1_m2
from mission.value_table import TableConfiguration, ValueTable
from mission.wind import WindError, least_radius_m
from mission.wording import move_words

_STEP_S = 1.0
_UNCERTAIN_M = 10.0
_OTHER_WIND = 0.15  # of the airspeed
_NO_BREACH = "a better place should the target turn"
# The table's classes need some speed, even for a target that is said to stand.
_LEAST_TARGET_SPEED_M_S = 0.5
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
        ramp_1_m2(aircraft, aircraft.airspeed_m_s + wind_speed_m_s),
        max(requirement.target_speed_max_m_s, _LEAST_TARGET_SPEED_M_S),
        WatchCost.inside(requirement.range_min_m, requirement.range_max_m, half_width_rad),
        follows_course=sector is None,
        # A sector or wind needs classes for every direction; fewer cells keep the table's cost in bounds.
        wind_speed_m_s=wind_speed_m_s,
        cells=28 if simple else 20,
        improvements=(8, 5) if simple else (5, 3),
    )


class PredictivePlanner:
    """Implements :class:`mission.plan.Planner`.

    table is that of :func:`table_configuration`; windy are more of them, for other winds. The one nearest to the
    present wind is used.
    """

    def __init__(
        self,
        aircraft: Aircraft,
        requirement: Requirement,
        table: ValueTable,
        settings: PredictiveSettings | None = None,
        windy: Sequence[ValueTable] = (),
    ) -> None:
        self._aircraft, self._requirement, self._tables = aircraft, requirement, (table, *windy)
        self._settings = settings or PredictiveSettings()
        self._policy = SidePolicy(requirement, aircraft.radius_m)

    def decide(
        self, aircraft: AircraftState, target: TargetEstimate, present: Plan, wind: Wind, latency_s: float
    ) -> Decision:
        """Decide at ``aircraft.time_s``; see :class:`mission.plan.Planner`."""
        unseen_s = aircraft.time_s - target.last_sighting_s
        if target.quality is TrackQuality.LOST or unseen_s > self._settings.lost_after_s:
            reason = f"holding the circle: the target has not been seen for {unseen_s:.0f} s"
            return Decision(aircraft.time_s, None, reason)
        try:
            return self._look_ahead(aircraft, target, present, wind, latency_s)
        except WindError as error:
            return Decision(aircraft.time_s, None, f"holding the circle: {error}")

    def _look_ahead(
        self, aircraft: AircraftState, target: TargetEstimate, present: Plan, wind: Wind, latency_s: float
    ) -> Decision:
        airspeed_m_s = self._aircraft.airspeed_m_s
        radius_m = max(self._aircraft.radius_m, least_radius_m(airspeed_m_s, wind, self._aircraft.bank_max_rad))
        ramp = ramp_1_m2(self._aircraft, airspeed_m_s + wind.speed_m_s)
        departure_s = aircraft.time_s + latency_s
        arc_m = nearest_arc_m(present, aircraft)
        start = point_at(present, arc_m, aircraft)
        arc_m += aircraft.ground_speed_m_s * latency_s
        if strayed(aircraft, start):
            start = dead_reckoned(aircraft, latency_s, 1.0 / radius_m)
        else:
            start = point_at(present, arc_m, aircraft)

        view = self._policy.viewpoint(start.east_m, start.north_m, target)
        frame, situation = self._situation(view, target, wind, departure_s)
        table = min(self._tables, key=lambda t: abs(t.configuration.wind_speed_m_s - wind.speed_m_s))
        c = table.configuration
        motion = table.under(situation.velocity_m_s, (situation.wind.east_m_s, situation.wind.north_m_s))
        other_wind = abs(wind.speed_m_s - c.wind_speed_m_s) > _OTHER_WIND * airspeed_m_s
        here = Start(*frame.place(start.east_m, start.north_m), frame.heading_rad(start.course_rad))
        # The table knows nothing of uncertainty, nor of another wind than its own. Where there is much of either,
        # all lines are followed for a lap more: else moves seem cheaper later than they ever turn out.
        doubtful = situation.sigma_position_m > _UNCERTAIN_M or other_wind
        beyond_m = 2.0 * math.pi * radius_m if doubtful else 0.0
        roll_out = RollOut(situation, c.cost, motion, airspeed_m_s * _STEP_S, beyond_m)

        moves = moves_from(frame.mirror * start.curvature_1_m, radius_m, ramp)
        costs = roll_out.costs(moves, here)
        path = present.transition
        if path is not None and arc_m < path.length_m - _NEARLY_FLOWN_S * airspeed_m_s:
            rest = _along(present, arc_m, path.length_m - arc_m + beyond_m, aircraft, frame, situation)
            stay_cost, price = float(roll_out.costs_of(rest)[0]), self._settings.change_cost
        else:
            stays = staying_on(frame.mirror * present.circle.curvature_1_m, radius_m, ramp)
            stay_costs = roll_out.costs(stays, here)
            stay_cost, price = float(stay_costs.min()), c.leave_cost
            costs[-1] = np.inf  # "back to the circle" is staying
        best = int(np.argmin(costs))
        values = {"stay_cost_s": stay_cost, "move_cost_s": float(costs[best]), "move": float(best)}
        going_on = _along(present, arc_m, 4.0 * math.pi * radius_m, aircraft, frame, situation)
        breach = breach_words(going_on, view.side, self._requirement, latency_s)
        if costs[best] + price >= stay_cost:
            reason = f"staying until a better moment: {breach}" if breach else f"staying: {range_words(going_on)}"
            return Decision(aircraft.time_s, None, reason, values)

        lines = moves if frame.mirror > 0.0 else moves.mirrored()
        line = lines.path(best, start.east_m, start.north_m, start.course_rad)
        circle = end_circle(line, radius_m)
        shift = move_words(circle.east_m - present.circle.east_m, circle.north_m - present.circle.north_m)
        reason = f"moving {shift}: {breach or _NO_BREACH}"
        return Decision(aircraft.time_s, Plan(circle, line, departure_s), reason, values)

    def _situation(
        self, view: Viewpoint, target: TargetEstimate, wind: Wind, departure_s: float
    ) -> tuple[WatchFrame, Situation]:
        """Return the watch frame and what is known in it when a new plan departs."""
        lead_s = departure_s - target.time_s
        frame = WatchFrame(
            target.east_m + target.velocity_east_m_s * lead_s,
            target.north_m + target.velocity_north_m_s * lead_s,
            view.course_rad,
            1.0 if view.side is Side.LEFT else -1.0,
        )
        situation = Situation(
            frame.vector(target.velocity_east_m_s, target.velocity_north_m_s),
            Wind(*frame.vector(wind.east_m_s, wind.north_m_s)),
            self._aircraft.airspeed_m_s,
            math.sqrt(max(float(target.covariance[0, 0]), float(target.covariance[1, 1]), 0.0)),
            velocity_sigma_m_s(target),
            view.course_sigma_rad,
        )
        return frame, situation


def _along(
    plan: Plan, arc_m: float, length_m: float, aircraft: AircraftState, frame: WatchFrame, situation: Situation
) -> Outlook:
    """Return the outlook of flying on along a plan for a length."""
    arc = np.linspace(0.0, length_m, max(2, math.ceil(length_m / (situation.airspeed_m_s * _STEP_S)) + 1))
    east_m, north_m, course_rad = line_at(plan, arc_m + arc, aircraft)
    x_m, y_m = frame.places(east_m, north_m)
    heading_rad = frame.mirror * (course_rad - frame.course_rad)
    return outlook(x_m[None, :], y_m[None, :], heading_rad[None, :], arc[None, :], situation)

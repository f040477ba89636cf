"""One aircraft's planner in a fleet: it counts on what the others will see, and moves where all together gain.

Without fresh advice, or alone on its target, it decides as the planner of a single aircraft does. In a fleet it then
pays the fleet's price of moves: its partner may have gone and left the required side unwatched.

Source: docs/explanation/planners.md#several-aircraft.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sidelong.estimators.estimate import TargetEstimate, TrackQuality
from sidelong.mission.core.fleet import FleetAdvice, Neighbour, NeighbourPlanned, Role
from sidelong.mission.core.path import FloatArray
from sidelong.mission.core.plan import AircraftState, Decision, Plan
from sidelong.mission.core.requirement import Side, Wind
from sidelong.mission.fleet import team_kernel as kernel
from sidelong.mission.fleet.roles import RoleCosts
from sidelong.mission.fleet.team_kernel import Team
from sidelong.mission.geometry.separation import airspeed_of, flown_places
from sidelong.mission.predictive.decision_kernel import Question, look_two_moves_ahead
from sidelong.mission.predictive.moves_kernel import MOVES
from sidelong.mission.predictive.planner import (
    PRICE_SHARE,
    PredictivePlanner,
    PredictiveSettings,
    cheapest_allowed,
    foreseen,
    scene_at,
)
from sidelong.mission.predictive.rollout_kernel import STEP_S
from sidelong.mission.predictive.value_table import ValueTable
from sidelong.mission.route.progress_kernel import Progress
from sidelong.mission.route.route import Route
from sidelong.mission.viewpoint.watch_course import describe_new_circle

# A circle that takes more of the band swings further about the target: predictions of the others are worth less.
_WIDE, _WIDER_POWER = 1.0 / 7.0, 3
# The share of the band that the fastest target crosses in a lap: where it is more, a circle is left sooner anyway.
_CROSSED = 0.43
# Where other aircraft watch during a move, cheaper moves than those of this share are too frequent in the tables. A
# remaining aircraft keeps these, as others may join it. By tight turns one gets back to the side sooner where a turn
# of the target has put all of them off it. Another can look where one is beyond its pan limit.
IN_TEAM = PredictiveSettings(min_share=PRICE_SHARE, turn_share=0.5, keeps_pan_limits=False)
_WORSE_MAX_S = 20.0  # a move that alone is worse by more, or was not looked at again, is out of the question
_DIRECTIONS_RAD = np.radians(np.arange(-168.75, 180.0, 22.5))


def team_of(table: ValueTable, wanted: Side) -> Team:
    """Return the settings of joint decisions for the compiled functions.

    Fast targets lower ``price`` and raise ``opposite``; wide circles raise ``own``.

    Raises:
        ValueError: The table is that of a sector.
    """
    configuration = table.configuration
    if not configuration.follows_course:
        raise ValueError("several aircraft share the sides of a target, not a sector")
    habits, cost = configuration.habits, configuration.cost
    wide = configuration.radius_m / (_WIDE * (cost.far_m - cost.near_m))
    lap_s = 2.0 * np.pi * configuration.radius_m / configuration.airspeed_m_s
    crossed = lap_s * configuration.target_speed_max_m_s / (cost.far_m - cost.near_m)
    haste = max(1.0, crossed / _CROSSED)
    return Team(
        wanted=1.0 if wanted is Side.LEFT else -1.0,
        turns_rad=np.radians(habits.turns_deg),
        chances=np.array(habits.chances),
        price=0.6 / haste,
        opposite=0.6 * haste,
        own=max(1.0, wide**_WIDER_POWER),
    )


def for_standing_target(team: Team) -> Team:
    """Return these settings for a stationary target, which may set out into any direction."""
    return team._replace(turns_rad=_DIRECTIONS_RAD, chances=np.full(_DIRECTIONS_RAD.size, 1.0 / _DIRECTIONS_RAD.size))


_ADVICE_S = 5.0  # how long advice is followed
_STANDING_M_S = 0.5  # the course of a slower target is not expected to last
_PREDICTED = 160  # seconds of the others' lines: longer than any line, and what their reports may be late


class TeamPlanner:
    """Implements :class:`sidelong.mission.core.fleet.CooperativePlanner`.

    Args:
        alone: the planner of a single aircraft, with the settings ``IN_TEAM``. Its required side is the wanted one
            until advice changes it.

    Raises:
        ValueError: The requirement has no side: either side, or a sector.
    """

    def __init__(self, alone: PredictivePlanner) -> None:
        requirement = alone.requirement
        if requirement.either_side or requirement.sector is not None:
            raise ValueError("several aircraft share the sides of a target: side has to be left or right")
        self._alone, self._side = alone, requirement.side
        self._wanted = 1.0 if self._side is Side.LEFT else -1.0
        self._teams = [team_of(table, self._side) for table in alone.tables]
        alone.price_share = self._teams[0].price
        self._advice: FleetAdvice | None = None
        self._plans: dict[str, NeighbourPlanned] = {}

    def advise(self, news: FleetAdvice | NeighbourPlanned) -> None:
        """See :class:`sidelong.mission.core.fleet.CooperativePlanner`."""
        if isinstance(news, NeighbourPlanned):
            self._plans[news.name] = news
        else:
            self._advice = news
            held = 1.0 if news.side is Side.LEFT else -1.0
            self._wanted = -held if news.role is Role.OPPOSITE else held
            self._alone.questions[0].context.watcher.memory[0].side = held  # of all questions
            if news.course_rad is not None:
                self.presume(news.course_rad)

    def presume(self, course_rad: float) -> None:
        """Use the fleet's course of the target until this planner has seen the target move."""
        self._alone.questions[0].context.watcher.memory[0].presumed_course_rad = course_rad  # of all questions

    def follow(self, route: Route | None, progress: Progress) -> None:
        """See :class:`sidelong.mission.route.route.RoutePlanner`."""
        self._alone.follow(route, progress)

    def prepare(self, wind_speed_m_s: float) -> None:
        """See :class:`sidelong.mission.core.plan.WindPlanner`."""
        self._alone.prepare(wind_speed_m_s)
        self._teams += [team_of(table, self._side) for table in self._alone.tables[len(self._teams) :]]

    def role_costs(
        self, aircraft: AircraftState, target: TargetEstimate, present: Plan, wind: Wind, latency_s: float
    ) -> RoleCosts:
        """Return this aircraft's expected costs alone in each role, from its next departure on, s off the side."""
        question, team = self._for(wind)
        held, costs_s = question.context.watcher.memory[0].side, []
        for side in (team.wanted, -team.wanted):
            question.context.watcher.memory[0].side = side
            scene = scene_at(aircraft, target, present, wind, latency_s, question)
            costs_s.append(kernel.role_value(scene, question))
        question.context.watcher.memory[0].side = held
        return RoleCosts(*costs_s)

    def decide(
        self, aircraft: AircraftState, target: TargetEstimate, present: Plan, wind: Wind, latency_s: float
    ) -> Decision:
        """Decide at ``aircraft.time_s``; see :class:`sidelong.mission.core.plan.Planner`."""
        others = self._others(aircraft.time_s)
        unseen_s = aircraft.time_s - target.last_sighting_s
        lost = target.quality is TrackQuality.LOST or unseen_s > self._alone.settings.lost_after_s
        if not others or lost or wind.speed_m_s >= self._alone.aircraft.airspeed_m_s:
            return self._alone.decide(aircraft, target, present, wind, latency_s)
        question, team = self._for(wind)
        if target.speed_m_s < _STANDING_M_S:
            team = for_standing_target(team)
        scene, costs = scene_at(aircraft, target, present, wind, latency_s, question), np.empty(MOVES)
        futures, answered_by = foreseen(scene, question)
        stay_cost, bar = kernel.team_decide(
            scene,
            futures,
            np.stack([self._predicted(other, wind) for other in others]),
            np.array([other.state.time_s for other in others]),
            question,
            team,
            costs,
        )
        if scene.mirror == team.wanted:
            alone, sight = np.empty(MOVES), self._alone.sight_in(scene)
            alone_stay = look_two_moves_ahead(scene, futures, answered_by, sight, 0.0, alone)
            costs += team.own * np.minimum(alone - alone_stay, _WORSE_MAX_S)
        values = {"stay_cost_s": float(stay_cost), "move_cost_s": float(costs.min())}
        move, plan, broken = cheapest_allowed(scene, question, costs, bar, self._alone.check)
        if plan is not None:
            moved = describe_new_circle(present.circle, plan.circle)
            reason = f"moving {moved}: better alongside {_names(others)}"
            return Decision(aircraft.time_s, plan, reason, {**values, "move": float(move)})
        reason = f"staying: {broken}" if broken else f"staying alongside {_names(others)}"
        return Decision(aircraft.time_s, None, reason, values)

    def _for(self, wind: Wind) -> tuple[Question, Team]:
        questions = self._alone.questions
        k = min(
            range(len(questions)), key=lambda i: abs(questions[i].context.motions.wind_speed_m_s - wind.speed_m_s)
        )
        return questions[k], self._teams[k]._replace(wanted=self._wanted)

    def _others(self, time_s: float) -> list[Neighbour]:
        advice = self._advice
        if advice is None or time_s - advice.time_s > _ADVICE_S:
            return []
        return [
            neighbour
            for neighbour in advice.neighbours
            if neighbour.ours
            and neighbour.target == advice.target
            and neighbour.role is not Role.LEAVE
            and time_s - neighbour.state.time_s <= _ADVICE_S
            and (news := self._plans.get(neighbour.name)) is not None
            and news.present is not None
        ]

    def _predicted(self, other: Neighbour, wind: Wind) -> FloatArray:
        news, state = self._plans[other.name], other.state
        assert news.present is not None
        airspeed_m_s = airspeed_of(state, wind)
        return flown_places(state, news.present, news.coming, wind, airspeed_m_s, STEP_S, _PREDICTED)


def _names(others: Sequence[Neighbour]) -> str:
    return " and ".join(other.name for other in others)

"""The control step: one event in, commands out. Live flight, replay and tests all call this.

Rules
-----
1. Nothing is commanded before ``ControlAcquired`` and nothing after ``Yield`` or ``End``.
2. At most one plan is under way to the autopilot. It is uploaded (the autopilot holds it, still flying the line
   before), then activated at its planned time; one that got ready too late to be joined is dropped and decided anew.
   Until it is known whether an activated plan is flown, nothing is decided; that it is may be known late.
3. A plan that breaks a fence is not sent; the present circle goes on.
4. What is sent is the wanted circle with the radius that makes the autopilot fly it; when the measured ratio of
   flown to commanded radius changes, the present circle is sent again.
5. An aircraft that has left its transition for some seconds (circling a waypoint that it cannot reach, say) is sent
   to the transition's circle directly.
6. Any flight mode but the one engaged in means that somebody else flies: Yield, latched.
7. A target lost for ``give_up_after_s`` ends the mission.
8. What a person changes in flight holds from the next decision on: the planner is made anew, and where it stays, the
   present circle is sent again as changed.
9. Every event passes :mod:`mission.control.plausibility` first. While that doubts the aircraft's own position, the
   circle is held: nothing is decided, and no plan departs.
10. In a fleet the joint estimate, the target and the side come with ``FleetAdvice`` while that is fresh; without it
    the aircraft goes on by its own. A plan that comes too near to another aircraft counts as one that breaks a fence.

The clock is the vehicle's: the latest time of a position reading.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import Literal

from estimators.estimate import TargetEstimate, TrackQuality
from estimators.readings import (
    AttitudeReading,
    GimbalReading,
    PositionReading,
    RangeReading,
    Reading,
    TargetFixReading,
)
from estimators.sighting import SightingOutcome
from estimators.tracker import Tracker
from mission.control.flown_radius import FlownRadius
from mission.control.mission_change import aircraft_after, describe_change, requirement_after
from mission.control.plausibility import Plausibility
from mission.control.sensor_status import SensorStatus
from mission.core.circle import Circle
from mission.core.events import (
    ActivatePlan,
    Announce,
    Command,
    ControlAcquired,
    DecisionRecord,
    End,
    Event,
    LinkReported,
    MissionChange,
    ModeReported,
    OperatorRequest,
    PlanStatus,
    RoundTripReported,
    UploadPlan,
    WindPrepared,
    WindReported,
    Yield,
    YieldRequested,
)
from mission.core.fleet import CooperativePlanner, FleetAdvice, NeighbourPlanned, Role
from mission.core.heights import ClimbRates, Heights, OneHeight
from mission.core.plan import AircraftState, Decision, Plan, Planner, PlannerFactory, WindPlanner, settled_m
from mission.core.requirement import GRAVITY_M_S2, Aircraft, Requirement, Side, Wind
from mission.geometry.approach import approach
from mission.geometry.progress import nearest_arc_m, off_track, point_at
from mission.geometry.separation import Separation
from mission.predictive._sight_kernel import NOTHING_HIDDEN, Sight, SightAt

# A plan that got ready after its time still departs, up to so much later, while the aircraft is near its line: a
# transition parts slowly from the line before it. Later than that the aircraft banks the wrong way for it.
_LATE_S, _JOINABLE_M, _JOINABLE_RAD = 1.5, 15.0, math.radians(15.0)
# Off its transition for so long, an aircraft does not come back by itself. So it is when it turns that much tighter
# than any plan asks for: it orbits a waypoint that it cannot reach, near to the line all the time.
_OFF_TRACK_S, _ORBITS = 6.0, 2.0
# The present circle is sent again when its flown radius is off by more than this share.
_RADIUS_TOLERANCE = 0.03
# A stronger wind, as a share of the airspeed, is not flown in: one that is reported all the same is not believed.
_WIND_MAX_SHARE = 0.9
# A target unseen for less than this is no news: lasers miss for some seconds all the time.
_NEWS_AFTER_S = 8.0
# The latency expected is the longest of so many uploads but one: one that hung says nothing of the next. Each took as
# many round trips as the next will take, at least two of them: the announcement's and the items'.
_LATENCY_UPLOADS, _LATENCY_MARGIN_S = 5, 0.1
_UPLOAD_ROUND_TRIPS = 2.0
_SENSED = (AttitudeReading, RangeReading, GimbalReading, TargetFixReading)
# What the fleet advised is followed for so long.
_ADVICE_S = 5.0


class Phase(StrEnum):
    """Where the mission stands."""

    WAITING = "waiting"  # not engaged yet
    WATCHING = "watching"
    HOLDING = "holding"  # by an operator's wish
    YIELDED = "yielded"
    ENDED = "ended"


class _Sight(StrEnum):
    """What was last told of the target."""

    SEEN = "seen"
    UNSEEN = "unseen"
    LOST = "lost"


@dataclass(frozen=True, slots=True)
class StandoffSettings:
    """decision_period_s: least time between two decisions. latency_s: of an upload, before one was measured."""

    requirement: Requirement
    aircraft: Aircraft
    decision_period_s: float = 1.0
    latency_s: float = 1.0
    lost_after_s: float = 60.0
    give_up_after_s: float = 300.0
    give_up_action: Literal["hold", "return"] = "return"


@dataclass(frozen=True, slots=True, eq=False)
class Snapshot:
    """Everything a display needs, at one moment."""

    time_s: float
    phase: Phase
    side: Side
    aircraft: AircraftState | None
    estimate: TargetEstimate | None
    present: Plan | None
    coming: Plan | None
    decision: Decision | None
    wind: Wind
    moves: int
    uploads: int
    upload_failures: int
    latency_s: float
    mode: str
    sensor_status: SensorStatus
    requirement: Requirement
    radius_m: float
    height_m: float | None  # as a person has changed it; None: as configured


@dataclass(slots=True)
class _PlanChange:
    """A plan on its way to the autopilot."""

    number: int
    plan: Plan
    commanded: Circle
    since_s: float
    stage: Literal["preparing", "ready", "departing"] = "preparing"


@dataclass(slots=True)
class _Counts:
    moves: int = 0
    uploads: int = 0
    upload_failures: int = 0


FenceCheck = Callable[[Plan], str | None]


def _no_fence(_plan: Plan) -> str | None:
    return None


def _all_in_sight(*_target: float) -> Sight:
    return NOTHING_HIDDEN


@dataclass
class StandoffController:
    """The mission's whole state. ``check`` names the fence that a plan would break, or returns None.

    ``heights`` gives plans theirs; None: the one that is configured, for all. ``sight`` tells what the ground hides
    about a target of this place and velocity. ``make_planner`` builds the planner for an aircraft and a requirement,
    at once and of what is at hand; it is called again, within a step, when one of them changes. ``sighted``: the
    sightings that the last step completed.
    """

    settings: StandoffSettings
    tracker: Tracker
    make_planner: PlannerFactory
    check: FenceCheck = _no_fence
    heights: Heights | None = None
    sight: SightAt = _all_in_sight
    phase: Phase = Phase.WAITING
    time_s: float = -math.inf
    decision: Decision | None = None
    estimate: TargetEstimate | None = None
    present: Plan | None = None
    door: Plausibility = field(init=False)
    prepared_winds_m_s: list[float] = field(default_factory=list)  # in flight
    separation: Separation = field(default_factory=Separation)
    sighted: tuple[SightingOutcome, ...] = ()
    _advice: FleetAdvice | None = None
    _requirement: Requirement = field(init=False)
    _planner: Planner = field(init=False)
    _aircraft: AircraftState | None = None
    _height_m: float | None = None  # the aircraft's, above home
    _sensor_status: SensorStatus = field(default_factory=SensorStatus)
    _wind: Wind = field(default_factory=Wind)
    _mode: str = ""
    _engaged_mode: str = ""
    _change: _PlanChange | None = None
    _not_taken: _PlanChange | None = None  # the last departure that failed: should it be flown after all
    _counts: _Counts = field(default_factory=_Counts)
    _latency_s: float = field(init=False)
    _took_s: deque[tuple[float, float | None]] = field(init=False)  # and the round trip of then
    _round_trip_s: float | None = None  # of the link, now
    _next_decision_s: float = -math.inf
    _number: int = 0
    _flown_radius: FlownRadius = field(default_factory=FlownRadius)
    _commanded: Circle | None = None  # as the autopilot was told to fly the present circle
    _sight: _Sight | None = None
    _changed_s: float | None = None  # when a person last changed the mission; None: that is flown
    _height_asked_m: float | None = None
    _on_line_s: float = math.inf  # when the aircraft was last seen on its transition; inf: it flies none

    def __post_init__(self) -> None:
        self.door = Plausibility(_WIND_MAX_SHARE * self.settings.aircraft.airspeed_m_s)
        self._requirement = self.settings.requirement
        self._planner = self._new_planner()
        self._latency_s = self.settings.latency_s
        self._took_s = deque([(self._latency_s, None)], _LATENCY_UPLOADS)

    def step(self, event: Event) -> tuple[Command, ...]:
        """Take one event; return what is to be done about it, in order."""
        self.sighted = ()
        admitted, told = self.door.admit(event)
        if admitted is None:
            return told
        commands = self._admitted(admitted)
        return told + commands if told else commands

    def _admitted(self, event: Event) -> tuple[Command, ...]:
        if isinstance(event, _SENSED):  # most of all events
            self._read(event)
            return ()
        match event:
            case PositionReading():
                return self._position(event)
            case WindReported() | WindPrepared():
                return self._wind_told(event)
            case ModeReported():
                return self._mode_reported(event)
            case ControlAcquired() if self.phase in (Phase.WAITING, Phase.WATCHING):
                self.phase, self._engaged_mode = Phase.WATCHING, event.mode
                begun = Plan(event.circle, None, event.time_s)
                cleared = self.cleared_first(begun)
                self.present = begun if isinstance(cleared, str) else cleared
                self._commanded = event.commanded or event.circle
                self._flown_radius = FlownRadius(event.circle.radius_m / self._commanded.radius_m)
                if self.door.two_vehicles is not None:
                    return self._yield(event.time_s, self.door.two_vehicles)
            case PlanStatus():
                return self._plan_reported(event)
            case LinkReported() | RoundTripReported():
                return self._link_reported(event)
            case YieldRequested():
                return self._yield(event.time_s, event.reason)
            case OperatorRequest():
                return self._operator(event)
            case MissionChange():
                return self._mission_changed(event)
            case FleetAdvice() | NeighbourPlanned():
                return self._advised(event)
        return ()

    @property
    def aircraft(self) -> AircraftState | None:
        """The aircraft as it was last reported, None before the first position."""
        return self._aircraft

    @property
    def coming(self) -> Plan | None:
        """The plan on its way to the autopilot."""
        return self._change.plan if self._change else None

    def snapshot(self) -> Snapshot:
        """Return the state as a display wants it."""
        return Snapshot(
            self.time_s,
            self.phase,
            self._requirement.side,
            self._aircraft,
            self.estimate,
            self.present,
            self.coming,
            self.decision,
            self._wind,
            self._counts.moves,
            self._counts.uploads,
            self._counts.upload_failures,
            self._latency_s,
            self._mode,
            self._sensor_status.copy(),
            self._requirement,
            self.settings.aircraft.radius_m,
            self._height_asked_m,
        )

    def _read(self, reading: Reading) -> None:
        self.sighted = self.tracker.add(reading)
        self._sensor_status.note(reading, self.sighted, self.tracker)

    # -- the aircraft's position is the tick ---------------------------------------------------------------

    def _position(self, reading: PositionReading) -> tuple[Command, ...]:
        if self.door.place_is_known:
            self._read(reading)
        if reading.time_s <= self.time_s:
            return ()  # overtaken on the way: it has helped the tracker, the clock stays
        self.time_s, self._height_m = reading.time_s, reading.height_m
        ground_speed_m_s = math.hypot(reading.velocity_east_m_s, reading.velocity_north_m_s)
        # A coordinated turn at this bank bends the flown line by g tan(bank) across it.
        curvature_per_m = GRAVITY_M_S2 * math.tan(self._sensor_status.bank_rad) / max(ground_speed_m_s, 5.0) ** 2
        self._aircraft = AircraftState(
            reading.time_s,
            reading.east_m,
            reading.north_m,
            math.atan2(reading.velocity_east_m_s, reading.velocity_north_m_s),
            ground_speed_m_s,
            curvature_per_m,
        )
        if self._commanded is not None and not self.door.dead_reckoned:
            self._flown_radius.observe(self._aircraft, self._commanded)
        told: tuple[Command, ...] = ()
        due = self.time_s >= self._next_decision_s
        if due:
            self._next_decision_s = self.time_s + self.settings.decision_period_s
            self.estimate = self._joint_estimate() or self.tracker.estimate(self.time_s)
            told = self._track_commands()
        if self._change is not None:
            return told + self._drive(self._change)
        if self.door.doubt is not None:
            self.decision = Decision(self.time_s, None, f"holding the circle: {self.door.doubt}")
            return told
        if self.door.faulty:
            return told
        return told + self._decide() if due else ()

    def _track_commands(self) -> tuple[Command, ...]:
        """Tell when the target goes out of sight for longer than lasers usually miss it, is lost, or is back."""
        estimate = self.estimate
        if estimate is None:
            return ()
        unseen_s = self.time_s - estimate.last_sighting_s
        sight = _Sight.SEEN
        if estimate.quality is TrackQuality.LOST:
            sight = _Sight.LOST
        elif unseen_s > _NEWS_AFTER_S:
            sight = _Sight.UNSEEN
        before, self._sight = self._sight, sight
        if sight is before:
            return ()
        match sight:
            case _Sight.SEEN:
                text = "the target is in sight" + (" again" if before is not None else "")
            case _Sight.UNSEEN:
                text = f"the target has not been seen for {unseen_s:.0f} s; its track goes on by its last motion"
            case _Sight.LOST:
                text = (
                    f"the target is lost: {estimate.reason or f'not seen for {unseen_s:.0f} s'}; holding the circle"
                )
        return (Announce(self.time_s, "track", text),)

    # -- deciding ------------------------------------------------------------------------------------------

    def _decide(self) -> tuple[Command, ...]:
        if self.phase is not Phase.WATCHING or self.estimate is None:
            return ()
        assert self.present is not None
        assert self._aircraft is not None
        if self._is_off_track(self._aircraft, self.present):
            reason = "the aircraft has left its line: going to the circle directly"
            plan = replace(self.present, transition=None, departure_s=self.time_s + self._latency_s)
            return (Announce(self.time_s, "plan", reason), self._prepared(plan, self.present, reason))
        unseen_s = self.time_s - self.estimate.last_sighting_s
        if unseen_s > self.settings.give_up_after_s:
            self.phase = Phase.ENDED
            reason = f"the target has not been seen for {unseen_s:.0f} s"
            return (End(self.time_s, self.settings.give_up_action, reason),)
        if unseen_s > self.settings.lost_after_s or self.estimate.quality is TrackQuality.LOST:
            self.decision = Decision(self.time_s, None, f"holding the circle: target unseen for {unseen_s:.0f} s")
            return self._circle_as_changed(self._aircraft, self.present)
        decision = self._choose(self._aircraft, self.estimate, self.present)
        cleared = self.cleared(decision.plan) if decision.plan is not None else None
        broken = cleared if isinstance(cleared, str) else None
        if isinstance(cleared, str):
            decision = replace(decision, plan=None, reason=f"staying: {broken}")
        else:
            decision = replace(decision, plan=cleared)
        self.decision = decision
        decided = DecisionRecord(self.time_s, decision.plan is not None, decision.reason, decision.values)
        if decision.plan is not None:
            prepare = self._prepared(decision.plan, self.present, decision.reason)
            text = f"{decision.reason}; there in {self._arrival_s(decision.plan) - self.time_s:.0f} s"
            return (decided, Announce(self.time_s, "decision", text), prepare)
        if broken is not None:
            told = Announce(self.time_s, "decision", decision.reason)
            return (decided, told, *self._circle_as_changed(self._aircraft, self.present))
        changed = self._circle_as_changed(self._aircraft, self.present)
        return (decided, *(changed or self._corrected_radius(self.present)))

    def _wind_told(self, event: WindReported | WindPrepared) -> tuple[Command, ...]:
        if isinstance(event, WindReported):
            self._wind = Wind(event.east_m_s, event.north_m_s)
            return ()
        if event.speed_m_s in self.prepared_winds_m_s or not isinstance(self._planner, WindPlanner):
            return ()
        self.prepared_winds_m_s.append(event.speed_m_s)
        self._planner.prepare(event.speed_m_s)
        return (Announce(event.time_s, "decision", f"ready for a wind of {event.speed_m_s:g} m/s"),)

    def _arrival_s(self, plan: Plan) -> float:
        """Return about when a plan's circle is reached."""
        length_m = plan.transition.length_m if plan.transition is not None else 0.0
        return plan.departure_s + length_m / self.settings.aircraft.airspeed_m_s

    def cleared(self, plan: Plan) -> Plan | str:
        """Return the plan with its heights, or in words which fence it breaks or what ground is in its way."""
        target = self.estimate
        place_m = None if target is None else (target.east_m, target.north_m)
        cleared = self._cleared(plan, self.heights, self.flown_height_m, place_m)
        return cleared if isinstance(cleared, str) else self._breach(cleared) or cleared

    def _cleared(
        self, plan: Plan, heights: Heights | None, flown_m: float | None, target_m: tuple[float, float] | None
    ) -> Plan | str:
        levelled = plan if heights is None else heights.levelled(plan, flown_m, target_m)
        return levelled if isinstance(levelled, str) else self.check(levelled) or levelled

    def _breach(self, plan: Plan) -> str | None:
        return self.separation.breach(
            plan,
            self.present,
            self._aircraft,
            self.flown_height_m,
            self._wind,
            self.settings.aircraft.airspeed_m_s,
        )

    @property
    def flown_height_m(self) -> float | None:
        """The aircraft's height above home, that of its plan where it is about there; None before it is known."""
        return None if self._height_m is None else settled_m(self._height_m, self.present)

    def cleared_first(self, plan: Plan) -> Plan | str:
        """Return the same of the first circle, which is gone to from anywhere and before anything is seen."""
        return self._cleared(plan, self.heights, None, None)

    def _is_off_track(self, aircraft: AircraftState, present: Plan) -> bool:
        if present.transition is None:
            return False
        nearest = point_at(present, nearest_arc_m(present, aircraft), aircraft)
        orbits = abs(aircraft.curvature_per_m) * present.circle.radius_m > _ORBITS
        if not orbits and not off_track(aircraft, nearest):
            self._on_line_s = self.time_s
        return self.time_s - self._on_line_s > _OFF_TRACK_S

    def _prepared(self, plan: Plan, present: Plan, reason: str) -> UploadPlan:
        self._number += 1
        self._counts.uploads += 1
        commanded = self._flown_radius.commanded(plan.circle)
        self._change = _PlanChange(self._number, plan, commanded, self.time_s)
        return UploadPlan(self.time_s, self._number, plan, commanded, present, self._wind, reason)

    def _corrected_radius(self, present: Plan) -> tuple[Command, ...]:
        assert self._commanded is not None
        wanted_m = self._flown_radius.commanded(present.circle).radius_m
        if abs(wanted_m / self._commanded.radius_m - 1.0) <= _RADIUS_TOLERANCE:
            return ()
        plan = replace(present, transition=None, departure_s=self.time_s + self._latency_s)
        reason = f"asking for a radius of {wanted_m:.0f} m, so that {present.circle.radius_m:.0f} m is flown"
        return (Announce(self.time_s, "decision", reason), self._prepared(plan, present, reason))

    def _choose(self, aircraft: AircraftState, estimate: TargetEstimate, present: Plan) -> Decision:
        range_m = math.hypot(aircraft.east_m - estimate.east_m, aircraft.north_m - estimate.north_m)
        if range_m > self._requirement.range_max_m:
            return self._approach(aircraft, estimate, present, range_m)
        return self._planner.decide(aircraft, estimate, present, self._wind, self._latency_s)

    def _approach(self, aircraft: AircraftState, estimate: TargetEstimate, present: Plan, range_m: float) -> Decision:
        """Out of the planners' range: go to a circle beside the target, unless one is already being flown to."""
        departure_s = aircraft.time_s + self._latency_s
        start = _advanced(aircraft, self._latency_s)
        plan = replace(approach(start, estimate, self.settings.aircraft, self._requirement), departure_s=departure_s)
        off_m = math.hypot(plan.circle.east_m - present.circle.east_m, plan.circle.north_m - present.circle.north_m)
        if off_m < 0.5 * self.settings.aircraft.radius_m:
            return Decision(self.time_s, None, f"on the way to the target, {range_m:.0f} m to go")
        return Decision(self.time_s, plan, f"approaching: the target is {range_m:.0f} m away")

    # -- plan changes ----------------------------------------------------------------------------------------

    def _drive(self, change: _PlanChange) -> tuple[Command, ...]:
        if change.stage != "ready" or self.time_s < change.plan.departure_s:
            return ()
        if self.phase is not Phase.WATCHING:
            self._change = None
            return ()
        late_s = self.time_s - change.plan.departure_s
        if self.door.faulty and late_s <= _LATE_S:
            return ()
        if self.door.doubt is not None or late_s > _LATE_S:
            self._change = None
            why = self.door.doubt or f"its time was {late_s:.1f} s ago"
            return (Announce(self.time_s, "plan", f"plan {change.number} does not depart: {why}"),)
        change.stage = "departing"
        return (ActivatePlan(self.time_s, change.number),)

    def _plan_reported(self, event: PlanStatus) -> tuple[Command, ...]:
        late = self._not_taken
        if event.stage == "departed" and late is not None and late.number == event.number:
            self._counts.upload_failures -= 1
            return self._departed(late, event.time_s)
        change = self._change
        if change is None or change.number != event.number:
            return ()
        if event.stage == "unconfirmed":
            return (Announce(event.time_s, "plan", f"plan {event.number}: {event.detail} yet"),)
        if event.stage == "failed":
            if change.stage == "departing":
                self._not_taken = change
            elif change.stage == "preparing" and event.time_s - change.since_s > self._latency_s:
                self._note_latency(event.time_s - change.since_s)
            self._change = None
            self._counts.upload_failures += 1
            return (Announce(event.time_s, "plan", f"plan {event.number} was not taken: {event.detail}"),)
        if event.stage == "ready":
            self._note_latency(event.time_s - change.since_s)
            late_s = event.time_s - change.plan.departure_s
            if late_s > 0.0 and not self._can_still_join(change.plan, late_s):
                self._change = None
                return (Announce(event.time_s, "plan", f"plan {event.number} was ready {late_s:.1f} s too late"),)
            change.stage = "ready"
            return self._drive(change)
        return self._departed(change, event.time_s)

    def _link_reported(self, event: LinkReported | RoundTripReported) -> tuple[Command, ...]:
        if isinstance(event, RoundTripReported):
            self._round_trip_s = event.round_trip_s
            self._expect_latency()
            return ()
        self._sensor_status.connected = event.connected
        text = "the link is back" if event.connected else "link lost: the aircraft goes on circling"
        return (Announce(event.time_s, "link", text),)

    def _note_latency(self, took_s: float) -> None:
        """Expect what an upload took of the next one; of one that was given up too, which would have taken longer."""
        self._took_s.append((took_s, self._round_trip_s))
        self._expect_latency()

    def _expect_latency(self) -> None:
        now_s = self._round_trip_s
        expected = sorted(
            took_s if now_s is None or then_s is None else took_s + _UPLOAD_ROUND_TRIPS * (now_s - then_s)
            for took_s, then_s in self._took_s
        )
        if len(expected) > 1:
            self._latency_s = expected[-2] + _LATENCY_MARGIN_S
        if now_s is not None:
            self._latency_s = max(self._latency_s, _UPLOAD_ROUND_TRIPS * now_s)

    def _departed(self, change: _PlanChange, time_s: float) -> tuple[Command, ...]:
        """Take over a plan that is flown: in good time, or one that was thought not to have been taken."""
        assert self.present is not None
        self._counts.moves += change.plan.circle != self.present.circle
        self.present, self._commanded = change.plan, change.commanded
        self._change = self._not_taken = None
        if self._changed_s is not None and change.since_s > self._changed_s:
            self._changed_s = None
        self._on_line_s = time_s
        return ()

    def _can_still_join(self, plan: Plan, late_s: float) -> bool:
        """Tell whether the aircraft, which has flown on, is still so near to the plan's line that it can take it."""
        assert self._aircraft is not None
        if late_s > _LATE_S:
            return False
        if plan.transition is None:
            return True  # a circle is flown to from anywhere
        line = point_at(plan, nearest_arc_m(plan, self._aircraft), self._aircraft)
        return not off_track(self._aircraft, line, _JOINABLE_M, _JOINABLE_RAD)

    # -- the fleet -----------------------------------------------------------------------------------------

    def _advised(self, told: FleetAdvice | NeighbourPlanned) -> tuple[Command, ...]:
        if isinstance(told, NeighbourPlanned):
            self.separation.planned(told)
        else:
            self._advice = told
            self.separation.note(told.neighbours)
        if isinstance(self._planner, CooperativePlanner):
            self._planner.advise(told)
        if isinstance(told, NeighbourPlanned) or self.phase not in (Phase.WATCHING, Phase.HOLDING):
            return ()
        if told.role is Role.LEAVE:
            self.phase, self._change = Phase.ENDED, None
            return (End(told.time_s, "return", told.reason),)
        if told.side is self._requirement.side:
            return ()
        self._requirement = replace(self._requirement, side=told.side)
        if not isinstance(self._planner, CooperativePlanner):
            self._planner = self._new_planner()
        return (Announce(told.time_s, "decision", f"watching from the {told.side}: {told.reason}"),)

    def _new_planner(self) -> Planner:
        """Return a planner for what is asked now, told of fleet and winds what the one before it was."""
        planner = self.make_planner(self.settings.aircraft, self._requirement)
        if isinstance(planner, WindPlanner):
            for speed_m_s in self.prepared_winds_m_s:
                planner.prepare(speed_m_s)
        if isinstance(planner, CooperativePlanner):
            for told in (*self.separation.plans.values(), *(() if self._advice is None else (self._advice,))):
                planner.advise(told)
        return planner

    def _joint_estimate(self) -> TargetEstimate | None:
        """Return the fleet's estimate of the target, while it is fresh and not lost."""
        advice = self._advice
        if advice is None or advice.estimate is None or self.time_s - advice.time_s > _ADVICE_S:
            return None
        return None if advice.estimate.quality is TrackQuality.LOST else advice.estimate

    # -- other hands ---------------------------------------------------------------------------------------

    def _mode_reported(self, event: ModeReported) -> tuple[Command, ...]:
        self._mode = event.mode
        if self.phase in (Phase.WATCHING, Phase.HOLDING) and event.mode != self._engaged_mode:
            return self._yield(event.time_s, f"the flight mode was changed to {event.mode}")
        return ()

    def _yield(self, time_s: float, reason: str) -> tuple[Command, ...]:
        if self.phase in (Phase.YIELDED, Phase.ENDED, Phase.WAITING):
            return ()
        self.phase, self._change = Phase.YIELDED, None
        return (Yield(time_s, reason),)

    def _operator(self, event: OperatorRequest) -> tuple[Command, ...]:
        if self.phase not in (Phase.WATCHING, Phase.HOLDING):
            return (Announce(event.time_s, "operator", f"{event.action} refused: the mission is {self.phase}"),)
        match event.action:
            case "hold":
                self.phase = Phase.HOLDING
            case "resume":
                self.phase = Phase.WATCHING
            case "end":
                self.phase = Phase.ENDED
            case "side" if event.side is None or self._requirement.sector is not None:
                why = "no side is named" if event.side is None else "the mission watches from bearings"
                return (Announce(event.time_s, "operator", f"side refused: {why}"),)
            case "side":
                self._requirement = replace(self._requirement, side=event.side)
                self._planner = self._new_planner()
        text = f"operator: {event.action}" + (f" {event.side}" if event.action == "side" else "")
        told = Announce(event.time_s, "operator", text)
        if event.action == "end":
            return told, End(event.time_s, "hold", "ended by the operator")
        return (told,)

    # -- what a person changes -----------------------------------------------------------------------------

    def _heights_at(self, height_m: float) -> Heights:
        return (self.heights or OneHeight(ClimbRates(self.settings.aircraft.airspeed_m_s))).at(height_m)

    def objection(self, change: MissionChange) -> str | None:
        """Return which fence or ground keeps the present circle from being flown at another height; None: nothing."""
        if change.height_m is None or self.present is None:
            return None
        place_m = None if self.estimate is None else (self.estimate.east_m, self.estimate.north_m)
        circle = replace(self.present, transition=None)
        cleared = self._cleared(circle, self._heights_at(change.height_m), self.flown_height_m, place_m)
        return cleared if isinstance(cleared, str) else None

    def _mission_changed(self, event: MissionChange) -> tuple[Command, ...]:
        what = describe_change(event)
        if self.phase not in (Phase.WATCHING, Phase.HOLDING):
            return (Announce(event.time_s, "operator", f"{what} refused: the mission is {self.phase}"),)
        aircraft = aircraft_after(event, self.settings.aircraft)
        self._requirement = requirement_after(event, self._requirement)
        self.settings = replace(self.settings, aircraft=aircraft, requirement=self._requirement)
        self._planner = self._new_planner()
        if event.height_m is not None:
            self.heights, self._height_asked_m = self._heights_at(event.height_m), event.height_m
        self._changed_s = self.time_s
        when = "from the next plan on" if self.phase is Phase.WATCHING else "when you resume"
        return (Announce(event.time_s, "operator", f"operator: {what}, {when}"),)

    def _circle_as_changed(self, aircraft: AircraftState, present: Plan) -> tuple[Command, ...]:
        """Return what sends the present circle with the radius and height that were asked for, once it is reached."""
        if self._changed_s is None:
            return ()
        line = present.transition
        if line is not None and nearest_arc_m(present, aircraft) < line.length_m:
            return ()
        radius_m, circle = self.settings.aircraft.radius_m, present.circle
        if circle.radius_m != radius_m:
            start = _advanced(aircraft, self._latency_s)
            circle = Circle.tangent_to(start.east_m, start.north_m, start.course_rad, radius_m, circle.clockwise)
        cleared = self.cleared(Plan(circle, None, self.time_s + self._latency_s))
        if isinstance(cleared, str):
            self._changed_s = None
            return (Announce(self.time_s, "decision", f"staying: {cleared}"),)
        if circle == present.circle and _circle_height_m(cleared) == _circle_height_m(present):
            self._changed_s = None
            return ()
        reason = f"the same circle as changed: radius {radius_m:.0f} m"
        if cleared.heights is not None:
            reason += f", {cleared.heights.to_m:.0f} m above home"
        return (Announce(self.time_s, "decision", reason), self._prepared(cleared, present, reason))


def _circle_height_m(plan: Plan) -> float | None:
    return None if plan.heights is None else plan.heights.to_m


def _advanced(aircraft: AircraftState, duration_s: float) -> AircraftState:
    """Return where the aircraft is after ``duration_s`` on its present curvature, without wind."""
    step_m = aircraft.ground_speed_m_s * duration_s
    turned_rad = aircraft.curvature_per_m * step_m
    circle_sinc = math.sin(0.5 * turned_rad) / (0.5 * turned_rad) if abs(turned_rad) > 1e-9 else 1.0
    middle_rad = aircraft.course_rad + 0.5 * turned_rad
    return replace(
        aircraft,
        time_s=aircraft.time_s + duration_s,
        east_m=aircraft.east_m + step_m * circle_sinc * math.sin(middle_rad),
        north_m=aircraft.north_m + step_m * circle_sinc * math.cos(middle_rad),
        course_rad=aircraft.course_rad + turned_rad,
    )

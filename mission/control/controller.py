"""The control step: one event in, commands out. Live flight, replay and tests all call this.

1. Nothing is commanded before ``ControlAcquired`` and nothing after ``Yield`` or ``End``.
2. At most one plan is under way to the autopilot (:mod:`sidelong.mission.control.planning`), and while one is,
   nothing is decided. A plan that is dropped or fails leads to a new decision.
3. A plan that breaks a fence, or comes too near to another aircraft, is not sent; the present circle goes on.
4. When the measured ratio of flown to commanded radius changes, the present circle is sent again.
5. An aircraft that has left its transition for some seconds (circling a waypoint that it cannot reach, say) is sent
   to the transition's circle directly. This way and every other way out passes the checks of an ordinary move;
   where none passes, ground, other aircraft and fences come before range, and range before side.
6. Any other flight mode than that of the takeover means that a pilot, another station or a failsafe of the autopilot
   flies: Yield, until an operator asks to resume. The aircraft is then taken over again, with the live track.
7. A target lost for ``give_up_after_s`` ends the mission, and so does a low battery: the aircraft flies home.
8. What a person changes in flight holds from the next decision on: a new planner is made, and where it stays, the
   present circle is sent again as changed.
9. Every event passes :mod:`sidelong.mission.control.plausibility` first. While that doubts the aircraft's own
   position, nothing is decided, and no plan departs.
10. Readings of a laser or gimbal that contradicts the other inputs (:mod:`sidelong.mission.health.health`) are not
    used, and their sightings undone. While the target is not seen, the aircraft keeps away from where it can be.
11. What is flown is judged once a second (:mod:`sidelong.mission.control.envelope`). Below the floor nothing is
    commanded but the way back to the plan's height; ``at_breach`` ends the mission instead.
12. Where a foreign aircraft is predicted to come nearer than it has to be kept clear of, the present circle is flown
    at another height until it has passed, or another circle is flown.
13. While advice is fresh, estimate, target and side are those of the advice.

The clock is the vehicle's: the latest time of a position reading.

Source: docs/decisions/0002-pure-step-and-replay.md; docs/watch-endings.md.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from typing import Literal

from sidelong.estimators.estimate import TargetEstimate, TrackQuality
from sidelong.estimators.sensing.readings import (
    AttitudeReading,
    GimbalReading,
    PositionReading,
    RangeReading,
    Reading,
    TargetFixReading,
)
from sidelong.estimators.sensing.sighting import SightingOutcome
from sidelong.estimators.tracking.tracker import Tracker
from sidelong.mission.control.alarms import battery_is_low
from sidelong.mission.control.envelope import Envelope
from sidelong.mission.control.mission_change import aircraft_after, describe_change, requirement_after
from sidelong.mission.control.planning import PlanChanges, Planning, UploadLatency
from sidelong.mission.control.plausibility import Plausibility
from sidelong.mission.control.present import Phase, Present, breach_in
from sidelong.mission.control.surroundings import Surroundings
from sidelong.mission.control.target_news import BLIND_S, AnotherObject, PayloadNews, TargetNews, UnseenTarget
from sidelong.mission.core.circle import Circle
from sidelong.mission.core.events import (
    AlarmReported,
    Announce,
    BankLimitReported,
    BatteryReported,
    ControlAcquired,
    DecisionRecord,
    End,
    Event,
    HomeReported,
    LinkReported,
    MissionChange,
    ModeReported,
    OperatorRequest,
    PlanStatus,
    RoundTripReported,
    RouteGiven,
    StepOutput,
    TrafficReported,
    WindPrepared,
    WindReported,
    Yield,
    YieldRequested,
)
from sidelong.mission.core.fleet import FleetAdvice, NeighbourPlanned, Role
from sidelong.mission.core.inputs import ENVELOPE, Input
from sidelong.mission.core.plan import (
    AircraftState,
    ClimbRates,
    Decision,
    Flown,
    Heights,
    OneHeight,
    Plan,
    PlannerFactory,
    settled_height_m,
)
from sidelong.mission.core.requirement import GRAVITY_M_S2, Aircraft, Requirement, Wind
from sidelong.mission.geometry.approach import HOLD_S, LEAVE_S, Reach, escapes, orbits, paths_to, retreats
from sidelong.mission.geometry.progress import dead_reckoned, nearest_arc_m
from sidelong.mission.geometry.separation import PREDICTED_S, Encounter, closest_of
from sidelong.mission.health.health import Health
from sidelong.mission.viewpoint.watch_course import TargetCourse

# Reports of a wind above this share of the airspeed are rejected: the aircraft cannot fly in such a wind.
_WIND_MAX_SHARE = 0.9
_OFTEN, _OFTEN_S = 3, 120.0  # that the aircraft leaves its line: it may not follow at all
_BACK_AGAIN_S = 20.0  # after which the way back to height or fence is commanded again
_SAME_HOME_M = 2.0  # against which the present plan was sent
_NEAR_SHARE = 1.25  # of its radius: from there an autopilot joins a circle without leaving it far
_RETREAT_S, _RETREAT_GAIN = 20.0, 0.25  # a retreat lasts, unless another gains this share of the range
_SEARCH_S = 10.0  # so does a circle of a search
_BELOW_LAYER_M = 10.0  # so far below its layer an aircraft is on its way there, or was taken over there
_CROSSED_COUNT = 3  # decisions until the circle is left: one report of a height may be wrong
_KEEP_CLEAR_EVERY_S, _BETTER_SHARE = 5.0, 0.1  # a new plan has this time to show what it does
_HEIGHT_MARGIN_M, _LEAST_HEIGHT_M = 12.0, 40.0  # of a height that keeps clear: for both altimeters; above home
_SILENT_S = 2.0
_NAMED_WITHIN_S = 3.0  # an autopilot states the reason of a failsafe this long after it has changed the mode
_UNSEEN_S = 20.0  # afterwards the estimate is too old to judge the watch by
_JUMPED = "the target's position has jumped"
_UNSEEN = "the target is not seen"
_ELSEWHERE = "the target may not be where it is seen"
_LATE = "the aircraft may not follow that path closely"
_BEFORE_M = 10.0  # within which the target was before it moved too fast
_EXPLAINED_M = 50.0  # beyond where the target can be, a correction does not explain why it seems to have jumped
_TOO_FAST = "the payload may follow another object: it moves faster than the target can"
_GIMBAL_SILENT_S = 4.0  # the same while the gimbal is silent: more than a gap of the laser
_SENSED = frozenset((AttitudeReading, RangeReading, GimbalReading, TargetFixReading))
_LOW_BATTERY_S = 10.0  # without a report in between that is not low


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
    at_low_battery: Literal["return", "warn"] = "return"
    at_breach: Literal["recover", "return"] = "recover"


class StandoffController:
    """The mission's whole state."""

    def __init__(
        self,
        settings: StandoffSettings,
        tracker: Tracker,
        make_planner: PlannerFactory,
        surroundings: Surroundings | None = None,
    ) -> None:
        self.settings, self.tracker = settings, tracker
        self.surroundings = surroundings = surroundings or Surroundings()
        self.phase = Phase.WAITING
        self.time_s = -math.inf
        self.decision: Decision | None = None
        self.estimate: TargetEstimate | None = None
        self.sighted: tuple[SightingOutcome, ...] = ()  # that the last step completed
        self.admitted: Event | None = None  # the last step's, as it passed the plausibility check
        self.aircraft: AircraftState | None = None  # as it was last reported
        self.door = Plausibility(_WIND_MAX_SHARE * settings.aircraft.airspeed_m_s)
        self.health = Health(tracker.payload)
        if surroundings.ground is not None:
            tracker.payload.ground = surroundings.ground.height_m
        self.latency = UploadLatency(settings.latency_s)
        self.changes = PlanChanges(self.door, self.latency)
        self.planning = Planning(make_planner, settings.aircraft, settings.requirement)
        self.envelope = Envelope(surroundings.bounds, settings.aircraft, settings.requirement)
        self._home_m: tuple[float, float] | None = None  # the autopilot's, east and north
        self._first_home_m: tuple[float, float] | None = None  # the same at the takeover
        self._recovery, self._recovered_s = 0, -math.inf  # number of the plan back into the envelope, and when
        self._retreated_s = -math.inf
        self._news = TargetNews()
        self._payload_news, self._object = PayloadNews(tracker), AnotherObject()
        self._corrections = tracker.corrections
        self._course = TargetCourse()
        self._attitude: AttitudeReading | None = None
        self._range_s = self._gimbal_s = -math.inf  # of the latest reading of the laser and the gimbal in use
        self._nis = math.nan  # of the latest sighting that was compared
        self._connected = True
        self._wind = Wind()
        self._mode = self._own_mode = ""
        self._next_decision_s = -math.inf
        self._changed_s: float | None = None  # when a person last changed the mission; None: that is flown
        self._height_asked_m: float | None = None
        self._off_track_s: deque[float] = deque(maxlen=_OFTEN)  # when the aircraft had left its line
        self.encounter: Encounter | None = None  # the closest approach of a foreign aircraft, as predicted
        self._kept_clear_s, self._near = -math.inf, ""  # and the aircraft of which no plan keeps farther away
        self._heights_before: Heights | None = None  # while another height is flown to keep clear
        self._crossed = 0  # decisions in a row at which another aircraft was too near below the circle
        self._height_m: float | None = None  # the aircraft's, above home
        self._mode_yield_s = -math.inf  # when another flight mode was last yielded to
        self._over = ""  # why the mission was yielded or has ended
        self.resuming = False  # being taken over again after a yield
        self._acquired_s = -math.inf
        self._low_battery_s = math.inf  # since when each report is of a low battery
        self._unseen = UnseenTarget(tracker)

    def step(self, event: Event) -> tuple[StepOutput, ...]:
        """Process one event, no earlier than the last one of its clock; return commands and announcements."""
        self.sighted = ()
        announced: tuple[StepOutput, ...]
        admitted, announced = self.door.admit(event)
        self.admitted = admitted
        if self.health.received(event, self.door.clock.now_s, self.tracker.ranges):
            announced += self._health_changes()
            self.door.vehicle_silent = self.health.silent_s >= _SILENT_S
        if admitted is None:
            return announced
        if type(admitted) in _SENSED:  # most of all events
            self._read(admitted)  # type: ignore[arg-type]
            return announced
        commands = self._position(admitted) if type(admitted) is PositionReading else self._admitted(admitted)
        return announced + commands if announced else commands

    def _health_changes(self) -> tuple[StepOutput, ...]:
        health, tracker, now_s = self.health, self.tracker, self.door.clock.now_s
        if now_s == -math.inf:
            return ()
        envelope = dict.fromkeys(ENVELOPE, "") | self.envelope.faults
        changes = health.changes(now_s, tracker.ranges, tracker.gimbals, {**self.door.input_faults, **envelope})
        if changes:
            self.door.no_heartbeat = not health.is_usable(Input.HEARTBEAT)
        return changes

    def _admitted(self, event: Event) -> tuple[StepOutput, ...]:
        match event:
            case WindReported() | WindPrepared() | RouteGiven():
                return self._planning_input(event)
            case ModeReported():
                return self._mode_reported(event)
            case ControlAcquired() if self.phase in (Phase.WAITING, Phase.WATCHING):
                return self._control_acquired(event)
            case PlanStatus():
                return self.changes.report(event, self.time_s, self.aircraft, watching=self._may_depart)
            case HomeReported() | BankLimitReported():
                self._assumption_reported(event)
            case LinkReported() | RoundTripReported():
                return self._link_reported(event)
            case YieldRequested():
                return self._yield(event.time_s, event.reason)
            case OperatorRequest():
                return self._operator(event)
            case MissionChange():
                return self._mission_changed(event)
            case TrafficReported():
                self.surroundings.separation.note(event.aircraft)
            case AlarmReported() | BatteryReported():
                return _announced(event) if isinstance(event, AlarmReported) else self._battery_reported(event)
            case FleetAdvice() | NeighbourPlanned():
                return self._advised(event)
        return ()

    @property
    def present(self) -> Plan | None:
        """The plan that is flown."""
        return self.changes.present

    @property
    def coming(self) -> Plan | None:
        """The plan on its way to the autopilot."""
        change = self.changes.under_way
        return None if change is None else change.command.plan

    @property
    def flown_height_m(self) -> float | None:
        """The aircraft's height above home, that of its plan where it is about there; None before it is known."""
        return None if self._height_m is None else settled_height_m(self._height_m, self.present)

    @property
    def breach(self) -> str:
        """What the aircraft itself breaches, in words; '' if nothing."""
        return breach_in(self.health.reports)

    @property
    def _may_depart(self) -> bool:
        """Whether the plan under way may be flown: while watching, and the way back into the envelope on hold too."""
        change = self.changes.under_way
        is_back = change is not None and change.command.number == self._recovery
        is_low = self._height_m is not None and self._height_m < self.envelope.floor_m
        return self.phase.in_control and (is_back or (self.phase is Phase.WATCHING and not is_low))

    def snapshot(self) -> Present:
        """Return what an operator sees now."""
        settings, changes, tracker, now_s = self.settings, self.changes, self.tracker, self.time_s
        planning = self.planning
        traffic = "" if self.encounter is None or self.encounter.share >= 1.0 else str(self.encounter)
        return Present(
            time_s=now_s,
            phase=self.phase,
            requirement=settings.requirement,
            aircraft=self.aircraft,
            estimate=self.estimate,
            course_rad=self._course.made_good_rad,
            present_course_rad=self._course.present_rad,
            plan=self.present,
            coming=self.coming,
            decision=self.decision,
            wind=self._wind,
            moves=changes.moves,
            uploads=changes.uploads,
            upload_failures=changes.failures,
            latency_s=self.latency.expected_s,
            mode=self._mode,
            height_m=math.nan if self._height_m is None else self._height_m,
            attitude=self._attitude,
            airframe=settings.aircraft,
            height_asked_m=self._height_asked_m,
            range_s=self._range_s,
            gimbal_s=self._gimbal_s,
            nis=self._nis,
            sightings=tracker.sightings,
            rejected=tracker.rejected,
            delays=tracker.delays,
            give_up_after_s=settings.give_up_after_s,
            give_up_action=settings.give_up_action,
            connected=self._connected,
            target=planning.target,
            turn_payload=planning.turn_payload,
            over=self._over,
            separation=planning.too_near(now_s) or traffic,
            health=self.health.reports,
            unknown=self._unknown(),
            position_age_s=max(self.door.clock.now_s - now_s, self.health.silent_s) if now_s > -math.inf else 0.0,
            route=planning.route_progress,
            orders=changes.stuck(now_s),
            home_m=self._home_m,
            home_moved_m=(math.dist(self._home_m or (), self._first_home_m or ()), self.door.home_m),
            other_object=self._object.reason,
            traffic=self.surroundings.separation.traffic,
        )

    def _unknown(self) -> str:
        unseen_s = math.inf if self.estimate is None else self.time_s - self.estimate.last_sighting_s
        limit_s = _UNSEEN_S if self.health.is_usable(Input.GIMBAL) else _GIMBAL_SILENT_S
        unseen = f"the target has not been seen for {unseen_s:.0f} s" if limit_s < unseen_s < math.inf else ""
        jumped = _JUMPED if self.health.payload.is_suspect(self.time_s) else ""
        return self.health.unknown or self.door.doubt or self._object.reason or jumped or unseen or self._wanders()

    def _wanders(self) -> str:
        """Return that the payload may have drifted by more than the target is within the band; empty: no."""
        wander_m, aircraft, target = self.health.payload.wander_m(self.time_s), self.aircraft, self.estimate
        if not wander_m or aircraft is None or target is None:
            return ""
        range_m = math.hypot(aircraft.east_m - target.east_m, aircraft.north_m - target.north_m)
        requirement = self.settings.requirement
        if wander_m <= min(range_m - requirement.range_min_m, requirement.range_max_m - range_m):
            return ""
        return f"the payload may have drifted: the target can be {wander_m:.0f} m elsewhere"

    def _read(self, reading: Reading) -> None:
        tracker = self.tracker
        self.sighted = tracker.add(reading)
        if self.sighted:
            jumps_s = tracker.payload.jumps_s
            self.health.sightings.note(reading.time_s, self.sighted, jumps_s, lambda: tracker.unexpected_pitch_rad)
            if self.aircraft is not None:
                requirement = self.settings.requirement
                self._object.note(self.sighted, self.aircraft, lambda: tracker.remaining_errors, requirement)
            for outcome in self.sighted:
                if math.isfinite(outcome.nis):
                    self._nis = outcome.nis
        match reading:
            case AttitudeReading():
                self._attitude = reading
                self.envelope.turns.note(reading)
            case RangeReading() if reading.source is (used := tracker.ranges.chosen) or reading.source == used:
                self._range_s = reading.time_s if reading.time_s > self._range_s else self._range_s
            case GimbalReading() if reading.source is (used := tracker.gimbals.chosen) or reading.source == used:
                self._gimbal_s = reading.time_s if reading.time_s > self._gimbal_s else self._gimbal_s

    # -- the aircraft's position is the tick ---------------------------------------------------------------

    def _position(self, reading: PositionReading) -> tuple[StepOutput, ...]:
        if self.door.place_is_known:
            self._read(reading)
        if reading.time_s <= self.time_s:
            return ()  # overtaken on the way: it has helped the tracker, the clock stays
        self.time_s, self._height_m = reading.time_s, reading.height_m
        self.aircraft = _state_of(reading, self._attitude.roll_rad if self._attitude is not None else 0.0)
        if not self.door.dead_reckoned:
            self.changes.observe(self.aircraft)
        announced: tuple[StepOutput, ...] = ()
        due = self.time_s >= self._next_decision_s
        if due:
            self._next_decision_s = self.time_s + self.settings.decision_period_s
            self.estimate = self.planning.joint_estimate(self.time_s) or self.tracker.estimate(self.time_s)
            if self.estimate is not None:
                self._predict(self.estimate)
                self._course.update(self.estimate, self.settings.requirement.course_horizon_s)
                announced = self._news.announce(self.time_s, self.estimate)
            announced += self._payload_news.announce(self.time_s)
            self.envelope.step(self.snapshot())
            if self.envelope.aircraft != self.settings.aircraft:
                self._ask_for(self.envelope.aircraft, self.settings.requirement)
                self._changed_s = self.time_s
            announced += self._health_changes()
            announced += self._judge_object()
            self._judge_traffic()
        if self.changes.under_way is not None:
            return announced + self.changes.activate_due(self.time_s, watching=self._may_depart)
        if self.door.doubt is not None:
            return announced + self._hold(self.door.doubt)
        if self.door.no_heartbeat:
            return announced + self._hold("no heartbeat from the autopilot")
        if self.door.faulty:
            if due:  # a link that often fails may bring few other positions
                self._next_decision_s = self.time_s
            return announced
        return announced + self._decide() if due else ()

    def _predict(self, estimate: TargetEstimate) -> None:
        speed_max_m_s = self.settings.requirement.target_speed_max_m_s
        if self.time_s - estimate.last_sighting_s <= BLIND_S:
            self._unseen.note(estimate, speed_max_m_s)
            return
        self.estimate = self._unseen.predicted(estimate, speed_max_m_s, self.settings.lost_after_s)

    def _judge_object(self) -> tuple[StepOutput, ...]:
        """Return what is new of whether the payload follows another object."""
        if self.tracker.corrections != self._corrections:  # the target was elsewhere, and did not move
            self._corrections = self.tracker.corrections
            self.envelope.forget_target()
            seen, left = self.tracker.estimate(self.time_s), self._object.left(self.time_s)
            if left is None or (seen is not None and left.holds(seen.east_m, seen.north_m, _EXPLAINED_M)):
                self._object.explain("an error of the payload was found")
        before_s, east_m, north_m = self.envelope.target_before
        if Input.SPEED in self.envelope.faults and math.isfinite(before_s):
            before = Reach(east_m, north_m, _BEFORE_M, self.settings.requirement.target_speed_max_m_s)
            self._object.suspect(self.time_s, _TOO_FAST, left=(before_s, before))
        return self._object.announce(self.time_s)

    def _judge_traffic(self) -> None:
        """Predict how near foreign aircraft come to what is flown and what is on its way to the autopilot."""
        self.encounter = None
        if self.present is not None and self.phase.in_control and self.surroundings.separation.traffic:
            self.surroundings.flown = self.flown
            self.encounter = self._encounter_of(self.coming)

    # -- deciding ------------------------------------------------------------------------------------------

    def _decide(self) -> tuple[StepOutput, ...]:
        aircraft, target, present = self.aircraft, self.estimate, self.present
        if not self.phase.in_control or present is None:
            return ()
        assert aircraft is not None
        self.surroundings.flown = self.flown
        back = self._back_into_envelope(aircraft, present)
        if back is not None or self.phase is not Phase.WATCHING:
            return back or ()
        escape = self._keep_clear(aircraft, present) or self._escape(aircraft, present)
        if escape or target is None:
            return escape
        is_lost = Input.PATH in self.envelope.faults and self.time_s - self._recovered_s >= _BACK_AGAIN_S
        if is_lost or self.changes.is_off_track(aircraft) or self.envelope.is_unflyable:
            self._recovered_s = self.time_s
            reason = "the aircraft has left its line: going to the circle directly"
            self._off_track_s.append(self.time_s)
            if len(self._off_track_s) == _OFTEN and self.time_s - self._off_track_s[0] < _OFTEN_S:
                reason = f"the aircraft has left its line {_OFTEN} times in {_OFTEN_S:.0f} s: be ready to take over"
            return self._way_out(aircraft, present, reason)
        unseen_s = self.time_s - target.last_sighting_s
        if min(unseen_s, self.time_s - self._acquired_s) > self.settings.give_up_after_s:
            reason = f"the target has not been seen for {unseen_s:.0f} s"
            self._end(Phase.ENDED, reason)
            return (End(self.time_s, self.settings.give_up_action, reason),)
        if not self.envelope.has_room:
            why = "no circle that can be flown fits the band; the target moves"
            return self._hold_away(aircraft, present, self._seen(target), why)
        fault = bool(self.health.payload_fault)
        is_gone = unseen_s > min(BLIND_S, self.settings.lost_after_s) or target.quality is TrackQuality.LOST
        reach = self._unseen.reach(self.time_s, target, fault, self.settings.requirement.target_speed_max_m_s)
        if is_gone and not fault:
            return self._search(aircraft, present, self._unseen.density(target))
        if reach is not None:
            away = self._hold_away(aircraft, present, reach)
            if away or fault or target.quality is TrackQuality.GOOD:
                return away
        elif self._object.reason:
            # What is seen may be another object: that and the target are kept clear, but for a shadow. What moves
            # faster than the target can is not watched: by a wrong yaw it circles with the aircraft.
            is_shadow, left = self._object.is_shadow, self._object.left(self.time_s)
            seen = None if is_shadow else self._seen(target)
            others = [one for one in (seen, left) if one is not None]
            away = self._hold_away(aircraft, present, others[0], "what is seen may be another object", others[1:])
            if away or is_shadow or Input.SPEED in self.envelope.faults:
                return away
            reach = left
        return self._planned(aircraft, target, present, reach)

    def _planned(
        self, aircraft: AircraftState, target: TargetEstimate, present: Plan, reach: Reach | None
    ) -> tuple[StepOutput, ...]:
        if self.health.payload.is_suspect(self.time_s):
            return self._hold(_JUMPED)
        decision = self.planning.decide(aircraft, target, present, self._wind, self.latency.expected_s)
        news = self.planning.route_news()
        announced: tuple[StepOutput, ...] = (Announce(self.time_s, "route", news),) if news else ()
        if decision.plan is not None and reach is not None and not self._keeps_away(decision.plan, reach):
            reason = f"staying: {_UNSEEN} and may be too near there"
            decision = replace(decision, plan=None, reason=reason)
        wander_m = self.health.payload.wander_m(self.time_s)
        wanders = wander_m > 0.0
        if self._spare_m or wanders:
            seen, plan = self._seen(target), decision.plan
            if not self._spare_m:  # an ordinary move allows for the rest
                seen = replace(seen, radius_m=wander_m, speed_m_s=0.0)
            if plan is not None and not self._keeps_away(plan, seen, LEAVE_S, self._spare_m):
                why = f"{_ELSEWHERE} and may be too near there" if wanders else _LATE
                decision = replace(decision, plan=None, reason=f"staying: {why}")
            why = _ELSEWHERE if wanders else "the target moves"
            if decision.plan is None and (away := self._hold_away(aircraft, present, seen, why, is_seen=True)):
                return away
        if decision.plan is not None:
            cleared = self.surroundings.cleared(decision.plan)
            if isinstance(cleared, str):
                decision = replace(decision, plan=None, reason=f"staying: {cleared}")
                if self.decision is None or self.decision.reason != decision.reason:
                    announced = (*announced, Announce(self.time_s, "decision", decision.reason))
            else:
                decision = replace(decision, plan=cleared)
        self.decision, plan = decision, decision.plan
        decided = DecisionRecord(self.time_s, plan is not None, decision.reason, decision.values)
        if plan is not None:
            arrival_s = plan.departure_s + plan.transition_m / self.settings.aircraft.airspeed_m_s
            text = f"{decision.reason}; there in {arrival_s - self.time_s:.0f} s"
            return (decided, *announced, *self.changes.upload(self.time_s, plan, self._wind, decision.reason, text))
        changed = self._circle_as_changed(aircraft, present)
        return (decided, *announced, *(changed if changed or announced else self._corrected_radius(present)))

    def _keep_clear(self, aircraft: AircraftState, present: Plan) -> tuple[StepOutput, ...]:
        """Return the plan that keeps clear of foreign aircraft: the circle at another height, or another circle."""
        found, height_m, now_s = self.encounter, self.flown_height_m, self.time_s
        if found is None or found.share >= 1.0 or height_m is None:
            return self._level_again(present)
        if now_s < self._kept_clear_s + _KEEP_CLEAR_EVERY_S:
            return ()
        self._kept_clear_s = now_s
        settings, start = self.settings, dead_reckoned(aircraft, self.latency.expected_s)
        best: tuple[Plan, Heights | None] | None = None
        best_share = min(found.share + _BETTER_SHARE, 1.0)
        plans = [(self._again(present), heights) for heights in self._other_heights(height_m)]
        others = escapes(start, self.estimate, present.circle, settings.aircraft, settings.requirement)
        for plan, heights in chain(plans, ((plan, None) for plan in others)):
            flown = self.surroundings.levelled(plan, height_m, self.surroundings.flown.target_m, heights)
            if isinstance(flown, str) or (heights is None and isinstance(self.surroundings.cleared(plan), str)):
                continue
            coming = self._encounter_of(flown)
            share = math.inf if coming is None else coming.share
            if share >= best_share:
                best, best_share = (flown, heights), share
                if share >= 1.0:
                    break
        if best is None:
            if found.other.name == self._near:
                return ()
            self._near = found.other.name
            return (Announce(now_s, "decision", f"no plan keeps farther away: {found}"),)
        plan, heights = best
        if heights is not None:
            if self._heights_before is None and self.surroundings.heights is not None:
                self._heights_before = self.surroundings.heights.at(height_m)
            self.surroundings.heights = heights
        to = "" if heights is None else f" at {plan.circle_height_m(height_m):.0f} m above home"
        return self.changes.upload(now_s, plan, self._wind, f"keeping clear{to}: {found}")

    def _other_heights(self, height_m: float) -> list[Heights]:
        """Return heights above and below each foreign aircraft; none in layers of a fleet, and over terrain."""
        heights = self.surroundings.heights
        if not isinstance(heights, OneHeight) or self.surroundings.separation.has_fleet:
            return []
        wanted = []
        for one in self._encounters_of(self.coming):
            for sign in (-1.0, 1.0):  # one that sinks or climbs towards such a height comes nearer later
                at_m = one.height_m + sign * (one.other.clear_m[1] + _HEIGHT_MARGIN_M)
                follows_m = PREDICTED_S * max(sign * one.other.climb_m_s, 0.0)
                wanted.append((abs(at_m - height_m) + follows_m, at_m))
        return [heights.at(at_m) for _, at_m in sorted(wanted) if at_m >= _LEAST_HEIGHT_M]

    def _level_again(self, present: Plan) -> tuple[StepOutput, ...]:
        """Return the present circle at the previous height, once no foreign aircraft comes near there."""
        before = self._heights_before
        if before is None or self.time_s < self._kept_clear_s + _KEEP_CLEAR_EVERY_S:
            return ()
        again = self.surroundings.levelled(self._again(present), self.flown_height_m, None, before)
        found = None if isinstance(again, str) else self._encounter_of(again)
        if isinstance(again, str) or (found is not None and found.share < 1.0 + _BETTER_SHARE):
            return ()
        self.surroundings.heights, self._heights_before = before, None
        return self.changes.upload(self.time_s, again, self._wind, "the other aircraft has passed: the old height")

    def _encounter_of(self, coming: Plan | None) -> Encounter | None:
        return closest_of(self._encounters_of(coming))

    def _encounters_of(self, coming: Plan | None) -> list[Encounter]:
        return self.surroundings.separation.encounters(self.surroundings.flown, coming)

    def _escape(self, aircraft: AircraftState, present: Plan) -> tuple[StepOutput, ...]:
        """Return the plan to another circle if a lower aircraft of the fleet flies too near below the present one."""
        crossed = None if self._height_m is None else self.surroundings.separation.crossed(present, self._height_m)
        self._crossed = 0 if crossed is None else self._crossed + 1
        if self._height_m is None or crossed is None or self._crossed % _CROSSED_COUNT:
            return ()
        plan, _ = self._best_way(aircraft, present)
        if plan is not None:
            return self.changes.upload(self.time_s, plan, self._wind, f"leaving the circle: {crossed}")
        if self._crossed != _CROSSED_COUNT:
            return ()
        text, layer_m = f"no separated circle is free: {crossed}", self.planning.layer_m
        if layer_m <= self._height_m + _BELOW_LAYER_M:
            return (Announce(self.time_s, "decision", text),)
        text += f"; climbing to {layer_m:.0f} m on the present circle"  # as two do that circled together at first
        return self.changes.upload(self.time_s, self._again(present), self._wind, text)

    # -- ways out ------------------------------------------------------------------------------------------

    def _seen(self, target: TargetEstimate) -> Reach:
        """Return the disk of a target that is seen, wider by a drift of the payload that is suspected."""
        seen = Reach.seen(target, self.settings.requirement.target_speed_max_m_s)
        return replace(seen, radius_m=seen.radius_m + self.health.payload.wander_m(self.time_s))

    def _best_way(self, aircraft: AircraftState, present: Plan) -> tuple[Plan | None, float]:
        """Return the way out to take, and how far it keeps from the target; None if none passes the checks.

        That is the first one that passes the checks of an ordinary move, else the one that keeps the most range of
        those that pass the other checks. The present circle, as wide as it can be flown, is tried first.
        """
        own, requirement, latency_s = self.settings.aircraft, self.settings.requirement, self.latency.expected_s
        start, target = dead_reckoned(aircraft, latency_s), self.estimate
        later = None if target is None else self._seen(target).after(latency_s)
        needed_m = requirement.range_min_m + self._spare_m

        def clear_m(plan: Plan) -> float:
            return math.inf if later is None else later.clearance_m(plan, own.airspeed_m_s, LEAVE_S)

        circle = replace(present.circle, radius_m=max(present.circle.radius_m, own.radius_m))
        away_m = math.hypot(start.east_m - circle.east_m, start.north_m - circle.north_m)
        direct = paths_to(circle, start, own)
        # The autopilot takes either turn to a circle that is commanded alone.
        if away_m < _NEAR_SHARE * circle.radius_m or (direct and min(map(clear_m, direct)) >= needed_m):
            direct.insert(0, self._again(replace(present, circle=circle)))
        ways: list[Iterable[Plan]] = [direct, escapes(start, target, present.circle, own, requirement)]
        if later is not None:
            ways.append(retreats(start, later, requirement.side.clockwise, own, requirement.range_min_m))
        best: tuple[Plan | None, float] = None, -math.inf
        refused = best
        for plan in chain.from_iterable(ways):
            kept_m = clear_m(plan)
            if kept_m <= best[1]:
                continue
            cleared = self.surroundings.cleared(plan)
            if not isinstance(cleared, Plan):
                continue
            if kept_m >= needed_m and self.changes.has_refused(cleared):
                refused = cleared, kept_m
                continue
            best = cleared, kept_m
            if kept_m >= needed_m:
                break
        return best if best[0] is not None else refused

    def _way_out(self, aircraft: AircraftState, present: Plan, reason: str) -> tuple[StepOutput, ...]:
        """Return what brings the aircraft to the present circle, or to another one, from where it is."""
        plan, clear_m = self._best_way(aircraft, present)
        if plan is None:
            return self.changes.upload(self.time_s, self._again(present), self._wind, reason, kind="plan")
        same = plan.circle.east_m == present.circle.east_m and plan.circle.north_m == present.circle.north_m
        keep_m = self.settings.requirement.range_min_m
        if clear_m < keep_m:
            reason += f"; no way keeps {keep_m:.0f} m from the target: taking the one that keeps {clear_m:.0f} m"
        elif not same:
            reason += " would come too near to the target: going to another circle"
        return self.changes.upload(self.time_s, plan, self._wind, reason, kind="plan")

    def _back_into_envelope(self, aircraft: AircraftState, present: Plan) -> tuple[StepOutput, ...] | None:
        """Return what leads back into the envelope; None: nothing keeps an ordinary decision from being made."""
        faults, is_again = self.envelope.faults, self.time_s - self._recovered_s >= _BACK_AGAIN_S
        height, fence = faults.get(Input.HEIGHT), faults.get(Input.FENCE)
        is_low = self._height_m is not None and self._height_m < self.envelope.floor_m
        if self.settings.at_breach == "return" and ((height and is_low) or fence):
            self._end(Phase.ENDED, reason := f"{height if is_low else fence}")
            return (End(self.time_s, "return", reason),)
        if abs(self.changes.home_m - self.door.home_m) > _SAME_HOME_M:
            reason = "home was set elsewhere: commanding the circle again, at the height that it had"
            return self._recover(self._again(present), reason)
        if height and is_again:
            return self._recover(self._again(present), f"{height}: commanding the circle's height again")
        if is_low:
            return self._hold("below the floor nothing new is commanded")
        if fence and is_again:
            plan, _ = self._best_way(aircraft, present)
            if plan is not None:
                return self._recover(plan, f"{fence}: turning back")
        return None

    def _recover(self, plan: Plan, reason: str) -> tuple[StepOutput, ...]:
        self._recovered_s = self.time_s
        outputs = self.changes.upload(self.time_s, plan, self._wind, reason)
        self._recovery = outputs[1].number
        return outputs

    @property
    def _spare_m(self) -> float:
        """By how much the turns of an aircraft come late that rolls more slowly than configured."""
        own = self.settings.aircraft
        is_slow = own.configured is not None and own.roll_rate_max_rad_s < own.configured.roll_rate_max_rad_s
        if not is_slow:
            return 0.0
        late_m, requirement = own.airspeed_m_s * own.roll_s(1.0 / own.radius_m), self.settings.requirement
        room_m = 0.5 * (requirement.range_max_m - requirement.range_min_m) - own.radius_m
        return max(late_m, min(self.envelope.strayed_m, room_m))

    def _keeps_away(self, plan: Plan, reach: Reach, hold_s: float = HOLD_S, spare_m: float = 0.0) -> bool:
        airspeed_m_s, least_m = self.settings.aircraft.airspeed_m_s, self.settings.requirement.range_min_m
        return reach.after(self.latency.expected_s).clearance_m(plan, airspeed_m_s, hold_s) >= least_m + spare_m

    def _hold_away(
        self,
        aircraft: AircraftState,
        present: Plan,
        reach: Reach,
        why: str = _UNSEEN,
        others: Sequence[Reach] = (),
        *,
        is_seen: bool = False,
    ) -> tuple[StepOutput, ...]:
        """Return the plan to another circle, if the target may come too near to the present one.

        It leads away from a target that is unseen, and stays within the band of one that is seen where it can.
        """
        reaches = (reach, *others)
        settings, latency_s, plan = self.settings, self.latency.expected_s, None
        airspeed_m_s, keep_m = settings.aircraft.airspeed_m_s, settings.requirement.range_min_m
        flown_m = nearest_arc_m(present, aircraft)
        if flown_m >= present.transition_m:
            present = replace(present, transition=None)
        clear_m = min(one.clearance_m(present, airspeed_m_s, LEAVE_S, flown_m) for one in reaches)
        if clear_m < keep_m + self._spare_m and is_seen:
            plan, _ = self._best_way(aircraft, present)
        elif clear_m < keep_m:
            start, later = dead_reckoned(aircraft, latency_s), [one.after(latency_s) for one in reaches]
            clockwise = settings.requirement.side.clockwise
            plans = retreats(start, later[0], clockwise, settings.aircraft, keep_m, later[1:])
            plan = self.surroundings.first_cleared(plans)
        if self.time_s - self._retreated_s < _RETREAT_S:
            clear_m += _RETREAT_GAIN * keep_m
        if plan is None or min(one.clearance_m(plan, airspeed_m_s, LEAVE_S) for one in reaches) <= clear_m:
            return self._hold(why)
        self._retreated_s = self.time_s
        text = f"moving away: {why} and may be within {keep_m:.0f} m"
        return self.changes.upload(self.time_s, plan, self._wind, text)

    def _search(self, aircraft: AircraftState, present: Plan, density: Reach) -> tuple[StepOutput, ...]:
        """Return the plan to a circle around where the target is likely to be, unless such a circle is flown."""
        airframe, keep_m = self.settings.aircraft, self.settings.requirement.range_min_m
        latency_s = self.latency.expected_s
        circle, flown_m = present.circle, nearest_arc_m(present, aircraft)
        rest = present if flown_m < present.transition_m else replace(present, transition=None)
        clear_m = density.clearance_m(rest, airframe.airspeed_m_s, LEAVE_S, flown_m)
        is_around = math.hypot(circle.east_m - density.east_m, circle.north_m - density.north_m) < circle.radius_m
        waits = self.time_s - self._retreated_s < _SEARCH_S and not self.changes.refused
        if (is_around and clear_m >= keep_m) or waits:
            return self._hold(_UNSEEN)
        start = dead_reckoned(aircraft, latency_s)
        plans = orbits(start, density.after(latency_s), airframe, keep_m)
        plan = self.surroundings.first_cleared(plan for plan in plans if not self.changes.has_refused(plan))
        if plan is None:
            return self._hold_away(aircraft, present, density)
        self._retreated_s = self.time_s
        return self.changes.upload(self.time_s, plan, self._wind, "searching: circling where the target can be")

    def _again(self, present: Plan) -> Plan:
        """Return the present circle as a new plan, without a transition."""
        return replace(present, transition=None, departure_s=self.time_s + self.latency.expected_s)

    def _hold(self, why: str) -> tuple[()]:
        self.decision = Decision(self.time_s, None, f"holding the circle: {why}")
        return ()

    def _corrected_radius(self, present: Plan) -> tuple[StepOutput, ...]:
        wanted_m = self.changes.wanted_radius_m()
        if wanted_m is None:
            return ()
        reason = f"asking for a radius of {wanted_m:.0f} m, so that {present.circle.radius_m:.0f} m is flown"
        return self.changes.upload(self.time_s, self._again(present), self._wind, reason)

    @property
    def flown(self) -> Flown:
        """Aircraft, height, plan, target and wind now: what a new plan starts from."""
        target_m = None if self.estimate is None else (self.estimate.east_m, self.estimate.north_m)
        airspeed_m_s = self.settings.aircraft.airspeed_m_s
        return Flown(self.aircraft, self.flown_height_m, self.present, target_m, self._wind, airspeed_m_s)

    # -- reports of the vehicle and of the exchange --------------------------------------------------------

    def _control_acquired(self, event: ControlAcquired) -> tuple[StepOutput, ...]:
        self.phase, self._own_mode, self._acquired_s = Phase.WATCHING, event.mode, event.time_s
        self.resuming, self.door.home_is_fixed = False, True
        begun = Plan(event.circle, None, event.time_s)
        cleared = self.surroundings.levelled(begun)
        plan = begun if isinstance(cleared, str) else cleared
        self.changes.begin(plan, event.circle, event.commanded or event.circle)
        if self.door.two_vehicles is not None:
            return self._yield(event.time_s, self.door.two_vehicles)
        return ()

    def _mode_reported(self, event: ModeReported) -> tuple[StepOutput, ...]:
        self._mode, changed = event.mode, f"the flight mode was changed to {event.mode}"
        failsafe = f"{changed} by a failsafe of the autopilot: {event.failsafe}" if event.failsafe else ""
        if self.phase.in_control and event.mode != self._own_mode:
            self._mode_yield_s = event.time_s
            return self._yield(event.time_s, failsafe or changed)
        recent = self.phase is Phase.YIELDED and event.time_s - self._mode_yield_s < _NAMED_WITHIN_S
        if recent and failsafe not in ("", self._over):  # the reason is reported later than the mode
            self._over = failsafe
            return (Yield(event.time_s, failsafe),)
        if self.phase.in_control and not event.armed:
            return self._yield(event.time_s, "the motors were disarmed")
        return ()

    def _yield(self, time_s: float, reason: str) -> tuple[StepOutput, ...]:
        if not self.phase.in_control and not self.resuming:
            return ()
        self._end(Phase.YIELDED, reason)
        return (Yield(time_s, reason),)

    def resume_objection(self) -> str:
        """Return why the watch cannot be resumed now, in words; '' if it can."""
        if self.phase is not Phase.YIELDED:
            return f"the mission is {self.phase}"
        if not self._connected or self.door.no_heartbeat:
            return "no message from the autopilot"
        return self.door.two_vehicles or self.door.doubt or self.health.unknown

    def resume(self) -> None:
        """Leave the yield: the aircraft is being taken over again. Nothing may object to it."""
        self.phase, self._over, self.resuming = Phase.WAITING, "", True
        self.planning.renew(self.settings.aircraft, self.settings.requirement)  # it planned for another path

    def _end(self, phase: Phase, reason: str) -> None:
        self.phase, self._over, self.resuming = phase, reason, False
        self.changes.under_way = None

    def _link_reported(self, event: LinkReported | RoundTripReported) -> tuple[StepOutput, ...]:
        if isinstance(event, RoundTripReported):
            self.latency.note_round_trip(event.round_trip_s)
            return ()
        self._connected = event.connected
        return (self.health.link_changed(event, event.time_s),)

    def _assumption_reported(self, event: HomeReported | BankLimitReported) -> None:
        if isinstance(event, BankLimitReported):
            self.envelope.bank_limit_reported(event.bank_rad)
            return
        self._home_m = event.east_m, event.north_m
        if self._first_home_m is None or not self.door.home_is_fixed:
            self._first_home_m = self._home_m

    def _battery_reported(self, event: BatteryReported) -> tuple[StepOutput, ...]:
        low = battery_is_low(event.left_s, event.home_s) and not event.rejected
        self._low_battery_s = min(self._low_battery_s, event.time_s) if low else math.inf
        wanted = self.phase.in_control and self.settings.at_low_battery == "return"
        if not wanted or event.time_s - self._low_battery_s < _LOW_BATTERY_S:
            return ()
        reason = event.text or f"the battery is at {event.percent:.0f} %, home is {event.home_s:.0f} s away"
        self._end(Phase.ENDED, reason)
        return (End(event.time_s, "return", reason),)

    def _planning_input(self, event: WindReported | WindPrepared | RouteGiven) -> tuple[StepOutput, ...]:
        if isinstance(event, RouteGiven):
            return (Announce(event.time_s, "route", self.planning.follow(event)),)
        if isinstance(event, WindReported):
            self._wind = Wind(event.east_m_s, event.north_m_s)
            return ()
        if not self.planning.prepare_wind(event.speed_m_s):
            return ()
        return (Announce(event.time_s, "decision", f"ready for a wind of {event.speed_m_s:g} m/s"),)

    def _advised(self, advice: FleetAdvice | NeighbourPlanned) -> tuple[StepOutput, ...]:
        before = self.planning.target
        self.planning.advise(advice)
        if isinstance(advice, NeighbourPlanned):
            self.surroundings.separation.planned(advice)
            return ()
        self.surroundings.separation.note(advice.neighbours)
        if before not in ("", advice.target):
            self._news, self._course, self._object = TargetNews(), TargetCourse(), AnotherObject()
        if advice.turn_payload:
            self.tracker.payload.expect_another_target()
        if not self.phase.in_control:
            return ()
        if advice.role is Role.LEAVE:
            self._end(Phase.ENDED, advice.reason)
            return (End(advice.time_s, "return", advice.reason),)
        requirement = self.settings.requirement
        if advice.side is requirement.side:
            return ()
        self.settings = replace(self.settings, requirement=replace(requirement, side=advice.side))
        self.planning.watch_from(self.settings.requirement)
        why = f": {advice.reason}" if advice.reason else ""
        return (Announce(advice.time_s, "decision", f"watching from the {advice.side}{why}"),)

    # -- what a person asks for ----------------------------------------------------------------------------

    def _operator(self, event: OperatorRequest) -> tuple[StepOutput, ...]:
        if self.phase is Phase.YIELDED and event.action == "resume":
            objection = self.resume_objection()
            waits = f", once this has passed: {objection}" if objection else ""
            return (Announce(event.time_s, "operator", f"operator: resume; the vehicle is checked again{waits}"),)
        if not self.phase.in_control:
            return (Announce(event.time_s, "operator", f"{event.action} refused: the mission is {self.phase}"),)
        settings = self.settings
        match event.action:
            case "hold":
                self.phase = Phase.HOLDING
            case "resume":
                self.phase = Phase.WATCHING
            case "confirm":
                self._object.explain("confirmed")
            case "end":
                self._end(Phase.ENDED, "ended by the operator")
            case "side" if event.side is None or settings.requirement.sector is not None:
                why = "no side is named" if event.side is None else "the mission watches from bearings"
                return (Announce(event.time_s, "operator", f"side refused: {why}"),)
            case "side":
                self._ask_for(settings.aircraft, replace(settings.requirement, side=event.side))
        text = f"operator: {event.action}" + (f" {event.side}" if event.action == "side" else "")
        announced = Announce(event.time_s, "operator", text)
        if event.action == "end":
            return announced, End(event.time_s, "hold", "ended by the operator")
        return (announced,)

    def _ask_for(self, aircraft: Aircraft, requirement: Requirement) -> None:
        self.envelope.configure(aircraft.configured or aircraft, requirement)
        aircraft = self.envelope.aircraft
        self.settings = replace(self.settings, aircraft=aircraft, requirement=requirement)
        self.planning.renew(aircraft, requirement)

    def _mission_changed(self, event: MissionChange) -> tuple[StepOutput, ...]:
        what, settings = describe_change(event), self.settings
        if not self.phase.in_control:
            return (Announce(event.time_s, "operator", f"{what} refused: the mission is {self.phase}"),)
        own = settings.aircraft.configured or settings.aircraft
        self._ask_for(aircraft_after(event, own), requirement_after(event, settings.requirement))
        if event.height_m is not None:
            self._heights_before = None
            self.surroundings.heights, self._height_asked_m = self._heights_at(event.height_m), event.height_m
        self._changed_s = self.time_s
        when = "from the next plan on" if self.phase is Phase.WATCHING else "when you resume"
        if event.pan_limit_deg is not None:
            return (Announce(event.time_s, "decision", f"{event.who}: {what}, {when}"),)
        return (Announce(event.time_s, "operator", f"operator: {what}, {when}"),)

    def objection(self, change: MissionChange) -> str | None:
        """Return which fence or ground keeps the present circle from being flown at another height; None: nothing."""
        if change.height_m is None or self.present is None:
            return None
        circle = replace(self.present, transition=None)
        flown, heights = self.flown, self._heights_at(change.height_m)
        cleared = self.surroundings.levelled(circle, flown.height_m, flown.target_m, heights)
        return cleared if isinstance(cleared, str) else None

    def _heights_at(self, height_m: float) -> Heights:
        heights = self.surroundings.heights or OneHeight(ClimbRates(self.settings.aircraft.airspeed_m_s))
        return heights.at(height_m)

    def _circle_as_changed(self, aircraft: AircraftState, present: Plan) -> tuple[StepOutput, ...]:
        """Return what sends the present circle with the radius and height that were asked for, once it is reached."""
        if self._changed_s is None or self.changes.flown_since_s > self._changed_s:
            return ()
        if nearest_arc_m(present, aircraft) < present.transition_m:
            return ()
        latency_s, radius_m, circle = self.latency.expected_s, self.settings.aircraft.radius_m, present.circle
        if self.settings.aircraft.configured is not None and circle.radius_m < radius_m:
            reason = f"flying a circle of {radius_m:.0f} m, as wide as the aircraft needs"
            return self._way_out(aircraft, present, reason)
        if circle.radius_m != radius_m:
            start = dead_reckoned(aircraft, latency_s)
            circle = Circle.tangent_to(start.east_m, start.north_m, start.course_rad, radius_m, circle.clockwise)
        cleared = self.surroundings.cleared(Plan(circle, None, self.time_s + latency_s))
        if isinstance(cleared, str):
            self._changed_s = None
            return (Announce(self.time_s, "decision", f"staying: {cleared}"),)
        if circle == present.circle and cleared.circle_height_m(-math.inf) == present.circle_height_m(-math.inf):
            self._changed_s = None
            return ()
        reason = f"the same circle as changed: radius {radius_m:.0f} m"
        if cleared.heights is not None:
            reason += f", {cleared.heights.to_m:.0f} m above home"
        return self.changes.upload(self.time_s, cleared, self._wind, reason)


def _announced(event: AlarmReported) -> tuple[Announce]:
    if event.stage == "raised":
        return (Announce(event.time_s, "alarm", f"alarm: {event.text}"),)
    text = f"alarm over: {event.text}" if event.stage == "cleared" else f"alarm acknowledged: {event.key}"
    return (Announce(event.time_s, "clear", text),)


def _state_of(reading: PositionReading, bank_rad: float) -> AircraftState:
    east_m_s, north_m_s = reading.velocity_east_m_s, reading.velocity_north_m_s
    course_rad, ground_speed_m_s = math.atan2(east_m_s, north_m_s), math.hypot(east_m_s, north_m_s)
    turning_m_s = ground_speed_m_s if ground_speed_m_s > 5.0 else 5.0
    # A coordinated turn at this bank bends the flown line by g tan(bank) across it.
    curvature_per_m = GRAVITY_M_S2 * math.tan(bank_rad) / turning_m_s**2
    place = reading.time_s, reading.east_m, reading.north_m
    return AircraftState(*place, course_rad, ground_speed_m_s, curvature_per_m)

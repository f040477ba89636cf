"""The planner in use, the plan that is flown, and the plan on its way to the autopilot.

At most one plan is pending. It is uploaded while the autopilot still flies the previous path, then activated at its
planned time. A plan that is ready too late to be joined is dropped. If only a command starts it, the command is sent
earlier by the autopilot's response time. An activated plan stays pending until the autopilot confirms it; the
confirmation may arrive late.

The circle that is sent has the radius that makes the autopilot fly the planned radius. ArduPlane flies 116 m when
asked for 100 m: its loiter law has no integral part and scales with altitude. The ratio is steady for an aircraft at
one speed, so it is measured and divided out.

Source: docs/explanation/planners.md; docs/explanation/exchange.md; docs/retries.md#3-one-plan.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from typing import Literal

from sidelong.estimators.estimate import TargetEstimate, TrackQuality
from sidelong.mission.control.plausibility import Plausibility
from sidelong.mission.core.circle import Circle
from sidelong.mission.core.events import ActivatePlan, Announce, PlanStatus, RouteGiven, StepOutput, UploadPlan
from sidelong.mission.core.fleet import CooperativePlanner, FleetAdvice, NeighbourPlanned
from sidelong.mission.core.plan import AircraftState, Decision, Plan, Planner, PlannerFactory, WindPlanner
from sidelong.mission.core.requirement import Aircraft, Requirement, Wind
from sidelong.mission.geometry.approach import approach
from sidelong.mission.geometry.progress import dead_reckoned, nearest_arc_m, off_track, point_at
from sidelong.mission.route.progress_kernel import fresh_progress, reset
from sidelong.mission.route.route import Route, RoutePlanner, RouteProgress, describe, progress_of, route_from

WINDS_MAX = 5  # a flight prepares for at most this number of wind speeds: a table takes seconds
# Fleet advice expires after this time.
_ADVICE_S = 5.0
# Minimum duration of an approach, while its circle is still within the target's range.
_APPROACH_S = 10.0


class Planning:
    """Holds the planner and rebuilds it, within a step, when the aircraft or the requirement changes."""

    def __init__(self, make_planner: PlannerFactory, aircraft: Aircraft, requirement: Requirement) -> None:
        self.make_planner = make_planner
        self.prepared_winds_m_s: list[float] = []
        self._aircraft, self._requirement = aircraft, requirement
        self._advice: FleetAdvice | None = None
        self._neighbours: dict[str, NeighbourPlanned] = {}
        self._route: Route | None = None
        self._progress = fresh_progress(0)  # along the route: a new planner continues with it
        self._route_reported = (False, False)  # on the route; and of use
        self.planner: Planner = make_planner(aircraft, requirement)

    def renew(self, aircraft: Aircraft, requirement: Requirement) -> None:
        """Rebuild the planner for a new aircraft or requirement."""
        self._aircraft, self._requirement = aircraft, requirement
        self.planner = self.make_planner(aircraft, requirement)
        if isinstance(self.planner, WindPlanner):
            for speed_m_s in self.prepared_winds_m_s:
                self.planner.prepare(speed_m_s)
        if self._route is not None and isinstance(self.planner, RoutePlanner):
            self.planner.follow(self._route, self._progress)
        if isinstance(self.planner, CooperativePlanner):
            for news in (*self._neighbours.values(), *(() if self._advice is None else (self._advice,))):
                self.planner.advise(news)

    def prepare_wind(self, speed_m_s: float) -> bool:
        """Prepare the planner for winds of a speed from tables in memory; return whether that is new."""
        if speed_m_s in self.prepared_winds_m_s or not isinstance(self.planner, WindPlanner):
            return False
        if len(self.prepared_winds_m_s) == WINDS_MAX or not 0.0 <= speed_m_s < self._aircraft.airspeed_m_s:
            return False  # no flight prepares for it: a journal that does is damaged
        self.prepared_winds_m_s.append(speed_m_s)
        self.planner.prepare(speed_m_s)
        return True

    # -- the route -----------------------------------------------------------------------------------------

    def follow(self, given: RouteGiven) -> str:
        """Expect the target on a route; return in words what that means for planning."""
        if not isinstance(self.planner, RoutePlanner):
            return "this planner does not use a route"
        try:
            self._route = route_from(given) if given.east_m else None
        except ValueError as error:
            return f"the route is not used: {error}"
        self._route_reported = False, False
        self._progress = fresh_progress(0 if self._route is None else self._route.east_m.size)
        self.planner.follow(self._route, self._progress)
        if self._route is None:
            return "no route of the target is known"
        return f"the target is expected on a route of {self._route.length_m:.0f} m"

    @property
    def route_progress(self) -> RouteProgress | None:
        """The target's progress along its route; None without a route."""
        return None if self._route is None else progress_of(self._route, self._progress)

    def route_news(self) -> str:
        """Return in words whether the target has joined or left its route, or its use has changed; '' if neither."""
        progress = self.route_progress
        if progress is None:
            return ""
        now = progress.on_route, progress.on_route and progress.of_use
        if now == self._route_reported:
            return ""
        self._route_reported = now
        if progress.on_route:
            return f"on route: the target is {describe(progress)}"
        return "off route: the target has left its route, and sidelong plans without it"

    # -- the fleet -----------------------------------------------------------------------------------------

    def advise(self, news: FleetAdvice | NeighbourPlanned) -> None:
        """Pass fleet advice, or a neighbour's plan, to the planner."""
        before = self.target
        if isinstance(news, NeighbourPlanned):
            self._neighbours[news.name] = news
        else:
            self._advice = news
            if before not in ("", news.target):  # the planner's memory belongs to another target
                reset(self._progress)
                self.renew(self._aircraft, self._requirement)
        if isinstance(self.planner, CooperativePlanner):
            self.planner.advise(news)

    @property
    def target(self) -> str:
        """Name of the target that the fleet assigns; '' without a fleet and before its first advice."""
        return "" if self._advice is None else self._advice.target

    @property
    def turn_payload(self) -> bool:
        """Whether the payload looks at another target than the fleet assigns."""
        return self._advice is not None and self._advice.turn_payload

    @property
    def layer_m(self) -> float:
        """Height above home of the layer that the fleet gives the aircraft, m; -inf without a fleet."""
        return -math.inf if self._advice is None else self._advice.height_m

    def too_near(self, time_s: float) -> str:
        """Return in words which other aircraft is too near; '' if none is, and without fresh advice."""
        advice = self._advice
        return "" if advice is None or time_s - advice.time_s > _ADVICE_S else advice.separation

    def watch_from(self, requirement: Requirement) -> None:
        """Plan for the side that the fleet assigns; a cooperative planner receives the side with the advice."""
        if isinstance(self.planner, CooperativePlanner):
            self._requirement = requirement
        else:
            self.renew(self._aircraft, requirement)

    def joint_estimate(self, time_s: float) -> TargetEstimate | None:
        """Return the fleet's estimate of the target; None if it is old or lost."""
        advice = self._advice
        if advice is None or advice.estimate is None or time_s - advice.time_s > _ADVICE_S:
            return None
        return None if advice.estimate.quality is TrackQuality.LOST else advice.estimate

    # -- deciding ------------------------------------------------------------------------------------------

    def decide(
        self, aircraft: AircraftState, target: TargetEstimate, present: Plan, wind: Wind, latency_s: float
    ) -> Decision:
        """See :class:`sidelong.mission.core.plan.Planner`. Out of the band, approach a circle next to the target."""
        range_m = math.hypot(aircraft.east_m - target.east_m, aircraft.north_m - target.north_m)
        if range_m <= self._requirement.range_max_m:
            return self.planner.decide(aircraft, target, present, wind, latency_s)
        start = dead_reckoned(aircraft, latency_s)
        plan = approach(start, target, self._aircraft, self._requirement)
        circle = present.circle
        off_m = math.hypot(plan.circle.east_m - circle.east_m, plan.circle.north_m - circle.north_m)
        ahead_m = math.hypot(circle.east_m - target.east_m, circle.north_m - target.north_m) + circle.radius_m
        begun = present.transition is not None and aircraft.time_s - present.departure_s < _APPROACH_S
        if off_m < 0.5 * self._aircraft.radius_m or (begun and ahead_m < self._requirement.range_max_m):
            return Decision(aircraft.time_s, None, f"on the way to the target, {range_m:.0f} m to go")
        return Decision(aircraft.time_s, plan, f"approaching: the target is {range_m:.0f} m away")


# The second longest of this many plans, once there are three: a stalled upload is an outlier. Each took as many round
# trips as the next will take: an upload at least two (the count's and the items'), a command one.
_PLANS, _MARGIN_S = 5, 0.1
_UPLOAD_ROUND_TRIPS, _COMMAND_ROUND_TRIPS = 2.0, 1.0


class UploadLatency:
    """How long plans take until they can be flown."""

    def __init__(self, expected_s: float) -> None:
        self.expected_s = self._given_s = expected_s  # of the next plan, by the vehicle's clock
        self.command_s = 0.0  # from a command until it is obeyed, as a rule
        self._by_command = False
        self._round_trip_s: float | None = None  # of the link, now
        self._took_s: deque[tuple[float, float | None]] = deque([(expected_s, None)], _PLANS)

    def note(self, took_s: float, *, by_command: bool = False) -> None:
        """Process the duration of an upload, also of one that was abandoned, or of a plan flown at one command."""
        self._by_command = by_command
        self._took_s.append((took_s, self._round_trip_s))
        self._expect()

    def note_round_trip(self, round_trip_s: float) -> None:
        """Process a measured round trip of the link."""
        self._round_trip_s = round_trip_s
        self._expect()

    def _expect(self) -> None:
        now_s = self._round_trip_s
        round_trips = _COMMAND_ROUND_TRIPS if self._by_command else _UPLOAD_ROUND_TRIPS
        min_s = 0.0 if now_s is None else round_trips * now_s
        expected = sorted(
            took_s if now_s is None or then_s is None else took_s + round_trips * (now_s - then_s)
            for took_s, then_s in self._took_s
        )
        if len(expected) > 1:
            self.expected_s = expected[-2 if len(expected) > 2 else -1] + _MARGIN_S
        else:
            self.expected_s = self._given_s
        self.expected_s = max(self.expected_s, min_s)
        if self._by_command:
            self.command_s = max(expected[(len(expected) - 1) // 2], min_s)


_MIN_RATIO, _MAX_RATIO = 0.7, 1.5


class FlownRadius:
    """Ratio of flown to commanded radius, averaged over the last lap; as given until the first whole lap is flown.

    Only samples near the circle and along it count, so that transitions do not spoil the average.
    """

    def __init__(self, ratio: float = 1.0) -> None:
        self.ratio = ratio
        self._circle: Circle | None = None
        self._turned_rad = 0.0
        self._sum_m = 0.0
        self._count = 0
        self._last_rad: float | None = None

    def observe(self, aircraft: AircraftState, commanded: Circle) -> None:
        """Process one position of the aircraft, on a circle as it was sent to the autopilot."""
        if commanded != self._circle:
            self._restart(commanded)
        east_m, north_m = aircraft.east_m - commanded.east_m, aircraft.north_m - commanded.north_m
        flown_m = math.hypot(east_m, north_m)
        if not _MIN_RATIO * commanded.radius_m <= flown_m <= _MAX_RATIO * commanded.radius_m:
            self._restart(commanded)
            return
        bearing_rad = math.atan2(east_m, north_m)
        if self._last_rad is not None:
            step_rad = (bearing_rad - self._last_rad + math.pi) % (2.0 * math.pi) - math.pi
            self._turned_rad += step_rad if commanded.clockwise else -step_rad
        self._last_rad = bearing_rad
        if self._turned_rad < math.pi:
            return  # the first half lap still shows the entry
        self._sum_m += flown_m
        self._count += 1
        if self._turned_rad >= 3.0 * math.pi:
            self.ratio = self._sum_m / self._count / commanded.radius_m
            self._restart(commanded)
            self._turned_rad = math.pi  # settled: the next lap counts from here

    def _restart(self, circle: Circle) -> None:
        self._circle, self._turned_rad, self._sum_m, self._count, self._last_rad = circle, 0.0, 0.0, 0, None

    def commanded(self, wanted: Circle) -> Circle:
        """Return the circle to command so that the aircraft flies ``wanted``."""
        return Circle(wanted.east_m, wanted.north_m, wanted.radius_m / self.ratio, wanted.clockwise)


# A late plan still departs within this time, while the aircraft is near its path: a transition leaves the previous
# path slowly. After it the aircraft banks the wrong way for the plan.
_LATE_S, _JOINABLE_M, _JOINABLE_RAD = 1.5, 15.0, math.radians(15.0)
# An aircraft that is off its transition for this time does not return automatically. The same holds if it turns this
# much tighter than any plan: it orbits a waypoint that it cannot reach, near its path all the time.
_OFF_TRACK_S, _ORBITS = 6.0, 2.0
# The aircraft cannot be moved when this number of plans in a row, or all of this time, have failed.
_STUCK, _STUCK_S = 3, 28.0  # the alarm follows within 30 s
_SAME_CIRCLE = 0.5  # of the radius: as far may the circle of a refused plan be, for the target moves on
# The present circle is sent again when its flown radius is off by more than this share.
_RADIUS_TOLERANCE = 0.03


@dataclass(slots=True)
class PlanChange:
    """A plan on its way to the autopilot."""

    command: UploadPlan
    stage: Literal["preparing", "ready", "departing"] = "preparing"
    by_command: bool = False  # nothing of it is on board: it departs when one command is obeyed
    activated_s: float = math.inf


class PlanChanges:
    """The plan that is flown, and the one on its way to the autopilot."""

    def __init__(self, door: Plausibility, latency: UploadLatency) -> None:
        self.present: Plan | None = None  # the plan that is flown
        self.under_way: PlanChange | None = None
        self.flown_since_s = -math.inf  # when the change to it was decided
        self.home_m = 0.0  # of home above that of the takeover, against which it was sent
        self.refused: list[Plan] = []  # the plans in a row that failed
        self._refused_since_s, self._why = math.inf, ""
        self.moves = self.uploads = self.failures = 0
        self._door, self._latency = door, latency
        self._not_taken: PlanChange | None = None  # the last departure that failed: should it be flown after all
        self._commanded: Circle | None = None  # the present circle as sent to the autopilot
        self._flown_radius = FlownRadius()
        self._on_line_s = math.inf  # when the aircraft was last seen on its transition; inf: it flies none

    def begin(self, plan: Plan, flown: Circle, commanded: Circle) -> None:
        """Begin with a circle that is flown already and was sent to the autopilot as ``commanded``."""
        self.present, self._commanded, self._not_taken = plan, commanded, None
        self.refused, self.home_m = [], self._door.home_m
        self._flown_radius = FlownRadius(flown.radius_m / commanded.radius_m)

    def observe(self, aircraft: AircraftState) -> None:
        """Update the aircraft's state, unless it is dead reckoned."""
        if self._commanded is not None:
            self._flown_radius.observe(aircraft, self._commanded)

    def upload(
        self,
        time_s: float,
        plan: Plan,
        wind: Wind,
        reason: str,
        text: str = "",
        kind: Literal["decision", "plan"] = "decision",
    ) -> tuple[Announce, UploadPlan]:
        """Announce a plan by a text, else by its reason, and begin to upload it."""
        assert self.present is not None
        self.uploads += 1
        commanded = self._flown_radius.commanded(plan.circle)
        command = UploadPlan(time_s, self.uploads, plan, commanded, self.present, wind, reason, self._door.home_m)
        self.under_way = PlanChange(command)
        return Announce(time_s, kind, text or reason), command

    def stuck(self, now_s: float) -> str:
        """Return why plans do not get through: several in a row, or all of some time, have failed; '' if they do."""
        count = len(self.refused)
        if count < _STUCK and not (count > 1 and now_s - self._refused_since_s >= _STUCK_S):
            return ""
        return f"{count} in a row did not get through ({self._why}): the aircraft stays on its circle"

    def has_refused(self, plan: Plan) -> bool:
        """Return whether one of the plans in a row that failed led to the same circle in the same way."""
        return any(_is_alike(plan, one) for one in self.refused)

    def activate_due(self, now_s: float, *, watching: bool) -> tuple[StepOutput, ...]:
        """Activate the plan that is ready, at its time of departure, while control of the aircraft is confirmed."""
        change = self.under_way
        if change is None or change.stage != "ready":
            return ()
        due_s = change.command.plan.departure_s - (self._latency.command_s if change.by_command else 0.0)
        if now_s < due_s:
            return ()
        if not watching:
            self.under_way = None
            return ()
        late_s = now_s - due_s
        if (self._door.faulty or self._door.no_heartbeat) and late_s <= _LATE_S:
            return ()
        if self._door.doubt is not None or late_s > _LATE_S:
            self.under_way = None
            why = self._door.doubt or f"its time was {late_s:.1f} s ago"
            return (Announce(now_s, "plan", f"plan {change.command.number} does not depart: {why}"),)
        change.stage, change.activated_s = "departing", now_s
        return (ActivatePlan(now_s, change.command.number),)

    def report(
        self, event: PlanStatus, now_s: float, aircraft: AircraftState | None, *, watching: bool
    ) -> tuple[StepOutput, ...]:
        """Process the status of a plan. watching: control of the aircraft is confirmed."""
        late = self._not_taken
        if event.stage == "departed" and late is not None and late.command.number == event.number:
            self.failures -= 1
            self._departed(late, event.time_s)
            return ()
        change = self.under_way
        if change is None or change.command.number != event.number:
            return ()
        match event.stage:
            case "unconfirmed":
                return (Announce(event.time_s, "plan", f"plan {event.number}: {event.detail} yet"),)
            case "failed":
                return self._failed(change, event)
            case "ready":
                change.by_command = event.by_command
                if not event.by_command:
                    self._latency.note(event.time_s - change.command.time_s)
                late_s = event.time_s - change.command.plan.departure_s
                if late_s > 0.0 and not _can_still_join(aircraft, change.command.plan, late_s):
                    self.under_way = None
                    text = f"plan {event.number} was on board {late_s:.1f} s too late: the present circle goes on"
                    return (Announce(event.time_s, "plan", text),)
                change.stage = "ready"
                return self.activate_due(now_s, watching=watching)
        if change.by_command:
            self._latency.note(event.time_s - change.activated_s, by_command=True)
        self._departed(change, event.time_s)
        return ()

    def _failed(self, change: PlanChange, event: PlanStatus) -> tuple[StepOutput, ...]:
        if change.stage == "departing":
            self._not_taken = change
        took_s = event.time_s - (change.activated_s if change.by_command else change.command.time_s)
        awaited = change.by_command or change.stage == "preparing"
        if awaited and took_s > self._latency.expected_s:
            self._latency.note(took_s, by_command=change.by_command)
        self.under_way = None
        self.failures += 1
        if not self.refused:
            self._refused_since_s = change.command.time_s
        self.refused, self._why = [*self.refused, change.command.plan], event.detail
        return (Announce(event.time_s, "plan", f"plan {event.number} was not taken: {event.detail}"),)

    def _departed(self, change: PlanChange, time_s: float) -> None:
        """Take over a plan that is flown: in good time, or one that was thought not to have been taken."""
        assert self.present is not None
        self.moves += change.command.plan.circle != self.present.circle
        self.present, self._commanded = change.command.plan, change.command.commanded
        self.under_way = self._not_taken = None
        self.flown_since_s, self.home_m, self.refused = change.command.time_s, change.command.home_m, []
        self._on_line_s = time_s

    # -- how the present plan is flown ---------------------------------------------------------------------

    def is_off_track(self, aircraft: AircraftState) -> bool:
        """Return whether the aircraft has left its transition for good."""
        present = self.present
        if present is None or present.transition is None:
            return False
        nearest = point_at(present, nearest_arc_m(present, aircraft), aircraft)
        orbits = abs(aircraft.curvature_per_m) * present.circle.radius_m > _ORBITS
        if not orbits and not off_track(aircraft, nearest):
            self._on_line_s = aircraft.time_s
        return aircraft.time_s - self._on_line_s > _OFF_TRACK_S

    def wanted_radius_m(self) -> float | None:
        """Return the radius to command for the present circle, None where it is the commanded one."""
        assert self.present is not None
        assert self._commanded is not None
        wanted_m = self._flown_radius.commanded(self.present.circle).radius_m
        return wanted_m if abs(wanted_m / self._commanded.radius_m - 1.0) > _RADIUS_TOLERANCE else None


def _is_alike(one: Plan, other: Plan) -> bool:
    """Return whether two plans lead to about the same circle, both by a path or both by a command of it alone."""
    a, b = one.circle, other.circle
    apart_m = math.hypot(a.east_m - b.east_m, a.north_m - b.north_m)
    is_same = a.clockwise == b.clockwise and apart_m < _SAME_CIRCLE * a.radius_m
    return is_same and (one.transition is None) == (other.transition is None)


def _can_still_join(aircraft: AircraftState | None, plan: Plan, late_s: float) -> bool:
    """Return whether the aircraft, which has flown on, is still near enough to the plan's path to join it."""
    assert aircraft is not None
    if late_s > _LATE_S:
        return False
    if plan.transition is None:
        return True  # a circle is flown to from anywhere
    line = point_at(plan, nearest_arc_m(plan, aircraft), aircraft)
    return not off_track(aircraft, line, _JOINABLE_M, _JOINABLE_RAD)

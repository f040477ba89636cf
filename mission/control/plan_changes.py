"""The plan that is flown, and the plan on its way to the autopilot.

At most one plan is pending. It is uploaded while the autopilot still flies the previous path, then activated at its
planned time. A plan that is ready too late to be joined is dropped. If only a command starts it, the command is sent
earlier by the autopilot's response time. An activated plan stays pending until the autopilot confirms it; the
confirmation may arrive late.

The circle that is sent has the radius that makes the autopilot fly the planned radius.

Source: docs/retries.md#3-one-plan.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

from sidelong.mission.control.flown_radius import FlownRadius
from sidelong.mission.control.plausibility import Plausibility
from sidelong.mission.control.upload_latency import UploadLatency
from sidelong.mission.core.circle import Circle
from sidelong.mission.core.events import ActivatePlan, Announce, PlanStatus, StepOutput, UploadPlan
from sidelong.mission.core.plan import AircraftState, Plan
from sidelong.mission.core.requirement import Wind
from sidelong.mission.geometry.progress import nearest_arc_m, off_track, point_at

# A late plan still departs within this time, while the aircraft is near its path: a transition leaves the previous
# path slowly. After it the aircraft banks the wrong way for the plan.
_LATE_S, _JOINABLE_M, _JOINABLE_RAD = 1.5, 15.0, math.radians(15.0)
# An aircraft that is off its transition for this time does not return automatically. The same holds if it turns this
# much tighter than any plan: it orbits a waypoint that it cannot reach, near its path all the time.
_OFF_TRACK_S, _ORBITS = 6.0, 2.0
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
    """One flight's. present: the plan that is flown, None before the aircraft was taken over.

    under_way: the change that is; flown_since_s: when the change was decided that led to the present plan.
    """

    def __init__(self, door: Plausibility, latency: UploadLatency) -> None:
        self.present: Plan | None = None
        self.under_way: PlanChange | None = None
        self.flown_since_s = -math.inf
        self.moves = self.uploads = self.failures = 0
        self._door, self._latency = door, latency
        self._not_taken: PlanChange | None = None  # the last departure that failed: should it be flown after all
        self._commanded: Circle | None = None  # the present circle as sent to the autopilot
        self._flown_radius = FlownRadius()
        self._on_line_s = math.inf  # when the aircraft was last seen on its transition; inf: it flies none

    def begin(self, plan: Plan, flown: Circle, commanded: Circle) -> None:
        """Begin with a circle that is already flown and was sent to the autopilot as ``commanded``.

        Args:
            plan: The plan.
            flown: The circle that is flown.
            commanded: The circle as it was sent to the autopilot.
        """
        self.present, self._commanded, self._not_taken = plan, commanded, None
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
        """Announce a plan, and begin to upload it.

        Args:
            time_s: Time on the vehicle's clock, s.
            plan: The plan.
            wind: Estimate of the wind.
            reason: Reason of the decision, in words.
            text: What is announced; empty: the reason.
            kind: Kind of the announcement.
        """
        assert self.present is not None
        self.uploads += 1
        commanded = self._flown_radius.commanded(plan.circle)
        command = UploadPlan(time_s, self.uploads, plan, commanded, self.present, wind, reason)
        self.under_way = PlanChange(command)
        return Announce(time_s, kind, text or reason), command

    def withdraw(self) -> None:
        """Let go of the plan under way."""
        self.under_way = None

    def activate_due(self, now_s: float, *, watching: bool) -> tuple[StepOutput, ...]:
        """Activate the plan that is ready, at its time of departure.

        Args:
            now_s: Present time, vehicle's clock, s.
            watching: Whether control of the aircraft is confirmed.
        """
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
        """Process the status of a plan.

        Args:
            event: The status.
            now_s: Present time, vehicle's clock, s.
            aircraft: State of the aircraft; None if unknown.
            watching: Whether control of the aircraft is confirmed.
        """
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
        return (Announce(event.time_s, "plan", f"plan {event.number} was not taken: {event.detail}"),)

    def _departed(self, change: PlanChange, time_s: float) -> None:
        """Take over a plan that is flown: in good time, or one that was thought not to have been taken."""
        assert self.present is not None
        self.moves += change.command.plan.circle != self.present.circle
        self.present, self._commanded = change.command.plan, change.command.commanded
        self.under_way = self._not_taken = None
        self.flown_since_s = change.command.time_s
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


def _can_still_join(aircraft: AircraftState | None, plan: Plan, late_s: float) -> bool:
    """Return whether the aircraft, which has flown on, is still near enough to the plan's path to join it."""
    assert aircraft is not None
    if late_s > _LATE_S:
        return False
    if plan.transition is None:
        return True  # a circle is flown to from anywhere
    line = point_at(plan, nearest_arc_m(plan, aircraft), aircraft)
    return not off_track(aircraft, line, _JOINABLE_M, _JOINABLE_RAD)

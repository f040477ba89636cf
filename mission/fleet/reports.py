"""What a step of one vehicle's core means for the fleet. Source: docs/decisions/0012-fleet-as-a-layer.md."""

from __future__ import annotations

import math
from collections.abc import Sequence

from sidelong.estimators.sensing.readings import AttitudeReading, GimbalReading, RangeReading
from sidelong.mission.control.controller import StandoffController
from sidelong.mission.control.present import Phase
from sidelong.mission.core.events import ClockTick, End, LinkReported, MissionChange, Yield
from sidelong.mission.core.plan import Plan
from sidelong.mission.exchange.outbox import ExternalControl
from sidelong.mission.exchange.reports import TimerExpired
from sidelong.mission.fleet.events import (
    FleetEvent,
    PayloadReported,
    PlansReported,
    RequirementReported,
    SightingReported,
    VehicleLost,
    VehicleReported,
)

_READ = frozenset((AttitudeReading, GimbalReading, RangeReading, ClockTick, TimerExpired))
_EVERY_S = 0.5
_ONE_PROGRAM = "make sure that only one program commands the fleet"


class FleetReporter:
    """Watches one vehicle's core. What ``after`` returns goes to the coordinator."""

    def __init__(self, name: str) -> None:
        self._name = name
        self._next_s = -math.inf
        self._plans: tuple[Plan | None, Plan | None] = (None, None)
        self._payload = "", False, False, 0  # as of PayloadReported

    def after(
        self, controller: StandoffController, event: object, outputs: Sequence[object], mission_time_s: float
    ) -> tuple[FleetEvent, ...]:
        """Return the fleet's events of one step: ``event`` went in, ``outputs`` came out.

        Args:
            mission_time_s: Mission time, s; the vehicle's own clock may stand still.
        """
        if type(event) in _READ and not outputs and not controller.sighted:
            return ()  # as most: what it may have changed is reported with the next position
        found: list[FleetEvent] = []
        tracker, health = controller.tracker, controller.health
        fault, jumped = health.unknown or controller.door.doubt or "", health.payload.is_suspect(controller.time_s)
        payload = fault, jumped, tracker.payload.is_confirmed, tracker.corrections
        if payload != self._payload:
            self._payload = payload
            found.append(PayloadReported(self._name, *payload, *tracker.remaining_sigmas))
        found += [
            SightingReported(self._name, tracker.without_known_errors(outcome.sighting))
            for outcome in controller.sighted
        ]
        external = any(isinstance(output, ExternalControl) for output in outputs)
        for output in outputs:
            if isinstance(output, Yield | End):
                reason = f"{output.reason}; {_ONE_PROGRAM}" if external else output.reason
                found.append(VehicleLost(self._name, mission_time_s, reason, isinstance(output, Yield)))
        if isinstance(event, LinkReported) and not event.connected:
            found.append(VehicleLost(self._name, mission_time_s, "its link is lost"))
        if isinstance(event, MissionChange):
            settings = controller.settings
            found.append(RequirementReported(self._name, mission_time_s, settings.aircraft, settings.requirement))
        plans = (controller.present, controller.coming)
        if plans[0] is not self._plans[0] or plans[1] is not self._plans[1]:
            self._plans = plans
            found.append(PlansReported(self._name, *plans))
        if controller.time_s >= self._next_s:
            self._next_s = controller.time_s + _EVERY_S
            now, height_m = controller.snapshot(), controller.flown_height_m
            if now.aircraft is not None and height_m is not None:
                flown = now.time_s, now.aircraft, height_m, now.phase is Phase.WATCHING and now.connected
                detail = "" if now.phase is Phase.WATCHING else f"the mission is {now.phase}"
                found.append(VehicleReported(self._name, *flown, now.latency_s, now.wind, detail))
        return tuple(found)

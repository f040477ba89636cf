"""What a step of one vehicle's core means for the fleet."""

from __future__ import annotations

import math
from collections.abc import Iterable

from mission.control.controller import Phase, StandoffController
from mission.core.events import ControlAcquired, End, LinkReported, PlanStatus, UploadPlan, Yield
from mission.fleet.events import FleetEvent, SightingReported, VehicleLost, VehicleReported

_EVERY_S = 0.5
_PLAN_NEWS = (UploadPlan, PlanStatus, ControlAcquired)


class FleetReporter:
    """Watches one vehicle's core. What ``after`` returns goes to the coordinator."""

    def __init__(self, name: str) -> None:
        self._name = name
        self._next_s = -math.inf

    def after(
        self, controller: StandoffController, event: object, outputs: Iterable[object], mission_time_s: float
    ) -> tuple[FleetEvent, ...]:
        """Return the fleet's events of one step: ``event`` went in, ``outputs`` came out.

        mission_time_s: now, on the fleet's clock; it is needed where the vehicle's own stands still.
        """
        found: list[FleetEvent] = [SightingReported(self._name, outcome.sighting) for outcome in controller.sighted]
        news = isinstance(event, _PLAN_NEWS)
        for output in outputs:
            if isinstance(output, Yield | End):
                found.append(VehicleLost(self._name, mission_time_s, output.reason))
            news = news or isinstance(output, _PLAN_NEWS)
        if isinstance(event, LinkReported) and not event.connected:
            found.append(VehicleLost(self._name, mission_time_s, "its link is lost"))
        if news or controller.time_s >= self._next_s:
            self._next_s = controller.time_s + _EVERY_S
            report = self._report(controller)
            found += [] if report is None else [report]
        return tuple(found)

    def _report(self, controller: StandoffController) -> VehicleReported | None:
        now = controller.snapshot()
        height_m = controller.flown_height_m
        if now.aircraft is None or height_m is None:
            return None
        return VehicleReported(
            self._name,
            now.time_s,
            now.aircraft,
            height_m,
            now.phase is Phase.WATCHING and now.sensor_status.connected,
            now.present,
            now.coming,
            now.latency_s,
            now.wind,
            "" if now.phase is Phase.WATCHING else f"the mission is {now.phase}",
        )

"""Carries out the control step's commands on the vehicle, and reports what became of them as events."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine
from typing import Any

from app.autopilots.autopilot import Autopilot
from app.autopilots.queries import mode_of
from app.delivery.guidance import PlanBackend, SwapError
from app.link.link import LinkError
from app.link.message import Message
from app.link.vehicle import Vehicle
from mission.core.events import ActivatePlan, End, Event, PlanStatus, UploadPlan, Yield, YieldRequested

_FINISH_S, _CUT_OFF_S = 10.0, 5.0


class CommandExecutor:
    """One vehicle's hands. After ``Yield`` or ``End`` nothing more is sent, but for the way home that ``End`` orders.

    report takes the events; now_s is the vehicle's clock.
    """

    def __init__(
        self,
        vehicle: Vehicle,
        autopilot: Autopilot,
        guidance: PlanBackend,
        report: Callable[[Event], None],
        now_s: Callable[[], float],
    ) -> None:
        self._vehicle, self._autopilot, self._guidance = vehicle, autopilot, guidance
        self._report, self._now_s = report, now_s
        self._silent = False
        self._tasks: set[asyncio.Task[None]] = set()
        vehicle.listeners.append(self._heard)

    def perform(self, command: UploadPlan | ActivatePlan | Yield | End) -> None:
        """Start carrying out a command; its outcome comes as an event."""
        if self._silent:
            return
        if isinstance(command, UploadPlan):
            self._start(self._swap(command.number, "ready", self._guidance.prepare(command)))
        elif isinstance(command, ActivatePlan):
            self._start(self._swap(command.number, "departed", self._guidance.depart(command.number)))
        else:
            self._silent = True
            self._guidance.stop()
            for task in self._tasks:
                task.cancel()
            if isinstance(command, End) and command.action == "return":
                self._start(self._return_home())

    async def drain(self) -> None:
        """Leave off: let what was started end soon, or cut it off, and guide no more."""
        self._vehicle.listeners.remove(self._heard)
        for bound_s in (_FINISH_S, _CUT_OFF_S):
            # An upload is tried again as long as the vehicle's clock allows; without a link that stands still.
            if self._tasks:
                await asyncio.wait(self._tasks, timeout=bound_s)
            for task in self._tasks:
                task.cancel()
        self._guidance.stop()

    def _start(self, work: Coroutine[Any, Any, None]) -> None:
        task = asyncio.create_task(work)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    async def _return_home(self) -> None:
        await self._autopilot.return_home(self._vehicle)

    async def _swap(self, number: int, stage: str, work: Coroutine[Any, Any, None]) -> None:
        try:
            await work
        except (SwapError, LinkError) as error:
            self._say(number, "failed", str(error))
        else:
            self._say(number, stage)

    def _say(self, number: int, stage: str, detail: str = "") -> None:
        if not self._silent:
            self._report(PlanStatus(self._now_s(), number, stage, detail))  # type: ignore[arg-type]  # a literal

    def _heard(self, message: Message) -> None:
        if self._silent:
            return
        reason = self._guidance.foreign(message)
        if message.name == "CURRENT_MODE" and mode_of(self._vehicle) != self._guidance.mode:
            reason = f"the flight mode was changed to {mode_of(self._vehicle)}"
        if reason is not None:
            self._report(YieldRequested(self._now_s(), reason))

"""Carries out the control step's commands on the vehicle, and reports what became of them as events."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from dataclasses import replace

from app.autopilot import Autopilot, Home, same_items
from app.link import LinkError, RawItem, UploadResult
from app.slots import Slots
from app.vehicle import Vehicle
from estimators.frames import LocalPlane
from mission.events import Depart, End, Event, Prepare, SwapReported, Yield
from mission.items import UnflyableError, plan_items
from mission.plan import Plan
from mission.requirement import Wind
from mission.wind import STILL_AIR

_UPLOAD_S, _DOWNLOAD_S = 8.0, 5.0


class Performer:
    """One vehicle's hands. After ``Yield`` or ``End`` nothing more is sent.

    report takes the events; now_s is the vehicle's clock; tolerance_m is how far the flown line may leave the plan.
    """

    def __init__(
        self,
        vehicle: Vehicle,
        autopilot: Autopilot,
        plane: LocalPlane,
        home: Home,
        *,
        airspeed_m_s: float,
        height_m: float,
        tolerance_m: float,
        report: Callable[[Event], None],
        now_s: Callable[[], float],
    ) -> None:
        self._vehicle, self._autopilot, self._plane, self._home = vehicle, autopilot, plane, home
        self._airspeed_m_s, self._height_m, self._tolerance_m = airspeed_m_s, height_m, tolerance_m
        self._report, self._now_s = report, now_s
        self._slots: Slots | None = None
        self._next: tuple[int, Slots] | None = None
        self._silent = False
        self._tasks: set[asyncio.Task[None]] = set()

    # -- the first mission ---------------------------------------------------------------------------------

    async def load(self, line: tuple[RawItem, ...], lead_in: tuple[RawItem, ...] = ()) -> UploadResult:
        """Upload the first mission: ``lead_in`` (a take-off), then ``line``, which ends in a circle."""
        head = self._autopilot.head(self._home)
        first = len(head) + len(lead_in)
        slots = Slots((*head, *lead_in, *line), len(head), first, first + len(line))
        result = await self._upload(slots, current=len(head))
        if result is UploadResult.ACCEPTED:
            self._slots = slots
        return result

    @property
    def line_first(self) -> int:
        """Index of the first item of the line that is flown."""
        assert self._slots is not None
        return self._slots.first

    def line(self, plan: Plan, wind: Wind = STILL_AIR) -> tuple[RawItem, ...]:
        """Return the items of a plan as the autopilot stores them. Raises UnflyableError."""
        tracking = self._autopilot.tracking(self._airspeed_m_s, wind)
        items = plan_items(plan, self._plane, self._height_m, self._tolerance_m, tracking)
        return tuple(self._autopilot.raw(item) for item in items)

    # -- commands of the step ------------------------------------------------------------------------------

    def perform(self, command: Prepare | Depart | Yield | End) -> None:
        """Start carrying out a command; its outcome comes as an event."""
        if self._silent:
            return
        if isinstance(command, Yield):
            self._silent = True
        elif isinstance(command, End):
            self._silent = True
            if command.action == "return":
                self._start(self._return_home())
        elif isinstance(command, Prepare):
            self._start(self._prepare(command))
        else:
            self._start(self._depart(command.number))

    async def drain(self) -> None:
        """Wait until what was started has ended."""
        if self._tasks:
            await asyncio.wait(self._tasks)

    def _start(self, work: object) -> None:
        task = asyncio.ensure_future(work)  # type: ignore[call-overload]  # always one of our coroutines
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    async def _return_home(self) -> None:
        await self._autopilot.return_home(self._vehicle)

    async def _prepare(self, command: Prepare) -> None:
        assert self._slots is not None
        try:
            # Laying out waypoints simulates how they are flown: some tens of milliseconds, beside the loop.
            plan = replace(command.plan, circle=command.commanded)
            line = await asyncio.to_thread(self.line, plan, command.wind)
            slots = self._slots.with_line(line)
            result = await self._upload(slots, current=self._flown_index())
        except (LinkError, UnflyableError) as error:
            self._say(command.number, "failed", str(error))
            return
        if result is UploadResult.ACCEPTED:
            self._next = (command.number, slots)
            self._say(command.number, "ready")
        else:
            self._say(command.number, "failed", f"upload {result}")

    async def _depart(self, number: int) -> None:
        if self._next is None or self._next[0] != number:
            self._say(number, "failed", "it is not on board")
            return
        slots = self._next[1]
        try:
            departed = await self._autopilot.select(self._vehicle, slots.first)
        except LinkError as error:
            self._say(number, "failed", str(error))
            return
        if departed:
            self._slots = slots
            self._say(number, "departed")
        else:
            self._say(number, "failed", "the autopilot did not switch to it")

    def _say(self, number: int, stage: str, detail: str = "") -> None:
        if not self._silent:
            self._report(SwapReported(self._now_s(), number, stage, detail))  # type: ignore[arg-type]  # a literal

    def _flown_index(self) -> int:
        """Return the item that is flown now, so that an upload marks it as current (PX4 goes there at once)."""
        assert self._slots is not None
        said = self._vehicle.latest.get("MISSION_CURRENT")
        index = int(said.fields["seq"]) if said is not None else self._slots.first
        return min(max(index, self._slots.first), self._slots.end - 1)

    async def _upload(self, slots: Slots, current: int) -> UploadResult:
        items = slots.closed_by(self._autopilot.tail(self._home)).items
        result = await self._vehicle.link.upload(items, current, _UPLOAD_S)
        if result is not UploadResult.TIMEOUT:
            return result
        # Often only the last acknowledgement was lost: look before believing anything.
        held = await self._vehicle.link.download(_DOWNLOAD_S)
        head = len(self._autopilot.head(self._home))  # ArduPlane keeps its own home there
        if held is not None and same_items(items[head:], held[head:]):
            return UploadResult.ACCEPTED
        return UploadResult.TIMEOUT

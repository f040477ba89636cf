"""Plans as mission items: check, upload, make current at the departure, look."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from app.autopilots.autopilot import Autopilot, Home
from app.delivery.guidance import SwapError
from app.delivery.slots import MissionLayout
from app.link.link import RawItem, UploadResult
from app.link.message import Message
from app.link.telemetry import AUTOPILOT_COMPONENT
from app.link.vehicle import Vehicle
from estimators.frames import LocalPlane
from mission.core.circle import Circle
from mission.core.events import UploadPlan
from mission.core.plan import Plan
from mission.core.requirement import Wind
from mission.geometry.wind import STILL_AIR
from mission.upload.items import NAV_LOITER_UNLIM, NAV_WAYPOINT, UnflyableError, plan_items

_SETTLED_S = 2.0  # of the vehicle's time after a change of ours: by then its own words about it are up to date
_SWITCH_M = 15.0  # so far before a waypoint the next one may be flown to
_DURATION_WEIGHT = 0.5
_LATE_MAX_S = 5.0
_UPLOAD_S, _USELESS_S = 8.0, 2.0


@dataclass(frozen=True, slots=True)
class _Ready:
    """A plan that the vehicle holds beside the line it flies."""

    command: UploadPlan
    slots: MissionLayout


@dataclass(slots=True)
class _Told:
    """What the vehicle says of its mission while it is ours; anything else is somebody else's doing.

    ours are (items, checksum). After a change of ours the vehicle's words may come late, but in their order: first of
    what was before, then of an ``expected`` number of items, which is ours too, once.
    """

    ours: set[tuple[int, int]]
    expected: int = -1
    left: MissionLayout | None = None  # the line before, until an item of the present one has been told of
    settled_s: float = math.inf  # until then every word is taken for an answer to our own doing
    last: tuple[int, int] | None = None  # of ours that was told

    def is_ours(self, said: tuple[int, int], now_s: float) -> bool:
        if said not in self.ours:
            if now_s >= self.settled_s and self.ours:
                if said[0] != self.expected:
                    return False
                self.expected = -1
            self.ours.add(said)
        self.last = said
        return True


class MissionItemBackend:
    """``PlanBackend`` by uploads. ``load`` or ``adopt`` comes first.

    now_s is the vehicle's clock; tolerance_m is how far the flown line may leave the plan.
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
        now_s: Callable[[], float],
    ) -> None:
        self._vehicle, self._autopilot, self._plane, self._home = vehicle, autopilot, plane, home
        self._airspeed_m_s, self._height_m, self._tolerance_m = airspeed_m_s, height_m, tolerance_m
        self._now_s = now_s
        self._slots: MissionLayout | None = None
        self._held: tuple[RawItem | None, ...] = ()  # by the vehicle; None where a failed upload leaves doubt
        self._next: _Ready | None = None
        self._upload_took_s = 0.0
        self._told = _Told(set())
        self._stopped = False

    @property
    def mode(self) -> str:
        return self._autopilot.mission_mode

    # -- the first mission ---------------------------------------------------------------------------------

    async def load(self, line: tuple[RawItem, ...], lead_in: tuple[RawItem, ...] = ()) -> UploadResult:
        """Upload the first mission: ``lead_in`` (a take-off), then ``line``, which ends in a circle."""
        head = self._autopilot.head(self._home)
        first = len(head) + len(lead_in)
        items = (*head, *lead_in, *line)
        slots = MissionLayout(items, len(head), first, len(items), self._autopilot.min_items).filled()
        result = await self._upload(slots, current=len(head))
        if result is UploadResult.ACCEPTED:
            self._slots = slots
        return result

    async def adopt(self) -> Circle | None:
        """Take over the line that the vehicle flies in its mission mode, and return the circle it ends in.

        None when the mission cannot be read, or what is flown does not end in a circle that needs no one.
        """
        current = await self._vehicle.heard("MISSION_CURRENT", 2.0)
        held = await self._autopilot.stored(self._vehicle)
        if current is None or held is None:
            return None
        first = int(current.fields["seq"])
        last = next((i for i in range(first, len(held)) if held[i].command != NAV_WAYPOINT), None)
        if last is None or held[last].command != NAV_LOITER_UNLIM:
            return None
        head = len(self._autopilot.head(self._home))
        kept = max(last + 1, self._autopilot.min_items)
        self._slots = MissionLayout(held[:kept], head, max(first, head), last + 1, self._autopilot.min_items).filled()
        self._held = held
        self._told.settled_s = self._now_s() + _SETTLED_S
        item = held[last]
        east_m, north_m = self._plane.east_north_m(item.x * 1e-7, item.y * 1e-7)
        return Circle(east_m, north_m, abs(item.param3), item.param3 > 0.0) if item.param3 else None

    async def select(self) -> bool:
        """Fly the line that was loaded."""
        assert self._slots is not None
        return await self._autopilot.select(self._vehicle, self._slots.first, self._slots.line())

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

    # -- swapping ------------------------------------------------------------------------------------------

    async def prepare(self, command: UploadPlan) -> None:
        """Upload the plan beside the line that is flown; again, while there is time, when an upload times out."""
        assert self._slots is not None
        try:
            # Laying out waypoints simulates how they are flown: some tens of milliseconds, beside the loop.
            plan = replace(command.plan, circle=command.commanded)
            line = await asyncio.to_thread(self.line, plan, command.wind)
        except UnflyableError as error:
            raise SwapError(str(error)) from error
        self._settle()
        slots = self._slots.with_line(line)
        departure_s = command.plan.departure_s
        # Long after its departure the plan is of no use, and a better one waits until this upload has ended.
        bound_s = min(_UPLOAD_S, max(departure_s - self._now_s(), 0.0) + _USELESS_S)
        result = await self._upload(slots, self._flown_index(), bound_s)
        while result is UploadResult.TIMEOUT and self._now_s() + self._upload_took_s < departure_s:
            result = await self._upload(slots, self._flown_index(), bound_s)
        if result is not UploadResult.ACCEPTED:
            raise SwapError(f"upload {result}")
        self._next = _Ready(command, slots)

    async def depart(self, number: int) -> None:
        ready = self._next
        if ready is None or ready.command.number != number:
            raise SwapError("it is not on board")
        slots = ready.slots
        passed = self._passed(ready)
        if not await self._autopilot.select(self._vehicle, slots.first + passed, slots.line()[passed:]):
            raise SwapError("the autopilot did not switch to it")
        self._slots, self._told.left = slots, self._slots

    def _settle(self) -> None:
        """Find out what is left of the line that is flown, be it that of an unconfirmed departure.

        An upload must leave that alone; the rest is free.
        """
        assert self._slots is not None
        said = self._vehicle.latest.get("MISSION_CURRENT")
        if said is None:
            return
        index = int(said.fields["seq"])
        if self._next is not None and self._next.slots.first <= index < self._next.slots.end:
            self._slots = self._next.slots
        self._slots = self._slots.since(index)

    def _passed(self, ready: _Ready) -> int:
        """Return how many waypoints of the line lie behind, the departure being late: never turn back."""
        path, slots = ready.command.plan.transition, ready.slots
        late_s = self._now_s() - ready.command.plan.departure_s
        if path is None or not 0.0 < late_s < _LATE_MAX_S:
            return 0
        flown_m = late_s * self._airspeed_m_s + _SWITCH_M
        passed = 0
        for item in slots.items[slots.first : slots.end - 1]:
            east_m, north_m = self._plane.east_north_m(item.x * 1e-7, item.y * 1e-7)
            nearest = int(np.argmin(np.hypot(path.east_m - east_m, path.north_m - north_m)))
            if path.arc_m[nearest] > flown_m:
                break
            passed += 1
        return passed

    def stop(self) -> None:
        self._stopped = True

    def foreign(self, message: Message) -> str | None:
        """Notice another station's mission: other contents, or an item made current that is none of our lines'."""
        if message.name != "MISSION_CURRENT" or message.component_id != AUTOPILOT_COMPONENT or self._slots is None:
            return None
        told, index = self._told, int(message.fields["seq"])
        said = (int(message.fields.get("total") or 0), int(message.fields.get("mission_id") or 0))
        if not told.is_ours(said, self._now_s()):
            return "another station has changed the mission"
        if self._slots.first <= index < self._slots.end:
            told.left = None
        lines = (self._slots, told.left, self._next.slots if self._next is not None else None)
        known = any(line is not None and line.first <= index < line.end for line in lines)
        if known or self._now_s() < told.settled_s:
            return None
        return f"another station has chosen item {index} of the mission"

    def _flown_index(self) -> int:
        """Return the item to mark as current in an upload: PX4 goes there at once when the last item has come.

        That is the item flown then, so a waypoint which is passed meanwhile does not count any more.
        """
        assert self._slots is not None
        said = self._vehicle.latest.get("MISSION_CURRENT")
        index = int(said.fields["seq"]) if said is not None else self._slots.first
        index = min(max(index, self._slots.first), self._slots.end - 1)
        position = self._vehicle.latest.get("GLOBAL_POSITION_INT")
        if position is None or index == self._slots.end - 1:
            return index
        fields, item = position.fields, self._slots.items[index]
        east_m, north_m = self._plane.east_north_m(fields["lat"] * 1e-7, fields["lon"] * 1e-7)
        goal_east_m, goal_north_m = self._plane.east_north_m(item.x * 1e-7, item.y * 1e-7)
        speed_m_s = math.hypot(fields["vx"], fields["vy"]) * 1e-2
        reach_m = _SWITCH_M + speed_m_s * self._upload_took_s
        return index + (math.hypot(goal_east_m - east_m, goal_north_m - north_m) < reach_m)

    async def _upload(self, slots: MissionLayout, current: int, timeout_s: float = _UPLOAD_S) -> UploadResult:
        if self._stopped:
            return UploadResult.DENIED
        items = slots.closed_by(self._autopilot.tail(self._home)).items
        told = self._told
        before = set() if told.last is None else {told.last}
        self._told = _Told(before, len(items) - slots.head, told.left, last=told.last)
        begin_s = self._now_s()
        result = await self._autopilot.store(self._vehicle, self._held, items, current, timeout_s)
        if result is UploadResult.ACCEPTED:
            self._held = items
            self._upload_took_s += _DURATION_WEIGHT * (self._now_s() - begin_s - self._upload_took_s)
        elif len(items) == len(self._held):
            self._held = tuple(b if a == b else None for a, b in zip(items, self._held, strict=True))
        else:
            self._held = ()
        # After a failure the vehicle may hold a part of it: that is ours as well.
        self._told.settled_s = self._now_s() + _SETTLED_S
        return result

"""What differs between autopilots, as one Protocol; the modules beside this one fill it in.

The rest of the program does not know which one it flies.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

from app.autopilots.parameters import RequiredParameter
from app.link.link import RawItem, UploadResult
from app.link.message import Message
from app.link.vehicle import Answer, Vehicle
from mission.core.requirement import Wind
from mission.upload.items import Item
from mission.upload.line_tracking import LineTracking

_COMPARED_METRES_AS_DEGREES_E7 = 3  # stored coordinates may lose the last digit on the way
_COMPARED_PARAM = 0.6  # ArduPlane keeps whole metres of radius


@dataclass(frozen=True, slots=True)
class Home:
    """Where heights count from."""

    latitude_deg: float
    longitude_deg: float
    altitude_m: float


@dataclass(frozen=True, slots=True)
class CircleOrder:
    """A circle on the globe: centre in 1e-7 degrees, a negative radius is flown counter-clockwise.

    height_m is above home, altitude_m above the sea.
    """

    x: int
    y: int
    height_m: float
    altitude_m: float
    signed_radius_m: float


@dataclass(frozen=True, slots=True)
class Limits:
    """What the autopilot's parameters allow; None where it has no such parameter."""

    bank_max_deg: float | None
    airspeed_min_m_s: float | None
    airspeed_max_m_s: float | None
    airspeed_cruise_m_s: float | None


@dataclass(frozen=True, slots=True)
class ParameterNote:
    """A parameter that matters here, its value, and what it means for the mission ('' when all is well)."""

    name: str
    value: float | None
    note: str = ""


class Autopilot(Protocol):
    """One kind of autopilot."""

    @property
    def name(self) -> str: ...

    @property
    def mission_mode(self) -> str:
        """The flight mode, by name, in which it flies a mission."""
        ...

    @property
    def relevant_parameters(self) -> Mapping[str, Mapping[float, str]]:
        """The parameters that matter for the mission, and which values deserve a word."""
        ...

    @property
    def circle_mode(self) -> str:
        """The flight mode, by name, in which it flies a circle given by one command."""
        ...

    def required_parameters(self, values: Mapping[str, float], airspeed_m_s: float) -> tuple[RequiredParameter, ...]:
        """Return those of ``relevant_parameters`` that have to be set for a mission at an airspeed."""
        ...

    def head(self, home: Home) -> tuple[RawItem, ...]:
        """Return the items that stand in front of every mission."""
        ...

    def tail(self, home: Home) -> tuple[RawItem, ...]:
        """Return the items that close every mission without ever being reached."""
        ...

    @property
    def min_items(self) -> int:
        """How long its mission is kept at least, see ``MissionLayout``."""
        ...

    def tracking(self, airspeed_m_s: float, wind: Wind) -> LineTracking:
        """Return how it flies along waypoints, for laying them out."""
        ...

    def raw(self, item: Item) -> RawItem:
        """Return the item as this autopilot stores it."""
        ...

    async def store(
        self,
        vehicle: Vehicle,
        held: Sequence[RawItem | None],
        items: Sequence[RawItem],
        current: int,
        timeout_s: float,
    ) -> UploadResult:
        """Make the vehicle hold ``items``; it holds ``held`` (None: not known), and flies on the while.

        current: the item flown; timeout_s: of the clock here. ACCEPTED only where the vehicle does hold them; after
        DENIED and TIMEOUT it may hold any mixture of both.
        """
        ...

    async def stored(self, vehicle: Vehicle) -> tuple[RawItem, ...] | None:
        """Return the mission that the vehicle holds, or None when it does not arrive in time."""
        ...

    async def arm(self, vehicle: Vehicle) -> Answer: ...

    async def disarm(self, vehicle: Vehicle) -> Answer: ...

    async def start_mission(self, vehicle: Vehicle) -> Answer: ...

    async def select(self, vehicle: Vehicle, first: int, line: Sequence[RawItem]) -> bool:
        """Fly the items of ``line``, from the mission's ``first`` on; True when the vehicle says so."""
        ...

    async def fly_circle(self, vehicle: Vehicle, order: CircleOrder, take_over: bool) -> Answer:
        """Fly a circle from now on, without a mission. take_over: from another mode too, where that can be told."""
        ...

    def told_circle(self, message: Message) -> CircleOrder | None:
        """Return the circle that a message says is flown in ``circle_mode``; radius 0: not told."""
        ...

    async def return_home(self, vehicle: Vehicle) -> Answer: ...

    def limits(self, values: Mapping[str, float]) -> Limits:
        """Return what the values of the parameters in ``relevant_parameters`` allow."""
        ...


def parameter_notes(autopilot: Autopilot, values: Mapping[str, float]) -> tuple[ParameterNote, ...]:
    """Return the parameters that matter, with what their values mean."""
    return tuple(
        ParameterNote(name, values.get(name), relevant_parameters.get(values.get(name, math.nan), ""))
        for name, relevant_parameters in autopilot.relevant_parameters.items()
    )


def raw_item(item: Item) -> RawItem:
    """Return the item in MISSION_ITEM_INT's units, without any autopilot's habits."""
    return RawItem(
        command=item.command,
        frame=item.frame,
        param1=item.param1,
        param2=item.param2,
        param3=item.param3,
        param4=item.param4,
        x=round(item.latitude_deg * 1e7),
        y=round(item.longitude_deg * 1e7),
        z=item.height_m,
        autocontinue=int(item.autocontinue),
    )


def at_place(x: int, y: int, item: RawItem) -> bool:
    """Tell whether 1e-7 degrees are an item's place."""
    return max(abs(x - item.x), abs(y - item.y)) <= _COMPARED_METRES_AS_DEGREES_E7


def same_items(sent: Sequence[RawItem], held: Sequence[RawItem]) -> bool:
    """Tell whether the vehicle holds what was sent, up to its own rounding."""
    return len(sent) == len(held) and all(map(same_item, sent, held))


def same_item(a: RawItem, b: RawItem) -> bool:
    """Tell whether the items are the same up to the vehicle's rounding."""
    return (
        a.command == b.command
        and at_place(a.x, a.y, b)
        and abs(a.z - b.z) <= _COMPARED_PARAM
        and all(
            math.isnan(x) or math.isnan(y) or abs(x - y) <= _COMPARED_PARAM
            for x, y in ((a.param1, b.param1), (a.param3, b.param3))
        )
    )


async def select_by_message(
    vehicle: Vehicle, first: int, end: int, proves: Callable[[Message], bool] = lambda _message: False
) -> bool:
    """Send MISSION_SET_CURRENT until MISSION_CURRENT, or what else ``proves`` it, is in [first, end)."""

    def tells(message: Message) -> bool:
        return proves(message) or (message.name == "MISSION_CURRENT" and first <= message.fields["seq"] < end)

    for _ in range(5):
        await vehicle.tell("MISSION_SET_CURRENT", {"seq": first})
        if await vehicle.wait_for(tells, 0.4) is not None:
            return True
    return False

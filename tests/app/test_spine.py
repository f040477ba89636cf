"""One range on its way through the program: from a DISTANCE_SENSOR frame to a mission item of the uploaded plan.

The path is measured in a flight in the closed-loop simulation against the vehicle of sitl, frames included. Counted
are

- the project functions on the call stack whenever a form of the datum (``FORMS``) is made: they have carried the form
  before it there
- the functions that return one of these very objects: they hand it on by their result
- the functions of the filter that take the sighting as an argument, because an update makes no form

A function that computes something on the way and hands nothing on is not counted, nor are readers next to the path,
such as displays and health checks. ``app/simulation`` stands for what a live flight does in its place (``app/link``
and ``app/flight/loop``); tests, sitl and the inside of compiled kernels are left out.

The values are upper bounds for one aircraft. They may fall; a change that raises them needs a reason.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from operator import is_
from pathlib import Path
from types import CodeType, FrameType
from typing import Any

import pytest

from sidelong.app.assembly import mission_controller_of, prepared
from sidelong.app.autopilots.registry import AUTOPILOTS
from sidelong.app.config import Config
from sidelong.app.simulation.loop import ClosedLoop
from sidelong.mission.core.events import ControlAcquired
from sidelong.mission.exchange.dialect import Home
from sidelong.mission.exchange.outbox import SendMessage
from sidelong.sitl.settings import Flavour, Settings
from sidelong.sitl.simulation import Simulation
from tests.sitl_vehicle import SitlVehicle

ROOT = Path(__file__).resolve().parents[2]
FORMS = (
    "Message",
    "RangeReading",
    "Sighting",
    "TargetEstimate",
    "Scene",
    "Plan",
    "Decision",
    "UploadPlan",
    "Path",
    "MissionItem",
    "MissionLayout",
    "SendMessage",
)
"""In the order of the path. With the frame at both of its ends they are 13."""

MOST = {Flavour.ARDUPLANE: (19, 53), Flavour.PX4: (19, 53)}
"""Files and functions."""

Function = tuple[str, str]
"""File and qualified name."""


@dataclass
class Birth:
    """A form that has been made, and the functions that were carrying the one before it."""

    kind: str
    stack: tuple[Function, ...]
    made: Any  # of a named tuple, which is made of them, its arguments by name

    def is_made(self, found: object) -> bool:
        """Return whether an object is this one."""
        if isinstance(self.made, dict):
            values = list(self.made.values())[1:]
            return isinstance(found, tuple) and len(found) == len(values) and all(map(is_, found, values))
        return found is self.made


class Tracer:
    """Notes each birth of a form, and each function that returns one, while it is the profile function."""

    def __init__(self) -> None:
        self.births: list[Birth] = []
        self.returned: list[tuple[object, Function]] = []
        self.sighting_users: set[Function] = set()
        self._names: dict[CodeType, Function | None] = {}

    def __call__(self, frame: FrameType, what: str, result: object) -> None:
        code = frame.f_code
        if what == "return" and (function := self._function(code)) is not None:
            results = result if type(result) is tuple else (result,)
            self.returned += [(one, function) for one in results if type(one).__name__ in FORMS]
        if what != "call":
            return
        if code.co_filename == "<string>":
            made = frame.f_locals.get("self")
            kind = getattr(frame.f_locals.get("_cls"), "__name__", "") or type(made).__name__
            if kind in FORMS:
                self.births.append(Birth(kind, self._stack(frame.f_back), made or dict(frame.f_locals)))
        elif "/estimators/" in code.co_filename and (function := self._function(code)) is not None:
            arguments = (frame.f_locals.get(name) for name in code.co_varnames[: code.co_argcount])
            if any(type(value).__name__ == "Sighting" for value in arguments):
                self.sighting_users.add(function)
        elif code.co_qualname == "Packer.frame":
            self.births.append(Birth("frame", self._stack(frame), frame.f_locals["name"]))

    def _stack(self, frame: FrameType | None) -> tuple[Function, ...]:
        found = []
        while frame is not None:
            function = self._function(frame.f_code)
            if function is not None:
                found.append(function)
            frame = frame.f_back
        return tuple(reversed(found))

    def _function(self, code: CodeType) -> Function | None:
        if code not in self._names:
            path = Path(code.co_filename).resolve()
            own = path.is_relative_to(ROOT) and path.relative_to(ROOT).parts[0] in ("app", "estimators", "mission")
            name = code.co_qualname.split(".<locals>.<")[0]  # a generator expression is part of its function
            self._names[code] = (path.relative_to(ROOT).as_posix(), name) if own else None
        return self._names[code]


def traced(flavour: Flavour) -> Tracer:
    """Fly until the first item of a plan is sent, and return what was made from control acquired on."""
    config = Config()
    vehicle = SitlVehicle(Simulation(Settings(flavour, seed=1)))
    home = vehicle.simulation.vehicle.home
    where = Home(home.latitude_deg, home.longitude_deg, home.altitude_m)
    loop: ClosedLoop[bytes] = ClosedLoop(vehicle)
    outputs: list[object] = []
    loop.listeners.append(lambda _event, found: outputs.extend(found))
    autopilot = next(one for one in AUTOPILOTS if one.name.lower() == flavour)
    home_deg = where.latitude_deg, where.longitude_deg
    loop.start(
        lambda plane: mission_controller_of(
            config, prepared(config).controller(plane, home_deg), autopilot, plane, where
        )
    )
    assert loop.run(240.0, lambda: any(isinstance(one, ControlAcquired) for one in outputs))
    outputs.clear()
    tracer = Tracer()
    sys.setprofile(tracer)
    try:
        sent = loop.run(
            120.0, lambda: any(isinstance(one, SendMessage) and one.name == "MISSION_ITEM_INT" for one in outputs)
        )
    finally:
        sys.setprofile(None)
    assert sent
    return tracer


def path_of(births: list[Birth]) -> list[Birth]:
    """Return the births of one datum, first to last: each the latest of its kind before the one that follows."""
    found: list[Birth] = []
    at = max(k for k, one in enumerate(births) if one.kind == "frame" and one.made == "MISSION_ITEM_INT")
    found.append(births[at])
    for kind in reversed(FORMS):
        at = max(k for k in range(at) if births[k].kind == kind)
        found.append(births[at])
    return found[::-1]


@pytest.mark.parametrize("flavour", Flavour)
def test_path_of_a_range_to_an_uploaded_item_does_not_grow(flavour):
    tracer = traced(flavour)
    path = path_of(tracer.births)
    by_kind = {one.kind: one.made for one in path}
    # It is one datum that is followed.
    reading, sighting, estimate = by_kind["RangeReading"], by_kind["Sighting"], by_kind["TargetEstimate"]
    assert by_kind["Message"]["name"] == "DISTANCE_SENSOR"
    assert reading.slant_range_m == pytest.approx(0.01 * by_kind["Message"]["fields"]["current_distance"])
    assert sighting.slant_range_m == pytest.approx(reading.slant_range_m)
    assert estimate.last_sighting_s == sighting.time_s
    assert by_kind["UploadPlan"].plan is by_kind["Decision"].plan
    command, layout = by_kind["UploadPlan"], by_kind["MissionLayout"]
    assert abs(layout.items[layout.end - 1].param3) == pytest.approx(command.commanded.radius_m, abs=0.5)
    assert by_kind["SendMessage"].fields["x"] in {item.x for item in layout.items}

    functions = {function for one in path for function in one.stack} | tracer.sighting_users
    functions |= {function for found, function in tracer.returned if any(one.is_made(found) for one in path)}
    print(*sorted(functions), sep="\n")
    files_max, functions_max = MOST[flavour]
    assert len({file for file, _ in functions}) <= files_max
    assert len(functions) <= functions_max

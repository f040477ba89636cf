"""Read the autopilot's parameters, and change them for the duration of a mission if requested."""

from __future__ import annotations

import asyncio
import contextlib
import math
import struct
from collections.abc import AsyncIterator, Callable, Iterable, Mapping
from typing import Any

from sidelong.app.autopilots.autopilot import Autopilot, ParameterTable, Release, RequiredParameter
from sidelong.app.autopilots.registry import autopilot_by_mav_autopilot
from sidelong.app.errors import InputError
from sidelong.app.link.message import Message
from sidelong.app.link.telemetry import AUTOPILOT_COMPONENT
from sidelong.app.link.vehicle import Vehicle

_ANSWER_S = 0.8  # timeout since the last answer, after which missing parameters are requested again
_IDLE_S, _IDLE_ROUNDS = 1.6, 2  # without the answer, though the autopilot answers: the parameter is absent
_SILENT_S = 6.0  # in which the autopilot answers nothing, before it is no longer asked
_REAL32 = 9  # MAV_PARAM_TYPE


async def read_table(vehicle: Vehicle, autopilot: Autopilot, release: Release | None) -> ParameterTable:
    """Return the parameters that matter for a mission.

    A parameter that does not answer under its name in ``release`` is requested under the names of other releases too.
    """
    names = [one.name for one in autopilot.parameters if one.is_in(release)]
    read = await read_parameters(vehicle, names)
    lacking = {one.known_as for one in autopilot.parameters if one.name in names and one.name not in read}
    others = [one.name for one in autopilot.parameters if one.known_as in lacking and one.name not in names]
    if others:
        read |= await read_parameters(vehicle, others)
    return ParameterTable(autopilot.parameters, release, read)


async def read_parameters(vehicle: Vehicle, names: Iterable[str]) -> dict[str, float]:
    """Return the values of the parameters that exist. All are requested at once; missing answers are requested again.

    An autopilot does not answer a request for an unknown name. So a parameter is absent if its answer is missing in
    rounds in which the answer to a known parameter, requested after it, arrives.
    """
    wanted = list(names)
    values: dict[str, float | None] = {}
    autopilot = autopilot_by_mav_autopilot(int(vehicle.latest["HEARTBEAT"].fields["autopilot"]))
    bytewise = autopilot is not None and autopilot.packs_integers_bytewise
    with vehicle.hearing("PARAM_VALUE") as answers:
        idle_s, idle_rounds, silent_s = 0.0, 0, 0.0
        while missing := [name for name in wanted if name not in values]:
            before, answered, answer_s, witness = len(values), False, _ANSWER_S, list(values)[:1]
            for name in (*missing, *witness):
                await vehicle.transmit("PARAM_REQUEST_READ", {"param_id": name, "param_index": -1})
            with contextlib.suppress(TimeoutError):
                while len(values) < len(wanted):
                    answer_s = vehicle.answer_s(_ANSWER_S)
                    answer = await asyncio.wait_for(answers.get(), answer_s)
                    name = answer.fields["param_id"]
                    answered = answered or name in witness
                    if name in wanted:
                        values[name] = _value(answer.fields, bytewise)
            if len(values) > before:
                idle_s, idle_rounds, silent_s = 0.0, 0, 0.0
            elif answered:
                idle_s, idle_rounds = idle_s + answer_s, idle_rounds + 1
            else:
                silent_s += answer_s
            if (idle_s >= _IDLE_S and idle_rounds >= _IDLE_ROUNDS) or silent_s >= _SILENT_S:
                break
    # Some of PX4's integers are NaN in the float field; they are read one by one through MAVSDK.
    found = {name: await vehicle.link.parameter(name) if value is None else value for name, value in values.items()}
    return {name: found[name] for name in wanted if found.get(name) is not None}  # type: ignore[misc]  # none is None


def _value(fields: Mapping[str, Any], bytewise: bool) -> float | None:
    """Return a PARAM_VALUE's number: PX4 puts the bytes of an integer where the float should be."""
    value = fields["param_value"]
    if value is None or not bytewise or int(fields["param_type"]) == _REAL32:
        return value if value is None else float(value)
    return float(struct.unpack("<i", struct.pack("<f", value))[0])


class ParameterWatch:
    """Reports when another station sets a parameter that matters for the mission.

    Args:
        bytewise: whether the autopilot sends the bytes of an integer where the float belongs.
        own: what this mission has set itself, by name.
        changed: receives the values by key after each change.
    """

    def __init__(
        self,
        table: ParameterTable,
        bytewise: bool,
        own: Mapping[str, float],
        note: Callable[[str], object],
        changed: Callable[[Mapping[str, float]], object] = lambda _values: None,
    ) -> None:
        self._table, self._values = table, {**table.read, **own}
        self._bytewise, self._note, self._changed = bytewise, note, changed

    def take(self, message: Message) -> None:
        if message.name != "PARAM_VALUE" or message.component_id != AUTOPILOT_COMPONENT:
            return
        name, value = message.fields["param_id"], _value(message.fields, self._bytewise)
        before = self._values.get(name)
        if value is None or before is None or math.isclose(value, before, rel_tol=1e-4, abs_tol=1e-6):
            return
        self._values[name] = value
        self._note(f"another ground station has set {name} to {value:g}; it was {before:g}")
        self._changed(self._table.of(self._values))


@contextlib.asynccontextmanager
async def temporary_parameters(
    vehicle: Vehicle,
    required_parameters: Iterable[RequiredParameter],
    note: Callable[[str], object],
    may_restore: Callable[[], bool],
) -> AsyncIterator[None]:
    """Set what is needed, and restore it afterwards, unless another station has taken over.

    Raises InputError when a parameter is not taken.
    """
    changed: list[RequiredParameter] = []
    try:
        for need in required_parameters:
            changed.append(need)  # before the answer: an interrupt may come between
            if not await vehicle.link.set_parameter(need.name, need.value):
                changed.pop()
                raise InputError(f"the autopilot did not take {need.name} = {need.value:g}; set it by hand.")
            note(f"{need.name} = {need.value:g} for this flight (was {need.present:g}): {need.why}")
        yield
    finally:
        for need in changed:
            if may_restore() and await vehicle.link.set_parameter(need.name, need.present):
                note(f"{need.name} = {need.present:g} again")
            else:
                note(f"{need.name} is still {need.value:g}; it was {need.present:g} before")

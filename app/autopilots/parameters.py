"""The autopilot's parameters: read, judged for the mission, and changed for its time where that is asked for."""

from __future__ import annotations

import contextlib
from collections.abc import AsyncIterator, Callable, Iterable, Mapping
from dataclasses import dataclass

from app.errors import InputError
from app.link.vehicle import Vehicle


@dataclass(frozen=True, slots=True)
class RequiredParameter:
    """A parameter whose present value stands in the way, what it has to be, and why."""

    name: str
    present: float
    value: float
    why: str


async def read_parameters(vehicle: Vehicle, names: Iterable[str]) -> dict[str, float]:
    """Return the values of those the autopilot has."""
    values = {name: await vehicle.link.parameter(name) for name in names}
    return {name: value for name, value in values.items() if value is not None}


def required_airspeed(values: Mapping[str, float], name: str, airspeed_m_s: float) -> tuple[RequiredParameter, ...]:
    """Return the need for another cruise airspeed, where it differs by more than a tenth."""
    cruise_m_s = values.get(name)
    if cruise_m_s is None or abs(cruise_m_s - airspeed_m_s) <= 0.1 * airspeed_m_s:
        return ()
    why = f"it would fly {cruise_m_s:g} m/s, aircraft.airspeed_m_s is {airspeed_m_s:g}"
    return (RequiredParameter(name, cruise_m_s, airspeed_m_s, why),)


@contextlib.asynccontextmanager
async def temporary_parameters(
    vehicle: Vehicle,
    required_parameters: Iterable[RequiredParameter],
    note: Callable[[str], object],
    may_restore: Callable[[], bool],
) -> AsyncIterator[None]:
    """Set what is needed, and set it back afterwards, unless somebody else flies then.

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

"""What of the autopilot's parameters stands in a mission's way."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class RequiredParameter:
    """A parameter whose present value stands in the way, what it has to be, and why."""

    name: str
    present: float
    value: float
    why: str


def required_airspeed(values: Mapping[str, float], name: str, airspeed_m_s: float) -> tuple[RequiredParameter, ...]:
    """Return the need for another cruise airspeed, where it differs by more than a tenth."""
    cruise_m_s = values.get(name)
    if cruise_m_s is None or abs(cruise_m_s - airspeed_m_s) <= 0.1 * airspeed_m_s:
        return ()
    why = f"it would fly {cruise_m_s:g} m/s, aircraft.airspeed_m_s is {airspeed_m_s:g}"
    return (RequiredParameter(name, cruise_m_s, airspeed_m_s, why),)

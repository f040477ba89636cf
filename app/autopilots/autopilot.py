"""All that autopilots do differently, as one Protocol: their part in the exchange, their parameters and limits.

A module for each fills it in, and ``sidelong.app.autopilots.registry`` knows them all; the rest of the program does
not know which one it flies.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

from sidelong.app.autopilots.required_parameter import RequiredParameter
from sidelong.mission.exchange.dialect import AutopilotDialect


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


class Autopilot(AutopilotDialect, Protocol):
    """One kind of autopilot."""

    @property
    def mav_autopilot(self) -> int:
        """Its MAV_AUTOPILOT, by which its heartbeat tells it."""
        ...

    @property
    def relevant_parameters(self) -> Mapping[str, Mapping[float, str]]:
        """The parameters that matter for the mission, and which values deserve a word."""
        ...

    def required_parameters(self, values: Mapping[str, float], airspeed_m_s: float) -> tuple[RequiredParameter, ...]:
        """Return the parameters that stand in the way of a mission, of those in ``relevant_parameters``."""
        ...

    def limits(self, values: Mapping[str, float]) -> Limits:
        """Return what the values of the parameters in ``relevant_parameters`` allow."""
        ...


def parameter_notes(autopilot: Autopilot, values: Mapping[str, float]) -> tuple[ParameterNote, ...]:
    """Return the parameters that matter, with what their values mean."""
    return tuple(
        ParameterNote(name, values.get(name), relevant_parameters.get(values.get(name, math.nan), ""))
        for name, relevant_parameters in autopilot.relevant_parameters.items()
    )

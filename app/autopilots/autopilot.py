"""Everything in which autopilots differ, as one Protocol: the exchange, parameters, limits, modes, names in files.

Each autopilot has one module, and ``sidelong.app.autopilots.registry`` lists them. The rest of the program does not
know which one it flies.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

from sidelong.app.autopilots.parameter import Parameter, RequiredParameter
from sidelong.app.autopilots.release import Release
from sidelong.mission.exchange.dialect import AutopilotDialect


@dataclass(frozen=True, slots=True)
class Limits:
    """What the autopilot's parameters allow; None where it did not report the parameter."""

    bank_max_deg: float | None
    airspeed_min_m_s: float | None
    airspeed_max_m_s: float | None
    airspeed_cruise_m_s: float | None


@dataclass(frozen=True, slots=True)
class SupportedReleases:
    """The releases of an autopilot that can be flown.

    Attributes:
        oldest: First one.
        newest: Last series whose parameters and protocol are known.
        older_lack: What releases before ``oldest`` lack, as the end of a sentence.
    """

    oldest: Release
    newest: Release
    older_lack: str


class Autopilot(AutopilotDialect, Protocol):
    """One kind of autopilot. Parameter values are given by key, see ``Parameter``."""

    mav_autopilot: int
    """Its MAV_AUTOPILOT in a heartbeat, and its firmware type in a QGroundControl plan."""

    key: str
    """Its name in options and files."""

    releases: SupportedReleases
    """The releases that can be flown."""

    parameters: tuple[Parameter, ...]
    """The parameters that matter for the mission, one entry for each name and unit they had."""

    packs_integers_bytewise: bool
    """Whether PARAM_VALUE carries the bytes of an integer where the float belongs."""

    circles_refused: str
    """Why circles are not flown by command (``planner.guidance``), '' if they are."""

    def mode_name(self, base_mode: int, custom_mode: int) -> str:
        """Return a flight mode as the autopilot's own documentation calls it."""

    def required_parameters(self, values: Mapping[str, float], airspeed_m_s: float) -> tuple[RequiredParameter, ...]:
        """Return the parameters whose values prevent a mission, by key."""

    def limits(self, values: Mapping[str, float]) -> Limits:
        """Return what the parameters allow."""

"""The parameters of an autopilot that matter for a mission, under the name and unit that each release gives them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from enum import StrEnum

from sidelong.app.autopilots.release import Release

_OLDEST = Release(0, 0)


class Purpose(StrEnum):
    """What a parameter is read for."""

    AIRSPEED = "airspeed"
    BANK_LIMIT = "bank limit"
    CIRCLE = "loiter and waypoint radius"
    GROUND_STATION = "ground station"
    MISSION_ITEMS = "take-off and landing"
    FENCE = "fence"


@dataclass(frozen=True, slots=True)
class Parameter:
    """A parameter as some releases have it.

    Attributes:
        name: Its name in those releases.
        purpose: What it is read for.
        key: What the rest of the program calls it: its name in the newest release. Empty: ``name``.
        unit: One unit of this parameter in units of ``key``, for example 0.01 for cm/s where ``key`` is in m/s.
        since: First release that has it.
        until: First release that no longer has it, None: all later ones have it.
        notes: Values that deserve a remark.
    """

    name: str
    purpose: Purpose
    key: str = ""
    unit: float = 1.0
    since: Release = _OLDEST
    until: Release | None = None
    notes: Mapping[float, str] = field(default_factory=dict, hash=False)

    @property
    def known_as(self) -> str:
        """Its key."""
        return self.key or self.name

    def is_in(self, release: Release | None) -> bool:
        """Return whether a release has it; an unknown release may."""
        return release is None or (self.since <= release and (self.until is None or release < self.until))


@dataclass(frozen=True, slots=True)
class ParameterNote:
    """A parameter that matters here, its value, and what it means for the mission ('' when all is well)."""

    name: str
    value: float | None
    note: str = ""


@dataclass(frozen=True, slots=True)
class RequiredParameter:
    """A parameter whose present value conflicts with the mission, its required value, and the reason."""

    name: str
    present: float
    value: float
    why: str


class ParameterTable:
    """The parameters of one release, with the values that were read.

    Args:
        parameters: Those of all releases.
        release: Release on board, None: not known.
        read: Values by the autopilot's own names, in its own units; what is missing there, it did not report.
    """

    def __init__(self, parameters: Iterable[Parameter], release: Release | None, read: Mapping[str, float]) -> None:
        every = tuple(parameters)
        self.read = read
        self._found = {one.known_as: one for one in reversed(every) if one.name in read}
        expected = [one for one in every if one.is_in(release)]
        self._missing = tuple(one for one in expected if one.known_as not in self._found)
        self._listed = tuple(dict.fromkeys(self._found.get(one.known_as, one) for one in expected))

    @property
    def values(self) -> dict[str, float]:
        """The values by key, in the units of the newest release."""
        return {key: self.read[one.name] * one.unit for key, one in self._found.items()}

    @property
    def missing(self) -> tuple[str, ...]:
        """One sentence for each parameter that the autopilot does not have."""
        gone: dict[str, list[Parameter]] = {}
        for one in self._missing:
            gone.setdefault(one.known_as, []).append(one)
        return tuple(
            f"the autopilot has no parameter {' or '.join(one.name for one in ones)}: "
            f"its {ones[0].purpose} is not checked"
            for ones in gone.values()
        )

    def found_for(self, purpose: Purpose) -> str:
        """Return what is known for a purpose, as text."""
        serving = (one for one in self._listed if one.purpose is purpose)
        return "; ".join(
            f"{one.name} = {self.read[one.name]:g}" if one.name in self.read else f"{one.name} is not reported"
            for one in serving
        )

    def notes(self) -> tuple[ParameterNote, ...]:
        """Return the parameters that matter, with what their values mean."""
        return tuple(
            ParameterNote(one.name, value, "" if value is None else one.notes.get(value, ""))
            for one in self._listed
            for value in (self.read.get(one.name),)
        )

    def as_on_board(self, required: Iterable[RequiredParameter]) -> tuple[RequiredParameter, ...]:
        """Return requirements that are given by key under the release's own names and in its own units."""
        return tuple(
            RequiredParameter(own.name, self.read[own.name], one.value / own.unit, one.why)
            for one in required
            for own in (self._found[one.name],)
        )


def required_airspeed(values: Mapping[str, float], name: str, airspeed_m_s: float) -> tuple[RequiredParameter, ...]:
    """Return the need for another cruise airspeed, where it differs by more than a tenth."""
    cruise_m_s = values.get(name)
    if cruise_m_s is None or abs(cruise_m_s - airspeed_m_s) <= 0.1 * airspeed_m_s:
        return ()
    why = f"it would fly {cruise_m_s:g} m/s, aircraft.airspeed_m_s is {airspeed_m_s:g}"
    return (RequiredParameter(name, cruise_m_s, airspeed_m_s, why),)

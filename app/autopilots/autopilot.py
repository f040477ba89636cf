"""Everything in which autopilots differ, as one Protocol: the exchange, parameters, limits, modes, names in files.

Each autopilot has one module, and ``sidelong.app.autopilots.registry`` lists them. The rest of the program does not
know which one it flies.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any, Protocol

from sidelong.mission.exchange.dialect import AutopilotDialect

_STAGES = {0: "dev", 64: "alpha", 128: "beta", 192: "rc"}  # FIRMWARE_VERSION_TYPE; 255: official


@dataclass(frozen=True, slots=True, order=True)
class Release:
    """A firmware release; releases are compared without stage and commit."""

    major: int
    minor: int
    patch: int = 0
    stage: str = field(default="", compare=False)  # dev, alpha, beta or rc; "" for an official release
    commit: str = field(default="", compare=False)  # first digits of the source's commit, "" where it is not reported

    def __str__(self) -> str:
        return f"{self.major}.{self.minor}.{self.patch}" + (f"-{self.stage}" if self.stage else "")

    @property
    def series(self) -> str:
        return f"{self.major}.{self.minor}"


def release_in(fields: Mapping[str, Any]) -> Release | None:
    """Return the release that the fields of an AUTOPILOT_VERSION name, None where the autopilot leaves it at 0."""
    version = int(fields["flight_sw_version"])
    if not version >> 8:
        return None
    numbers = version >> 24, version >> 16 & 0xFF, version >> 8 & 0xFF
    return Release(*numbers, _STAGES.get(version & 0xFF, ""), _commit(fields.get("flight_custom_version") or ()))


def _commit(data: Sequence[int]) -> str:
    """Return the commit: ArduPilot sends its digits as text, PX4 as a number, its lowest byte first."""
    text = bytes(data).rstrip(b"\0")
    if all(digit in b"0123456789abcdef" for digit in text):
        return text.decode()
    return bytes(reversed(data)).hex()[:8]


_OLDEST = Release(0, 0)


class Purpose(StrEnum):
    AIRSPEED = "airspeed"
    BANK_LIMIT = "bank limit"
    CIRCLE = "loiter and waypoint radius"
    GROUND_STATION = "ground station"
    MISSION_ITEMS = "take-off and landing"
    FENCE = "fence"


@dataclass(frozen=True, slots=True)
class Parameter:
    """A parameter as some releases have it."""

    name: str  # its name in those releases
    purpose: Purpose
    key: str = ""  # what the rest of the program calls it: its name in the newest release. Empty: ``name``
    unit: float = 1.0  # in units of ``key``, for example 0.01 for cm/s where ``key`` is in m/s
    since: Release = _OLDEST  # first release that has it
    until: Release | None = None  # first release that no longer has it, None: all later ones have it
    notes: Mapping[float, str] = field(default_factory=dict, hash=False)  # values that deserve a remark

    @property
    def known_as(self) -> str:
        """The name that the values are looked up by, the same in all releases."""
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
    """The parameters of one release, with the values that were read: by its own names and in its own units."""

    def __init__(self, parameters: Iterable[Parameter], release: Release | None, read: Mapping[str, float]) -> None:
        every = tuple(parameters)
        self.read = read
        self._found = {parameter.known_as: parameter for parameter in reversed(every) if parameter.name in read}
        expected = [parameter for parameter in every if parameter.is_in(release)]
        self._missing = tuple(parameter for parameter in expected if parameter.known_as not in self._found)
        self._listed = tuple(dict.fromkeys(self._found.get(parameter.known_as, parameter) for parameter in expected))

    @property
    def values(self) -> dict[str, float]:
        """The values by key, in the units of the newest release."""
        return self.of(self.read)

    def of(self, read: Mapping[str, float]) -> dict[str, float]:
        """Return values by key that were read later, in the units of the newest release."""
        return {key: read[parameter.name] * parameter.unit for key, parameter in self._found.items()}

    @property
    def missing(self) -> tuple[str, ...]:
        """One sentence for each parameter that the autopilot does not have."""
        gone: dict[str, list[Parameter]] = {}
        for parameter in self._missing:
            gone.setdefault(parameter.known_as, []).append(parameter)
        return tuple(
            f"the autopilot has no parameter {' or '.join(parameter.name for parameter in ones)}: "
            f"its {ones[0].purpose} is not checked"
            for ones in gone.values()
        )

    def found_for(self, purpose: Purpose) -> str:
        """Return in words the parameters that were found for a purpose."""
        names = [parameter.name for parameter in self._listed if parameter.purpose is purpose]
        return "; ".join(
            f"{name} = {self.read[name]:g}" if name in self.read else f"{name} is not reported" for name in names
        )

    def notes(self) -> tuple[ParameterNote, ...]:
        """Return the parameters worth a note, with their values (None: not read) and what these mean."""
        return tuple(
            ParameterNote(parameter.name, value, "" if value is None else parameter.notes.get(value, ""))
            for parameter in self._listed
            for value in (self.read.get(parameter.name),)
        )

    def as_on_board(self, required: Iterable[RequiredParameter]) -> tuple[RequiredParameter, ...]:
        """Return requirements that are given by key under the release's own names and in its own units."""
        return tuple(
            RequiredParameter(own.name, self.read[own.name], parameter.value / own.unit, parameter.why)
            for parameter in required
            for own in (self._found[parameter.name],)
        )


def required_airspeed(values: Mapping[str, float], name: str, airspeed_m_s: float) -> tuple[RequiredParameter, ...]:
    """Return the need for another cruise airspeed, where it differs by more than a tenth."""
    cruise_m_s = values.get(name)
    if cruise_m_s is None or abs(cruise_m_s - airspeed_m_s) <= 0.1 * airspeed_m_s:
        return ()
    why = f"it would fly {cruise_m_s:g} m/s, aircraft.airspeed_m_s is {airspeed_m_s:g}"
    return (RequiredParameter(name, cruise_m_s, airspeed_m_s, why),)


@dataclass(frozen=True, slots=True)
class Limits:
    """What the autopilot's parameters allow; None where it did not report the parameter."""

    bank_max_deg: float | None
    airspeed_min_m_s: float | None
    airspeed_max_m_s: float | None
    airspeed_cruise_m_s: float | None


@dataclass(frozen=True, slots=True)
class SupportedReleases:
    """The releases of an autopilot that can be flown."""

    oldest: Release
    newest: Release  # last series whose parameters and protocol are known
    older_lack: str  # what releases before ``oldest`` lack, as the end of a sentence


class Autopilot(AutopilotDialect, Protocol):
    """One kind of autopilot. Parameter values are given by key, see ``Parameter``."""

    mav_autopilot: int  # in a heartbeat, and its firmware type in a QGroundControl plan
    key: str  # its name in options and files
    releases: SupportedReleases
    parameters: tuple[Parameter, ...]  # those that matter for the mission, one entry for each name and unit they had
    packs_integers_bytewise: bool  # whether PARAM_VALUE carries the bytes of an integer where the float belongs
    circles_refused: str  # why circles are not flown by command (``planner.guidance``), '' if they are

    def mode_name(self, base_mode: int, custom_mode: int) -> str: ...  # as the autopilot's own documentation has it
    def limits(self, values: Mapping[str, float]) -> Limits: ...
    def failsafe_cause(self, event_id: int, arguments: Sequence[int]) -> str: ...  # of an EVENT; "": it is another

    def required_parameters(self, values: Mapping[str, float], airspeed_m_s: float) -> tuple[RequiredParameter, ...]:
        """Return the parameters whose values prevent a mission, by key."""

    def renewed_failsafe(self, values: Mapping[str, float], station_id: int) -> str:
        """Return the failsafe, in words, that heartbeats of this ground station (system id) keep from acting."""

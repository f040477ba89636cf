"""The fleet file: today's configuration with several ``[[aircraft]]`` in place of one ``[aircraft]``.

Sections without a value of its own (requirement, planner, fences, ...) hold for all aircraft.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import chain, pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, Self

from pydantic import Field, model_validator

from sidelong.app.config import (
    MAX_AIRCRAFT,
    AircraftSection,
    Config,
    RequirementSection,
    RouteSection,
    Section,
    SensorsSection,
    SharingSection,
    check_flyable,
    height_outside,
    validated,
)
from sidelong.app.errors import InputError
from sidelong.app.payload.registry import MAVLINK
from sidelong.app.planners.planner_kind import PlannerKind, Predictive
from sidelong.app.planners.registry import planner_by_name
from sidelong.app.records.text_file import read_toml
from sidelong.estimators.compiled import is_cached
from sidelong.mission.core.plan import Planner
from sidelong.mission.core.requirement import Requirement, Side

if TYPE_CHECKING:
    from sidelong.mission.predictive.planner import PredictivePlanner, PredictiveSettings


class TeamPredictive(Predictive):
    """``PlannerKind`` for :class:`sidelong.mission.fleet.team_planner.TeamPlanner`."""

    about = "decides every second by looking ahead, together with the rest of the fleet"

    def is_compiled(self) -> bool:
        from sidelong.mission.fleet.team_kernel import team_decide  # noqa: PLC0415  # see PlannerKind

        return super().is_compiled() and is_cached(team_decide)

    def settings(self) -> PredictiveSettings:
        from sidelong.mission.fleet.team_planner import IN_TEAM  # noqa: PLC0415  # see PlannerKind

        return IN_TEAM

    def finished(self, planner: PredictivePlanner) -> Planner:
        """Return the cooperative planner; a requirement without sides to share has the planner of one aircraft."""
        from sidelong.mission.fleet.team_planner import TeamPlanner  # noqa: PLC0415  # see PlannerKind

        has_sides = planner.requirement.sector is None and not planner.requirement.either_side
        return TeamPlanner(planner) if has_sides else planner


def planner_in_fleet(settings: Config) -> PlannerKind:
    """Return the kind of planner of an aircraft of a fleet; one that watches alone has that of a single aircraft."""
    together = settings.requirement.fleet_size > 1 and settings.planner.name == TeamPredictive.name
    return TeamPredictive() if together else planner_by_name(settings.planner.name)


MIN_LAYER_M = 30.0
"""Least difference of two aircraft's heights."""
LAYER_M = 60.0
"""Difference of heights where none are given: two aircraft are 50 m apart then wherever they fly."""
MAX_TARGETS = 4

_OWN_NAME = SharingSection.model_fields["cot_callsign"].default  # the target's name, on others' displays
_Name = Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_-]{0,31}$")]


class FleetAircraftSection(AircraftSection):
    """One aircraft: what [aircraft] has, its name, its link and what its sensors have of their own."""

    name: _Name
    """Letters, digits, - and _: its folder in the run folder is named by it."""
    url: str | None = None
    """Its MAVSDK URL; none: on the link of all, where one is given, else simulated."""
    urls: list[str] = Field(default_factory=list)
    """Several links to it, instead of url."""
    system_id: int | None = Field(None, ge=1, le=255)
    """Its MAVLink system id; needed on a link that it shares."""
    autopilot: Literal["arduplane", "px4"] | None = None
    """Which autopilot it behaves like where it is simulated; none: as [simulation] has it."""
    reserve: bool = False
    """It waits on the ground until the fleet needs it: another is lost, or must be relieved."""
    relieve_after_min: float | None = Field(None, gt=0)
    """Watching time after which another aircraft relieves it, min; none: only when its battery is low."""
    sensors: SensorsSection = SensorsSection()  # type: ignore[call-arg]  # every field has a default
    """What differs from [sensors] for its payload."""
    target: str | None = None
    """The [[target]] that it watches first, and that its payload looks at then; none: all in turn."""


class TargetSection(Section):
    name: _Name = "target"
    """Letters, digits, - and _."""
    side: Literal["left", "right"] | None = None
    """Side of its motion to watch from; none: as [requirement] has it."""
    motion: str | None = None
    """Its motion in simulation; none: as [simulation] has it."""
    route: RouteSection | None = None
    """The route that it is expected to follow; none: as [route] has it."""
    start_m: tuple[float, float] | None = None
    """Where it sets off in simulation, [east, north] of the first aircraft's home, m; none: some way off."""


@dataclass(frozen=True, slots=True)
class Member:
    """One aircraft of a fleet with a configuration as if it flew alone."""

    name: str
    config: Config
    target: str
    reserve: bool = False
    relieve_after_min: float | None = None


class FleetFile(Config):
    aircraft: list[FleetAircraftSection] = Field(min_length=1, max_length=MAX_AIRCRAFT)  # type: ignore[assignment]
    target: list[TargetSection] = Field(default=[TargetSection()], min_length=1, max_length=MAX_TARGETS)

    @model_validator(mode="before")
    @classmethod
    def _layers_given(cls, values: Any) -> Any:
        """Give the aircraft without a height of their own layers above one another."""
        aircraft = values.get("aircraft") if isinstance(values, Mapping) else None
        if not isinstance(aircraft, list) or any(
            not isinstance(one, Mapping) or "height_m" in one for one in aircraft
        ):
            return values
        lowest_m = AircraftSection.model_fields["height_m"].default
        layered = [{**one, "height_m": lowest_m + k * LAYER_M} for k, one in enumerate(aircraft)]
        return {**values, "aircraft": layered}

    @model_validator(mode="after")
    def _sections_agree(self) -> Self:
        """Check what the sections say together, in place of the check of a single aircraft's configuration."""
        for problem in chain(self._problems_of_aircraft(), self._problems_of_targets()):
            raise ValueError(problem)
        return self

    def _problems_of_aircraft(self) -> Iterator[str]:
        if self.payload.kind != MAVLINK:
            yield (
                f"payload.kind = {self.payload.kind!r}: a fleet reads its payloads by MAVLink; "
                "run one `sidelong payload` for each aircraft, and leave payload.kind out"
            )
        if problem := self.wind_problem(min(one.airspeed_m_s for one in self.aircraft)):
            yield problem
        above = {one.height_above for one in self.aircraft}
        if len(above) > 1:
            yield 'aircraft.height_above is "home" for one and "ground" for another; give all the same'
        if above == {"ground"} and self.terrain.folder is None:
            yield 'aircraft.height_above = "ground" needs elevation data; give terrain.folder, or "home" instead'
        for what, entries in (
            ("name", [one.name for one in self.aircraft]),
            ("system_id", [one.system_id for one in self.aircraft if not _own_links(one)]),
            ("url", [url for one in self.aircraft for url in _own_links(one)]),
        ):
            twice = (one for k, one in enumerate(entries) if one is not None and one in entries[:k])
            yield from (f"aircraft.{what} = {one!r} is given twice; give each aircraft its own" for one in twice)
        for one in self.aircraft:
            if self.link.connections and not _own_links(one) and one.system_id is None:
                yield f"aircraft {one.name!r} shares the link of all; give its system_id"
            if not self.link.connections and not _own_links(one) and any(map(_own_links, self.aircraft)):
                yield f"aircraft {one.name!r} has no link; give its url"
        if all(one.reserve for one in self.aircraft):
            yield "aircraft.reserve: all of them wait on the ground; let one fly"
        if len(self.aircraft) > 1 and self.sharing.beacon is not None:
            yield "sharing.beacon: a beacon is used by one aircraft, not by a fleet; leave it out"
        yield from self._problems_of_heights()

    def _problems_of_heights(self) -> Iterator[str]:
        ordered = sorted(self.aircraft, key=lambda one: one.height_m)
        for lower, upper in pairwise(ordered):
            apart_m = upper.height_m - lower.height_m
            if apart_m < MIN_LAYER_M:
                yield (
                    f"aircraft.height_m of {lower.name!r} and {upper.name!r} are {apart_m:g} m apart; "
                    f"make that {MIN_LAYER_M:g} m or more"
                )
        for one in ordered:
            if outside := height_outside(one, self.fences):
                yield f"aircraft {one.name!r}: {outside}"

    def _problems_of_targets(self) -> Iterator[str]:
        names = [one.name for one in self.target]
        if len(set(names)) < len(names):
            yield f"target.name: {names} has one twice; give each target its own"
        for one in self.aircraft:
            if one.target is not None and one.target not in names:
                yield f"aircraft {one.name!r} has target = {one.target!r}; there are {', '.join(names)}"
        flying = {self._first_target(k).name for k, one in enumerate(self.aircraft) if not one.reserve}
        for name in names:
            if name not in flying:
                yield f"target {name!r} has no aircraft that flies; give it one, or leave the target out"
        placed = [one.start_m is not None for one in self.target]
        if any(placed) and not all(placed):
            yield f"target {names[placed.index(False)]!r} has no start_m, as others have; give it one"
        asked = self.asked.values()
        if len(self.aircraft) > 1 and any(one.either_side or one.sector is not None for one in asked):
            yield (
                f"requirement.side = {self.requirement.side!r}: several aircraft share the sides of a target; "
                f"give {Side.LEFT} or {Side.RIGHT}"
            )

    @property
    def is_simulated(self) -> bool:
        """Whether no aircraft has a link."""
        return super().is_simulated and not any(map(_own_links, self.aircraft))

    @property
    def members(self) -> tuple[Member, ...]:
        """The aircraft in their order, each with its whole configuration."""
        return tuple(self._members())

    @property
    def asked(self) -> dict[str, Requirement]:
        """How each target is to be watched, by its name."""
        return {one.name: self._requirement_of(one).requirement() for one in self.target}

    @property
    def routes(self) -> dict[str, RouteSection]:
        """The route of each target, by its name; without a file and a system id: none."""
        return {one.name: one.route or self.route for one in self.target}

    def _first_target(self, number: int) -> TargetSection:
        """Return what that aircraft watches to begin with."""
        in_turn, named = self.target[number % len(self.target)], self.aircraft[number].target
        return next((one for one in self.target if one.name == named), in_turn)

    def _requirement_of(self, target: TargetSection) -> RequirementSection:
        side = target.side or self.requirement.side
        return self.requirement.model_copy(update={"side": side, "fleet_size": len(self.aircraft)})

    def _members(self) -> Iterator[Member]:
        for number, one in enumerate(self.aircraft):
            own = {"url": None, "urls": list(_own_links(one)) or list(self.link.connections)}
            kept = {name: getattr(one, name) for name in AircraftSection.model_fields}
            simulated: dict[str, Any] = {
                "autopilot": one.autopilot or self.simulation.autopilot,
                "seed": self.simulation.seed + number,
            }
            target = self._first_target(number)
            if target.motion is not None:
                simulated["target"] = target.motion
            # Each target once on others' displays, all aircraft by their names; follow modes listen to one sender.
            entries: dict[str, Any] = {"cot_own_callsign": one.name} if len(self.aircraft) > 1 else {}
            if len(self.target) > 1:
                entries["cot_callsign"] = _OWN_NAME
            if one is not next(other for other in self.aircraft if not other.reserve):
                entries |= {"follow_target": None, "nmea": None}
            yield Member(
                one.name,
                Config(
                    aircraft=AircraftSection(**kept),
                    requirement=self._requirement_of(target),
                    planner=self.planner,
                    sensors=self.sensors.model_copy(update=one.sensors.model_dump(exclude_unset=True)),
                    link=self.link.model_copy(update={**own, "system_id": one.system_id}),
                    fences=self.fences,
                    terrain=self.terrain,
                    sharing=self.sharing.model_copy(update=entries),
                    simulation=self.simulation.model_copy(update=simulated),
                ),
                target.name,
                one.reserve,
                one.relieve_after_min,
            )


def _own_links(one: FleetAircraftSection) -> tuple[str, ...]:
    return tuple(one.urls) or ((one.url,) if one.url is not None else ())


def names_a_fleet(path: Path | None) -> bool:
    """Return whether a configuration file has ``[[aircraft]]``. Raises InputError if it is not a TOML file."""
    return path is not None and isinstance(read_toml(path).get("aircraft"), list)


def load_fleet(
    path: Path | None, overrides: dict[str, dict[str, Any]] | None = None, count: int | None = None
) -> FleetFile:
    """Return the fleet of a file with ``[[aircraft]]``, or ``count`` aircraft alike of any other configuration.

    ``overrides`` by section and key go on top for all. The names of simulated autopilots may be several, separated by
    commas: they are gone through in turn. Raises InputError naming the file and the field.
    """
    values: dict[str, Any] = read_toml(path) if path is not None else {}
    name = "command line" if path is None else str(path)
    aircraft = values.get("aircraft", {})
    if not isinstance(aircraft, dict | list):
        raise InputError(f"{name}: aircraft = {aircraft!r:.80}: a table belongs there; write [aircraft].")
    if isinstance(aircraft, dict):
        base_m = aircraft.get("height_m", AircraftSection.model_fields["height_m"].default)
        if not isinstance(base_m, int | float):
            raise InputError(f"{name}: aircraft.height_m = {base_m!r:.80}: give a number of metres.")
        values["aircraft"] = aircraft = [
            {**aircraft, "name": f"aircraft-{k + 1}", "height_m": base_m + k * LAYER_M} for k in range(count or 1)
        ]
    elif count is not None and count != len(aircraft):
        raise InputError(f"{name}: it has {len(aircraft)} aircraft; leave out --fleet {count}.")
    for section, keys in (overrides or {}).items():
        given = {key: value for key, value in keys.items() if value is not None}
        if section == "aircraft":
            values[section] = aircraft = [one | given if isinstance(one, dict) else one for one in aircraft]
            continue
        autopilots = str(given.pop("autopilot", "")).split(",") if section == "simulation" else [""]
        for k, one in enumerate(aircraft if autopilots != [""] else ()):
            if isinstance(one, dict):
                one["autopilot"] = autopilots[k % len(autopilots)]
        if given and isinstance(values.setdefault(section, {}), dict):
            values[section] |= given
    fleet = validated(FleetFile, values, name)
    for member in fleet.members:
        try:
            check_flyable(member.config)
        except InputError as error:
            raise InputError(f"{name}: aircraft {member.name!r}: {error}") from error
        if member.config.aircraft.aircraft().has_pan_limit and member.config.requirement.fleet_size > 1:
            raise InputError(
                f"{name}: aircraft {member.name!r}: pan_limit_deg: a fleet plans for no pan limits; leave it out."
            )
    return fleet

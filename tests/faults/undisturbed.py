"""Flights without any fault, by the simulated vehicles of both autopilots: everything reported in them is false.

The vehicles, their targets and payloads are those of :mod:`sidelong.sitl`, with the noise, outliers and dropouts of
the laser that these have by default. Targets are drawn or recorded; winds, releases and frames of the gimbal differ.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from sidelong.app.assembly import mission_controller_of, prepared
from sidelong.app.autopilots.registry import autopilot_by_mav_autopilot
from sidelong.app.config import Config
from sidelong.app.fleet.coordination import Coordination, Participant, VehicleClockReader, coordinator_of
from sidelong.app.fleet.fleet_file import FleetFile, planner_in_fleet
from sidelong.app.simulation.loop import ClosedLoop
from sidelong.estimators.frames import LocalPlane
from sidelong.mission.core.events import Announce, ControlAcquired, HealthChanged
from sidelong.mission.core.inputs import Input, InputState
from sidelong.mission.exchange.dialect import Home
from sidelong.sitl.settings import (
    NEWEST,
    OLDEST,
    STARTS_M,
    Flavour,
    GimbalFrame,
    PayloadSettings,
    RangeMessage,
    Settings,
    TargetSettings,
    in_a_row,
)
from sidelong.sitl.settings import HomePosition as SitlHome
from sidelong.sitl.simulation import Simulation
from sidelong.sitl.world.airframe import WindVector
from sidelong.sitl.world.geodesy import HomePlane
from sidelong.sitl.world.hills import Hills
from sidelong.sitl.world.motion import MOTIONS
from sidelong.sitl.world.truth import TruthRow
from tests.sitl_vehicle import RATES_HZ, SitlVehicle

KINDS = ("flat", "flat", "hills", "flat", "flat", "hills", "fleet", "flat", "hills", "fleet")
"""What is flown, in turn."""
_TRACKS = sorted((Path(__file__).parents[2] / "app" / "study" / "tracks").glob("*.csv"))
_WIND_MAX_M_S, _ON_CIRCLE_WITHIN_S = 6.0, 300.0
_SILENT_AFTER_S = {Input.LASER: 20.0, Input.GIMBAL: 5.0}
_SYSTEM_TIME, _SET_ROI_LOCATION = 2, 195
_JUDGED = ("sensor", "position")  # what the plausibility checks announce
_OTHER = "another object"
_ESTIMATE = "delays of the payload"  # it names no fault


@dataclass(slots=True)
class Flown:
    """What was reported in one flight, and what of it the truth supports: the target was hidden by a hill."""

    number: int
    kind: str
    watched_s: float = 0.0
    false: list[str] = field(default_factory=list)
    supported: list[str] = field(default_factory=list)


class _NoJournal:
    def write(self, _record: object) -> None:
        """Drop a record."""


class Craft(ClosedLoop[bytes]):
    """One simulated aircraft, and what sidelong reports of it."""

    def __init__(self, name: str, config: Config, settings: Settings, plane: LocalPlane | None, flown: Flown) -> None:
        self.simulation = Simulation(settings)
        vehicle = SitlVehicle(self.simulation, {**RATES_HZ, _SYSTEM_TIME: 1.0})
        super().__init__(vehicle)
        self.name, self._config, self._flown = name, config, flown
        self.waiting: deque[object] = deque()
        self.has_control = self.begun = False
        self.begins_s = 0.0
        self._hidden: set[Input] = set()  # whose silence was reported, and is true
        self._seen_s = {Input.LASER: -math.inf, Input.GIMBAL: -math.inf}
        self._unseen_until_s = dict(self._seen_s)  # of the last silence that is long enough to be reported
        self.simulation.on_truth = self._truth
        self.listeners.append(self._note)
        self.connect()
        if plane is not None:
            self.telemetry.plane = plane
        autopilot, home = self.simulation.vehicle, self.simulation.vehicle.home
        self._dialect = autopilot_by_mav_autopilot(autopilot.autopilot_id)
        self._home = Home(home.latitude_deg, home.longitude_deg, home.altitude_m)

    def ready(self, *, in_fleet: bool) -> None:
        """Make the core."""
        config, plane = self._config, self.telemetry.plane
        home_deg = self._home.latitude_deg, self._home.longitude_deg
        kind = planner_in_fleet(config) if in_fleet else None
        controller = prepared(config, kind=kind).controller(plane, home_deg)
        self.core = mission_controller_of(config, controller, self._dialect, plane, self._home)

    def turn_payload(self) -> None:
        """Point the gimbal at the target that the fleet asks for, as a live flight does."""
        controller, plane = self.core.controller, self.telemetry.plane
        if not controller.planning.turn_payload or controller.estimate is None:
            return
        target = controller.estimate
        x, y = (round(1e7 * degrees) for degrees in plane.latitude_longitude_deg(target.east_m, target.north_m))
        fields = {"command": _SET_ROI_LOCATION, "frame": 0, "x": x, "y": y, "z": 0.0}
        self.simulated.receive(self._packer.frame("COMMAND_INT", fields, self.simulated.system_id))

    def _truth(self, row: TruthRow) -> None:
        now_s = self.simulation.time_s
        for source, is_seen in ((Input.LASER, row.laser_valid), (Input.GIMBAL, row.in_sight)):
            if is_seen:
                if now_s - self._seen_s[source] >= _SILENT_AFTER_S[source]:
                    self._unseen_until_s[source] = now_s
                self._seen_s[source] = now_s

    def _note(self, _event: object, outputs: tuple[object, ...]) -> None:
        now_s = self.simulation.time_s
        for output in outputs:
            self.has_control |= isinstance(output, ControlAcquired)
            if isinstance(output, HealthChanged):
                limit_s = _SILENT_AFTER_S.get(output.input, math.inf)
                silent = now_s - self._seen_s.get(output.input, now_s) >= limit_s
                silent |= now_s - self._unseen_until_s.get(output.input, -math.inf) < 1.0  # just seen again
                if silent and output.state is InputState.STALE:
                    self._hidden.add(output.input)
                true = output.input in self._hidden and output.state in (InputState.STALE, InputState.OK)
                if output.state is InputState.OK:
                    self._hidden.discard(output.input)
                kept = self._flown.supported if true else self._flown.false
            elif isinstance(output, Announce) and (
                (output.kind in _JUDGED and not output.text.startswith(_ESTIMATE)) or _OTHER in output.text
            ):
                kept = self._flown.false
            else:
                continue
            kept.append(f"{self.name} at {now_s:.1f} s: {output.text}")


def fly(number: int, duration_s: float, hills: Path, hills_home_deg: tuple[float, float]) -> Flown:
    """Fly one flight, or one of a fleet of two or three.

    Args:
        number: which; it is the seed of everything that is drawn.
        duration_s: how long the target is watched.
        hills: folder of elevation data.
        hills_home_deg: where flights over hills begin.
    """
    kind = KINDS[number % len(KINDS)]
    flown, rng = Flown(number, kind), np.random.default_rng((number, 41))
    first = _settings(number, rng)
    if kind == "fleet":
        crafts, advance = _fleet(first, flown)
    else:
        config = Config.model_validate({"requirement": {"target_speed_max_m_s": _speed_max_m_s(first)}})
        if kind == "hills":
            first, config = _over_hills(first, rng, hills, hills_home_deg)
        crafts, advance = [Craft("aircraft", config, first, None, flown)], (lambda: None)
        crafts[0].ready(in_fleet=False)
    for _ in _until(crafts, advance, _ON_CIRCLE_WITHIN_S):
        if all(one.has_control for one in crafts):
            break
    else:
        flown.false.append("the aircraft did not reach its circle")
    begun_s = crafts[0].simulation.time_s
    for _ in _until(crafts, advance, duration_s):
        pass
    flown.watched_s = crafts[0].simulation.time_s - begun_s
    ended = [one.name for one in crafts if one.core.controller.phase != "watching"]
    flown.false += [f"{name} does not watch any more" for name in ended]
    return flown


def _until(crafts: list[Craft], advance, seconds: float) -> Iterator[None]:
    end_s = crafts[0].simulation.time_s + seconds
    while crafts[0].simulation.time_s < end_s:
        for craft in crafts:
            if craft.link_s >= craft.begins_s and not craft.begun:
                craft.begun = True
                craft.take_over()
            craft.step()
            while craft.waiting:
                craft.put(craft.waiting.popleft())
            craft.turn_payload()
        advance()
        yield


def _settings(number: int, rng: np.random.Generator) -> Settings:
    flavour = tuple(Flavour)[number % 2]
    motion = str(rng.choice(list(MOTIONS))) if rng.random() < 0.7 else _TRACKS[rng.integers(len(_TRACKS))]
    wind = WindVector.blowing_from(float(rng.uniform(0.0, _WIND_MAX_M_S)), float(rng.uniform(-math.pi, math.pi)))
    payload = PayloadSettings(
        gimbal_frame=GimbalFrame(str(rng.choice([GimbalFrame.EARTH, GimbalFrame.VEHICLE]))),
        range_message=RangeMessage.DISTANCE_SENSOR,
        gimbal_yaw_bias_deg=float(rng.normal(0.0, 0.5)),
    )
    return Settings(
        flavour,
        release=(NEWEST if rng.random() < 0.5 else OLDEST)[flavour],
        seed=number,
        wind=wind,
        targets=(TargetSettings(motion),),
        payload=payload,
    )


def _speed_max_m_s(settings: Settings) -> float:
    """Return how fast the target moves at most: a faster one would be reported, truly."""
    return 3.0 if settings.targets[0].motion in MOTIONS else 6.0


def _over_hills(
    settings: Settings, rng: np.random.Generator, folder: Path, home_deg: tuple[float, float]
) -> tuple[Settings, Config]:
    latitude_deg, longitude_deg = (degrees + float(rng.uniform(-0.03, 0.03)) for degrees in home_deg)
    ground_m = Hills(folder, HomePlane(latitude_deg, longitude_deg)).home_altitude_m
    home = SitlHome(latitude_deg, longitude_deg, ground_m)
    height_m = float(rng.uniform(100.0, 160.0))
    config = {
        "aircraft": {"height_m": height_m, "height_above": "ground"},
        "terrain": {"folder": str(folder)},
        "requirement": {"target_speed_max_m_s": _speed_max_m_s(settings)},
    }
    return replace(settings, home=home, terrain=folder), Config.model_validate(config)


def _fleet(first: Settings, flown: Flown) -> tuple[list[Craft], Callable[[], None]]:
    """Return the aircraft of a fleet on one or two targets, and what lets its coordinator keep up."""
    count, targets = 2 + flown.number % 2, ("boat", "bike")[: 1 + flown.number // 2 % 2]
    described = {
        "aircraft": [{"name": f"a{number}"} for number in range(count)],
        "target": [{"name": name} for name in targets],
        "requirement": {"target_speed_max_m_s": 3.0},
    }
    file = FleetFile.model_validate(described)
    moving = tuple(
        replace(first.targets[0], speed_max_m_s=3.0, start_m=start_m, name=name)
        for name, start_m in zip(targets, STARTS_M, strict=False)
    )
    seen = [targets.index(member.target) for member in file.members]
    flavours = [first.flavour, *(one for one in Flavour if one is not first.flavour)]
    all_settings = [
        replace(one, flavour=flavours[k % 2], release=None, endurance_s=1e4, looks_at=seen[k])
        for k, one in enumerate(in_a_row(replace(first, targets=moving), count))
    ]
    crafts: list[Craft] = []
    coordination = Coordination(coordinator_of(file), _NoJournal(), lambda _name, _text: None)
    for number, (member, settings) in enumerate(zip(file.members, all_settings, strict=True)):
        plane = crafts[0].telemetry.plane if crafts else None
        craft = Craft(member.name, member.config, settings, plane, flown)
        craft.begins_s = craft.link_s + 20.0 * (count - number)  # the highest layer first
        craft.ready(in_fleet=True)
        clock = VehicleClockReader(craft.name, lambda one=craft: one.telemetry.now_s)
        coordination.add(Participant(craft.name, craft.core.controller, craft.waiting.append, clock))
        craft.listeners.append(coordination.stepped(craft.name))
        craft.vehicle.listeners.append(
            lambda message, name=craft.name: (
                coordination.message(name, message) if message.name == "SYSTEM_TIME" else None
            )
        )
        crafts.append(craft)
    return crafts, lambda: coordination.advance(crafts[0].simulation.time_s)

"""What a simulation is made of, as plain values: one record, which another program writes as JSON."""

from __future__ import annotations

import re
from dataclasses import dataclass, field, replace
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

from pydantic import BeforeValidator, ConfigDict, Field, TypeAdapter

from sidelong.sitl.world.airframe import WindVector
from sidelong.sitl.world.geodesy import HomePlane
from sidelong.sitl.world.turbulence import Level

Share = Annotated[float, Field(ge=0.0, le=1.0)]


class Flavour(StrEnum):
    ARDUPLANE = "arduplane"
    PX4 = "px4"


class RangeMessage(StrEnum):
    DISTANCE_SENSOR = "distance_sensor"
    RANGEFINDER = "rangefinder"


class GimbalFrame(StrEnum):
    EARTH = "earth"
    VEHICLE = "vehicle"
    UNNAMED = "unnamed"  # relative to the vehicle, but without the flag: mounts of ArduPlane 4.3 and 4.4


def _release_of(value: Any) -> Any:
    """Return the numbers of a text such as "4.5" or "4.5.7"; other values unchanged."""
    found = re.fullmatch(r"(\d{1,3})\.(\d{1,3})(?:\.\d{1,3})?", value) if isinstance(value, str) else None
    return (int(found[1]), int(found[2])) if found else value


Release = Annotated[tuple[int, int], BeforeValidator(_release_of)]
"""Major and minor number of an autopilot's firmware."""

NEWEST: dict[Flavour, Release] = {Flavour.ARDUPLANE: (4, 7), Flavour.PX4: (1, 18)}
OLDEST: dict[Flavour, Release] = {Flavour.ARDUPLANE: (4, 3), Flavour.PX4: (1, 13)}


@dataclass(frozen=True, slots=True)
class HomePosition:
    latitude_deg: Annotated[float, Field(gt=-89.0, lt=89.0)]
    longitude_deg: Annotated[float, Field(ge=-180.0, le=180.0)]
    altitude_m: float = 0.0


# The default home positions of the stock simulators.
DEFAULT_HOMES = {
    Flavour.ARDUPLANE: HomePosition(-35.3632621, 149.1652370, 584.09),
    Flavour.PX4: HomePosition(47.3977419, 8.5455938, 489.2),
}


@dataclass(frozen=True, slots=True)
class PayloadSettings:
    range_sigma_m: Annotated[float, Field(ge=0.0, le=100.0)] = 0.8
    outlier_fraction: Share = 0.02
    gimbal_sigma_deg: Annotated[float, Field(ge=0.0, le=45.0)] = 0.35
    gimbal_yaw_bias_deg: Annotated[float, Field(ge=-180.0, le=180.0)] = 0.4
    dropout_fraction: Share = 0.15  # of the time without range, in pieces of 0.5 to 8 s
    latency_s: Annotated[float, Field(ge=0.0, le=10.0)] = 0.05  # from the measurement to the sending
    range_message: RangeMessage = RangeMessage.DISTANCE_SENSOR
    gimbal_frame: GimbalFrame = GimbalFrame.EARTH
    pan_limit_deg: Annotated[float, Field(gt=0.0, le=180.0)] = 180.0  # to each side; a target beyond is not seen


@dataclass(frozen=True, slots=True)
class CameraSettings:
    """A gimbal camera in place of laser and gimbal.

    url: where its video goes, such as udp://127.0.0.1:5600; "": nowhere. trees, lookalikes: along the target's path,
    times the usual number.
    """

    url: Annotated[str, Field(pattern=r"^(udp://127\.0\.0\.1:\d{1,5})?$")] = ""
    width_px: Annotated[int, Field(ge=160, le=1280)] = 640
    height_px: Annotated[int, Field(ge=90, le=720)] = 360
    rate_hz: Annotated[float, Field(gt=0.0, le=60.0)] = 15.0
    view_deg: Annotated[float, Field(gt=1.0, lt=120.0)] = 12.0  # horizontal
    rate_deg_s: Annotated[float, Field(gt=0.0)] = 60.0  # of the gimbal, like lag_s
    lag_s: Annotated[float, Field(gt=0.0)] = 0.1
    pan_limit_deg: Annotated[float, Field(gt=0.0, le=180.0)] = 180.0
    trees: Annotated[float, Field(ge=0.0)] = 1.0
    lookalikes: Annotated[float, Field(ge=0.0)] = 1.0


@dataclass(frozen=True, slots=True)
class LinkFaults:
    """Faults of a link, in each direction."""

    loss: Annotated[float, Field(ge=0.0, le=1.0)] = 0.0  # fraction
    duplicate: Annotated[float, Field(ge=0.0, le=1.0)] = 0.0  # fraction of the datagrams that are not lost
    delay_s: Annotated[float, Field(ge=0.0, le=60.0)] = 0.0  # of the stations' clock
    jitter_s: float = 0.0  # maximum additional delay, drawn for each datagram: datagrams overtake each other
    # Of a serial line: what it cannot carry is late, then lost.
    baud: Annotated[float, Field(ge=1200.0)] = float("inf")


@dataclass(frozen=True, slots=True)
class Quirks:
    """Deviations of a device from its manual, and its transmission errors."""

    range_unit_m: Annotated[float, Field(gt=0.0)] | None = None  # of one count; None: as in the manual
    yaw_mirrored: bool = False
    streams: bool = True  # after a streaming request
    reach_m: float = 1200.0  # of the laser
    steered: bool = False  # it turns as commanded; else an operator keeps it on the target
    silent_beyond: bool = True  # nothing is sent beyond its reach, instead of the value for no echo
    damaged: Share = 0.0  # of its frames, which arrive with a changed byte


MAX_VEHICLES = 8
DEFAULT_STATIONS = ("127.0.0.1:14540", "127.0.0.1:14550")
_APART_M = 200.0  # more than the circles that are flown at home are wide
# Default start positions of several targets: each within laser range of vehicles in a row.
STARTS_M = ((250.0, 300.0), (650.0, -300.0), (850.0, 300.0), (250.0, -300.0))


@dataclass(frozen=True, slots=True)
class TargetSettings:
    """One target; its name is used in the truth."""

    motion: str = "walk"  # a name of sidelong.sitl.world.motion.MOTIONS, or a track file
    speed_max_m_s: Annotated[float, Field(ge=0.0, le=50.0)] | None = None  # None: 3, for tracks 6
    start_m: tuple[float, float] = STARTS_M[0]  # east and north of the first vehicle's home
    skip_s: Annotated[float, Field(ge=0.0)] | None = None  # where a track begins; None: where it becomes lively
    name: Annotated[str, Field(pattern=r"^([A-Za-z0-9][A-Za-z0-9_-]{0,31})?$")] = ""


@dataclass(frozen=True, slots=True)
class Settings:
    """Settings of one vehicle, with its payload and its targets.

    device: protocol of a payload with a port of its own, and that port, KIND@HOST:PORT; "": it sends MAVLink.
    """

    flavour: Flavour = Flavour.ARDUPLANE
    release: Release | None = None  # of its firmware; None: the newest
    system_id: Annotated[int, Field(ge=1, le=250)] = 1
    seed: Annotated[int, Field(ge=0)] = 0
    target_seed: int | None = None  # of the targets alone, where there are several vehicles; None: seed
    airspeed_m_s: Annotated[float, Field(ge=5.0, le=60.0)] = 15.0  # equivalent airspeed, as in its parameter
    endurance_s: Annotated[float, Field(gt=0.0)] = 3.0 * 3600.0  # of its battery
    wind: WindVector = field(default_factory=WindVector)
    turbulence: Level = Level.NONE
    home: HomePosition | None = None
    home_on_ground: bool = False  # home's altitude is that of the elevation data, where there is some
    home_east_m: float = 0.0  # of the first vehicle's
    targets: Annotated[tuple[TargetSettings, ...], Field(min_length=1, max_length=len(STARTS_M))] = (
        TargetSettings(),
    )
    looks_at: Annotated[int, Field(ge=0)] = 0  # index of the target that its payload sees first, from 0
    payload: PayloadSettings | None = field(default_factory=PayloadSettings)
    device: str = ""
    quirks: Quirks = field(default_factory=Quirks)
    camera: CameraSettings | None = None  # in place of laser and gimbal; needs PyAV and OpenCV
    stations: tuple[str, ...] = DEFAULT_STATIONS  # where it sends to, HOST:PORT
    logs: Path | None = None  # folder for another simulator's files; None: they are deleted at the end
    truth: Path | None = None  # file for the true tracks
    lost_s: float | None = None  # from then on nothing is received from it
    signing_key: bytes | None = field(default=None, repr=False)  # frames not signed with it are dropped
    link_rate: float = 1.0  # seconds of the vehicle in one of the stations'
    boot_unix_s: float = 1.7e9
    terrain: Path | None = None  # folder of .hgt tiles; None: flat

    @property
    def home_or_default(self) -> HomePosition:
        return self.home or DEFAULT_HOMES[self.flavour]

    @property
    def release_or_newest(self) -> tuple[int, int]:
        return self.release or NEWEST[self.flavour]


@dataclass(frozen=True, slots=True)
class RunSettings:
    __pydantic_config__ = ConfigDict(extra="forbid", allow_inf_nan=False)

    vehicles: Annotated[tuple[Settings, ...], Field(min_length=1, max_length=MAX_VEHICLES)] = (Settings(),)
    speed: Annotated[float, Field(gt=0.0, le=1000.0)] = 1.0  # simulated time over wall time
    duration_s: Annotated[float, Field(gt=0.0)] | None = None  # simulated; None: until it is interrupted
    link: LinkFaults = field(default_factory=LinkFaults)  # of each vehicle
    signing_key_file: Path | None = None  # with which all sign, and without which they accept nothing

    def to_json(self) -> bytes:
        """Return the settings in one line of JSON, without those that have their default."""
        return RUN_SETTINGS.dump_json(self, exclude_defaults=True)


RUN_SETTINGS = TypeAdapter(RunSettings)
"""Reads settings; raises pydantic's ValidationError, which names the field."""


def in_a_row(first: Settings, count: int) -> list[Settings]:
    """Return the settings of ``count`` vehicles: the first at its home, the others in a row east of it.

    System ids and seeds follow one another; the targets are the same for all.
    """
    home = first.home_or_default
    plane, row = HomePlane(home.latitude_deg, home.longitude_deg), []
    for number in range(count):
        own_deg = plane.latitude_longitude_deg(number * _APART_M, 0.0)
        own = replace(first, system_id=first.system_id + number, seed=first.seed + number, target_seed=first.seed)
        own_home = HomePosition(*own_deg, home.altitude_m) if number else home
        row.append(replace(own, home=own_home, home_east_m=number * _APART_M))
    return row

"""What a simulation is made of, as plain values."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from pathlib import Path

from sidelong.sitl.world.airframe import Wind
from sidelong.sitl.world.geodesy import HomePlane


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


Release = tuple[int, int]
"""Major and minor number of an autopilot's firmware."""

NEWEST: dict[Flavour, Release] = {Flavour.ARDUPLANE: (4, 7), Flavour.PX4: (1, 18)}
OLDEST: dict[Flavour, Release] = {Flavour.ARDUPLANE: (4, 3), Flavour.PX4: (1, 13)}


@dataclass(frozen=True, slots=True)
class Home:
    latitude_deg: float
    longitude_deg: float
    altitude_m: float


# The default home positions of the stock simulators.
DEFAULT_HOMES = {
    Flavour.ARDUPLANE: Home(-35.3632621, 149.1652370, 584.09),
    Flavour.PX4: Home(47.3977419, 8.5455938, 489.2),
}


@dataclass(frozen=True, slots=True)
class PayloadSettings:
    """Laser and gimbal. dropout_fraction: part of the time without range, in pieces of 0.5 to 8 s.

    pan_limit_rad: how far the gimbal pans to each side of the nose. A target beyond is not seen.
    """

    range_sigma_m: float = 0.8
    outlier_fraction: float = 0.02
    gimbal_sigma_rad: float = math.radians(0.35)
    gimbal_yaw_bias_rad: float = math.radians(0.4)
    dropout_fraction: float = 0.15
    latency_s: float = 0.05
    range_message: RangeMessage = RangeMessage.DISTANCE_SENSOR
    gimbal_frame: GimbalFrame = GimbalFrame.EARTH
    pan_limit_rad: float = math.pi


@dataclass(frozen=True, slots=True)
class Quirks:
    """Deviations of a device from its manual, and its transmission errors.

    Attributes:
        range_unit_m: length of one count of its range, m; None: as in the manual.
        yaw_mirrored: whether its yaw has the opposite sign.
        streams: whether it streams data after a streaming request.
        reach_m: the laser's maximum range.
        silent_beyond: whether it sends nothing beyond its reach, instead of the value for no echo.
        damaged: fraction of its frames that arrive with a changed byte.
    """

    range_unit_m: float | None = None
    yaw_mirrored: bool = False
    streams: bool = True
    reach_m: float = 1200.0
    silent_beyond: bool = True
    damaged: float = 0.0


MAX_VEHICLES = 8
_APART_M = 200.0  # more than the circles that are flown at home are wide
# Default start positions of several targets: each within laser range of vehicles in a row.
STARTS_M = ((250.0, 300.0), (650.0, -300.0), (850.0, 300.0), (250.0, -300.0))


@dataclass(frozen=True, slots=True)
class TargetSettings:
    """motion: a name of sidelong.sitl.world.motion.MOTIONS or a track file. speed_max_m_s None: 3, for tracks 6.

    start_m: east and north of the first vehicle's home. skip_s None: a track starts where it becomes lively. name: in
    the truth.
    """

    motion: str | Path = "walk"
    speed_max_m_s: float | None = None
    start_m: tuple[float, float] = STARTS_M[0]
    skip_s: float | None = None
    name: str = ""


@dataclass(frozen=True, slots=True)
class Settings:
    """Settings of one vehicle. airspeed_m_s: equivalent airspeed that the autopilot holds, as in its parameter.

    looks_at: index of the target its payload sees at first; home_east_m: its home's offset from the first vehicle's.
    """

    flavour: Flavour = Flavour.ARDUPLANE
    release: Release | None = None  # of its firmware; None: the newest
    system_id: int = 1
    seed: int = 0
    target_seed: int | None = None  # of the targets alone, if there are several vehicles; None: seed
    airspeed_m_s: float = 15.0
    endurance_s: float = 3.0 * 3600.0  # battery endurance
    wind: Wind = field(default_factory=Wind)
    home: Home | None = None
    home_east_m: float = 0.0
    targets: tuple[TargetSettings, ...] = (TargetSettings(),)
    looks_at: int = 0
    payload: PayloadSettings | None = field(default_factory=PayloadSettings)
    device: str = ""  # protocol of a payload with a port of its own; "": it sends MAVLink
    quirks: Quirks = field(default_factory=Quirks)  # of the device
    signing_key: bytes | None = field(default=None, repr=False)  # frames not signed with it are dropped
    link_rate: float = 1.0  # seconds of the vehicle in one of the stations'
    boot_unix_s: float = 1.7e9
    terrain: Path | None = None  # folder of .hgt tiles; flat without

    @property
    def home_or_default(self) -> Home:
        return self.home or DEFAULT_HOMES[self.flavour]

    @property
    def release_or_newest(self) -> Release:
        return self.release or NEWEST[self.flavour]


def in_turn(
    first: Settings,
    flavours: Sequence[Flavour],
    airspeeds_m_s: Sequence[float],
    endurances_s: Sequence[float],
    count: int,
    looks_at: Sequence[int] = (0,),
    releases: Sequence[Release | None] = (None,),
) -> list[Settings]:
    """Return the settings of ``count`` vehicles: the first at its home, the others in a row east of it.

    Flavours, releases, airspeeds, endurances and what they look at are repeated in turn. System ids follow one
    another; the targets are the same for all.
    """
    home = first.home_or_default
    plane = HomePlane(home.latitude_deg, home.longitude_deg)
    return [
        replace(
            first,
            flavour=flavours[number % len(flavours)],
            release=releases[number % len(releases)],
            system_id=first.system_id + number,
            seed=first.seed + number,
            target_seed=first.seed,
            airspeed_m_s=airspeeds_m_s[number % len(airspeeds_m_s)],
            endurance_s=endurances_s[number % len(endurances_s)],
            home=Home(*plane.latitude_longitude_deg(number * _APART_M, 0.0), home.altitude_m) if number else home,
            home_east_m=number * _APART_M,
            looks_at=looks_at[number % len(looks_at)],
        )
        for number in range(count)
    ]

"""The requirement of a watch, and the limits of the aircraft.

Source: Beard and McLain, *Small Unmanned Aircraft*, 2012, chapter 9 (coordinated turn);
docs/explanation/how-it-works.md#the-geometry.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum
from typing import TypeVar

import numpy as np
import numpy.typing as npt

from sidelong.estimators.numbers import convert_to_floats, require_type

Angle = TypeVar("Angle", float, npt.NDArray[np.float64])
GRAVITY_M_S2 = 9.80665
# A circle wider than this share of the band leaves no room to move it in: it was found on recorded targets.
_WIDEST_OF_BAND = 1.0 / 3.8
PAN_LIMIT_MIN_DEG = 90.0
"""With less on one side of the nose, figures of eight do not keep a target in view either."""


class Side(StrEnum):
    """The side of the target's direction of motion from which it is watched."""

    LEFT = "left"
    RIGHT = "right"

    @property
    def clockwise(self) -> bool:
        """Whether circles are flown clockwise: on the left, so that transitions bulge away from the target."""
        return self is Side.LEFT

    @property
    def opposite(self) -> Side:
        """The other side."""
        return Side.RIGHT if self is Side.LEFT else Side.LEFT

    @property
    def normal_turn_rad(self) -> float:
        """Angle from the target's course to the direction of this side, rad, clockwise: -pi/2 on the left."""
        return -math.pi / 2 if self is Side.LEFT else math.pi / 2


@dataclass(frozen=True, slots=True)
class Sector:
    """Bearings from the target where the aircraft is to stay, clockwise from ``from_rad`` to ``to_rad``."""

    from_rad: float
    to_rad: float

    def __post_init__(self) -> None:
        convert_to_floats(self, "from_rad", "to_rad")

    @property
    def half_width_rad(self) -> float:
        """Half the angle covered, in (0, pi]."""
        return 0.5 * ((self.to_rad - self.from_rad) % (2.0 * math.pi) or 2.0 * math.pi)

    @property
    def middle_rad(self) -> float:
        """Bearing in the middle of the sector, rad clockwise from north, seen from the target."""
        return self.from_rad + self.half_width_rad


@dataclass(frozen=True, slots=True)
class Requirement:
    """The allowed horizontal range, the side, and how fast the target may be.

    either_side: ``side`` is only the one to begin with; the nearer one is taken. sector: watch from these bearings,
    whichever way the target moves; ``side`` then only selects the sense of the circles.
    course_horizon_s: the side refers to the course made good over this time; 0: to the present course.
    """

    range_min_m: float
    range_max_m: float
    side: Side
    target_speed_max_m_s: float
    threshold: float = 0.9  # C of the paper: a lap is refused when it would end beyond threshold * range_max_m
    either_side: bool = False
    sector: Sector | None = None
    course_horizon_s: float = 20.0

    def __post_init__(self) -> None:
        convert_to_floats(self, "range_min_m", "range_max_m", "target_speed_max_m_s", "threshold", "course_horizon_s")
        require_type(self, "sector", Sector, type(None))
        try:
            object.__setattr__(self, "side", Side(self.side))
        except ValueError:
            raise TypeError(f"Requirement.side must be Side.LEFT or Side.RIGHT, not {self.side!r}") from None

    def middle_rad(self, course_rad: Angle) -> Angle | float:
        """Return the bearing from the target to the middle of the allowed positions, rad; course: the target's."""
        return course_rad + self.side.normal_turn_rad if self.sector is None else self.sector.middle_rad

    @property
    def allowed_rad(self) -> float:
        """How far a bearing from the target may be from ``middle_rad``, rad, 0 to pi."""
        if self.sector is not None:
            return self.sector.half_width_rad
        return math.pi if self.either_side else math.pi / 2


@dataclass(frozen=True, slots=True)
class Aircraft:
    """The aircraft as the planner sees it: radius_m is that of the circle next to the target.

    pan_limit_rad: how far the gimbal pans to each side of the nose; pi: it looks all around.
    configured: the aircraft as configured, where less than that was found in flight; its value tables serve.
    """

    airspeed_m_s: float
    radius_m: float
    bank_max_rad: float = math.radians(45.0)
    roll_rate_max_rad_s: float = math.radians(30.0)
    pan_limit_rad: float = math.pi
    configured: Aircraft | None = None

    def __post_init__(self) -> None:
        convert_to_floats(self, "airspeed_m_s", "radius_m", "bank_max_rad", "roll_rate_max_rad_s", "pan_limit_rad")

    @property
    def has_pan_limit(self) -> bool:
        """Whether the gimbal does not look all around."""
        return self.pan_limit_rad < math.pi

    @property
    def lap_s(self) -> float:
        """Time of one circle in still air."""
        return 2.0 * math.pi * self.radius_m / self.airspeed_m_s

    def roll_s(self, to_per_m: float, from_per_m: float = 0.0) -> float:
        """Return the time to roll into a turn from another one, by their curvatures, positive to the right."""
        to_rad, from_rad = (
            math.atan(self.airspeed_m_s**2 * per_m / GRAVITY_M_S2) for per_m in (to_per_m, from_per_m)
        )
        return abs(to_rad - from_rad) / self.roll_rate_max_rad_s

    @property
    def min_radius_m(self) -> float:
        """Radius of a coordinated turn at the bank limit, in still air."""
        return self.airspeed_m_s**2 / (GRAVITY_M_S2 * math.tan(self.bank_max_rad))


def widest_radius_m(range_min_m: float, range_max_m: float) -> float:
    """Return the radius of the widest circle that leaves room to move it within a range band."""
    return _WIDEST_OF_BAND * (range_max_m - range_min_m)


@dataclass(frozen=True, slots=True)
class Wind:
    """The air's motion over the ground (where it blows *to*)."""

    east_m_s: float = 0.0
    north_m_s: float = 0.0

    def __post_init__(self) -> None:
        convert_to_floats(self, "east_m_s", "north_m_s")

    @property
    def speed_m_s(self) -> float:
        """Speed of the air over the ground, m/s."""
        return math.hypot(self.east_m_s, self.north_m_s)

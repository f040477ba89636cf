"""From where the target is to be watched: a side of its motion, the nearer side, or a sector of the compass."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, replace

from estimators.estimate import TargetEstimate
from mission.core.requirement import Requirement, Sector, Side
from mission.viewpoint.course_hold import CourseHold, course_sigma_rad

_SECTOR_WORDS = re.compile(r"(\d+(?:\.\d+)?)-(\d+(?:\.\d+)?)")


@dataclass(frozen=True, slots=True)
class Viewpoint:
    """The frame to watch from: the course whose ``side`` counts, and how well it is known.

    course_sigma_rad is 0 for a course that is not the estimate's own: held through a stop, or a sector's.
    """

    course_rad: float
    side: Side
    course_sigma_rad: float


class SidePolicy:
    """Applies a requirement's wish to the target as it moves. With either side it remembers the present one."""

    def __init__(self, requirement: Requirement, hysteresis_m: float) -> None:
        """hysteresis_m: how far across the target's line the aircraft must be before the other side is taken."""
        self._requirement, self._hysteresis_m = requirement, hysteresis_m
        self._side = requirement.side
        self._course = CourseHold()
        self._presumed_rad: float | None = None

    def viewpoint(self, east_m: float, north_m: float, target: TargetEstimate) -> Viewpoint:
        """Return the viewpoint for an aircraft at a place of the plane.

        While the target has not moved yet, its course is presumed to be such that the aircraft began right beside it.
        """
        sector = self._requirement.sector
        if sector is not None:
            return Viewpoint(sector.middle_rad - self._side.normal_turn_rad, self._side, 0.0)
        course_rad = self._course.update(target)
        away_rad = math.atan2(east_m - target.east_m, north_m - target.north_m)
        if course_rad is None:
            if self._presumed_rad is None:
                self._presumed_rad = away_rad - self._side.normal_turn_rad
            return Viewpoint(self._presumed_rad, self._side, 0.0)
        if self._requirement.either_side:
            range_m = math.hypot(east_m - target.east_m, north_m - target.north_m)
            aside_m = range_m * math.cos(away_rad - course_rad - self._side.normal_turn_rad)
            if aside_m < -self._hysteresis_m:
                self._side = Side.RIGHT if self._side is Side.LEFT else Side.LEFT
        sigma_rad = 0.0 if self._course.standing else course_sigma_rad(target)
        return Viewpoint(course_rad, self._side, sigma_rad)


def watching_from(requirement: Requirement, words: str) -> Requirement:
    """Return the requirement with its side as a person writes it: left, right, either, or a sector like 120-200.

    Raises ValueError with one sentence when the words are none of these.
    """
    plain = replace(requirement, either_side=False, sector=None)
    if words in (Side.LEFT, Side.RIGHT):
        return replace(plain, side=Side(words))
    if words == "either":
        return replace(plain, either_side=True)
    match = _SECTOR_WORDS.fullmatch(words)
    if match is None:
        raise ValueError(f"side: {words!r} is none of left, right, either, or a sector in degrees such as 120-200")
    from_deg, to_deg = float(match[1]), float(match[2])
    if max(from_deg, to_deg) > 360.0 or from_deg % 360.0 == to_deg % 360.0:
        raise ValueError(f"side: the sector {words} needs two different bearings from 0 to 360 degrees")
    return replace(plain, sector=Sector(math.radians(from_deg), math.radians(to_deg)))

"""The side of the target, or the sector, to watch from. Source: docs/explanation/planners.md#watch-course."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, replace

from sidelong.estimators.estimate import TargetEstimate
from sidelong.mission.core.requirement import Requirement, Sector, Side
from sidelong.mission.viewpoint import viewpoint_kernel as kernel
from sidelong.mission.viewpoint.course_hold import estimates_of

_SECTOR_WORDS = re.compile(r"(\d+(?:\.\d+)?)-(\d+(?:\.\d+)?)")


@dataclass(frozen=True, slots=True)
class Viewpoint:
    """The frame to watch from: the course whose ``side`` counts, and how well it is known.

    course_sigma_rad is 0 for a present course that is held through a stop, and for a sector's.
    """

    course_rad: float
    side: Side
    course_sigma_rad: float


class SidePolicy:
    """Applies a requirement's wish to the target as it moves. With either side it remembers the present one."""

    def __init__(self, requirement: Requirement, hysteresis_m: float, course_horizon_s: float = 0.0) -> None:
        """hysteresis_m: how far across the target's line the aircraft must be before the other side is taken.

        course_horizon_s: the sides are those of the course made good over this time, s; 0: of the present course.
        """
        sector, side = requirement.sector, requirement.side
        fixed_rad = math.nan if sector is None else sector.middle_rad - side.normal_turn_rad
        self.wish = kernel.SideRule(requirement.either_side, hysteresis_m, fixed_rad, course_horizon_s)
        self.memory = kernel.fresh_memory(1.0 if side is Side.LEFT else -1.0)

    def viewpoint(self, east_m: float, north_m: float, target: TargetEstimate) -> Viewpoint:
        """Return from where an aircraft watches.

        Until the target has moved, its course is assumed to put the aircraft's first position exactly on the side.
        """
        view = kernel.viewpoint(east_m, north_m, estimates_of(target), self.wish, self.memory[0])
        return Viewpoint(view.course_rad, Side.LEFT if view.side > 0.0 else Side.RIGHT, view.course_sigma_rad)


def side_words(requirement: Requirement) -> str:
    """Return the requirement's side as :func:`watching_from` takes it."""
    if requirement.sector is not None:
        return f"{math.degrees(requirement.sector.from_rad):g}-{math.degrees(requirement.sector.to_rad):g}"
    return "either" if requirement.either_side else str(requirement.side)


def watching_from(requirement: Requirement, words: str) -> Requirement:
    """Return the requirement with its side as a person writes it.

    Args:
        requirement: How the target has to be observed.
        words: left, right, either, or a sector like 120-200.

    Raises:
        ValueError: The words are none of these; the message is one sentence.
    """
    plain = replace(requirement, either_side=False, sector=None)
    if words in (Side.LEFT, Side.RIGHT):
        return replace(plain, side=Side(words))
    if words == "either":
        return replace(plain, either_side=True)
    match = _SECTOR_WORDS.fullmatch(words)
    if match is None:
        raise ValueError(f"{words!r} is none of left, right, either, or a sector in degrees such as 120-200")
    from_deg, to_deg = float(match[1]), float(match[2])
    if max(from_deg, to_deg) > 360.0 or from_deg % 360.0 == to_deg % 360.0:
        raise ValueError(f"the sector {words} needs two different bearings from 0 to 360 degrees")
    return replace(plain, sector=Sector(math.radians(from_deg), math.radians(to_deg)))

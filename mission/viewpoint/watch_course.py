"""The course and side to watch a target from: held while it stands, made good, or present; and directions in words.

A slowing estimate turns about at random before its speed falls below the threshold, so the course that is held is
the one of some seconds earlier. The course made good, which defines the sides, is the direction in which the target
moved over a horizon. A jump of the estimated position is a correction, not a motion of the target.

Source: docs/explanation/planners.md#watch-course; docs/how-to/read-the-terminal.md.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, replace

import numpy as np

from sidelong.estimators.estimate import TargetEstimate
from sidelong.mission.core.circle import Circle
from sidelong.mission.core.path import FloatArray
from sidelong.mission.core.requirement import Requirement, Sector, Side
from sidelong.mission.viewpoint import viewpoint_kernel as kernel
from sidelong.mission.viewpoint.viewpoint_kernel import Estimates, TargetState

STANDING_M_S = 0.3
"""Below this speed a target keeps its present course: the direction of its velocity is noise."""


def known(target: TargetEstimate) -> TargetState:
    """Return an estimate as the compiled functions take it."""
    place_m, velocity_m_s = (target.east_m, target.north_m), (target.velocity_east_m_s, target.velocity_north_m_s)
    return TargetState(target.time_s, *place_m, *velocity_m_s, np.ascontiguousarray(target.covariance, np.float64))


def estimates_of(target: TargetEstimate) -> Estimates:
    """Return an estimate as the compiled functions take it, with that of the last sighting."""
    now = known(target)
    return Estimates(now, now if target.as_seen is None else known(target.as_seen))


class CourseHold:
    """The course to watch from: the target's while it moves; None until it has moved."""

    def __init__(self) -> None:
        self._memories = kernel.fresh_memory(1.0)

    def update(self, target: TargetEstimate) -> float | None:
        """Process an estimate; return the course to watch from, rad, None until the target has moved."""
        now = known(target)
        course_rad, _ = kernel.courses_of(Estimates(now, now), 0.0, self._memories)
        return None if math.isnan(course_rad) else course_rad

    @property
    def standing(self) -> bool:
        """Whether the target stands."""
        return bool(self._memories[0].standing)


class TargetCourse:
    """Both courses of a target, as the planner takes them, None until it has moved; for a horizon of 0 the same."""

    def __init__(self) -> None:
        self._seen: TargetEstimate | None = None
        self._jumped = -math.inf, math.nan  # when, and the course made good until then
        self.made_good_rad: float | None = None
        self.present_rad: float | None = None
        self._memories = kernel.fresh_memory(1.0)

    def update(self, target: TargetEstimate, horizon_s: float) -> None:
        """Process an estimate."""
        if math.hypot(target.velocity_east_m_s, target.velocity_north_m_s) >= STANDING_M_S:
            self.present_rad = math.atan2(target.velocity_east_m_s, target.velocity_north_m_s)
        seen, before, held_rad = target.as_seen or target, self._seen, float(self._memories[0].made_good_rad)
        self._seen = seen
        if before and math.dist(before.position_m(seen.time_s), (seen.east_m, seen.north_m)) > kernel.MIN_WAY_M:
            self._jumped = seen.time_s, held_rad
        _, made_good_rad = kernel.courses_of(estimates_of(target), horizon_s, self._memories)
        if horizon_s == 0.0:
            self.made_good_rad = self.present_rad
        # A target that jumped may have moved out of sight: until its course is found again, or for the horizon.
        elif made_good_rad == self._jumped[1] and seen.time_s < self._jumped[0] + horizon_s:
            self.made_good_rad = None
        elif not math.isnan(made_good_rad):
            self.made_good_rad = made_good_rad


def courses_made_good_rad(
    time_s: FloatArray,
    place_m: FloatArray,
    velocity_m_s: FloatArray,
    horizon_s: FloatArray,
    gap_max_s: float = math.inf,
) -> FloatArray:
    """Return the courses made good (n,) of exactly known motion; NaN until the target has moved far enough.

    They are held while it moves less than ``MIN_WAY_M``.

    Args:
        time_s: Times of the samples, ascending, (n,).
        velocity_m_s: East and north, (n, 2), as place_m: what it does not explain of a way is a correction.
        horizon_s: Time over which each course is taken, (n,).
        gap_max_s: The motion between two samples further apart is unknown and counts as none.
    """
    time_s, place_m, velocity_m_s, horizon_s = (
        np.ascontiguousarray(values, np.float64) for values in (time_s, place_m, velocity_m_s, horizon_s)
    )
    return kernel.courses_made_good(time_s, place_m, velocity_m_s, horizon_s, gap_max_s, kernel.fresh_memory(1.0))


_SECTOR_WORDS = re.compile(r"(\d+(?:\.\d+)?)-(\d+(?:\.\d+)?)")


@dataclass(frozen=True, slots=True)
class Viewpoint:
    """The frame to watch from; course_sigma_rad is 0 for a course that is held through a stop, and for a sector's."""

    course_rad: float
    side: Side
    course_sigma_rad: float


class SidePolicy:
    """Applies a requirement's wish to the target as it moves. With either side it remembers the present one."""

    def __init__(self, requirement: Requirement, hysteresis_m: float, course_horizon_s: float = 0.0) -> None:
        """hysteresis_m: how far across the target's line the aircraft must be before the other side is taken."""
        sector, side = requirement.sector, requirement.side
        fixed_rad = math.nan if sector is None else sector.middle_rad - side.normal_turn_rad
        self.wish = kernel.SideRule(requirement.either_side, hysteresis_m, fixed_rad, course_horizon_s)
        self.memory = kernel.fresh_memory(1.0 if side is Side.LEFT else -1.0)

    def viewpoint(self, east_m: float, north_m: float, target: TargetEstimate) -> Viewpoint:
        """Return the frame in which an aircraft at a position (east, north) watches the target.

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
    """Return the requirement with its side as a person writes it: left, right, either, or a sector like 120-200.

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


_WINDS = ("north", "north-east", "east", "south-east", "south", "south-west", "west", "north-west")
_SAME_PLACE_M = 3.0


def describe_new_circle(old: Circle, new: Circle) -> str:
    """Return where one circle lies from another in words."""
    return describe_move(new.east_m - old.east_m, new.north_m - old.north_m)


def describe_move(east_m: float, north_m: float) -> str:
    """Return a shift in words: ``212 m east``."""
    if math.hypot(east_m, north_m) < _SAME_PLACE_M:
        return "on to the same circle"
    direction = _WINDS[round(math.atan2(east_m, north_m) / (math.pi / 4)) % 8]
    return f"{math.hypot(east_m, north_m):.0f} m {direction}"

"""From when: the point A at which a move of the circle begins, when the target will have moved on by then.

Source: Liao et al., Defence Technology 16(4), 2020, equations 9-22.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from sidelong.mission.core.circle import Circle
from sidelong.mission.core.path import Path
from sidelong.mission.core.requirement import Wind
from sidelong.mission.geometry.switching import departure_course_rad, range_after_lap_m, turn_to_go_rad
from sidelong.mission.geometry.wind import LapClock, path_times_s

Vector = tuple[float, float]


@dataclass(frozen=True, slots=True)
class DepartureState:
    """A circle that is flown, now on ``course_rad``, and a target that is taken to keep its velocity.

    latency_s: no move can depart earlier.
    """

    circle: Circle
    course_rad: float
    clock: LapClock
    target_m: Vector
    velocity_m_s: Vector
    airspeed_m_s: float
    wind: Wind
    latency_s: float

    def target_after(self, wait_s: float) -> Vector:
        """Return (east, north) of the target after ``wait_s`` at its present velocity, m.

        Args:
            wait_s: Time from now, s.
        """
        return (
            self.target_m[0] + self.velocity_m_s[0] * wait_s,
            self.target_m[1] + self.velocity_m_s[1] * wait_s,
        )

    def min_range_m(self, path: Path, wait_s: float) -> float:
        """Return the least range while ``path`` is flown from ``wait_s`` on.

        Args:
            path: The path.
            wait_s: Time from now to the departure, s.
        """
        time_s = wait_s + path_times_s(path, self.airspeed_m_s, self.wind)
        east_m = path.east_m - self.target_m[0] - self.velocity_m_s[0] * time_s
        north_m = path.north_m - self.target_m[1] - self.velocity_m_s[1] * time_s
        return float(np.min(np.hypot(east_m, north_m)))


@dataclass(frozen=True, slots=True)
class Move:
    """A move to ``circle`` that departs from A in ``wait_s``; target_m and range_after_lap_m are those of then."""

    circle: Circle
    wait_s: float
    east_m: float
    north_m: float
    target_m: Vector
    range_after_lap_m: float

    @property
    def length_m(self) -> float:
        """How far the circle moves, m."""
        return math.hypot(self.east_m, self.north_m)


def next_move(situation: DepartureState, place: Callable[[Vector], Circle], lead_rad: float) -> Move:
    """Return the next move to where ``place`` puts the circle for a target, leaving ``lead_rad`` before its bearing.

    Where the move leads depends on where the target is by then, and A on where it leads: found by repetition,
    which converges as the target is much slower than the aircraft.

    Args:
        situation: Aircraft, target, circle and wind.
        place: Returns the circle for a position of the target.
        lead_rad: Turn before the bearing of the move at which the aircraft leaves, rad.
    """
    circle, clock = situation.circle, situation.clock
    sense = 1.0 if circle.clockwise else -1.0
    begin_s = clock.time_s(sense * situation.course_rad)
    wait_s = situation.latency_s
    for _ in range(4):
        target_m = situation.target_after(wait_s)
        new = place(target_m)
        east_m, north_m = new.east_m - circle.east_m, new.north_m - circle.north_m
        leaving_rad = departure_course_rad(math.atan2(east_m, north_m), lead_rad, circle.clockwise)
        turn_rad = turn_to_go_rad(situation.course_rad, leaving_rad, circle.clockwise)
        wait_s = clock.time_s(sense * situation.course_rad + turn_rad) - begin_s
        if wait_s < situation.latency_s:
            wait_s += clock.lap_s
    range_m = range_after_lap_m(circle.position_at_course(leaving_rad), target_m, situation.velocity_m_s, clock.lap_s)
    return Move(new, wait_s, east_m, north_m, target_m, range_m)

"""How the target moves: legs of constant speed and turn rate, drawn or laid down."""

from __future__ import annotations

import itertools
import math
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Protocol

import numpy as np

# Heading changes of the random walk and their chances: a target that mostly goes on, sometimes turns back.
_WALK_TURNS_RAD = np.radians([-90, -45, -20, 0, 20, 45, 90, 180])
_WALK_CHANCES = (0.12, 0.15, 0.15, 0.10, 0.15, 0.15, 0.12, 0.06)


class Motion(Protocol):
    """The position of the target (east, north); called with times that never decrease."""

    def at(self, time_s: float) -> tuple[float, float]: ...


@dataclass(frozen=True, slots=True)
class Leg:
    duration_s: float
    speed_m_s: float
    turn_rate_rad_s: float = 0.0
    turn_before_rad: float = 0.0


class LegMotion:
    """Flies legs one after the other, exactly: each is a straight line or an arc."""

    def __init__(self, start_m: tuple[float, float], course_rad: float, legs: Iterator[Leg]) -> None:
        self._east_m, self._north_m = start_m
        self._course_rad = course_rad
        self._legs = legs
        self._begin_s = 0.0
        self._leg = self._take_leg()

    def at(self, time_s: float) -> tuple[float, float]:
        """Return (east, north) m at a time, s; times must not go back."""
        while time_s - self._begin_s > self._leg.duration_s:
            leg = self._leg
            self._east_m, self._north_m = self._after(leg.duration_s)
            self._course_rad += leg.turn_rate_rad_s * leg.duration_s
            self._begin_s += leg.duration_s
            self._leg = self._take_leg()
        return self._after(time_s - self._begin_s)

    def _take_leg(self) -> Leg:
        leg = next(self._legs)
        self._course_rad += leg.turn_before_rad
        return leg

    def _after(self, elapsed_s: float) -> tuple[float, float]:
        half_turn_rad = 0.5 * self._leg.turn_rate_rad_s * elapsed_s
        chord_over_arc = math.sin(half_turn_rad) / half_turn_rad if abs(half_turn_rad) > 1e-9 else 1.0
        chord_m = self._leg.speed_m_s * elapsed_s * chord_over_arc
        chord_rad = self._course_rad + half_turn_rad
        return self._east_m + chord_m * math.sin(chord_rad), self._north_m + chord_m * math.cos(chord_rad)


def _turning(speed_m_s: float, rng: np.random.Generator) -> Iterator[Leg]:
    """Bends of 20-60 s, to either side, with radii of 40 m and more."""
    while True:
        rate_rad_s = speed_m_s / float(rng.uniform(40.0, 200.0)) * float(rng.choice((-1.0, 1.0)))
        yield Leg(float(rng.uniform(20.0, 60.0)), speed_m_s, rate_rad_s)


def _stop_and_go(speed_m_s: float, rng: np.random.Generator) -> Iterator[Leg]:
    while True:
        yield Leg(float(rng.uniform(30.0, 60.0)), speed_m_s, turn_before_rad=float(rng.normal(0.0, 0.4)))
        yield Leg(float(rng.uniform(15.0, 45.0)), 0.0)


def _walk(speed_m_s: float, rng: np.random.Generator) -> Iterator[Leg]:
    while True:
        duration_s = float(rng.uniform(40.0, 200.0))
        some_m_s = float(rng.uniform(min(1.0, speed_m_s), speed_m_s))
        chosen_m_s = float(rng.choice((0.0, some_m_s, speed_m_s)))
        yield Leg(duration_s, chosen_m_s, turn_before_rad=float(rng.choice(_WALK_TURNS_RAD, p=_WALK_CHANCES)))


def _u_turn(speed_m_s: float, _rng: np.random.Generator) -> Iterator[Leg]:
    """Two minutes one way, round a half circle of 8 m, and back."""
    half_turn_s = math.pi * 8.0 / speed_m_s if speed_m_s > 0 else math.inf
    return itertools.cycle((Leg(120.0, speed_m_s), Leg(half_turn_s, speed_m_s, math.pi / half_turn_s)))


def _demo(speed_m_s: float, _rng: np.random.Generator) -> Iterator[Leg]:
    """Everything within three minutes: walk, bend, stop for a while, turn back; and so on."""
    legs = (
        Leg(60.0, speed_m_s),
        Leg(60.0, speed_m_s, turn_before_rad=math.radians(60.0)),
        Leg(15.0, 0.0),
        Leg(90.0, speed_m_s, turn_before_rad=math.pi),
        Leg(75.0, 0.6 * speed_m_s, turn_before_rad=math.radians(-70.0)),
    )
    return itertools.cycle(legs)


MOTIONS: dict[str, Callable[[float, np.random.Generator], Iterator[Leg]]] = {
    "still": lambda _speed_m_s, _rng: itertools.repeat(Leg(math.inf, 0.0)),
    "straight": lambda speed_m_s, _rng: itertools.repeat(Leg(math.inf, speed_m_s)),
    "turning": _turning,
    "stop-and-go": _stop_and_go,
    "walk": _walk,
    "u-turn": _u_turn,
    "circle": lambda speed_m_s, _rng: itertools.repeat(Leg(math.inf, speed_m_s, speed_m_s / 60.0)),
    "demo": _demo,
}


def built_in_motion(name: str, start_m: tuple[float, float], speed_m_s: float, rng: np.random.Generator) -> LegMotion:
    """Return a motion of :data:`MOTIONS`; its first course is drawn."""
    course_rad = float(rng.uniform(0.0, math.tau))
    return LegMotion(start_m, course_rad, MOTIONS[name](speed_m_s, rng))


_SILENT_S = 1.0  # of this computer's clock: then another vehicle's clock leads
_FAR_S = 2.0  # a vehicle's clock offset is reset at this error
_SHARE = 0.02  # share of the error corrected each time, as positions arrive at irregular intervals


class SharedTarget:
    """A target that moves by the clock of the first vehicle received, later of another if that ends. Thread-safe.

    The others' clocks are compared with that clock as their positions arrive, and follow it if a simulator falls
    behind.
    """

    def __init__(self, motion: Motion) -> None:
        self._motion, self._lock = motion, threading.Lock()
        self._now_s = self._asked_s = 0.0
        self._leader: _Seen | None = None
        self._led_s = 0.0

    def seen_from(self, home_east_m: float) -> Motion:
        """Return its motion in the plane of a home this far east of the first one, by the caller's clock."""
        return _Seen(self, home_east_m)

    def at(self, seen: _Seen, time_s: float) -> tuple[float, float]:
        """Return (east, north) m at an aircraft's own time, s; the clocks of several aircraft are joined."""
        with self._lock:
            wall_s = time.monotonic()
            if self._leader is None or (seen is not self._leader and wall_s - self._led_s > _SILENT_S):
                self._leader = seen
            if seen.offset_s is None:
                seen.offset_s = self._now_s - time_s
            if seen is self._leader:
                self._led_s, self._now_s = wall_s, time_s + seen.offset_s
            else:
                off_s = self._now_s - time_s - seen.offset_s
                seen.offset_s += off_s if abs(off_s) > _FAR_S else _SHARE * off_s
            self._asked_s = max(self._asked_s, time_s + seen.offset_s)
            return self._motion.at(self._asked_s)


class _Seen(Motion):
    def __init__(self, target: SharedTarget, home_east_m: float) -> None:
        self._target, self._home_east_m = target, home_east_m
        self.offset_s: float | None = None

    def at(self, time_s: float) -> tuple[float, float]:
        east_m, north_m = self._target.at(self, time_s)
        return east_m - self._home_east_m, north_m

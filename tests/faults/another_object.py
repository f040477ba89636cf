"""Scenes in which the payload follows another object from a moment on: crossings, swaps, cars, the own shadow."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from tests.faults.flight import ERRORS, FaultedFlight, Scenario
from tests.faulty_payload import FaultyPayload

BEGIN_S, LASTS_S, SWAP_S = 90.0, 90.0, 20.0
KINDS = ("crossing", "swap", "car", "shadow")


class Misled(FaultyPayload):
    """A payload that looks where it is pointed: ``place_m`` gives that at a time, None: at the target."""

    def __init__(self, rng, place_m):
        super().__init__(ERRORS, rng)
        self._place_m = place_m

    def measure(self, time_s, boot_ms, east_m, north_m, up_m, **how):
        place_m = self._place_m(time_s, (east_m, north_m), up_m)
        return super().measure(time_s, boot_ms, *(place_m or (east_m, north_m)), up_m, **how)


@dataclass
class Seen:
    """What came of a scene.

    Attributes:
        kind: of the scene.
        known_s: how long after its begin it counted as unknown; inf: never.
        least_m: least range to the target or to the object after that, and without them the same flight's.
        wrongly_s: how long a wrong object was claimed to be watched.
        announced: what was announced from then on.
    """

    kind: str
    known_s: float = math.inf
    least_m: float = math.inf
    wrongly_s: float = 0.0
    announced: list[str] = field(default_factory=list)


class SceneFlight(FaultedFlight):
    """One flight with a scene of the kind, drawn from the seed."""

    def __init__(self, seed, kind, flavour="arduplane"):
        self._kind, draw = kind, np.random.default_rng((seed, KINDS.index(kind)))
        self.apart_m, self._bearing_rad = float(draw.uniform(0.0, 50.0)), float(draw.uniform(-math.pi, math.pi))
        self._speed_m_s = float(draw.uniform(0.5, 3.0) if kind != "car" else draw.uniform(5.0, 15.0))
        self._course_rad, self._slope = float(draw.uniform(-math.pi, math.pi)), float(draw.uniform(0.8, 1.5))
        if kind == "swap":
            self.apart_m = float(draw.uniform(20.0, 120.0))
        self.seen = Seen(kind)
        self._object_m = None
        super().__init__(Scenario(seed, flavour, BEGIN_S + LASTS_S))

    def payload(self, rng):
        return Misled(rng, self._looks_at)

    def _object_at(self, time_s):
        """Return where the object is, east and north; the shadow has no place of its own."""
        begun, since_s = self._target.at(BEGIN_S), time_s - BEGIN_S
        apart_m = self.apart_m if self._kind in ("crossing", "swap") else 0.0
        return (
            begun.east_m
            + apart_m * math.sin(self._bearing_rad)
            + since_s * self._speed_m_s * math.sin(self._course_rad),
            begun.north_m
            + apart_m * math.cos(self._bearing_rad)
            + since_s * self._speed_m_s * math.cos(self._course_rad),
        )

    def _looks_at(self, time_s, target_m, up_m):
        if time_s < BEGIN_S or (self._kind == "swap" and time_s >= BEGIN_S + SWAP_S):
            return None
        if self._kind == "shadow":
            away_m = -self._slope * up_m
            return away_m * math.sin(self._bearing_rad), away_m * math.cos(self._bearing_rad)
        truth = self._target.at(time_s)
        own_m = truth.east_m - target_m[0], truth.north_m - target_m[1]
        object_m = self._object_at(time_s)
        return object_m[0] - own_m[0], object_m[1] - own_m[1]

    def _judge_reported(self, now_s, state):
        if now_s < BEGIN_S:
            return
        seen, snapshot, truth = self.seen, self.controller.snapshot(), self._target.at(now_s)
        here_m = state.east_m, state.north_m
        places_m = [(truth.east_m, truth.north_m)] + ([] if self._kind == "shadow" else [self._object_at(now_s)])
        seen.least_m = min(seen.least_m, *(math.dist(here_m, place_m) for place_m in places_m))
        is_claimed = not snapshot.unknown and snapshot.in_band is not None
        if not is_claimed:
            seen.known_s = min(seen.known_s, now_s - BEGIN_S)
        estimate = snapshot.estimate
        is_wrong = estimate is not None and math.dist((estimate.east_m, estimate.north_m), places_m[0]) > 30.0
        seen.wrongly_s += 0.1 * (is_claimed and is_wrong)


def flown(seed, kind, flavour="arduplane"):
    """Fly a scene; return what came of it."""
    flight = SceneFlight(seed, kind, flavour)
    flight.fly()
    flight.seen.announced = [text for at_s, text in flight.flown.announced if at_s >= BEGIN_S]
    return flight.seen

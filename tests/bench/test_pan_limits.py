"""A gimbal with pan limits next to a target outside the circle: how long it cannot look there, and what that costs.

``python -m pytest tests/bench/test_pan_limits.py -s`` flies the same targets with and without limits.
"""

from __future__ import annotations

import math

import numpy as np

from sidelong.app.simulation.payload import Payload
from sidelong.estimators.frames import wrap_rad
from tests.bench.size import size
from tests.faults.flight import ERRORS, FaultedFlight, Scenario
from tests.payload.test_flight import error_m, shares

SEEDS, DURATION_S = range(1, size(7, 2)), float(size(600, 60))
LIMITS_DEG = (180.0, 150.0, 120.0)


class PannedFlight(FaultedFlight):
    """A flight whose gimbal pans so far to each side of the nose; ``outside`` has a flag for each reading."""

    def __init__(self, scenario: Scenario, limit_rad: float) -> None:
        self.limit_rad = limit_rad
        self.outside: list[bool] = []
        super().__init__(scenario)

    def payload(self, rng):
        return _Panned(rng, self)


class _Panned(Payload):
    def __init__(self, rng, loop: PannedFlight) -> None:
        super().__init__(ERRORS, rng)
        self._loop = loop

    def measure(self, time_s, boot_ms, east_m, north_m, up_m, *, with_range=True):
        loop = self._loop
        heading_rad = loop.simulated.heading_rad
        pan_rad = wrap_rad(math.atan2(east_m, north_m) - heading_rad)
        loop.outside.append(abs(pan_rad) > loop.limit_rad)
        if loop.outside[-1]:  # it waits at its stop, and the laser hits nothing
            stop_rad, level_m = heading_rad + math.copysign(loop.limit_rad, pan_rad), math.hypot(east_m, north_m)
            east_m, north_m, with_range = level_m * math.sin(stop_rad), level_m * math.cos(stop_rad), False
        return super().measure(time_s, boot_ms, east_m, north_m, up_m, with_range=with_range)


def test_a_watch_goes_on_while_pan_limits_hide_the_target_in_each_lap():
    side_without = None
    for limit_deg in LIMITS_DEG:
        rows = []
        for seed in SEEDS:
            scenario = Scenario(seed=seed, flavour="px4" if seed % 2 else "arduplane", duration_s=DURATION_S)
            flight = PannedFlight(scenario, math.radians(limit_deg))
            flown = flight.fly()
            rows.append((100.0 * np.mean(flight.outside), *shares(flown), error_m(flown), min(flown.range_m)))
        rows = np.array(rows)
        outside, side, band, rms_m, _ = rows.mean(axis=0)
        print(
            f"\n+-{limit_deg:.0f} degrees: outside {outside:.1f} %, side {side:.1f} %, band {band:.1f} %, "
            f"error {rms_m:.2f} m, least range {rows[:, 4].min():.0f} m",
            end="",
        )
        side_without = side if side_without is None else side_without
        assert outside <= 100.0 - limit_deg / 1.8 + 1.0  # at most the share of a lap
        assert side >= side_without - 3.0
        assert rows[:, 4].min() >= 95.0

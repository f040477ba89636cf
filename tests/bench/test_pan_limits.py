"""A gimbal with pan limits: how long it cannot look at the target, on circles and on figures of eight.

``python -m pytest tests/bench/test_pan_limits.py -s`` flies the same targets with each limit, which the plan does not
know of and then knows of.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from sidelong.estimators.frames import wrap_rad
from tests.bench.size import SMOKE, size
from tests.faults.flight import ERRORS, FaultedFlight, Scenario
from tests.faulty_payload import FaultyPayload
from tests.payload.test_flight import error_m, shares

SEEDS, DURATION_S = range(1, size(13, 2)), float(size(1200, 60))
LIMITS_DEG = (150.0, 135.0, 120.0)[: size(3, 1)]
WINDS_M_S = [0.5, 1.0, 1.5, 2.0, 2.5, 3.0][: size(6, 0)]  # have their tables, as in a flight


class PannedFlight(FaultedFlight):
    """A flight whose gimbal pans so far to each side of the nose; ``outside`` has a flag for each second."""

    def __init__(self, scenario: Scenario, limit_deg: float, planned_deg: float) -> None:
        self._limit_rad = math.radians(limit_deg)
        self.outside: list[bool] = []
        configured = {"aircraft": {"pan_limit_deg": planned_deg}, "planner": {"winds_m_s": WINDS_M_S}}
        super().__init__(scenario, configured=configured)

    def payload(self, rng):
        return FaultyPayload(replace(ERRORS, pan_limit_rad=self._limit_rad), rng)

    def _judge_reported(self, now_s, state):
        truth, heading_rad = self._target.at(now_s), self.simulated.heading_rad
        bearing_rad = math.atan2(truth.east_m - state.east_m, truth.north_m - state.north_m)
        self.outside.append(abs(wrap_rad(bearing_rad - heading_rad)) > self._limit_rad)
        super()._judge_reported(now_s, state)


def flown(limit_deg: float, planned_deg: float) -> dict[str, float]:
    """Return what the flights come to, and print it."""
    rows = []
    for seed in SEEDS:
        scenario = Scenario(seed=seed, flavour="px4" if seed % 2 else "arduplane", duration_s=DURATION_S)
        flight = PannedFlight(scenario, limit_deg, planned_deg)
        one = flight.fly()
        moves = sum(decided.moved for decided in one.decided) * 3600.0 / DURATION_S
        rows.append((100.0 * np.mean(flight.outside), *shares(one), error_m(one), min(one.range_m), moves))
    rows = np.array(rows)
    outside, side, band, rms_m, _, moves = rows.mean(axis=0)
    spread = rows[:, 0].std() / math.sqrt(len(rows))
    least_m = rows[:, 4].min()
    plan = "figures of eight" if planned_deg < 180.0 else "circles"
    print(
        f"\n+-{limit_deg:.0f} degrees, {plan}: outside {outside:.1f} +- {spread:.1f} %, side {side:.1f} %, band "
        f"{band:.1f} %, error {rms_m:.2f} m, least range {least_m:.0f} m, {moves:.0f} moves/h",
        end="",
        flush=True,
    )
    return {"outside": outside, "side": side, "least_m": least_m}


def test_figures_of_eight_keep_the_target_within_pan_limits():
    flown(180.0, 180.0)
    for limit_deg in LIMITS_DEG:
        circles, eights = flown(limit_deg, 180.0), flown(limit_deg, limit_deg)
        assert circles["outside"] <= 100.0 - limit_deg / 1.8 + 1.0  # at most the share of a lap
        assert min(circles["least_m"], eights["least_m"]) >= 95.0
        if not SMOKE:  # a minute is over before the first figure of eight is
            assert eights["outside"] < 0.4 * circles["outside"]
            assert eights["outside"] - eights["side"] < circles["outside"] - circles["side"]

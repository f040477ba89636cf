"""Whole flights on what a target's beacon reports: no laser, no gimbal."""

from __future__ import annotations

import math

import numpy as np
import pytest

from sidelong.app.sharing.beacon import BeaconInput
from sidelong.estimators.sensing.readings import TargetFixReading
from tests.app.test_beacon import follow_target
from tests.faults.flight import FLAVOURS, FaultedFlight, Scenario, watched

SIGMA_M, EVERY_S, LASTING_S = 2.0, 1.0, 30.0
SILENT_S = (150.0, 165.0)


class BeaconLoop(FaultedFlight):
    """A flight with a FOLLOW_TARGET frame a second in place of a payload; its error lasts, as a receiver's does."""

    def __init__(self, scenario: Scenario) -> None:
        self._beacon = None
        super().__init__(scenario)
        self._reported: list[TargetFixReading] = []
        announced = self.flown.announced
        self._beacon = BeaconInput(
            self.telemetry.plane,
            None,
            5.0,
            lambda: self.telemetry.now_s,
            self._reported.append,
            lambda text: announced.append((0.0, text)),
        )
        self._error_m = SIGMA_M * np.random.default_rng((scenario.seed, 5)).standard_normal(2)

    def payload(self, rng):
        return None

    def step(self):
        super().step()
        now_s = self.simulated.time_s
        silent = SILENT_S[0] <= now_s < SILENT_S[1]
        if self._beacon is None or round(now_s / 0.1) % round(EVERY_S / 0.1) or silent:
            return
        kept = math.exp(-EVERY_S / LASTING_S)
        self._error_m = kept * self._error_m + SIGMA_M * math.sqrt(1 - kept**2) * self._noise.standard_normal(2)
        truth = self._target.at(now_s)
        place_m = truth.east_m + self._error_m[0], truth.north_m + self._error_m[1]
        self._beacon.datagram_received(follow_target(*place_m, sigma_m=SIGMA_M), None)
        while self._reported:
            self.put(self._reported.pop())


@pytest.mark.parametrize("flavour", FLAVOURS)
def test_a_target_is_watched_by_its_beacon_alone(flavour):
    loop = BeaconLoop(Scenario(4, flavour, 300.0))
    flown = loop.fly()
    assert watched(flown, loop.controller)
    assert [text for _, text in flown.announced if "beacon" in text] == [
        "the beacon 30 reports the target's position"
    ]
    assert all(100.0 - 3 * SIGMA_M <= range_m <= 500.0 + 3 * SIGMA_M for range_m in flown.range_m)
    assert sum(decision.moved for decision in flown.decided) >= 1
    seen_m = [one.target_error_m for one in flown.decided if one.unseen_s < 2.0]
    assert np.median(seen_m) < 2 * SIGMA_M
    assert max(seen_m) < 20.0  # within ten seconds of a sharp turn: a beacon's error is taken to last
    assert any(one.unseen_s > 10.0 for one in flown.decided)  # and when it is silent, the flight goes on

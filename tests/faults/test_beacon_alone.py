"""Whole flights on what a target's beacon reports, without a laser and with one that it contradicts."""

from __future__ import annotations

import math

import numpy as np
import pytest

from sidelong.app.sharing.beacon import BeaconInput
from sidelong.estimators.sensing.readings import TargetFixReading
from sidelong.mission.core.inputs import Input, InputState
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
            clock_s=lambda: self.telemetry.now_s,
        )
        self._error_m = SIGMA_M * np.random.default_rng((scenario.seed, 5)).standard_normal(2)

    def payload(self, rng):
        return None

    def reported_m(self, now_s: float, place_m: tuple[float, float]) -> tuple[float, float]:
        """Return what the beacon reports at a place."""
        return place_m

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
        self._beacon.datagram_received(follow_target(*self.reported_m(now_s, place_m), sigma_m=SIGMA_M), None)
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


def reported(loop: BeaconLoop) -> list[tuple[float, str]]:
    return [
        (at_s, one.text)
        for at_s, one in loop.fly().health
        if one.input is Input.SIGHTINGS and one.state is InputState.INCONSISTENT
    ]


class WithLaser(BeaconLoop):
    off_m = 0.0

    def payload(self, rng):
        return FaultedFlight.payload(self, rng)

    def reported_m(self, now_s, place_m):
        return place_m[0] + (self.off_m if now_s > 40.0 else 0.0), place_m[1]


@pytest.mark.parametrize("off_m", [0.0, 60.0, 200.0])
def test_beacon_that_is_not_where_the_laser_sees_the_target_is_reported(off_m):
    loop = WithLaser(Scenario(1, "px4", 100.0))
    loop.off_m = off_m
    found = reported(loop)
    assert len(found) == (off_m > 0.0)
    for at_s, text in found:
        assert 40.0 < at_s <= 70.0
        assert "is not where the payload sees the target" in text


class OfTwoTargets(BeaconLoop):
    def reported_m(self, now_s, place_m):
        return place_m[0] + 500.0 * (int(now_s) % 2), place_m[1]


def test_beacon_whose_positions_contradict_one_another_is_reported():
    """At 1 Hz, as slow lasers report, too."""
    found = reported(OfTwoTargets(Scenario(1, "px4", 60.0)))
    assert "do not fit one another" in found[0][1]


class Frozen(BeaconLoop):
    def reported_m(self, now_s, place_m):
        if now_s < 40.0:
            self._last_m = place_m
        return self._last_m


def test_beacon_that_repeats_its_position_is_reported_once():
    flown = Frozen(Scenario(1, "px4", 120.0)).fly()
    found = [(at_s, text) for at_s, text in flown.announced if "reported the same position" in text]
    assert len(found) == 1
    assert found[0][0] <= 65.0

"""Faults of a gimbal whose camera tracks the target without a laser, over flat ground."""

from __future__ import annotations

import math
import re
from dataclasses import replace

import numpy as np
import pytest

from sidelong.app.assembly import settle
from sidelong.app.config import Config
from sidelong.mission.core.inputs import Input, InputState
from tests.faults import flight as faults
from tests.faults.flight import HOME_DEG, FaultedFlight, Scenario
from tests.faults.flight_faults import GIMBAL, Fault, flagged, repeated, turned
from tests.faulty_payload import FaultyPayload
from tests.payload.test_camera import CAMERA

BEGIN_S, DURATION_S = 60.0, 300.0


class CameraFlight(FaultedFlight):
    def __init__(self, scenario, injected=(), camera=CAMERA):
        self._camera = camera
        super().__init__(scenario, injected)

    def payload(self, rng):
        settle(self.controller, Config.model_validate({"terrain": {"flat": True}}), faults._PLANE, HOME_DEG)
        return FaultyPayload(self._camera, rng)


def flown_with(change, begin_s=BEGIN_S):
    flight = CameraFlight(Scenario(2, "px4", DURATION_S), [Fault("gimbal", begin_s, math.inf, change)])
    return flight, flight.fly()


@pytest.mark.parametrize(
    ("made", "words"),
    [
        (lambda: flagged(44), "its frame flags are wrong"),
        (lambda: repeated(GIMBAL, "q"), "its orientation is frozen"),
    ],
    ids=["flags", "frozen"],
)
def test_wrong_flags_and_a_frozen_gimbal_are_reported_and_not_followed(made, words):
    _, flown = flown_with(made())
    found_s = [
        time_s
        for time_s, one in flown.health
        if one.input is Input.GIMBAL and one.state is InputState.INCONSISTENT and words in one.text
    ]
    assert BEGIN_S < found_s[0] <= BEGIN_S + 15.0
    assert flown.unknown_s >= DURATION_S - found_s[0] - 1.0
    assert flown.wrongly_in_band_s <= 0.02 * DURATION_S
    assert min(flown.range_m) > 80.0


@pytest.mark.parametrize(("error_deg", "begin_s"), [(90.0, 0.0), (90.0, BEGIN_S), (20.0, 0.0)])
def test_yaw_error_is_reported_and_corrected(error_deg, begin_s):
    flight, flown = flown_with(turned(error_deg), begin_s=begin_s)
    found = re.compile("the gimbal's yaw is off by about (.*) degrees, and corrected")
    said = [float(match[1]) for _, text in flown.announced if (match := found.match(text))]
    assert said[-1] == pytest.approx(error_deg, abs=5.0)
    assert math.degrees(flight.controller.tracker.calibration.yaw_bias_rad) == pytest.approx(error_deg, abs=2.0)
    assert np.median([one.target_error_m for one in flown.decided[-60:]]) < 10.0
    assert min(flown.range_m) > 80.0


def test_delay_of_the_gimbal_is_found_without_a_laser():
    flight = CameraFlight(Scenario(2, "px4", DURATION_S), camera=replace(CAMERA, gimbal_delay_s=0.8))
    flown = flight.fly()
    assert flight.controller.tracker.delays.gimbal_s == pytest.approx(0.8, abs=0.1)
    assert np.median([one.target_error_m for one in flown.decided[-60:]]) < 10.0

"""Faults of a gimbal whose camera tracks the target without a laser, over flat ground and over hills."""

from __future__ import annotations

import math
import re
from dataclasses import replace

import numpy as np
import pytest

from sidelong.estimators.terrain.ground import Ground
from sidelong.mission.core.inputs import Input, InputState
from tests.faults.flight import FaultedFlight, Scenario
from tests.faults.flight_faults import GIMBAL, Fault, flagged, repeated, turned
from tests.faulty_payload import FaultyPayload
from tests.payload.test_camera import CAMERA

BEGIN_S, DURATION_S = 60.0, 300.0


def hills() -> Ground:
    """Return hills of 50 m, 2 km around home."""
    at_m = np.arange(-2000.0, 2001.0, 30.0)
    heights_m = 25.0 + 15.0 * np.sin(at_m[None, :] / 90.0) + 10.0 * np.sin(at_m[:, None] / 130.0)
    return Ground(heights_m.astype(np.float32), -2000.0, -2000.0, 30.0, 30.0)


class CameraFlight(FaultedFlight):
    def __init__(self, scenario, injected=(), camera=CAMERA, ground=None):
        self._camera, self._ground = camera, ground
        super().__init__(scenario, injected, configured={"terrain": {"flat": ground is None}})

    def payload(self, rng):
        ground, payload = self._ground, FaultyPayload(self._camera, rng)
        if ground is not None:
            self.controller.tracker.stand_on(ground)
            measure = payload.measure

            def over_hills(time_s, boot_ms, east_m, north_m, up_m, **how):
                at = self._target.at(time_s)
                return measure(time_s, boot_ms, east_m, north_m, up_m + ground.height_m(at.east_m, at.north_m), **how)

            payload.measure = over_hills
            return payload
        return payload


def flown_with(change, begin_s=BEGIN_S, ground=None):
    faulty = [Fault("gimbal", begin_s, math.inf, change)]
    flight = CameraFlight(Scenario(2, "px4", DURATION_S), faulty, ground=ground)
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


@pytest.mark.parametrize("error_deg", [20.0, -30.0])
def test_yaw_error_is_corrected_over_hills_too(error_deg):
    flight, flown = flown_with(turned(error_deg), begin_s=0.0, ground=hills())
    said_s = [time_s for time_s, text in flown.announced if re.search("yaw is off by about .* and corrected", text)]
    assert said_s[0] < 120.0
    assert math.degrees(flight.controller.tracker.calibration.yaw_bias_rad) == pytest.approx(error_deg, abs=2.0)
    assert np.median([one.target_error_m for one in flown.decided[-60:]]) < 10.0
    assert min(flown.range_m) > 80.0


def test_sound_camera_over_hills_gives_no_warning():
    flight, flown = flown_with(lambda one, _since_s, _rng: iter([(0.0, one)]), ground=hills())
    assert not flown.health
    assert not [text for _, text in flown.announced if "yaw" in text or "delay" in text]
    assert flight.controller.tracker.delays.gimbal_s == 0.0


@pytest.mark.parametrize("ground", [None, hills()], ids=["flat", "hills"])
def test_delay_of_the_gimbal_is_found_without_a_laser(ground):
    late = replace(CAMERA, gimbal_delay_s=0.8)
    flight = CameraFlight(Scenario(2, "px4", DURATION_S), camera=late, ground=ground)
    flown = flight.fly()
    assert flight.controller.tracker.delays.gimbal_s == pytest.approx(0.8, abs=0.1)
    assert np.median([one.target_error_m for one in flown.decided[-60:]]) < 10.0

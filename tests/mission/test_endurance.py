"""The battery's endurance by the charge that is reported, and the time to fly home in wind."""

from __future__ import annotations

import math

import pytest

from sidelong.mission.control.alarms import Endurance, time_to_s
from sidelong.mission.core.plan import AircraftState
from sidelong.mission.core.requirement import Wind


def observed(lasts_s, until_s, reserve_percent=20.0, power=lambda _time_s: 1.0):
    """Return the estimate of a battery that lasts this long, reported once a second in whole percent."""
    endurance, charge = Endurance(reserve_percent), 100.0
    for second in range(int(until_s) + 1):
        endurance.take(float(second), float(int(charge)))
        charge -= 100.0 * power(second) / lasts_s
    return endurance


@pytest.mark.parametrize("lasts_s", [1200.0, 3600.0, 3.0 * 3600.0])
def test_half_of_the_battery_predicts_the_rest_within_two_percent(lasts_s):
    endurance = observed(lasts_s, 0.5 * lasts_s)
    assert endurance.left_s(0.5 * lasts_s) == pytest.approx(0.3 * lasts_s, rel=0.02)
    assert 100.0 / endurance.percent_per_s == pytest.approx(lasts_s, rel=0.02)


def test_a_stronger_consumption_shows_within_the_window():
    endurance = observed(3600.0, 2400.0, power=lambda time_s: 2.0 if time_s > 1200 else 1.0)
    assert 100.0 / endurance.percent_per_s == pytest.approx(1800.0, rel=0.02)


def test_nothing_is_predicted_from_too_little():
    assert observed(3600.0, 60.0).left_s(60.0) is None
    assert Endurance(20.0).left_s(0.0) is None


def test_another_battery_begins_another_estimate():
    endurance = observed(1200.0, 600.0)
    endurance.take(700.0, 100.0)
    assert endurance.left_s(700.0) is None


def test_a_battery_that_does_not_fall_has_no_end():
    endurance = Endurance(20.0)
    for second in range(1000):
        endurance.take(float(second), 100.0)
    assert endurance.left_s(1000.0) is None


@pytest.mark.filterwarnings("error")
def test_falls_reported_at_one_time_predict_nothing():
    endurance = Endurance(20.0)
    for percent in range(100, 40, -1):
        endurance.take(5.0, float(percent))
    assert endurance.left_s(5.0) is None


@pytest.mark.parametrize(
    ("wind", "expected_s"),
    [
        (Wind(), 100.0),
        (Wind(0.0, -5.0), 150.0),  # from ahead
        (Wind(0.0, 5.0), 75.0),
        (Wind(9.0, 0.0), 125.0),  # across: 12 m/s are left
        (Wind(0.0, -15.0), math.inf),
        (Wind(20.0, 0.0), math.inf),
    ],
)
def test_the_flight_home_takes_the_wind_into_account(wind, expected_s):
    aircraft = AircraftState(0.0, 0.0, 0.0, 0.0, 15.0, 0.0)
    assert time_to_s(aircraft, (0.0, 1500.0), 15.0, wind) == pytest.approx(expected_s)
    assert time_to_s(aircraft, (0.0, 0.0), 15.0, wind) == 0.0

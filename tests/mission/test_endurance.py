"""The battery's endurance by the charge that is reported, and the time to fly home in wind."""

from __future__ import annotations

import math

import pytest

from sidelong.mission.control.alarms import Charge, Endurance, time_to_s
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
    assert 100.0 / endurance.percent_per_s(0.5 * lasts_s) == pytest.approx(lasts_s, rel=0.02)


def test_a_stronger_consumption_shows_within_the_window():
    endurance = observed(3600.0, 2400.0, power=lambda time_s: 2.0 if time_s > 1200 else 1.0)
    assert 100.0 / endurance.percent_per_s(2400.0) == pytest.approx(1800.0, rel=0.02)


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


def reported(percent_at, until_s, volts_at=lambda _second: None):
    endurance = Endurance(20.0)
    for second in range(until_s + 1):
        endurance.take(float(second), float(percent_at(second)), volts_at(second))
    return endurance


@pytest.mark.parametrize("volts", [None, 12.6])
@pytest.mark.parametrize("lasts_s", [1, 3, 30, 90])
def test_a_reading_that_dips_changes_neither_charge_nor_consumption(lasts_s, volts):
    def percent(second):
        return 3 if 600 <= second < 600 + lasts_s else 90 - second // 60

    dipped, undisturbed = reported(percent, 900, lambda _: volts), reported(lambda second: 90 - second // 60, 900)
    assert reported(percent, 599 + lasts_s, lambda _: volts).charge.percent > 80.0 - 0.42 * lasts_s - 1.0
    assert dipped.charge.percent == 75.0
    assert dipped.charge.doubt == ""
    # The charge was followed down slowly; those falls are few.
    assert dipped.left_s(900.0) == pytest.approx(undisturbed.left_s(900.0), rel=0.02 if lasts_s < 4 else 0.75)


def test_a_sensor_that_stays_low_is_in_doubt_as_long_as_the_voltage_contradicts_it():
    stuck = reported(lambda second: 80 if second < 60 else 3, 600, lambda _: 12.6)
    assert stuck.charge.percent == 3.0
    text = "the reported charge fell from 80 to 3 % within 1 s, faster than any aircraft uses it"
    assert stuck.charge.doubt == f"{text}, and the battery still has 12.6 V"
    assert reported(lambda second: 80 if second < 60 else 3, 600).charge.doubt == ""  # no second source


def test_a_fall_that_the_voltage_confirms_is_accepted_at_once():
    charge = Charge()
    charge.take(0.0, 80.0, 12.6)
    charge.take(1.0, 10.0, 11.0)
    assert (charge.percent, charge.doubt) == (10.0, "")


def test_the_consumption_of_a_stock_simulation_is_rejected_and_forgotten():
    # PX4's simulated battery: from 100 to 50 % in 30 s, and no further; its voltage follows its charge.
    def percent(second):
        return max(50, math.ceil(100.0 - second / 0.6))

    def volts(second):
        return 4.0 * (3.6 + 0.45 * percent(second) / 100.0)

    for second in (*range(5, 200, 3), *range(200, 1200, 97)):
        endurance = reported(percent, second, volts)
        assert endurance.charge.doubt
        left_s = endurance.left_s(float(second))
        assert left_s is None or left_s > 60.0
    assert reported(percent, 1200, volts).left_s(1200.0) > 700.0


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

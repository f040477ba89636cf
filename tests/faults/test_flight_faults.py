"""Flights that a payload, a clock, a neighbour or a link would mislead, each next to the same flight without."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from sidelong.mission.control.plausibility import Plausibility
from tests.faults import flight_faults
from tests.faults.flight import FaultedFlight, Scenario
from tests.faults.flight_campaign import flight
from tests.faults.flight_faults import ALONGSIDE, HARMLESS, Fault, later, moved, only, with_fields

BEGIN_S = 60.2  # a decision falls on it
LOST_ON_SIDE_MAX = 2.0  # points


def fault(name, names, change, length_s=0.05):
    return Fault(name, BEGIN_S, BEGIN_S + length_s, only(names, lambda message, since_s, rng: change(message)))


LASER, GIMBAL, POSITION = ("DISTANCE_SENSOR",), ("GIMBAL_DEVICE_ATTITUDE_STATUS",), ("GLOBAL_POSITION_INT",)
# One thing that each misled a flight once.
MISLEADING = [
    fault("laser an hour ahead", LASER, lambda message: later(message, 3600.0)),
    fault("gimbal an hour ahead", GIMBAL, lambda message: later(message, 3600.0)),
    fault("laser beyond all time", LASER, lambda message: with_fields(message, time_boot_ms=2**32 - 1)),
    fault("1.5 km off for 1.5 s", POSITION, lambda message: moved(message, 1500.0, 0.0), 1.5),
    fault("position an hour ahead", POSITION, lambda message: later(message, 3600.0)),
    fault("position beyond all time", POSITION, lambda message: with_fields(message, time_boot_ms=2**32 - 1)),
    fault("10,000 km off", POSITION, lambda message: with_fields(message, lat=-450_000_000, lon=1_700_000_000)),
    fault("150 km off", POSITION, lambda message: moved(message, 0.0, 150_000.0)),
]


@pytest.mark.parametrize("one", MISLEADING, ids=lambda one: one.name)
def test_a_single_wrong_word_misleads_no_one(one):
    verdict = flight(3, "arduplane", [one], duration_s=110.0)
    assert not verdict.broken
    assert verdict.lost_on_side <= LOST_ON_SIDE_MAX


def test_without_the_door_each_of_them_would(monkeypatch):
    """So that the flights above are known to be able to fail."""
    monkeypatch.setattr(Plausibility, "admit", lambda self, event: (event, ()))
    for name in ("1.5 km off for 1.5 s", "position an hour ahead", "150 km off"):
        (one,) = (one for one in MISLEADING if one.name == name)
        assert flight(3, "arduplane", [one], duration_s=110.0).broken


@pytest.mark.parametrize("make", HARMLESS + ALONGSIDE, ids=lambda make: make.__name__)
def test_a_fault_neither_misleads_nor_ends_a_flight(make):
    rng = np.random.default_rng(11)
    verdicts = [
        flight(seed, flavour, [make(rng, float(rng.uniform(30.0, 90.0)))], duration_s=150.0)
        for seed, flavour in enumerate(("arduplane", "px4"))
    ]
    assert [verdict.broken for verdict in verdicts] == [[], []], [verdict.what for verdict in verdicts]


@pytest.mark.parametrize("flavour", ["arduplane", "px4"])
@pytest.mark.parametrize("ending", flight_faults.EXPECTED_YIELDS)
def test_who_else_flies_is_yielded_to(ending, flavour):
    assert not flight(4, flavour, [], duration_s=110.0, ending=(ending, 80.0)).broken


@pytest.mark.parametrize("seed", range(4))
def test_faults_that_come_together_do_not_either(seed):
    verdict = flight(seed, ("arduplane", "px4")[seed % 2], duration_s=150.0)
    assert not verdict.broken, verdict.what


def test_a_vehicles_clock_that_is_set_under_a_corrected_payload_misleads_no_one():
    # The payload has restarted, and its clock is corrected by the vehicle's, which is then set by 1.7 s and back.
    verdict = flight(20373, "px4")
    assert set(verdict.names) >= {"vehicle clock", "payload restart"}
    assert not verdict.broken, verdict.what


def test_a_wrong_velocity_next_to_complaints_of_the_ekf_misleads_no_one():
    # It was accepted, because after a complaint the place may have drifted, and led dead reckoning off.
    verdict = flight(1752, "arduplane")
    assert set(verdict.names) >= {"nonsense", "poor link"}
    assert not verdict.broken, verdict.what


def test_a_place_that_drifted_not_received_misleads_no_one():
    # GPS was lost in a silence: the first place after it was 100 m off, and GPS and EKF reported it a second later.
    verdict = flight(110239, "px4")
    assert set(verdict.names) >= {"silence", "gps lost"}
    assert not verdict.broken, verdict.what


def test_a_gimbal_that_changes_its_frame_ends_no_flight():
    # A line of sight of the body's frame, found where only the newest one was asked whether it needs the attitude.
    verdict = flight(70052, "arduplane")
    assert "payload extremes" in verdict.names
    assert not verdict.broken, verdict.what


@pytest.mark.parametrize(("seed", "flavour"), [(1207, "px4"), (1360, "arduplane")])
def test_wrong_flags_and_units_are_found_before_the_aircraft_follows_them(seed, flavour):
    # A plan was made by the wrong target; and the unit was found too late, as the aircraft flew straight.
    verdict = flight(seed, flavour)
    assert {"wrong flags", "wrong unit"} & set(verdict.names)
    assert not verdict.broken, verdict.what


def test_single_wrong_flags_do_not_stop_the_decisions():
    # Each of them looked like a jump of the target, by which nothing is decided for 15 s.
    verdict = flight(50040, "arduplane", targets=96)
    assert "payload extremes" in verdict.names
    assert not verdict.broken, verdict.what


def test_the_same_flight_again_is_the_same_to_the_last_bit():
    scenario = Scenario(7, "px4", 60.0)
    faults = [replace(flight_faults.poor_link(np.random.default_rng(3), 10.0)), MISLEADING[3]]
    first, second = (FaultedFlight(scenario, faults).fly() for _ in range(2))
    assert first.range_m == second.range_m
    assert first.announced == second.announced


def test_what_is_refused_is_reported_in_words():
    announced = FaultedFlight(Scenario(3, "arduplane", 90.0), [MISLEADING[0], MISLEADING[3]]).fly().announced
    texts = [text for _, text in announced]
    assert "the laser's clock (component 154) is 3600 s ahead: what it stamps is refused" in texts
    assert any("the position jumped by" in text and "dead reckoning" in text for text in texts)


def test_a_longer_jump_holds_the_circle_and_reports_so():
    jump = fault("2 km for 8 s", POSITION, lambda message: moved(message, -2000.0, 0.0), 8.0)
    flown = FaultedFlight(Scenario(3, "px4", 90.0), [jump]).fly()
    assert not [one for one in flown.decided if BEGIN_S + 3.3 < one.time_s < BEGIN_S + 7.9]
    texts = [text for _, text in flown.announced]
    assert any("holding the circle, nothing is decided on it" in text for text in texts)
    assert "the aircraft's position is accepted again" in texts
    assert max(one.own_error_m for one in flown.decided) < 15.0
    assert not math.isnan(flown.decided[-1].own_error_m)

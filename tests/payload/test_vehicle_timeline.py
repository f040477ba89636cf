from __future__ import annotations

import numpy as np
import pytest

from sidelong.app.link.vehicle import VehicleTimeline


def test_time_before_the_first_message_is_unknown():
    assert VehicleTimeline().vehicle_s(5.0) is None


def test_least_delayed_message_sets_the_offset():
    rng, timeline = np.random.default_rng(1), VehicleTimeline()
    for at in range(400):
        timeline.on_message(1000.0 + 0.05 * at, 0.05 * at + 0.03 + float(rng.exponential(0.05)))
    assert timeline.vehicle_s(19.0, delay_s=0.03) == pytest.approx(1019.0, abs=0.005)
    assert timeline.vehicle_s(20.5, delay_s=0.03) == pytest.approx(1020.5, abs=0.005)


def test_reboot_begins_a_new_time():
    timeline = VehicleTimeline()
    for at in range(100):
        timeline.on_message(1000.0 + 0.1 * at, 0.1 * at)
    timeline.on_message(2.0, 10.1)
    assert timeline.vehicle_s(10.2) == pytest.approx(2.1)


def test_simulation_that_waits_is_not_carried_on():
    timeline = VehicleTimeline(rate=10.0)
    for at in range(100):
        timeline.on_message(0.05 * at, 0.005 * at)
    assert timeline.vehicle_s(0.5) == pytest.approx(5.0, abs=0.02)
    assert timeline.vehicle_s(0.9) < 5.2


def test_simulation_slower_than_asked_for_is_not_ahead_of_its_stamps():
    timeline = VehicleTimeline(rate=10.0)
    for at in range(200):  # it runs at 6 times
        timeline.on_message(0.05 * at, 0.05 * at / 6.0)
    assert timeline.vehicle_s(199 * 0.05 / 6.0 + 0.004) == pytest.approx(199 * 0.05 + 0.024, abs=0.01)

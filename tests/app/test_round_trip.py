"""What of a link's measures is news to the core."""

from __future__ import annotations

from sidelong.app.link.quality import LinkReport, Measured, RoundTripWatch


def measured(round_trip_s: float | None, in_use: bool = True) -> LinkReport:
    return LinkReport("udpin://127.0.0.1:1", False, in_use, Measured(0.0, 0.0, round_trip_s, 0.0, 0.0), {})


def test_a_change_is_reported_and_noise_is_not():
    watch = RoundTripWatch()
    announced = [watch.news([measured(one)]) for one in (None, 0.3, 0.31, 0.35, 0.9, 0.8, 0.02, 0.04)]
    assert announced == [None, 0.3, None, None, 0.9, None, 0.02, None]


def test_it_is_reported_in_the_vehicles_time_which_a_busy_simulation_makes_slower():
    watch = RoundTripWatch()
    announced = [watch.news([measured(0.2)], rate) for rate in (10.0, 10.0, 2.0, 10.0)]
    assert announced == [2.0, None, 0.4, 2.0]


def test_only_the_link_in_use_counts():
    assert RoundTripWatch().news([measured(2.0, in_use=False), measured(0.1)]) == 0.1
    assert RoundTripWatch().news([]) is None

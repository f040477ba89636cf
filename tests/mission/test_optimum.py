import math
from dataclasses import replace

import numpy as np
import pytest

from sidelong.estimators.estimate import TargetEstimate, TrackQuality
from sidelong.mission.core.circle import Circle
from sidelong.mission.core.plan import AircraftState, Plan
from sidelong.mission.core.requirement import Aircraft, Requirement, Side
from sidelong.mission.geometry.wind import STILL_AIR
from sidelong.mission.paper.planner import PaperPlanner
from sidelong.mission.paper.scope import fastest_target_m_s, max_range_m, optimise, scope, threshold_bounds
from tests.plan_track import PlanTrack

AIRCRAFT = Aircraft(airspeed_m_s=10.0, radius_m=50.0)
REQUIREMENT = Requirement(100.0, 500.0, Side.LEFT, 3.0, 1.0)


def fly_straight(
    aircraft: Aircraft, requirement: Requirement, target_m_s: float, phase_rad: float
) -> tuple[list[float], int]:
    """Return the ranges of 700 s next to a straight target, and how many moves were refused."""
    planner, plan = (
        PaperPlanner(aircraft, requirement),
        Plan(Circle(0.0, 100.0 + aircraft.radius_m, aircraft.radius_m, True)),
    )
    start_m = plan.circle.position_at_course(phase_rad)
    start = AircraftState(0.0, *start_m, phase_rad, aircraft.airspeed_m_s, 1.0 / aircraft.radius_m)
    track = PlanTrack(plan, start, aircraft.airspeed_m_s)
    ranges_m, refused = [], 0
    for time_s in np.arange(0.0, 700.0, 1.0):
        state = track.state_at(float(time_s))
        ranges_m.append(math.hypot(state.east_m - target_m_s * time_s, state.north_m))
        if time_s >= plan.departure_s:
            seen = TargetEstimate(
                float(time_s), target_m_s * float(time_s), 0.0, target_m_s, 0.0,
                np.zeros((4, 4)), TrackQuality.GOOD, float(time_s),
            )  # fmt: skip
            decision = planner.decide(state, seen, plan, STILL_AIR, 0.0)
            refused += "shorter" in decision.reason
            if decision.plan is not None:
                plan = decision.plan
                track = PlanTrack(plan, track.state_at(plan.departure_s), aircraft.airspeed_m_s, before=track)
    return ranges_m, refused


def test_the_bounds_of_the_papers_example() -> None:
    bounds = threshold_bounds(AIRCRAFT, REQUIREMENT)
    assert bounds is not None
    assert bounds.least == pytest.approx(0.9081, abs=1e-4)
    assert bounds.greatest == pytest.approx(0.9767, abs=2e-4)
    assert bounds.best == pytest.approx(0.9409, abs=2e-4)
    best = replace(REQUIREMENT, threshold=bounds.best)
    assert scope(AIRCRAFT, best).straight_left_m == pytest.approx(bounds.room_m)
    assert 500.0 - max_range_m(AIRCRAFT, best) == pytest.approx(bounds.room_m, abs=1e-6)


@pytest.mark.parametrize("share", [0.0, 0.5, 1.0])
@pytest.mark.parametrize("target_m_s", [3.0, 2.2])
def test_what_is_proven_is_flown(share: float, target_m_s: float) -> None:
    bounds = threshold_bounds(AIRCRAFT, REQUIREMENT)
    assert bounds is not None
    threshold = bounds.least + share * (bounds.greatest - bounds.least)
    requirement = replace(REQUIREMENT, threshold=threshold)
    for phase_rad in (0.0, 2.0, 4.0):
        ranges_m, refused = fly_straight(AIRCRAFT, requirement, target_m_s, phase_rad)
        assert refused == 0
        assert min(ranges_m) >= 100.0 - 1e-6
        assert max(ranges_m) <= max_range_m(AIRCRAFT, requirement) + 0.1


def test_the_bound_on_the_range_is_nearly_reached() -> None:
    ranges_m = [max(fly_straight(AIRCRAFT, REQUIREMENT, 3.0, phase_rad)[0]) for phase_rad in np.arange(0.0, 6.0, 0.8)]
    assert max_range_m(AIRCRAFT, REQUIREMENT) - 10.0 < max(ranges_m) <= max_range_m(AIRCRAFT, REQUIREMENT)


def test_above_the_greatest_threshold_the_band_can_be_left() -> None:
    bounds = threshold_bounds(AIRCRAFT, REQUIREMENT)
    assert bounds is not None
    requirement = replace(REQUIREMENT, threshold=bounds.greatest + 0.05)
    assert max(max(fly_straight(AIRCRAFT, requirement, 3.0, phase)[0]) for phase in (0.0, 1.5, 3.0, 4.5)) > 500.0


@pytest.mark.parametrize(
    "requirement",
    [replace(REQUIREMENT, target_speed_max_m_s=5.0), replace(REQUIREMENT, range_max_m=199.0)],
)
def test_no_threshold_where_none_works(requirement: Requirement) -> None:
    assert threshold_bounds(AIRCRAFT, requirement) is None


def test_the_fastest_target_is_the_edge() -> None:
    fastest_m_s = fastest_target_m_s(AIRCRAFT, REQUIREMENT)
    assert fastest_m_s == pytest.approx(4.0, abs=0.05)
    assert threshold_bounds(AIRCRAFT, replace(REQUIREMENT, target_speed_max_m_s=fastest_m_s)) is not None
    assert threshold_bounds(AIRCRAFT, replace(REQUIREMENT, target_speed_max_m_s=fastest_m_s + 0.01)) is None


def test_the_best_speed_takes_all_of_the_bank() -> None:
    optimum = optimise(AIRCRAFT, REQUIREMENT, (8.0, 30.0))
    assert optimum is not None
    assert optimum.aircraft.airspeed_m_s == pytest.approx(math.sqrt(50.0 * 9.80665), abs=1e-6)
    assert optimum.aircraft.radius_m == pytest.approx(50.0)
    present = threshold_bounds(AIRCRAFT, REQUIREMENT)
    assert present is not None
    assert optimum.bounds.room_m > present.room_m
    assert optimum.target_speed_max_m_s > 8.0


def test_the_best_speed_stays_in_the_range_asked_for() -> None:
    optimum = optimise(AIRCRAFT, REQUIREMENT, (8.0, 12.0))
    assert optimum is not None and optimum.aircraft.airspeed_m_s == 12.0
    assert optimise(AIRCRAFT, replace(REQUIREMENT, target_speed_max_m_s=6.0), (8.0, 9.0)) is None

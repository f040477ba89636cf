import math

import pytest

from sidelong.mission.core.circle import Circle
from sidelong.mission.core.plan import AircraftState, Plan
from sidelong.mission.core.requirement import Wind
from sidelong.mission.geometry.follower import PlanTrack
from sidelong.mission.geometry.transition import abcd


def state(east_m: float, north_m: float, course_rad: float, time_s: float = 0.0) -> AircraftState:
    return AircraftState(time_s, east_m, north_m, course_rad, 10.0, 0.02)


def test_a_quarter_of_a_circle() -> None:
    track = PlanTrack(Plan(Circle(0.0, 150.0, 50.0, True)), state(0.0, 100.0, -math.pi / 2), 10.0)
    at = track.state_at(math.pi / 2 * 5.0)
    assert (at.east_m, at.north_m) == pytest.approx((-50.0, 150.0))
    assert at.course_rad == pytest.approx(0.0, abs=1e-9)
    assert at.curvature_per_m == pytest.approx(0.02)


@pytest.mark.parametrize("clockwise", [True, False])
def test_a_transition_is_flown_at_its_time_and_ends_on_the_circle(clockwise: bool) -> None:
    first, second = Circle(0.0, 0.0, 50.0, clockwise), Circle(400.0, 0.0, 50.0, clockwise)
    path = abcd(first, second)
    circling = PlanTrack(Plan(first), state(-50.0, 0.0, 0.0), 10.0)
    departure_s = 2 * math.pi * 5.0
    moving = PlanTrack(Plan(second, path, departure_s), circling.state_at(departure_s), 10.0, before=circling)
    assert moving.state_at(3.0) == circling.state_at(3.0)
    assert moving.arrival_s == pytest.approx(departure_s + path.length_m / 10.0)
    half_way = moving.state_at((departure_s + moving.arrival_s) / 2.0)
    assert half_way.east_m == pytest.approx(200.0, abs=1e-6)
    for time_s in (departure_s, moving.arrival_s):
        just_before, just_after = moving.state_at(time_s - 1e-6), moving.state_at(time_s + 1e-6)
        assert math.dist(
            (just_before.east_m, just_before.north_m), (just_after.east_m, just_after.north_m)
        ) == pytest.approx(2e-5, abs=2e-5)
        assert math.remainder(just_after.course_rad - just_before.course_rad, 2 * math.pi) == pytest.approx(
            0.0, abs=1e-5
        )
    after = moving.state_at(moving.arrival_s + 17.0)
    assert math.dist((after.east_m, after.north_m), (400.0, 0.0)) == pytest.approx(50.0)


def test_velocity_is_the_change_of_position_in_wind() -> None:
    track = PlanTrack(Plan(Circle(0.0, 0.0, 80.0, False)), state(80.0, 0.0, 0.0), 15.0, Wind(4.0, -3.0))
    for time_s in range(0, 60, 7):
        before, at, after = (track.state_at(time_s + dt) for dt in (-0.01, 0.0, 0.01))
        assert (after.east_m - before.east_m) / 0.02 == pytest.approx(
            at.ground_speed_m_s * math.sin(at.course_rad), abs=0.05
        )
        assert (after.north_m - before.north_m) / 0.02 == pytest.approx(
            at.ground_speed_m_s * math.cos(at.course_rad), abs=0.05
        )

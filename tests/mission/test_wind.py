import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sidelong.mission.core.circle import Circle
from sidelong.mission.core.requirement import Wind
from sidelong.mission.geometry.progress import (
    STILL_AIR,
    WindError,
    ground_speed_m_s,
    path_times_s,
)
from sidelong.mission.paper.planner import LapClock
from sidelong.mission.paper.transition import abcd

CIRCLE = Circle(0.0, 0.0, 50.0, True)


@pytest.mark.parametrize(
    ("course_deg", "speed_m_s"),
    [(90.0, 13.0), (270.0, 7.0), (0.0, math.sqrt(91.0)), (180.0, math.sqrt(91.0))],
)
def test_ground_speed_in_a_wind_that_blows_east(course_deg: float, speed_m_s: float) -> None:
    assert ground_speed_m_s(math.radians(course_deg), 10.0, Wind(3.0, 0.0)) == pytest.approx(speed_m_s)


@given(course_rad=st.floats(-math.pi, math.pi), east_m_s=st.floats(-6, 6), north_m_s=st.floats(-6, 6))
def test_the_wind_triangle_closes(course_rad: float, east_m_s: float, north_m_s: float) -> None:
    wind = Wind(east_m_s, north_m_s)
    speed_m_s = ground_speed_m_s(course_rad, 10.0, wind)
    through_air = (speed_m_s * math.sin(course_rad) - east_m_s, speed_m_s * math.cos(course_rad) - north_m_s)
    assert math.hypot(*through_air) == pytest.approx(10.0)


def test_a_wind_as_strong_as_the_aircraft_is_an_error() -> None:
    with pytest.raises(WindError, match="too strong"):
        LapClock(CIRCLE, 10.0, Wind(0.0, 10.0))


def test_a_lap_in_still_air_and_its_lengthening_in_wind() -> None:
    assert LapClock(CIRCLE, 10.0, STILL_AIR).lap_s == pytest.approx(2.0 * math.pi * 5.0)
    assert LapClock(CIRCLE, 10.0, Wind(1.0, 0.0)).lap_s == pytest.approx(2.0 * math.pi * 5.0 * 1.0075, rel=1e-3)


@given(turn_rad=st.floats(-20.0, 20.0), clockwise=st.booleans())
def test_the_lap_clock_reads_both_ways(turn_rad: float, clockwise: bool) -> None:
    clock = LapClock(Circle(0.0, 0.0, 80.0, clockwise), 15.0, Wind(3.0, -2.0))
    assert clock.turn_rad(clock.time_s(turn_rad)) == pytest.approx(turn_rad, abs=1e-9)


@pytest.mark.parametrize("clockwise", [True, False])
def test_the_lap_is_flown_faster_where_the_wind_is_astern(clockwise: bool) -> None:
    clock = LapClock(Circle(0.0, 0.0, 80.0, clockwise), 15.0, Wind(4.0, 0.0))
    to_east_rad = math.pi / 2 if clockwise else 3 * math.pi / 2  # of turn, from north
    fast_s = clock.time_s(to_east_rad + 0.1) - clock.time_s(to_east_rad - 0.1)
    assert fast_s == pytest.approx(0.2 * 80.0 / 19.0, rel=1e-2)


def test_flight_time_of_a_path() -> None:
    path = abcd(Circle(0.0, 0.0, 50.0, True), Circle(2000.0, 0.0, 50.0, True))
    still_s = path_times_s(path, 10.0, STILL_AIR)
    assert np.allclose(still_s, path.arc_m / 10.0)
    assert path_times_s(path, 10.0, Wind(5.0, 0.0))[-1] < 0.75 * still_s[-1]

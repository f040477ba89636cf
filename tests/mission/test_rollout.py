import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mission.core.requirement import Wind
from mission.geometry.trapezoid import Trapezoids
from mission.geometry.wind import path_times_s
from mission.predictive.rollout import Situation, WatchFrame, outlook

ANGLES = st.floats(-math.pi, math.pi)
METRES = st.floats(-1000.0, 1000.0)


def situation(velocity=(0.0, 0.0), wind=None):
    return Situation(velocity, wind or Wind(), 10.0, 0.0, 0.0, 0.0)


@given(ANGLES, METRES, METRES, ANGLES)
def test_left_of_the_course_is_negative_x(course_rad, ahead_m, left_m, aircraft_course_rad):
    frame = WatchFrame(50.0, -20.0, course_rad, 1.0)
    east_m = 50.0 + ahead_m * math.sin(course_rad) - left_m * math.cos(course_rad)
    north_m = -20.0 + ahead_m * math.cos(course_rad) + left_m * math.sin(course_rad)
    assert frame.place(east_m, north_m) == pytest.approx((-left_m, ahead_m), abs=1e-6)
    x_m, y_m = frame.places(np.array([east_m]), np.array([north_m]))
    assert (x_m[0], y_m[0]) == pytest.approx((-left_m, ahead_m), abs=1e-6)
    mirrored = WatchFrame(50.0, -20.0, course_rad, -1.0)
    assert mirrored.place(east_m, north_m) == pytest.approx((left_m, ahead_m), abs=1e-6)
    assert mirrored.heading_rad(aircraft_course_rad) == pytest.approx(-frame.heading_rad(aircraft_course_rad))


def test_a_target_ahead_comes_nearer_by_its_own_speed():
    arc_m = np.array([[0.0, 50.0, 100.0]])
    seen = outlook(arc_m * 0.0 - 200.0, arc_m, arc_m * 0.0, arc_m, situation((0.0, 4.0)))
    np.testing.assert_allclose(seen.time_s, [[0.0, 5.0, 10.0]])
    np.testing.assert_allclose(seen.y_m, [[0.0, 30.0, 60.0]])
    np.testing.assert_allclose(seen.x_m, -200.0)


@given(st.floats(0.0, 6.0), ANGLES)
def test_wind_changes_the_time_and_not_the_line(wind_m_s, towards_rad):
    wind = Wind(wind_m_s * math.sin(towards_rad), wind_m_s * math.cos(towards_rad))
    path = Trapezoids.between(0.02, [-0.01], [100.0], [0.02], 0.0008).path(0, 0.0, 0.0, 0.3)
    line = (path.east_m[None], path.north_m[None], path.course_rad[None], path.arc_m[None])
    calm, windy = outlook(*line, situation()), outlook(*line, situation(wind=wind))
    np.testing.assert_allclose(windy.x_m, calm.x_m)
    np.testing.assert_allclose(windy.time_s[0], path_times_s(path, 10.0, wind), atol=1e-9)

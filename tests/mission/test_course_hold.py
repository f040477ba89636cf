import math

import numpy as np
import pytest

from sidelong.estimators.estimate import TargetEstimate, TrackQuality
from sidelong.mission.viewpoint.viewpoint_kernel import course_sigma_rad
from sidelong.mission.viewpoint.watch_course import CourseHold, TargetCourse, known


def estimate(time_s, speed_m_s, course_rad, sigma_m_s=0.1):
    return TargetEstimate(
        time_s,
        0.0,
        0.0,
        speed_m_s * math.sin(course_rad),
        speed_m_s * math.cos(course_rad),
        np.diag([1.0, 1.0, sigma_m_s**2, sigma_m_s**2]),
        TrackQuality.GOOD,
        time_s,
    )


def test_there_is_no_course_until_the_target_has_moved():
    hold = CourseHold()
    assert hold.update(estimate(0.0, 0.5, 1.0)) is None
    assert hold.update(estimate(1.0, 2.0, 1.0)) == pytest.approx(1.0)


def test_a_stop_brings_back_the_course_of_three_seconds_earlier():
    hold = CourseHold()
    for time_s in range(10):
        hold.update(estimate(time_s, 4.0, 0.5))
    # Slowing down, the estimate swings about.
    hold.update(estimate(10, 2.5, 0.8))
    hold.update(estimate(11, 1.2, 1.9))
    assert hold.update(estimate(12, 0.4, -2.0)) == pytest.approx(0.5)
    assert hold.standing
    assert hold.update(estimate(50, 0.2, 3.0)) == pytest.approx(0.5)
    assert hold.update(estimate(51, 2.0, -1.0)) == pytest.approx(-1.0)


def test_a_turn_is_followed_at_once():
    hold = CourseHold()
    hold.update(estimate(0.0, 3.0, 0.0))
    assert hold.update(estimate(1.0, 3.0, 2.0)) == pytest.approx(2.0)


def test_a_speed_within_its_error_is_no_motion():
    hold = CourseHold()
    assert hold.update(estimate(0.0, 3.0, 1.0, sigma_m_s=5.0)) is None
    assert hold.update(estimate(1.0, 3.0, 1.0, sigma_m_s=1.0)) == pytest.approx(1.0)


def test_course_sigma_is_that_of_the_velocity_across():
    moving_north = TargetEstimate(
        0.0, 0.0, 0.0, 0.0, 4.0, np.diag([1.0, 1.0, 0.2**2, 3.0**2]), TrackQuality.GOOD, 0.0
    )
    assert course_sigma_rad(known(moving_north)) == pytest.approx(0.05)


def test_the_present_course_holds_through_a_stop():
    course, courses = TargetCourse(), []
    for time_s, speed_m_s in enumerate((-0.2, 3.0, -0.2)):
        course.update(estimate(float(time_s), speed_m_s, 0.0), 20.0)
        courses.append(course.present_rad)
    assert courses == [None, 0.0, 0.0]

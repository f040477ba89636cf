import math

import numpy as np
import pytest

from sidelong.estimators.estimate import TargetEstimate, TrackQuality, confidence_ellipse


def test_two_sigmas_are_not_95_percent_in_two_dimensions():
    # chi-square with two degrees of freedom: 5.991 at 95 %, so 2.4477 sigma.
    ellipse = confidence_ellipse(np.diag([9.0, 4.0]))
    assert (ellipse.semi_major_m, ellipse.semi_minor_m) == pytest.approx((7.3431, 4.8955), abs=1e-3)
    assert math.degrees(ellipse.orientation_rad) == pytest.approx(90)


@pytest.mark.parametrize("orientation_deg", [0, 30, 90, 135, 179])
def test_the_long_axis_points_along_the_compass_angle_of_the_larger_error(orientation_deg):
    angle = math.radians(orientation_deg)
    along = np.array([math.sin(angle), math.cos(angle)])
    ellipse = confidence_ellipse(25.0 * np.outer(along, along) + np.eye(2))
    assert math.degrees(ellipse.orientation_rad) == pytest.approx(orientation_deg, abs=1e-6)
    assert ellipse.semi_major_m / ellipse.semi_minor_m == pytest.approx(math.sqrt(26))


def test_it_holds_as_many_draws_as_it_promises():
    covariance = np.array([[9.0, 5.0], [5.0, 4.0]])
    draws = np.random.default_rng(1).multivariate_normal([0, 0], covariance, 20_000)
    for probability in (0.5, 0.95):
        ellipse = confidence_ellipse(covariance, probability)
        major = np.array([math.sin(ellipse.orientation_rad), math.cos(ellipse.orientation_rad)])
        minor = np.array([major[1], -major[0]])
        inside = (draws @ major / ellipse.semi_major_m) ** 2 + (draws @ minor / ellipse.semi_minor_m) ** 2 < 1
        assert inside.mean() == pytest.approx(probability, abs=0.01)


def test_an_estimate_publishes_it():
    estimate = TargetEstimate(0.0, 0.0, 0.0, 0.0, 0.0, np.diag([4.0, 1.0, 9.0, 9.0]), TrackQuality.GOOD, 0.0)
    assert estimate.ellipse_95.semi_major_m == pytest.approx(2 * 2.4477, abs=1e-3)

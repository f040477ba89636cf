import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sidelong.estimators.filters.imm import seen as seen_of
from sidelong.estimators.filters.imm_kernel import compared
from sidelong.estimators.sensing.sighting import Fix, Sighting
from tests.estimators.plain_motion import measured

DEG = math.pi / 180


def sighting(**changed):
    values = {
        "time_s": 0.0,
        "slant_range_m": 500.0,
        "bearing_rad": 90 * DEG,
        "depression_rad": math.asin(0.6),
        "range_sigma_m": 1.0,
        "bearing_sigma_rad": 0.01,
        "depression_sigma_rad": 0.005,
        "aircraft_east_m": 1000.0,
        "aircraft_north_m": 2000.0,
        "aircraft_height_m": 310.0,
    }
    return Sighting(**(values | changed))


def test_a_3_4_5_triangle_puts_the_target_400_m_east_and_300_m_down():
    seen = sighting()
    assert (seen.east_m, seen.north_m, seen.height_m) == pytest.approx((1400, 2000, 10))


def test_the_covariance_has_the_ranges_share_along_the_sight_and_the_bearings_across():
    # Along: (0.8 * 1)^2 of range and (300 * 0.005)^2 of depression; across: (400 * 0.01)^2.
    assert sighting().covariance == pytest.approx(np.diag([0.64 + 2.25, 16.0]))
    # Looking north-east, the two share out evenly and correlate.
    turned = sighting(bearing_rad=45 * DEG).covariance
    assert turned == pytest.approx(np.array([[9.445, -6.555], [-6.555, 9.445]]))


def compare(one, east_m, north_m, height_m):
    """Return residual (3,) and derivative (3, 6) of the measurement model."""
    residual, jacobian = np.empty(3), np.empty((3, 6))
    compared(seen_of(one), east_m, north_m, height_m, residual, jacobian)
    return residual, jacobian


place = st.tuples(st.floats(-400, 400), st.floats(-400, 400), st.floats(-50, 50))
aircraft = st.tuples(st.floats(-30, 30), st.floats(-30, 30), st.floats(60, 200))


@settings(max_examples=60, deadline=None)
@given(place, aircraft)
def test_the_derivative_is_that_of_what_is_expected(place, aircraft):
    east, north = place[0] - aircraft[0], place[1] - aircraft[1]
    if math.hypot(east, north) < 20 or abs(abs(math.atan2(east, north)) - math.pi) < 1e-3:
        return
    seen = sighting(
        bearing_rad=math.atan2(east, north),
        aircraft_east_m=aircraft[0],
        aircraft_north_m=aircraft[1],
        aircraft_height_m=aircraft[2],
    )
    residual, derivative = compare(seen, *place)
    plain, plain_derivative = measured(seen, *place)
    assert residual == pytest.approx(plain, abs=1e-9)
    assert derivative[:, :3] == pytest.approx(plain_derivative, abs=1e-9)
    for axis in range(3):
        ahead, behind = np.array(place), np.array(place)
        ahead[axis] += 1e-3
        behind[axis] -= 1e-3
        difference = (compare(seen, *behind)[0] - compare(seen, *ahead)[0]) / 2e-3
        assert derivative[:, axis] == pytest.approx(difference, abs=1e-6)


@settings(max_examples=60, deadline=None)
@given(st.floats(50, 600), st.floats(-math.pi, math.pi), st.floats(0.05, 1.3))
def test_a_sighting_expects_itself_where_it_puts_the_target(slant_range_m, bearing_rad, depression_rad):
    seen = sighting(slant_range_m=slant_range_m, bearing_rad=bearing_rad, depression_rad=depression_rad)
    place = (seen.east_m, seen.north_m, seen.height_m)
    residual, derivative = compare(seen, *place)
    assert residual == pytest.approx((0, 0, 0), abs=1e-9)
    there_and_back = seen.place_by_measurement @ derivative[:, :3]
    assert there_and_back == pytest.approx(np.eye(3), abs=1e-8)


def test_straight_below_the_aircraft_nothing_is_infinite():
    _, derivative = compare(sighting(), 1000.0, 2000.0, 10.0)
    assert np.isfinite(derivative).all()


def test_a_fix_is_where_it_reports():
    fix = Fix(0.0, 10.0, 20.0, 3.0)
    residual, derivative = compare(fix, 7.0, 24.0, 99.0)
    assert residual.tolist() == [3.0, -4.0, 0.0]
    assert derivative.tolist() == [[1.0, *[0.0] * 5], [0.0, 1.0, *[0.0] * 4], [0.0] * 6]
    assert fix.covariance == pytest.approx(np.diag([9.0, 9.0]))

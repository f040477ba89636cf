import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sidelong.mission.predictive.value_table import WatchCost

COST = WatchCost.inside(100.0, 500.0)


def rate(x_m, y_m, cost=COST, **wider):
    return float(cost.rate(np.array([x_m]), np.array([y_m]), **wider)[0])


def test_costs_nothing_well_inside_the_band_on_the_side():
    assert rate(-300.0, 0.0) == 0.0
    assert rate(-200.0, 200.0) == 0.0


def test_a_second_on_the_other_side_costs_one():
    assert rate(300.0, 0.0) == 1.0
    assert rate(0.0, 300.0) == pytest.approx(0.5)  # on the line itself, either way


def test_any_place_outside_the_band_costs_more_than_the_wrong_side():
    for range_m in (0.0, 50.0, 99.0, 501.0, 700.0):
        assert rate(-range_m, 0.0) > 10.0


@given(st.floats(0.0, 114.0), st.floats(0.1, 50.0))
def test_further_out_costs_more(range_m, step_m):
    assert rate(-range_m - step_m, 0.0) < rate(-range_m, 0.0)
    assert rate(-486.0 - range_m - step_m, 0.0) > rate(-486.0 - range_m, 0.0)


def test_uncertainty_widens_the_walls_but_leaves_a_middle():
    assert rate(-140.0, 0.0) == 0.0
    assert rate(-140.0, 0.0, widened_m=20.0) > 0.0
    assert rate(-300.0, 0.0, widened_m=1000.0) == 0.0


def test_a_sector_ends_at_its_edges():
    sector = WatchCost.inside(100.0, 500.0, math.radians(40.0))
    for off_deg, off in ((0.0, 0.0), (39.0, 0.0), (41.0, 1.0), (-41.0, 1.0), (180.0, 1.0)):
        angle = math.radians(off_deg)
        assert rate(-300.0 * math.cos(angle), 300.0 * math.sin(angle), sector) == off


def test_wide_circles_pay_less_where_the_gimbal_loses_the_target():
    narrow, wide = (
        WatchCost.inside(100.0, 500.0, pan_limit_rad=2.0, radius_m=radius_m) for radius_m in (40.0, 120.0)
    )
    assert narrow.lost > wide.lost == 0.0
    assert narrow.pan_limit_rad == wide.pan_limit_rad == 2.0 - math.radians(2.0)
    assert WatchCost.inside(100.0, 500.0, radius_m=40.0) == WatchCost.inside(100.0, 500.0)

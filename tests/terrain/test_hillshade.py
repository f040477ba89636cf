from __future__ import annotations

import io
import math

import numpy as np
import pytest
from matplotlib.image import imread

from sidelong.app.view.shading import hillshade
from sidelong.estimators.terrain.ground import Ground


def pixels(shade):
    """Rows from the north, (rows, columns, 4), 0..1."""
    return imread(io.BytesIO(shade.png), format="png")


def test_a_hill_is_bright_to_the_north_west_and_dark_to_the_south_east_and_level_ground_between():
    axis_m = np.arange(-1000.0, 1001.0, 20.0)
    east, north = np.meshgrid(axis_m, axis_m)
    heights = (100.0 * np.exp(-(east**2 + north**2) / 250.0**2)).astype(np.float32)
    heights[-1, -1] = np.nan
    shade = hillshade(Ground(heights, -1000.0, -1000.0, 20.0, 20.0))
    assert shade.edges_m == (-1010.0, -1010.0, 1010.0, 1010.0)
    seen = pixels(shade)
    assert seen.shape == (101, 101, 4)
    north_west, south_east = seen[40, 40], seen[60, 60]
    assert north_west[0] == 1.0 and south_east[0] == 0.0
    assert min(north_west[3], south_east[3]) > 0.1
    level = seen[95, 5]
    assert level[0] == 0.0 and 0.1 < level[3] < 0.5 * south_east[3]
    assert seen[0, -1, 3] == 0.0  # void, in the north-east


@pytest.mark.parametrize("reach_m", [math.inf, 3_000.0, 1.0])
def test_the_picture_lies_where_its_ground_is_and_stays_small(ground: Ground, reach_m: float):
    shade = hillshade(ground, reach_m)
    seen = pixels(shade)
    assert max(seen.shape) <= 1200
    west_m, south_m, east_m, north_m = shade.edges_m
    size_m = (east_m - west_m) / seen.shape[1], (north_m - south_m) / seen.shape[0]
    thin = round(size_m[0] / ground.step_east_m)
    assert size_m == pytest.approx((thin * ground.step_east_m, thin * ground.step_north_m))
    if math.isfinite(reach_m) and reach_m > 10.0:
        assert west_m >= -reach_m - size_m[0] and east_m <= reach_m + size_m[0]
        assert seen[..., 3].max() > 0.3

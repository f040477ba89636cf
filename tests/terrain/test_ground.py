from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.interpolate import RegularGridInterpolator

from sidelong.estimators.terrain.ground import Ground
from tests.terrain.patch import patch_of

# A tilted plane, which bilinear posts report exactly, with a wall 300 m long and 80 m high across it.
STEP_M = 50.0
EAST, NORTH = np.meshgrid(np.arange(61) * STEP_M - 1500.0, np.arange(61) * STEP_M - 1500.0)


def tilted(east_m: float, north_m: float) -> float:
    return 0.1 * east_m - 0.05 * north_m


PLANE = Ground(tilted(EAST, NORTH).astype(np.float32), -1500.0, -1500.0, STEP_M, STEP_M, 4.0)
WALL_M = np.where((np.abs(EAST - 500.0) < 1.0) & (np.abs(NORTH) <= 150.0), 80.0, 0.0)
WALLED = Ground(WALL_M.astype(np.float32), -1500.0, -1500.0, STEP_M, STEP_M, 4.0)


def test_heights_are_bilinear(ground: Ground) -> None:
    rows, columns = ground.heights_m.shape
    north = ground.south_m + np.arange(rows) * ground.step_north_m
    east = ground.west_m + np.arange(columns) * ground.step_east_m
    reference = RegularGridInterpolator((north, east), ground.heights_m.astype(float))
    places = np.random.default_rng(1).uniform(-8000.0, 8000.0, (2, 1000))
    assert ground.heights_at_m(*places) == pytest.approx(reference(places[::-1].T), abs=1e-3)


def test_a_patch_reports_slope_and_doubt(ground: Ground) -> None:
    patch = patch_of(PLANE, 123.0, -321.0)
    assert patch is not None
    assert (patch.slope_east, patch.slope_north) == pytest.approx((0.1, -0.05), abs=1e-6)
    assert patch.height_m == pytest.approx(tilted(123.0, -321.0), abs=1e-4)
    assert patch.sigma_m == pytest.approx(math.hypot(4.0, 0.15 * STEP_M * math.hypot(0.1, 0.05)), rel=1e-5)
    steep = patch_of(ground, 5000.0, 1000.0)
    assert steep is not None
    ahead = ground.height_m(5000.0 + 1.0, 1000.0) - ground.height_m(5000.0 - 1.0, 1000.0)
    assert steep.slope_east == pytest.approx(ahead / 2.0, abs=1e-4)


def test_doubt_of_heights_is_one_to_three_times_the_error_of_data_with_half_the_posts(ground: Ground) -> None:
    step_m = 2.0 * ground.step_east_m, 2.0 * ground.step_north_m
    coarse = Ground(ground.heights_m[::2, ::2].copy(), ground.west_m, ground.south_m, *step_m, sigma_m=0.0)
    at_m = np.random.default_rng(1).uniform(-8000.0, 8000.0, (2000, 2)).tolist()
    patches = [patch for patch in (patch_of(coarse, *one) for one in at_m) if patch is not None]
    off_m = [patch.height_m - ground.height_m(patch.east_m, patch.north_m) for patch in patches]
    doubt_m = [patch.sigma_m for patch in patches]
    assert len(patches) > 1500
    assert 1.0 <= float(np.sqrt(np.mean(np.square(doubt_m))) / np.std(off_m)) <= 3.0


def test_at_the_rim_the_last_posts_count_and_beyond_nothing_is_known() -> None:
    assert PLANE.height_m(1500.0, 1500.0) == pytest.approx(tilted(1500.0, 1500.0), abs=1e-3)
    assert math.isnan(PLANE.height_m(1500.1, 0.0))
    assert math.isnan(PLANE.height_m(0.0, math.nan))


@pytest.mark.parametrize("bearing_deg", [0, 77, 180, 301])
@pytest.mark.parametrize("depression_deg", [8, 20, 45])
def test_a_ray_is_cut_where_the_plane_is(bearing_deg: float, depression_deg: float) -> None:
    bearing_rad, depression_rad = math.radians(bearing_deg), math.radians(depression_deg)
    slope_along = 0.1 * math.sin(bearing_rad) - 0.05 * math.cos(bearing_rad)
    expected_m = 100.0 / (math.tan(depression_rad) + slope_along)
    found_m = PLANE.cut_m(0.0, 0.0, 100.0, bearing_rad, depression_rad, 5000.0)
    if expected_m > 1400.0 or expected_m < 0.0:
        assert found_m is None
    else:
        assert found_m == pytest.approx(expected_m, abs=0.02)


def test_a_ray_meets_the_first_of_two_hills_and_none_in_the_sky() -> None:
    bearing_rad = math.pi / 2
    over_m = WALLED.cut_m(0.0, 0.0, 100.0, bearing_rad, math.atan2(100.0, 1000.0), 1400.0)
    assert over_m is not None
    assert 450.0 < over_m < 500.0  # at the wall's near side, not at 1000 m
    assert WALLED.cut_m(0.0, 400.0, 100.0, bearing_rad, math.atan2(100.0, 1000.0), 1400.0) == pytest.approx(
        1000.0, abs=0.1
    )
    assert WALLED.cut_m(0.0, 0.0, 100.0, bearing_rad, -0.1, 1400.0) is None
    assert WALLED.cut_m(0.0, 0.0, -1.0, bearing_rad, 0.1, 1400.0) is None


def test_a_wall_hides_and_height_sees_over_it() -> None:
    target_m = (800.0, 0.0, 1.0)
    assert not WALLED.sees((0.0, 0.0, 100.0), target_m)
    assert WALLED.sees((0.0, 0.0, 300.0), target_m)
    assert WALLED.sees((0.0, 0.0, 100.0), (800.0, 500.0, 1.0))
    assert WALLED.sees((800.0, -300.0, 60.0), target_m)


def test_the_horizon_agrees_with_each_line_of_sight(ground: Ground) -> None:
    """Over real hills: from a place a little above the horizon the target is seen, from a little below it is not."""
    rng = np.random.default_rng(4)
    azimuths, rings, ring_m = 36, 34, 15.0
    agreed = total = 0
    for east_m, north_m in rng.uniform(-8000.0, 8000.0, (30, 2)):
        target_m = (float(east_m), float(north_m), ground.height_m(east_m, north_m) + 1.0)
        needed_m = ground.horizon_m(*target_m, azimuths, rings, ring_m)
        for i in range(azimuths):
            azimuth_rad = 2.0 * math.pi * i / azimuths
            for k in (11, 22, 33):
                distance_m = (k + 1) * ring_m
                place = (east_m + distance_m * math.sin(azimuth_rad), north_m + distance_m * math.cos(azimuth_rad))
                if needed_m[i, k] - ground.height_m(*place) < 5.0:
                    continue  # it is the aircraft that would be below the ground
                for above_m, seen in ((3.0, True), (-3.0, False)):
                    total += 1
                    agreed += ground.sees((*place, float(needed_m[i, k]) + above_m), target_m) is seen
    assert total > 3000
    assert agreed / total > 0.98  # the two sample the ground at different places

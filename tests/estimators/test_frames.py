"""The local plane against pyproj's geodesics on the same ellipsoid."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pyproj import Geod

from sidelong.estimators.frames import LocalPlane
from sidelong.sitl.world.geodesy import HomePlane

GEOD = Geod(ellps="WGS84")
LATITUDES_DEG = (-80.0, -47.4, 0.0, 30.0, 47.4, 60.0, 70.0, 80.0)


def places(latitude_deg: float, within_m: float, count: int = 200) -> list[tuple[float, float, float, float]]:
    """Return (latitude, longitude, distance, azimuth in degrees) of places around an origin near the date line."""
    rng = np.random.default_rng(3)
    azimuth_deg, distance_m = rng.uniform(-180.0, 180.0, count), within_m * np.sqrt(rng.uniform(0.0, 1.0, count))
    longitude_deg, there_deg, _ = GEOD.fwd([179.99] * count, [latitude_deg] * count, azimuth_deg, distance_m)
    return list(zip(there_deg, longitude_deg, distance_m, azimuth_deg, strict=True))


@pytest.mark.parametrize("latitude_deg", LATITUDES_DEG)
@pytest.mark.parametrize(
    ("plane_type", "within_m", "exact_m"), [(LocalPlane, 5e3, 5e-3), (LocalPlane, 5e4, 1.0), (HomePlane, 5e3, 1e-2)]
)
def test_places_are_those_of_the_geodesics(plane_type, latitude_deg, within_m, exact_m):
    plane = plane_type(latitude_deg, 179.99)
    for latitude, longitude, distance_m, azimuth_deg in places(latitude_deg, within_m):
        east_m, north_m = plane.east_north_m(latitude, longitude)
        azimuth_rad = math.radians(azimuth_deg)
        off_m = math.hypot(east_m - distance_m * math.sin(azimuth_rad), north_m - distance_m * math.cos(azimuth_rad))
        assert off_m < exact_m
        back_deg = plane.latitude_longitude_deg(east_m, north_m)
        assert GEOD.inv(back_deg[1], back_deg[0], longitude, latitude)[2] < 1e-4


@pytest.mark.parametrize("latitude_deg", LATITUDES_DEG)
def test_distances_between_places_are_those_of_the_geodesics(latitude_deg):
    plane, around = LocalPlane(latitude_deg, 179.99), places(latitude_deg, 5e3)
    for (lat_a, lon_a, *_), (lat_b, lon_b, *_) in pairwise(around):
        distance_m = math.dist(plane.east_north_m(lat_a, lon_a), plane.east_north_m(lat_b, lon_b))
        assert distance_m == pytest.approx(GEOD.inv(lon_a, lat_a, lon_b, lat_b)[2], abs=5e-3)


@settings(max_examples=200, deadline=None)
@given(st.floats(-90, 90), st.floats(-180, 180), st.floats(-90, 90), st.floats(-180, 180))
def test_what_is_far_away_never_comes_out_near(origin_latitude, origin_longitude, latitude, longitude):
    plane = LocalPlane(origin_latitude, origin_longitude)
    distance_m = GEOD.inv(origin_longitude, origin_latitude, longitude, latitude)[2]
    east_m, north_m = plane.east_north_m(latitude, longitude)
    assert math.hypot(east_m, north_m) >= 0.5 * distance_m - 1e-3
    assert all(map(math.isfinite, plane.latitude_longitude_deg(east_m, north_m)))

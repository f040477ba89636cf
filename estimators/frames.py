"""The local plane; compass angles. Source: EPSG Guidance Note 7-2, methods 9602 and 9840."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

_WGS84_SEMI_MAJOR_AXIS_M = 6_378_137.0
_WGS84_ECCENTRICITY_SQUARED = 6.694379990141e-3
_AXIS_RATIO_SQUARED = 1.0 - _WGS84_ECCENTRICITY_SQUARED

_Vector = tuple[float, float, float]


def wrap_rad(angle_rad: float) -> float:
    """Return the same angle in [-pi, pi)."""
    return (angle_rad + math.pi) % (2.0 * math.pi) - math.pi


@dataclass(frozen=True, slots=True)
class LocalPlane:
    """Tangent plane of the WGS-84 ellipsoid at a geodetic origin, x east, y north, metres.

    Points of the ellipsoid are projected along the vertical of the origin (orthographic), so both ways are exact
    inverses. Within 5 km of the origin, at any latitude, places and the distances between them are those of the
    geodesics to 5 mm; within 50 km to 1 m. North of the plane is true north at the origin: east of it the meridians
    lean by (east / 6378 km) tan(latitude), which is 0.04 degrees at 5 km and 45 degrees.

    Points beyond the horizon, as only a broken position has them, still come out far away and never near.
    """

    origin_latitude_deg: float
    origin_longitude_deg: float

    def east_north_m(self, latitude_deg: float, longitude_deg: float) -> tuple[float, float]:
        """Return a geodetic position in the plane, (east, north) from the origin, m."""
        origin, east, north, up = _axes(self.origin_latitude_deg, self.origin_longitude_deg)
        place = _earth_centred_m(latitude_deg, longitude_deg)
        offset = (place[0] - origin[0], place[1] - origin[1], place[2] - origin[2])
        east_m, north_m = _dot(offset, east), _dot(offset, north)
        if _dot(place, up) >= 0.0:
            return east_m, north_m
        # On the far half of the globe the projection comes back towards the origin: unfold it at the horizon.
        azimuth_rad = math.atan2(east_m, north_m)
        unfolded_m = 2.0 * _WGS84_SEMI_MAJOR_AXIS_M - math.hypot(east_m, north_m)
        return unfolded_m * math.sin(azimuth_rad), unfolded_m * math.cos(azimuth_rad)

    def latitude_longitude_deg(self, east_m: float, north_m: float) -> tuple[float, float]:
        """Return (latitude, longitude) of a point of the plane; beyond the horizon, those of the horizon."""
        origin, east, north, up = _axes(self.origin_latitude_deg, self.origin_longitude_deg)
        x = origin[0] + east_m * east[0] + north_m * north[0]
        y = origin[1] + east_m * east[1] + north_m * north[1]
        z = origin[2] + east_m * east[2] + north_m * north[2]
        # How far above the ellipsoid is it along the vertical? With z stretched the ellipsoid is a sphere.
        squared = 1.0 + _WGS84_ECCENTRICITY_SQUARED / _AXIS_RATIO_SQUARED * up[2] ** 2
        along_m = x * up[0] + y * up[1] + z * up[2] / _AXIS_RATIO_SQUARED
        beyond_m2 = x * x + y * y + z * z / _AXIS_RATIO_SQUARED - _WGS84_SEMI_MAJOR_AXIS_M**2
        above_m = (along_m - math.sqrt(max(along_m**2 - squared * beyond_m2, 0.0))) / squared
        x, y, z = x - above_m * up[0], y - above_m * up[1], z - above_m * up[2]
        latitude_rad = math.atan2(z, _AXIS_RATIO_SQUARED * math.hypot(x, y))
        return math.degrees(latitude_rad), (math.degrees(math.atan2(y, x)) + 180.0) % 360.0 - 180.0


@lru_cache(maxsize=8)
def _axes(latitude_deg: float, longitude_deg: float) -> tuple[_Vector, _Vector, _Vector, _Vector]:
    """Return origin, east, north and up of a tangent plane, earth-centred and earth-fixed."""
    latitude_rad, longitude_rad = math.radians(latitude_deg), math.radians(longitude_deg)
    sin_lat, cos_lat = math.sin(latitude_rad), math.cos(latitude_rad)
    sin_lon, cos_lon = math.sin(longitude_rad), math.cos(longitude_rad)
    return (
        _earth_centred_m(latitude_deg, longitude_deg),
        (-sin_lon, cos_lon, 0.0),
        (-sin_lat * cos_lon, -sin_lat * sin_lon, cos_lat),
        (cos_lat * cos_lon, cos_lat * sin_lon, sin_lat),
    )


def _earth_centred_m(latitude_deg: float, longitude_deg: float) -> _Vector:
    """Return the point of the ellipsoid (x to Greenwich, z to the pole)."""
    latitude_rad, longitude_rad = math.radians(latitude_deg), math.radians(longitude_deg)
    sin_lat, cos_lat = math.sin(latitude_rad), math.cos(latitude_rad)
    normal_m = _WGS84_SEMI_MAJOR_AXIS_M / math.sqrt(1.0 - _WGS84_ECCENTRICITY_SQUARED * sin_lat**2)
    return (
        normal_m * cos_lat * math.cos(longitude_rad),
        normal_m * cos_lat * math.sin(longitude_rad),
        normal_m * _AXIS_RATIO_SQUARED * sin_lat,
    )


def _dot(a: _Vector, b: _Vector) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]

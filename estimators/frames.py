"""The local plane, compass angles."""

from __future__ import annotations

import math
from dataclasses import dataclass

_WGS84_SEMI_MAJOR_AXIS_M = 6_378_137.0
_WGS84_ECCENTRICITY_SQUARED = 6.694379990141e-3


def wrap_rad(angle_rad: float) -> float:
    """Return the same angle in [-pi, pi)."""
    return (angle_rad + math.pi) % (2.0 * math.pi) - math.pi


def bearing_rad(east: float, north: float) -> float:
    """Return the compass angle of a vector in the plane, in (-pi, pi]; 0 for the zero vector."""
    return math.atan2(east, north)


@dataclass(frozen=True, slots=True)
class LocalPlane:
    """Tangent plane at a geodetic origin, x east, y north, metres.

    Uses the WGS-84 radii of curvature at the origin: the error against the geodesic stays below 1 m within
    5 km of the origin at latitudes up to 60 degrees.
    """

    origin_latitude_deg: float
    origin_longitude_deg: float

    def _metres_per_degree(self) -> tuple[float, float]:
        latitude_rad = math.radians(self.origin_latitude_deg)
        w = 1.0 - _WGS84_ECCENTRICITY_SQUARED * math.sin(latitude_rad) ** 2
        meridian_m = _WGS84_SEMI_MAJOR_AXIS_M * (1.0 - _WGS84_ECCENTRICITY_SQUARED) / w**1.5
        normal_m = _WGS84_SEMI_MAJOR_AXIS_M / math.sqrt(w)
        return math.radians(1.0) * normal_m * math.cos(latitude_rad), math.radians(1.0) * meridian_m

    def east_north_m(self, latitude_deg: float, longitude_deg: float) -> tuple[float, float]:
        """Return (east, north) of a geodetic position."""
        east_per_deg, north_per_deg = self._metres_per_degree()
        longitude_step_deg = (longitude_deg - self.origin_longitude_deg + 180.0) % 360.0 - 180.0
        return longitude_step_deg * east_per_deg, (latitude_deg - self.origin_latitude_deg) * north_per_deg

    def latitude_longitude_deg(self, east_m: float, north_m: float) -> tuple[float, float]:
        """Return (latitude, longitude) of a point of the plane."""
        east_per_deg, north_per_deg = self._metres_per_degree()
        longitude_deg = self.origin_longitude_deg + east_m / east_per_deg
        return self.origin_latitude_deg + north_m / north_per_deg, (longitude_deg + 180.0) % 360.0 - 180.0

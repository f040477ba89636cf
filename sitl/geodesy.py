"""The local plane at home and the geodetic positions that MAVLink speaks of."""

from __future__ import annotations

import math

_SEMI_MAJOR_M = 6_378_137.0  # WGS 84
_SEMI_MINOR_M = 6_356_752.314245


class HomePlane:
    """East and north of home, by the radii of curvature of the WGS 84 ellipsoid there."""

    __slots__ = ("_degree_east_m", "_degree_north_m", "latitude_deg", "longitude_deg")

    def __init__(self, latitude_deg: float, longitude_deg: float) -> None:
        self.latitude_deg = latitude_deg
        self.longitude_deg = longitude_deg
        cosine, sine = math.cos(math.radians(latitude_deg)), math.sin(math.radians(latitude_deg))
        squared_m2 = (_SEMI_MAJOR_M * cosine) ** 2 + (_SEMI_MINOR_M * sine) ** 2
        meridian_m = (_SEMI_MAJOR_M * _SEMI_MINOR_M) ** 2 / squared_m2**1.5
        prime_vertical_m = _SEMI_MAJOR_M**2 / math.sqrt(squared_m2)
        self._degree_north_m = math.radians(meridian_m)
        self._degree_east_m = math.radians(prime_vertical_m * cosine)

    def east_north_m(self, latitude_deg: float, longitude_deg: float) -> tuple[float, float]:
        step_deg = math.remainder(longitude_deg - self.longitude_deg, 360.0)
        return step_deg * self._degree_east_m, (latitude_deg - self.latitude_deg) * self._degree_north_m

    def latitude_longitude_deg(self, east_m: float, north_m: float) -> tuple[float, float]:
        longitude_deg = self.longitude_deg + east_m / self._degree_east_m
        return self.latitude_deg + north_m / self._degree_north_m, math.remainder(longitude_deg, 360.0)

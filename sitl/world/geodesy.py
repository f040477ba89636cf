"""The local plane at home and the geodetic positions that MAVLink speaks of."""

from __future__ import annotations

import math

_SEMI_MAJOR_M = 6_378_137.0  # WGS 84
_SEMI_MINOR_M = 6_356_752.314245
_STEPS = 5  # each gains two digits and more, even at 80 degrees


class HomePlane:
    """East and north of home, along geodesics of the WGS 84 ellipsoid (Gauss's mid-latitude formulas).

    Exact to a centimetre within 5 km at latitudes up to 80 degrees.
    """

    def __init__(self, latitude_deg: float, longitude_deg: float) -> None:
        self.latitude_deg = latitude_deg
        self.longitude_deg = longitude_deg

    def east_north_m(self, latitude_deg: float, longitude_deg: float) -> tuple[float, float]:
        """Return a geodetic position as (east, north) from home, m."""
        middle_rad = math.radians(0.5 * (self.latitude_deg + latitude_deg))
        step_rad = math.radians(math.remainder(longitude_deg - self.longitude_deg, 360.0))
        meridian_m, parallel_m = _radii_m(middle_rad)
        across_m, along_m = step_rad * parallel_m, math.radians(latitude_deg - self.latitude_deg) * meridian_m
        course_rad = math.atan2(across_m, along_m) - 0.5 * step_rad * math.sin(middle_rad)
        length_m = math.hypot(across_m, along_m)
        return length_m * math.sin(course_rad), length_m * math.cos(course_rad)

    def latitude_longitude_deg(self, east_m: float, north_m: float) -> tuple[float, float]:
        """Return a position in the plane as (latitude, longitude)."""
        length_m, course_rad = math.hypot(east_m, north_m), math.atan2(east_m, north_m)
        middle_rad, step_rad = math.radians(self.latitude_deg), 0.0
        for _ in range(_STEPS):
            middle_course_rad = course_rad + 0.5 * step_rad * math.sin(middle_rad)
            meridian_m, parallel_m = _radii_m(middle_rad)
            rise_rad = length_m * math.cos(middle_course_rad) / meridian_m
            step_rad = length_m * math.sin(middle_course_rad) / parallel_m
            middle_rad = math.radians(self.latitude_deg) + 0.5 * rise_rad
        return (
            self.latitude_deg + math.degrees(rise_rad),
            math.remainder(self.longitude_deg + math.degrees(step_rad), 360.0),
        )


def _radii_m(latitude_rad: float) -> tuple[float, float]:
    """Return the radius of curvature of the meridian, and the radius of the parallel."""
    cosine, sine = math.cos(latitude_rad), math.sin(latitude_rad)
    squared_m2 = (_SEMI_MAJOR_M * cosine) ** 2 + (_SEMI_MINOR_M * sine) ** 2
    return (_SEMI_MAJOR_M * _SEMI_MINOR_M) ** 2 / squared_m2**1.5, _SEMI_MAJOR_M**2 / math.sqrt(squared_m2) * cosine

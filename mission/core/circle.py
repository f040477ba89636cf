"""A circle in the local plane, flown one way round. Source: docs/explanation/how-it-works.md#frames-and-units."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from sidelong.estimators.numbers import convert_to_floats, require_type


@dataclass(frozen=True, slots=True)
class Circle:
    """A circle in the local plane, metres; clockwise as seen from above."""

    east_m: float
    north_m: float
    radius_m: float
    clockwise: bool

    def __post_init__(self) -> None:
        convert_to_floats(self, "east_m", "north_m", "radius_m")
        require_type(self, "clockwise", bool, np.bool_)
        if not self.radius_m > 0.0:
            raise ValueError(f"Circle.radius_m must be greater than 0, not {self.radius_m!r}")

    @property
    def curvature_per_m(self) -> float:
        """Curvature of the circle as it is flown, 1/m; positive turns right."""
        return 1.0 / self.radius_m if self.clockwise else -1.0 / self.radius_m

    def position_at_course(self, course_rad: float) -> tuple[float, float]:
        """Return the point (east, north) of the circle at which it is flown on a course, m."""
        # The centre lies to the right (cos, -sin) of a clockwise flight.
        signed_radius_m = self.radius_m if self.clockwise else -self.radius_m
        return (
            self.east_m - signed_radius_m * math.cos(course_rad),
            self.north_m + signed_radius_m * math.sin(course_rad),
        )

    def course_at(self, east_m: float, north_m: float) -> float:
        """Return the course flown at the point of the circle nearest to a position, rad."""
        outward_rad = math.atan2(east_m - self.east_m, north_m - self.north_m)
        return outward_rad + (math.pi / 2 if self.clockwise else -math.pi / 2)

    @staticmethod
    def tangent_to(east_m: float, north_m: float, course_rad: float, radius_m: float, clockwise: bool) -> Circle:
        """Return the circle that touches a ray at its origin."""
        signed_radius_m = radius_m if clockwise else -radius_m
        return Circle(
            east_m + signed_radius_m * math.cos(course_rad),
            north_m - signed_radius_m * math.sin(course_rad),
            radius_m,
            clockwise,
        )

"""A point of the plane with a height."""

from __future__ import annotations

import math
from dataclasses import dataclass

from sidelong.sitl.world.airframe import Airframe


@dataclass(frozen=True, slots=True)
class Place:
    """Height is above home."""

    east_m: float
    north_m: float
    height_m: float

    @staticmethod
    def of(craft: Airframe) -> Place:
        return Place(craft.east_m, craft.north_m, craft.height_m)

    @property
    def ground_m(self) -> tuple[float, float]:
        return self.east_m, self.north_m

    def distance_m(self, craft: Airframe) -> float:
        return math.hypot(self.east_m - craft.east_m, self.north_m - craft.north_m)

    def bearing_rad(self, other: Place) -> float:
        """Return the bearing of ``other`` from here."""
        return math.atan2(other.east_m - self.east_m, other.north_m - self.north_m)

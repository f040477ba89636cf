"""Where a stationary target would be seen. Source: Liao et al., Defence Technology 16(4), 2020, equations 1-8."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class RelativePosition:
    """The target as the aircraft sees it: horizontal range l and bearing theta."""

    range_m: float
    bearing_rad: float

    @staticmethod
    def of(east_m: float, north_m: float) -> RelativePosition:
        """Return the polar form of target minus aircraft; the bearing of a target right below is 0.

        Args:
            east_m: East of the target from the aircraft, m.
            north_m: North of the target from the aircraft, m.
        """
        return RelativePosition(math.hypot(east_m, north_m), math.atan2(east_m, north_m))

    @property
    def east_m(self) -> float:
        """Metres east of the target from the aircraft."""
        return self.range_m * math.sin(self.bearing_rad)

    @property
    def north_m(self) -> float:
        """Metres north of the target from the aircraft."""
        return self.range_m * math.cos(self.bearing_rad)

    def after_flying(self, east_m: float, north_m: float) -> RelativePosition:
        """Return where a stationary target is seen once the aircraft has flown (east, north).

        This is the exact integral of l' = -v cos(theta - psi), theta' = (v / l) sin(theta - psi) (1-4) over any
        course and speed, wind included, so it does not drift with the step.

        Args:
            east_m: Distance flown to the east, m.
            north_m: Distance flown to the north, m.
        """
        return RelativePosition.of(self.east_m - east_m, self.north_m - north_m)


def displacement_m(measured: RelativePosition, reference: RelativePosition) -> tuple[float, float]:
    """Return the error vector e (east, north): how far the target is from where a stationary one would be (5-8).

    Args:
        measured: Measured relative position.
        reference: Relative position of a stationary target.
    """
    return measured.east_m - reference.east_m, measured.north_m - reference.north_m

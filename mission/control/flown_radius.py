"""The radius the autopilot really flies, measured while circling, and the radius to ask for instead.

ArduPlane flies 116 m when asked for 100 m: its loiter law has no integral part and scales with altitude. The
ratio is steady for an aircraft at one speed, so it is measured and divided out.

Source: docs/explanation/exchange.md.
"""

from __future__ import annotations

import math

from sidelong.mission.core.circle import Circle
from sidelong.mission.core.plan import AircraftState

_MIN_RATIO, _MAX_RATIO = 0.7, 1.5


class FlownRadius:
    """Ratio of flown to commanded radius, averaged over the last lap; as given until the first whole lap is flown.

    Only samples near the circle and along it count, so that transitions do not spoil the average.
    """

    def __init__(self, ratio: float = 1.0) -> None:
        self.ratio = ratio
        self._circle: Circle | None = None
        self._turned_rad = 0.0
        self._sum_m = 0.0
        self._count = 0
        self._last_rad: float | None = None

    def observe(self, aircraft: AircraftState, commanded: Circle) -> None:
        """Process one position of the aircraft.

        Args:
            aircraft: State of the aircraft.
            commanded: The circle as it was sent to the autopilot.
        """
        if commanded != self._circle:
            self._restart(commanded)
        east_m, north_m = aircraft.east_m - commanded.east_m, aircraft.north_m - commanded.north_m
        flown_m = math.hypot(east_m, north_m)
        if not _MIN_RATIO * commanded.radius_m <= flown_m <= _MAX_RATIO * commanded.radius_m:
            self._restart(commanded)
            return
        bearing_rad = math.atan2(east_m, north_m)
        if self._last_rad is not None:
            step_rad = (bearing_rad - self._last_rad + math.pi) % (2.0 * math.pi) - math.pi
            self._turned_rad += step_rad if commanded.clockwise else -step_rad
        self._last_rad = bearing_rad
        if self._turned_rad < math.pi:
            return  # the first half lap still shows the entry
        self._sum_m += flown_m
        self._count += 1
        if self._turned_rad >= 3.0 * math.pi:
            self.ratio = self._sum_m / self._count / commanded.radius_m
            self._restart(commanded)
            self._turned_rad = math.pi  # settled: the next lap counts from here

    def _restart(self, circle: Circle) -> None:
        self._circle, self._turned_rad, self._sum_m, self._count, self._last_rad = circle, 0.0, 0.0, 0, None

    def commanded(self, wanted: Circle) -> Circle:
        """Return the circle to command so that the aircraft flies ``wanted``."""
        return Circle(wanted.east_m, wanted.north_m, wanted.radius_m / self.ratio, wanted.clockwise)

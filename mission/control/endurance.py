"""How long the battery lasts, and how long the way home takes. Source: docs/explanation/alarms.md."""

from __future__ import annotations

import math
from collections import deque

import numpy as np

from sidelong.mission.core.plan import AircraftState
from sidelong.mission.core.requirement import Wind

_WINDOW_S = 900.0
_LEAST_STEPS = 3
_ROUNDING = 0.5  # when N percent are first reported, the charge is N + 0.5 or, if it is cut off, N + 1
_LEAST_GROUND_SPEED_M_S = 1.0


class Endurance:
    """Estimates the consumption from the charge that the autopilot reports in whole percent.

    The moments at which the charge falls by a percent are exact where the charge itself is not: a line through those
    of the last 15 minutes is the consumption.

    Args:
        reserve_percent: Charge that is to be left.
    """

    def __init__(self, reserve_percent: float) -> None:
        self._reserve_percent = reserve_percent
        self._steps: deque[tuple[float, float]] = deque()  # time and charge of each fall
        self._last: tuple[float, float] | None = None

    def take(self, time_s: float, percent: float) -> None:
        """Process the reported charge.

        Args:
            time_s: Vehicle's clock, s; not earlier than the previous one.
            percent: Remaining charge, 0 to 100.
        """
        last = None if self._last is None else self._last[1]
        self._last = time_s, percent
        if last is not None and percent > last:  # another battery, or a correction
            self._steps.clear()
        elif last is not None and percent < last:
            self._steps.append((time_s, percent + _ROUNDING))
        while len(self._steps) > _LEAST_STEPS and self._steps[0][0] < time_s - _WINDOW_S:
            self._steps.popleft()

    @property
    def percent_per_s(self) -> float | None:
        """The consumption; None until the charge has fallen often enough."""
        if len(self._steps) < _LEAST_STEPS:
            return None
        time_s, percent = np.array(self._steps).T
        since_s = time_s - time_s.mean()
        spread_s2 = float((since_s**2).sum())
        if spread_s2 == 0.0:  # all reported at one time, as by a clock that stands still
            return None
        falling = -float((since_s * percent).sum()) / spread_s2
        return falling if falling > 0.0 else None

    def left_s(self, time_s: float) -> float | None:
        """Return the flight time left until the reserve.

        Args:
            time_s: Time on the vehicle's clock, s.

        Returns:
            Time, s; None while the consumption is unknown.
        """
        rate = self.percent_per_s
        if rate is None:
            return None
        fallen_s, percent = self._steps[-1]
        return (percent - self._reserve_percent) / rate - (time_s - fallen_s)


def time_to_s(aircraft: AircraftState, place_m: tuple[float, float], airspeed_m_s: float, wind: Wind) -> float:
    """Return the time of a straight flight to a position.

    Args:
        aircraft: State of the aircraft.
        place_m: The position (east, north), m.
        airspeed_m_s: Airspeed, m/s.
        wind: Estimate of the wind.

    Returns:
        Time, s; infinite if the wind prevents the flight.
    """
    east_m, north_m = place_m[0] - aircraft.east_m, place_m[1] - aircraft.north_m
    distance_m = math.hypot(east_m, north_m)
    if distance_m == 0.0:
        return 0.0
    along_m_s = (wind.east_m_s * east_m + wind.north_m_s * north_m) / distance_m
    across_m_s = (wind.east_m_s * north_m - wind.north_m_s * east_m) / distance_m
    if abs(across_m_s) >= airspeed_m_s:
        return math.inf
    ground_m_s = along_m_s + math.sqrt(airspeed_m_s**2 - across_m_s**2)
    return distance_m / ground_m_s if ground_m_s > _LEAST_GROUND_SPEED_M_S else math.inf

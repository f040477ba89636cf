"""What time it is on the vehicle's clock, by the arrival of its stamped messages."""

from __future__ import annotations

import math
from collections import deque

_REAL_WINDOW_S = 10.0
_SIMULATED_WINDOW_S, _SIMULATED_AHEAD_MAX_S = 0.5, 0.06  # a little more than the time between two stamps
_JUMP_S = 5.0


class VehicleTimeline:
    """Converts this computer's time to the vehicle's.

    The least delayed message gives the offset of the clocks. A simulated vehicle's clock runs up to ``rate`` times as
    fast. Its latest stamps show its present rate. It may pause, so it is extrapolated only for a short time.

    Args:
        rate: seconds of the vehicle's clock per second of this computer's.
    """

    def __init__(self, rate: float = 1.0) -> None:
        self._rate = rate
        real = rate == 1.0
        self._window_s = _REAL_WINDOW_S if real else _SIMULATED_WINDOW_S
        self._ahead_max_s = math.inf if real else _SIMULATED_AHEAD_MAX_S
        self._samples: deque[tuple[float, float]] = deque()  # (arrival, stamp)

    def on_message(self, stamp_s: float, arrived_s: float) -> None:
        """Take a message of the vehicle.

        Args:
            stamp_s: its stamp, s on the vehicle's clock.
            arrived_s: when it arrived, s on this computer's clock.
        """
        expected_s = self.vehicle_s(arrived_s)
        if expected_s is not None and abs(stamp_s - expected_s) > _JUMP_S:
            self._samples.clear()  # the autopilot has rebooted, or its clock was set
        self._samples.append((arrived_s, stamp_s))
        while self._samples[0][0] < arrived_s - self._window_s:
            self._samples.popleft()

    def vehicle_s(self, time_s: float, delay_s: float = 0.0) -> float | None:
        """Return the vehicle's time at a time of this computer, None before the first message.

        Args:
            time_s: s on this computer's clock.
            delay_s: the shortest delay of a message of the vehicle, s of this computer's clock.
        """
        if not self._samples:
            return None
        rate = self._present_rate()
        now_s = max(
            stamp_s + min(rate * (time_s - arrived_s), self._ahead_max_s) for arrived_s, stamp_s in self._samples
        )
        return now_s + rate * delay_s

    def _present_rate(self) -> float:
        """Return how fast the vehicle's clock runs now."""
        (first_s, from_s), (last_s, to_s) = self._samples[0], self._samples[-1]
        if self._rate == 1.0 or last_s <= first_s:
            return self._rate
        return min(max((to_s - from_s) / (last_s - first_s), 0.0), self._rate)

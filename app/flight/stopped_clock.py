"""How long the vehicle's clock has stood still."""

from __future__ import annotations


class StoppedClock:
    """Counts by this computer's clock while the vehicle's clock stands still.

    Attributes:
        seconds: For how long it has stood still; 0 once it has gone on by more than that.
    """

    def __init__(self, now_s: float, wall_s: float) -> None:
        self.seconds = 0.0
        self._now_s, self._wall_s = now_s, wall_s

    def update(self, now_s: float, wall_s: float) -> None:
        """Compare both clocks.

        Args:
            now_s: The vehicle's clock.
            wall_s: This computer's clock.
        """
        if now_s == self._now_s:
            self.seconds += wall_s - self._wall_s
        elif abs(now_s - self._now_s) > self.seconds:
            self.seconds = 0.0
        self._now_s, self._wall_s = now_s, wall_s

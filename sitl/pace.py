"""How far the simulation may go: not on without the program that flies its vehicle."""

from __future__ import annotations

import math

_LEAD_S, _LEAD_WALL_S, _LEAD_MAX_S = 0.3, 0.02, 0.75
_SILENT_MAX_S = 2.0


class Pace:
    """Limits the simulation's lead over the controlling program, which reports the time it has processed.

    The lead adds to the delay of each exchange between the two, in the vehicle's time. It is limited to the delay of
    a real link, so a busy machine slows the simulation down instead of degrading its link. The simulation does not
    wait for a program that has reported nothing yet, or nothing for two seconds of wall time.
    """

    def __init__(self, speed: float) -> None:
        self._lead_s = min(_LEAD_S + _LEAD_WALL_S * speed, _LEAD_MAX_S)
        self._reported: tuple[float, float] | None = None

    def follow(self, time_s: float, now_s: float) -> None:
        """Store that the program has processed ``time_s`` of the simulation at wall time ``now_s``."""
        self._reported = time_s, now_s

    def limit_s(self, now_s: float) -> float:
        """Return the time of the simulation that it may go to."""
        reported = self._reported
        if reported is None or now_s - reported[1] > _SILENT_MAX_S:
            return math.inf
        return reported[0] + self._lead_s

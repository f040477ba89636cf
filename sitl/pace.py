"""How far the simulation may go: not on without the program that flies its vehicle."""

from __future__ import annotations

import math

_LEAD_S, _LEAD_WALL_S, _LEAD_MAX_S = 0.3, 0.02, 0.75
_SILENT_MAX_S = 2.0


class Pace:
    """Told what time the program has come to, it lets the simulation be ahead by what a quick one needs to follow.

    The lead is what every question and answer between the two may take of the vehicle's time, whatever else the
    machine does: it is kept to what a link takes, so that a simulation gets slower rather than its link worse. A
    program that has told nothing yet, or nothing for two seconds of the wall clock, is not waited for.
    """

    def __init__(self, speed: float) -> None:
        self._lead_s = min(_LEAD_S + _LEAD_WALL_S * speed, _LEAD_MAX_S)
        self._told: tuple[float, float] | None = None

    def follow(self, time_s: float, now_s: float) -> None:
        """Hear that the program has come to ``time_s`` of the simulation, at ``now_s`` of the wall clock."""
        self._told = time_s, now_s

    def limit_s(self, now_s: float) -> float:
        """Return the time of the simulation that it may go to."""
        told = self._told
        if told is None or now_s - told[1] > _SILENT_MAX_S:
            return math.inf
        return told[0] + self._lead_s

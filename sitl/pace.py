"""How far the simulation may go: not on without the program that flies its vehicle."""

from __future__ import annotations

import math

_LEAD_S, _LEAD_WALL_S = 0.5, 0.15
_SILENT_MAX_S = 2.0


class Pace:
    """Told what time the program has come to, it lets the simulation be ahead by what a quick one needs to follow.

    lead: half a second, and what goes by in 0.15 s of the wall clock. A program that has told nothing yet, or nothing
    for two seconds of the wall clock, is not waited for.
    """

    def __init__(self, speed: float) -> None:
        self._lead_s = _LEAD_S + _LEAD_WALL_S * speed
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

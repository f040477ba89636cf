"""One target for several vehicles that are not ours, each on a clock of its own."""

from __future__ import annotations

import threading
import time

from sidelong.sitl.world.motion import Motion

_SILENT_S = 1.0  # of this computer's clock: then another vehicle's clock leads
_FAR_S = 2.0  # a vehicle's clock offset is reset at this error
_SHARE = 0.02  # share of the error corrected each time, as positions arrive at irregular intervals


class SharedTarget:
    """A target that moves by the clock of the first vehicle received. Thread-safe.

    The others' clocks are compared with that clock as their positions arrive, and follow it if a simulator falls
    behind. If the leading vehicle ends, another vehicle leads.
    """

    def __init__(self, motion: Motion) -> None:
        self._motion, self._lock = motion, threading.Lock()
        self._now_s = self._asked_s = 0.0
        self._leader: _Seen | None = None
        self._led_s = 0.0

    def seen_from(self, home_east_m: float) -> Motion:
        """Return its motion in the plane of a home this far east of the first one, by the caller's clock."""
        return _Seen(self, home_east_m)

    def at(self, seen: _Seen, time_s: float) -> tuple[float, float]:
        with self._lock:
            wall_s = time.monotonic()
            if self._leader is None or (seen is not self._leader and wall_s - self._led_s > _SILENT_S):
                self._leader = seen
            if seen.offset_s is None:
                seen.offset_s = self._now_s - time_s
            if seen is self._leader:
                self._led_s, self._now_s = wall_s, time_s + seen.offset_s
            else:
                off_s = self._now_s - time_s - seen.offset_s
                seen.offset_s += off_s if abs(off_s) > _FAR_S else _SHARE * off_s
            self._asked_s = max(self._asked_s, time_s + seen.offset_s)
            return self._motion.at(self._asked_s)


class _Seen:
    """Implements :class:`sidelong.sitl.world.motion.Motion`."""

    def __init__(self, target: SharedTarget, home_east_m: float) -> None:
        self._target, self._home_east_m = target, home_east_m
        self.offset_s: float | None = None

    def at(self, time_s: float) -> tuple[float, float]:
        east_m, north_m = self._target.at(self, time_s)
        return east_m - self._home_east_m, north_m

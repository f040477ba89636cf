"""The time of day by the vehicle's clock: a simulation at ten times the speed leaves a log of its true length."""

from __future__ import annotations

import threading

from sidelong.app.link.frames import Frame

_ATTITUDE, _GLOBAL_POSITION_INT = 30, 33
_AUTOPILOT_COMPONENT = 1
_LATE_MAX_S = 1.0  # messages of one moment overtake one another
_SPEED_MAX, _AHEAD_MAX_S = 100.0, 5.0  # what a clock may gain over the wall's, and at once


class VehicleTime:
    """Gives each frame, from any thread, the wall's time at the first one carried on by the vehicle's stamps.

    ATTITUDE and GLOBAL_POSITION_INT of the autopilot of ``system_id`` (None: of the first that speaks) move it.
    Where the vehicle's clock jumps it is carried on by the wall's.
    """

    def __init__(self) -> None:
        self.system_id: int | None = None
        self._lock = threading.Lock()
        self._now_s: float | None = None
        self._wall_s = 0.0  # when now_s was moved
        self._boot_s: float | None = None  # the vehicle's time then

    def stamp_s(self, frame: bytes, wall_s: float) -> float:
        """Return the time of a frame that came or went at ``wall_s``, seconds since 1970."""
        with self._lock:
            if self._now_s is None:
                self._now_s, self._wall_s = wall_s, wall_s
            boot_s = self._boot_time_s(frame)
            if boot_s is not None:
                self._move(boot_s, wall_s)
            elif self._boot_s is None:
                self._now_s += max(wall_s - self._wall_s, 0.0)
                self._wall_s = wall_s
            return self._now_s

    def _move(self, boot_s: float, wall_s: float) -> None:
        assert self._now_s is not None
        waited_s = max(wall_s - self._wall_s, 0.0)
        gained_s = waited_s if self._boot_s is None else boot_s - self._boot_s
        if -_LATE_MAX_S < gained_s < 0.0:
            return
        if not 0.0 <= gained_s <= _SPEED_MAX * waited_s + _AHEAD_MAX_S:
            gained_s = waited_s
        self._now_s += gained_s
        self._wall_s, self._boot_s = wall_s, boot_s

    def _boot_time_s(self, frame: bytes) -> float | None:
        """Return time_boot_ms of a frame that moves the time, in seconds."""
        read = Frame(frame)
        if read.component_id != _AUTOPILOT_COMPONENT or read.message_id not in {_ATTITUDE, _GLOBAL_POSITION_INT}:
            return None
        if self.system_id is None:
            self.system_id = read.system_id
        return int.from_bytes(read.payload[:4], "little") * 1e-3 if read.system_id == self.system_id else None

"""Writes a telemetry log (tlog) while flying: received and sent frames, as QGroundControl and others open them."""

from __future__ import annotations

import struct

from sidelong.app.records.appender import Appender

_STAMP = struct.Struct(">Q")


class TlogWriter(Appender):
    """Takes whole MAVLink frames from any thread."""

    def write(self, frame: bytes, time_s: float) -> None:
        """Append a frame that was received or sent at ``time_s``, seconds since 1970."""
        self.append(_STAMP.pack(round(time_s * 1e6)) + frame)

"""Writes a telemetry log (tlog) while flying: received and sent frames, as QGroundControl and others open them."""

from __future__ import annotations

import struct
from collections.abc import Callable
from pathlib import Path
from types import TracebackType
from typing import Self

from app.records.appender import Appender

_STAMP = struct.Struct(">Q")


class TlogWriter:
    """Takes frames from any thread and never raises into the flight. Use as ``with``.

    on_trouble gets one sentence when the recording has ended early (full disk). Raises OSError when the file exists
    or cannot be made.
    """

    def __init__(self, path: Path, on_trouble: Callable[[str], None]) -> None:
        self._appender = Appender(path, on_trouble)

    def write(self, frame: bytes, time_s: float) -> None:
        """Append one whole MAVLink frame that was received or sent at ``time_s``, seconds since 1970."""
        self._appender.append(_STAMP.pack(round(time_s * 1e6)) + frame)

    def close(self) -> None:
        self._appender.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

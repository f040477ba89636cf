"""A file that grows while something flies: bytes go in from any thread and reach the disk from one of its own.

Nothing here ever holds up or ends a flight: a slow disk makes the backlog grow up to a limit, a full or vanished
one ends the recording. Both are reported once through ``on_trouble``.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Self

_WRITE_EVERY_S = 0.25
_BACKLOG_MAX_BYTES = 64 << 20
_CLOSE_TIMEOUT_S = 5.0


class Appender:
    """Appends to ``path``, which must not exist yet. Use as ``with``.

    ``opening`` reaches the kernel immediately, appended data after 0.25 s: a killed process loses at most that.
    on_trouble gets one sentence when the recording has ended early, from the thread that found out. Raises OSError
    when the file, which is its owner's alone, exists or cannot be made; after that nothing raises.
    """

    def __init__(self, path: Path, on_trouble: Callable[[str], None], opening: bytes = b"") -> None:
        self._path, self._on_trouble = path, on_trouble
        self.failure = ""  # why the recording has ended early
        self._file = os.fdopen(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "wb", buffering=0)
        while opening:  # a disk that is almost full takes a part, and the error comes with the next
            opening = opening[self._file.write(opening) or 0 :]
        self._lock = threading.Lock()
        self._backlog: list[bytes] = []
        self._backlog_bytes = 0
        self._ended = False
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._run, name=f"record {path.name}", daemon=True)
        self._thread.start()

    def append(self, data: bytes) -> None:
        """Add ``data``, whole or not at all; after the recording has ended it does nothing."""
        with self._lock:
            if self._ended:
                return
            if self._backlog_bytes + len(data) <= _BACKLOG_MAX_BYTES:
                self._backlog.append(data)
                self._backlog_bytes += len(data)
                return
        self._end(f"the disk of {self._path} is too slow")

    def close(self) -> None:
        """Write what is left, then close the file."""
        self._closing.set()
        self._thread.join(_CLOSE_TIMEOUT_S)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _run(self) -> None:
        closing = False
        while not closing and not self._ended:
            closing = self._closing.wait(_WRITE_EVERY_S)
            with self._lock:
                data = b"".join(self._backlog)
                self._backlog.clear()
                self._backlog_bytes = 0
            try:
                while data:
                    data = data[self._file.write(data) or 0 :]
            except OSError as error:
                self._end(f"{self._path} cannot be written ({error.strerror})")
        with self._lock:
            self._ended = True
        self._file.close()

    def _end(self, why: str) -> None:
        with self._lock:
            already, self._ended = self._ended, True
            self._backlog.clear()
        if not already:
            self.failure = why
            self._on_trouble(f"recording has ended: {why}; the flight goes on.")

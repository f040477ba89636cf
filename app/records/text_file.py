"""Files: texts within bounds, with errors of one sentence, written whole or not at all; long ones mapped."""

from __future__ import annotations

import codecs
import contextlib
import mmap
import os
import shutil
import threading
import tomllib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Self

from sidelong.app.errors import InputError

_CONFIG_MAX_BYTES = 256 << 10
_REASON_MAX = 160  # characters


def read_text(path: Path, max_bytes: int, remedy: str) -> str:
    """Return a UTF-8 file's text. Raises InputError, which ends in ``remedy``, for what is none or too long."""
    try:
        if path.exists() and not path.is_file():
            raise InputError(f"{path}: is no file; {remedy}.")
        with path.open("rb") as file:
            data = file.read(max_bytes + 1)
    except (OSError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) else str(error)
        raise InputError(f"{path}: cannot be read ({reason}); {remedy}.") from error
    if len(data) > max_bytes:
        raise InputError(f"{path}: is longer than {max_bytes >> 10} KiB; {remedy}.")
    if data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        raise InputError(f"{path}: is text in UTF-16; save it as UTF-8 (in an editor: Save as, encoding UTF-8).")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: is not text in UTF-8 (byte {error.start}); {remedy}.") from error


@contextlib.contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """Yield the name to write to; it becomes ``path`` once it is whole. Pipes and devices are written directly."""
    whole = path.is_file() or not path.exists()
    path = path.resolve() if whole else path  # a symbolic link stays one
    partial = path.with_name(f"{path.name}.partial") if whole else path
    try:
        yield partial
        if whole:
            if path.exists():
                shutil.copymode(path, partial)
            partial.replace(path)
    finally:
        if whole:
            partial.unlink(missing_ok=True)


def write_text(path: Path, text: str) -> None:
    """Write a file whole or not at all. Raises OSError."""
    with whole_file(path) as partial, partial.open("w", encoding="utf-8") as file:
        file.write(text)
        file.flush()
        if partial != path:  # a pipe has no disk
            os.fsync(file.fileno())


def read_toml(path: Path) -> dict[str, Any]:
    """Return the values of a TOML file. Raises InputError naming the file, what is wrong and the way out."""
    remedy = "give the path of a TOML file (sidelong init writes one)"
    text = read_text(path, _CONFIG_MAX_BYTES, remedy)
    try:
        return tomllib.loads(text)
    except (RecursionError, ValueError) as error:
        reason = "brackets are nested too deep" if isinstance(error, RecursionError) else str(error)[:_REASON_MAX]
        raise InputError(f"{path}: is not valid TOML: {reason}; correct it.") from error


Progress = Callable[[float], None]
"""Called with the completed fraction, 0 to 1."""


def unseen(_share: float) -> None:
    """Show no progress."""


@contextmanager
def mapped(path: Path) -> Iterator[mmap.mmap | bytes]:
    """Map a file into memory; an empty one cannot be mapped and is b''. Raises OSError."""
    with path.open("rb") as opened:
        if path.stat().st_size == 0:
            yield b""
            return
        with mmap.mmap(opened.fileno(), 0, access=mmap.ACCESS_READ) as data:
            yield data


_WRITE_EVERY_S = 0.25
_BACKLOG_MAX_BYTES = 64 << 20
_CLOSE_TIMEOUT_S = 5.0


class Appender:
    """Appends to a new file of its owner alone, from any thread, and never delays or ends a flight. Use as ``with``.

    ``opening`` reaches the kernel immediately, other data after 0.25 s: a killed process loses at most that. If the
    disk is full, gone or too slow, the recording ends, and on_trouble gets one sentence. Only the constructor raises
    OSError.
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

"""Long files, read without being held in memory."""

from __future__ import annotations

import mmap
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

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

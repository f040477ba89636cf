"""Looks at a long file piece by piece, so that memory does not grow with it."""

from __future__ import annotations

import mmap
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

Progress = Callable[[float], None]
"""Called with the completed fraction, 0 to 1."""

WINDOW_BYTES = 2 << 20


class Window(NamedTuple):
    """``data[own_begin:own_end]`` belongs to this window and to no other; the rest overlaps its neighbours."""

    data: bytes
    own_begin: int
    own_end: int
    at_end: bool  # of the file


def windows(path: Path, margin_bytes: int, progress: Progress | None = None) -> Iterator[Window]:
    """Yield the file's windows in order, each with up to ``margin_bytes`` of its neighbours on both sides."""
    if path.stat().st_size == 0:
        return  # cannot be mapped
    with path.open("rb") as opened, mmap.mmap(opened.fileno(), 0, access=mmap.ACCESS_READ) as file:
        size = len(file)
        for begin in range(0, size, WINDOW_BYTES):
            end = min(begin + WINDOW_BYTES, size)
            before = min(begin, margin_bytes)
            data = file[begin - before : end + margin_bytes]
            yield Window(data, before, before + end - begin, end + margin_bytes >= size)
            if hasattr(file, "madvise"):
                file.madvise(mmap.MADV_DONTNEED)
            if progress:
                progress(end / size)

"""Give back memory that only the preparation of a flight needs."""

from __future__ import annotations

import contextlib
import ctypes
import re
from pathlib import Path

_MADV_DONTNEED = 4
_COMPILER = re.compile(r"([0-9a-f]+)-([0-9a-f]+) r-xp .*/libllvmlite\.so$")


def release_unused_code() -> None:
    """Drop the pages of the compiler's own code (60 MB): no step of a flight compiles.

    Code is never written to, so pages that are called for again come from the file.
    """
    with contextlib.suppress(OSError, AttributeError):
        advise = ctypes.CDLL(None).madvise
        for line in Path("/proc/self/maps").read_text().splitlines():
            found = _COMPILER.match(line)
            if found:
                begin, end = (int(one, 16) for one in found.groups())
                advise(ctypes.c_void_p(begin), ctypes.c_size_t(end - begin), _MADV_DONTNEED)

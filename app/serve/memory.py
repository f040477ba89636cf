"""Keep the resident program small: one heap, and nothing that only the preparation of a flight needs."""

from __future__ import annotations

import contextlib
import ctypes
import gc
import re
from pathlib import Path

_MADV_DONTNEED, _M_ARENA_MAX = 4, -8
_LIBRARY = re.compile(r"([0-9a-f]+)-([0-9a-f]+) r-[x-]p .*/[^/]*\.so[.\d]*$")


def share_one_heap() -> None:
    """Let the threads that begin from now on allocate from one heap: each one of their own keeps unused memory."""
    with contextlib.suppress(OSError, AttributeError):  # another system, or another C library
        ctypes.CDLL(None).mallopt(_M_ARENA_MAX, 1)


def release_unused() -> None:
    """Drop the pages of the libraries' code and constants (100 MB), and return freed memory to the system.

    Most were needed for the preparation only, the compiler's above all. Pages that are called for again come from the
    file.
    """
    gc.collect()
    with contextlib.suppress(OSError, AttributeError):  # another system, or another C library
        library, region = ctypes.CDLL(None), None
        for line in Path("/proc/self/smaps").read_text().splitlines():
            region = _LIBRARY.match(line) or region
            if region and line.startswith("Anonymous:"):
                if line.split()[1] == "0":  # no page differs from the file's
                    begin, end = (int(one, 16) for one in region.groups())
                    library.madvise(ctypes.c_void_p(begin), ctypes.c_size_t(end - begin), _MADV_DONTNEED)
                region = None
        library.malloc_trim(0)

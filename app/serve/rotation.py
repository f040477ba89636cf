"""Keeps run folders within a disk budget: the oldest are deleted first, the present one never."""

from __future__ import annotations

import contextlib
import re
import shutil
from datetime import UTC, datetime, timedelta
from pathlib import Path

_RUN = re.compile(r"(\d{8}T\d{6}Z)")  # how a run folder's name begins; nothing else is touched
_STAMP = "%Y%m%dT%H%M%SZ"


def rotate(parent: Path, budget_bytes: float, keep: timedelta, now: datetime, present: Path | None = None) -> int:
    """Delete run folders that are too old or beyond the budget; return the bytes that the others take.

    Args:
        parent: Where the run folders are.
        budget_bytes: What all of them may take together.
        keep: How old they may become.
        now: The time in UTC.
        present: The run that is being written.
    """
    total = 0
    for begun, run in sorted(_runs(parent), reverse=True):  # newest first
        size = _size(run)
        too_old = now - begun > keep
        if run != present and (too_old or total + size > budget_bytes):
            shutil.rmtree(run, ignore_errors=True)
            size = _size(run)  # what could not be deleted
        total += size
    return total


def _runs(parent: Path) -> list[tuple[datetime, Path]]:
    found = []
    with contextlib.suppress(OSError):
        for path in parent.iterdir():
            match = _RUN.match(path.name)
            if match and path.is_dir() and not path.is_symlink():
                with contextlib.suppress(ValueError):
                    found.append((datetime.strptime(match[1], _STAMP).replace(tzinfo=UTC), path))
    return found


def _size(run: Path) -> int:
    size = 0
    with contextlib.suppress(OSError):  # a person may delete it in the meantime
        for path in run.rglob("*"):
            with contextlib.suppress(OSError):
                size += path.lstat().st_blocks * 512
    return size

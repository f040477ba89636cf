"""Times as a person reads them."""

from __future__ import annotations


def clock(time_s: float) -> str:
    """Return minutes:seconds."""
    return f"{int(time_s // 60):d}:{int(time_s % 60):02d}"

"""How much a benchmark does: all of it, or with SIDELONG_SMOKE=1 just enough to show that it still runs."""

from __future__ import annotations

import os

SMOKE = os.environ.get("SIDELONG_SMOKE") == "1"


def size(full: int, smoke: int, name: str = "") -> int:
    """Return how much to do.

    Args:
        full: what the benchmark is meant to do.
        smoke: what shows that it runs.
        name: of an environment variable that sets the number; "": there is none.
    """
    return int(os.environ.get(name) or (smoke if SMOKE else full))


def numbers(full: int, smoke: int, name: str) -> range:
    """Return the numbers of what is flown, of as many as ``size`` returns; the variable FIRST: the first of them."""
    return range(int(os.environ.get("FIRST") or 0), size(full, smoke, name))

"""Where a function of one number is zero; scipy does it, and is loaded only when there is a root to find.

Source: Brent, *Algorithms for Minimization without Derivatives*, 1973, chapter 4.
"""

from __future__ import annotations

from collections.abc import Callable


def root(function: Callable[[float], float], low: float, high: float, tolerance: float = 2e-12) -> float:
    """Return where ``function`` is zero between ``low`` and ``high`` (Brent's method).

    Raises:
        ValueError: It has the same sign at both ends.
    """
    from scipy.optimize import brentq  # noqa: PLC0415  # a third of a second

    return float(brentq(function, low, high, xtol=tolerance))

"""How the figures look: one hand for all of them."""

from __future__ import annotations

from contextlib import AbstractContextManager
from typing import Any

import matplotlib
from matplotlib.axes import Axes
from matplotlib.figure import Figure

AIRCRAFT, TARGET, ESTIMATE = "#1f5f9e", "#c2541b", "#8a5fa8"
BAND, CIRCLE, BAD, FAINT, ROUTE = "#cfe6d3", "#9fb4c8", "#c0262d", "#8c8c8c", "#f0dca8"

WIDTH_IN = 9.0

_STYLE: dict[str, Any] = {
    "font.family": "sans-serif",
    "font.size": 9.5,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "#e4e4e4",
    "grid.linewidth": 0.6,
    "axes.edgecolor": "#707070",
    "legend.frameon": False,
    "legend.fontsize": 9,
    "path.simplify_threshold": 0.3,
    "svg.fonttype": "none",  # text stays text: smaller, and can be searched
    "svg.hashsalt": "sidelong",  # the same flight gives the same file
}


def figure(height_in: float, rows: int = 1) -> tuple[Figure, list[Axes]]:
    """Return a figure and its axes, one below the other over the same x."""
    made = Figure(figsize=(WIDTH_IN, height_in), layout="constrained")
    axes = made.subplots(rows, 1, sharex=True, squeeze=False)
    return made, list(axes[:, 0])


def styled() -> AbstractContextManager[None]:
    """Return the context in which figures are made and written."""
    return matplotlib.rc_context(_STYLE)  # type: ignore[arg-type]  # keys are literals to the checker


def legend_above(axes: Axes) -> None:
    """Put the legend where it hides nothing."""
    axes.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=5, borderaxespad=0.2, columnspacing=1.4)

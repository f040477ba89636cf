"""Options that more than one command has, and the panels of ``--help`` in which options stand."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import typer


def panel(name: str) -> Callable[..., Any]:
    """Return what describes the options of one panel."""
    return partial(typer.Option, rich_help_panel=name)


AIRCRAFT = panel("Aircraft and requirement")
MAP = panel("Live map")
OUTPUT = panel("Output")

PortOption = Annotated[int, MAP(min=0, max=65535, help="Port of the live map.")]
MapOption = Annotated[
    Path | None,
    MAP(
        "--map",
        metavar="FILE",
        help="Map below the tracks: raster tiles (.mbtiles, .pmtiles), or a picture with --map-bounds.",
    ),
]
BoundsOption = Annotated[str | None, MAP(metavar="S,W,N,E", help="Bounds of that picture, degrees.")]

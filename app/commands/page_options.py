"""Options of the live map that more than one command has."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

PortOption = Annotated[int, typer.Option(min=0, max=65535, help="Port of the live map.", rich_help_panel="Live map")]
MapOption = Annotated[
    Path | None,
    typer.Option(
        "--map",
        metavar="FILE",
        help="Map below the tracks: raster tiles (.mbtiles, .pmtiles), or a picture with --map-bounds.",
        show_default=False,
        rich_help_panel="Live map",
    ),
]
BoundsOption = Annotated[
    str | None,
    typer.Option(
        metavar="S,W,N,E", help="Bounds of that picture, degrees.", show_default=False, rich_help_panel="Live map"
    ),
]

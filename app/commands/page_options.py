"""Options of the live map that more than one command has."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

PortOption = Annotated[int, typer.Option(min=0, max=65535, help="Port of the live map.")]
MapOption = Annotated[
    Path | None,
    typer.Option(
        "--map",
        metavar="FILE",
        help="Lies under the live map: raster tiles (.mbtiles, .pmtiles), or a picture with --map-bounds.",
        show_default=False,
    ),
]
BoundsOption = Annotated[
    str | None, typer.Option(metavar="S,W,N,E", help="Where that picture lies, degrees.", show_default=False)
]

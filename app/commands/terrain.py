"""``sidelong terrain``: what elevation data covers."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer
from rich.table import Table

from sidelong.app.commands.output import JsonOption, checked_output, console, say, write_json
from sidelong.app.errors import InputError
from sidelong.app.terrain.elevation_data import Bounds, Coverage, ElevationData


def terrain(
    folder: Annotated[Path, typer.Argument(help="Folder of SRTM .hgt tiles or GeoTIFF files, or one of them.")],
    bounds: Annotated[
        str | None, typer.Option(metavar="S,W,N,E", help="Degrees; without it the outline of all tiles.")
    ] = None,
    json: JsonOption = None,
) -> None:
    """Show the area that elevation data covers and where it is void.

    For example:
      sidelong terrain dem
      sidelong terrain dem --bounds 36.4,-84.5,36.8,-84.0
    """
    checked_output(json)
    data = ElevationData(folder)
    coverage = data.coverage(_bounds(bounds) if bounds is not None else _outline(data))
    table = Table("tile", "spacing", "covers", "void", "heights above sea", box=None, pad_edge=False)
    for tile in coverage.tiles:
        heights = "-" if tile.lowest_m is None else f"{tile.lowest_m:.0f} to {tile.highest_m:.0f} m"
        table.add_row(
            tile.path.name,
            f"{tile.spacing_m:.0f} m",
            f"{100.0 * tile.covered:.1f} %",
            f"{100.0 * tile.void:.1f} %",
            heights,
        )
    console.print(table)
    say(_words(coverage))
    write_json(json, _as_json(coverage))


def _words(coverage: Coverage) -> str:
    b = coverage.bounds
    missing = 1.0 - coverage.covered - coverage.void
    shares = ((coverage.covered, "covered"), (coverage.void, "void"), (max(missing, 0.0), "without a tile"))
    where = f"{b.south_deg:g},{b.west_deg:g} to {b.north_deg:g},{b.east_deg:g}"
    return f"{where}: " + ", ".join(f"{100.0 * share:.1f} % {what}" for share, what in shares)


def _as_json(coverage: Coverage) -> dict[str, Any]:
    b = coverage.bounds
    return {
        "bounds_deg": [b.south_deg, b.west_deg, b.north_deg, b.east_deg],
        "covered": coverage.covered,
        "void": coverage.void,
        "tiles": [
            {
                "file": str(tile.path),
                "spacing_m": tile.spacing_m,
                "covered": tile.covered,
                "void": tile.void,
                "min_height_m": tile.lowest_m,
                "max_height_m": tile.highest_m,
            }
            for tile in coverage.tiles
        ],
    }


def _outline(data: ElevationData) -> Bounds:
    outlines = [tile.posts.bounds for tile in data.tiles]
    return Bounds(
        min(one.south_deg for one in outlines),
        min(one.west_deg for one in outlines),
        max(one.north_deg for one in outlines),
        max(one.east_deg for one in outlines),
    )


def _bounds(text: str) -> Bounds:
    try:
        south, west, north, east = (float(part) for part in text.split(","))
    except ValueError:
        raise InputError(f"--bounds: {text!r} is not S,W,N,E in degrees such as 36.4,-84.5,36.8,-84.0.") from None
    if not (-90.0 <= south < north <= 90.0 and -180.0 <= west < east <= 180.0):
        raise InputError(f"--bounds: {text} is no area: south and west come first, north and east lie beyond them.")
    return Bounds(south, west, north, east)

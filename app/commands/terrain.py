"""``sidelong terrain``: what elevation data covers."""

from __future__ import annotations

from dataclasses import asdict, astuple
from pathlib import Path
from typing import Annotated

import typer
from rich.table import Table

from sidelong.app.commands.output import JsonOption, checked_output, console, say, write_json
from sidelong.app.errors import InputError
from sidelong.app.terrain.elevation_data import Bounds, Coverage, ElevationData


def terrain(
    folder: Annotated[Path, typer.Argument(help="Folder of SRTM .hgt tiles or GeoTIFF files, or one of them.")],
    bounds: Annotated[str | None, typer.Option(metavar="S,W,N,E", help="Degrees [outline of all tiles].")] = None,
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
        heights = "-" if tile.min_height_m is None else f"{tile.min_height_m:.0f} to {tile.max_height_m:.0f} m"
        shares = (f"{100.0 * share:.1f} %" for share in (tile.covered, tile.void))
        table.add_row(tile.file.name, f"{tile.spacing_m:.0f} m", *shares, heights)
    console.print(table)
    say(_words(coverage))
    tiles = [asdict(tile) | {"file": str(tile.file)} for tile in coverage.tiles]
    values = {"covered": coverage.covered, "void": coverage.void, "tiles": tiles}
    write_json(json, {"bounds_deg": astuple(coverage.bounds), **values})


def _words(coverage: Coverage) -> str:
    b = coverage.bounds
    missing = 1.0 - coverage.covered - coverage.void
    shares = ((coverage.covered, "covered"), (coverage.void, "void"), (max(missing, 0.0), "without a tile"))
    where = f"{b.south_deg:g},{b.west_deg:g} to {b.north_deg:g},{b.east_deg:g}"
    return f"{where}: " + ", ".join(f"{100.0 * share:.1f} % {what}" for share, what in shares)


def _outline(data: ElevationData) -> Bounds:
    south, west, north, east = zip(*(astuple(tile.posts.bounds) for tile in data.tiles), strict=True)
    return Bounds(min(south), min(west), max(north), max(east))


def _bounds(text: str) -> Bounds:
    try:
        south, west, north, east = (float(part) for part in text.split(","))
    except ValueError:
        raise InputError(f"--bounds: {text!r} is not S,W,N,E in degrees such as 36.4,-84.5,36.8,-84.0.") from None
    if not (-90.0 <= south < north <= 90.0 and -180.0 <= west < east <= 180.0):
        raise InputError(f"--bounds: {text} is no area: south and west come first, north and east lie beyond them.")
    return Bounds(south, west, north, east)

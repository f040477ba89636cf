"""What the commands have in common: the JSON summary, and progress on the terminal."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console

from app.errors import InputError

console = Console(highlight=False)

JsonOption = Annotated[
    Path | None, typer.Option("--json", help="Write the summary to this file as JSON; - is standard output.")
]


def write_json(path: Path | None, values: dict[str, Any]) -> None:
    """Write the summary where it was asked for. Raises InputError naming the file."""
    if path is None:
        return
    text = json.dumps(_finite(values), indent=2, allow_nan=False) + "\n"
    if str(path) == "-":
        print(text, end="")
        return
    try:
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror}); give another file to --json.") from error


def checked_output(path: Path | None) -> None:
    """Complain about an output file that cannot be written before the work begins, not after.

    When the summary goes to standard output, everything else goes to standard error.
    """
    if str(path) == "-":
        console.stderr = True
    elif path is not None and not path.parent.is_dir():
        raise InputError(f"{path}: there is no folder {path.parent}; create it or give another file to --json.")


def latitude_longitude_deg(option: str, text: str | None) -> tuple[float, float] | None:
    """Return what was given as LAT,LON. Raises InputError naming the option."""
    if text is None:
        return None
    try:
        latitude_deg, longitude_deg = (float(part) for part in text.split(","))
    except ValueError:
        raise InputError(f"{option}: {text!r} is not LAT,LON in degrees such as 36.59,-84.24.") from None
    if not (abs(latitude_deg) < 89.0 and abs(longitude_deg) <= 180.0):
        raise InputError(f"{option}: {text} is no place: latitudes go to 89 degrees, longitudes to 180.")
    return latitude_deg, longitude_deg


def table_progress(tell: Callable[[str], None]) -> Callable[[float], None]:
    """Return what tells, now and then, how far the computation of the value table is."""
    told = -1.0

    def progress(share: float) -> None:
        nonlocal told
        if told < 0.0 or share - told >= 0.25:
            told = share
            tell(f"computing the planner's value table, once for this configuration: {100.0 * share:.0f} %")

    return progress


def _finite(value: Any) -> Any:
    """JSON has no infinity: what is infinite (the time between moves beside a standing target) is null."""
    if isinstance(value, dict):
        return {key: _finite(one) for key, one in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(one) for one in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value

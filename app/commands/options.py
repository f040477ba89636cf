"""Options that more than one command has, and the panels of ``--help`` in which options stand."""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import typer

from sidelong.app.errors import InputError
from sidelong.app.payload.registry import KIND_NAMES
from sidelong.app.planners.registry import PLANNER_NAMES

Overrides = dict[str, dict[str, Any]]
"""Values of the configuration by section and key; None: not given."""


def panel(name: str) -> Callable[..., Any]:
    """Return ``typer.Option`` for options that ``--help`` shows in this panel."""
    return partial(typer.Option, rich_help_panel=name)


AIRCRAFT = panel("Aircraft and requirement")
MAP = panel("Live map")
OUTPUT = panel("Output")


def _parsed(words: str) -> float | str:
    try:
        return words if words == "auto" else float(words)
    except ValueError:
        raise ValueError(f"{words!r} is neither a number of metres nor auto.") from None


RadiusOption = Annotated[Any, AIRCRAFT(parser=_parsed, metavar="M|auto", help="Radius of the circle, m, or auto.")]
"""A float, or "auto"."""

AirspeedOption = Annotated[float | None, AIRCRAFT(help="Airspeed while circling, m/s.")]
VehicleOption = Annotated[str | None, typer.Option("--connect", metavar="URL", help="Check with its fences, too.")]
TargetSpeedOption = Annotated[float | None, AIRCRAFT(help="Highest speed to expect of the target, m/s.")]
PlannerOption = Annotated[str | None, AIRCRAFT(help=f"{' or '.join(PLANNER_NAMES)}; else as configured.")]
TerrainOption = Annotated[Path | None, AIRCRAFT(help="Elevation data: a folder of SRTM .hgt tiles or GeoTIFF files.")]
ConfigArgument = Annotated[Path | None, typer.Argument(help="Configuration (TOML).")]
ConfigOption = Annotated[Path | None, typer.Option(help="Configuration (TOML); a run folder has its own.")]
TruthOption = Annotated[Path | None, typer.Option(help="CSV with the true track; a run folder may have its own.")]
PayloadOption = Annotated[
    str | None, typer.Option(metavar="KIND://HOST[:PORT]", help=f"By its own protocol: {', '.join(KIND_NAMES)}.")
]
SetOption = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="SECTION.KEY=VALUE", help="Any key that sidelong init lists (repeatable)."),
]


def changed_keys(given: Sequence[str] | None, *overrides: Overrides) -> Overrides:
    """Return values by section and key: ``overrides``, then ``--set``, whose values are TOML, else text."""
    changes: Overrides = {}
    for override in overrides:
        for section, keys in override.items():
            changes.setdefault(section, {}).update((key, value) for key, value in keys.items() if value is not None)
    for words in given or ():
        key, equals, text = words.partition("=")
        section, dot, name = key.partition(".")
        if not (equals and dot and name):
            raise InputError(f"--set {words}: write it as SECTION.KEY=VALUE, for example requirement.side=right.")
        try:
            value = tomllib.loads(f"value = {text}")["value"]
        except tomllib.TOMLDecodeError:
            value = text
        changes.setdefault(section, {})[name] = value
    return changes

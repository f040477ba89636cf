"""``sidelong check``: whether this aircraft can keep this requirement."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.table import Table

from app.commands.output import JsonOption, checked_output, console, write_json
from app.config import load_config
from app.errors import InputError
from mission.feasibility import Feasibility, feasibility

_LABELS = {
    "x_tr_m": ("advance of one turn of the transition (x_tr)", "m"),
    "shortest_time_s": ("shortest time between moves (t_y,min)", "s"),
    "shortest_move_m": ("shortest move of the circle", "m"),
    "longest_move_m": ("longest move of the circle", "m"),
    "straight_left_m": ("straight part left for correcting the course", "m"),
    "least_threshold": ("least threshold C that works", ""),
}


def check(
    config: Annotated[Path | None, typer.Argument(help="Configuration (TOML).", show_default=False)] = None,
    airspeed: Annotated[float | None, typer.Option(help="Airspeed, m/s.")] = None,
    radius: Annotated[float | None, typer.Option(help="Radius of the circle, m.")] = None,
    target_speed: Annotated[float | None, typer.Option(help="Highest speed of the target, m/s.")] = None,
    dmin: Annotated[float | None, typer.Option(help="Least allowed range, m.")] = None,
    dmax: Annotated[float | None, typer.Option(help="Greatest allowed range, m.")] = None,
    threshold: Annotated[float | None, typer.Option(help="Factor C on dmax at which the circle is moved.")] = None,
    json: JsonOption = None,
) -> None:
    """Check whether the paper's method can keep the requirement, and say which number to change if not.

    Example: sidelong check --airspeed 10 --radius 50 --target-speed 3 --dmin 100 --dmax 500 --threshold 1
    """
    checked_output(json)
    settings = load_config(
        config,
        {
            "aircraft": {"airspeed_m_s": airspeed, "radius_m": radius},
            "requirement": {
                "target_speed_max_m_s": target_speed,
                "range_min_m": dmin,
                "range_max_m": dmax,
                "threshold": threshold,
            },
        },
    )
    result = feasibility(settings.aircraft.aircraft(), settings.requirement.requirement())
    console.print(_table(result))
    values = {key: getattr(result, key) for key in ("feasible", *_LABELS)}
    write_json(json, values)
    if not result.feasible:
        raise InputError("infeasible: " + "; ".join(map(str, result.reasons)) + ".")
    console.print("feasible")


def _table(result: Feasibility) -> Table:
    table = Table(show_header=False, box=None, pad_edge=False)
    for key, (label, unit) in _LABELS.items():
        table.add_row(label, f"{getattr(result, key):.3f}", unit)
    return table

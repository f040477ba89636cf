"""``sidelong study``: planners compared over many random targets."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from app.commands.output import JsonOption, checked_output, console, write_json
from app.errors import InputError
from app.study.report import study_json, study_table, study_title
from app.study.settings import PlannerName, StudySettings
from app.study.study import run_study
from app.value_cache import value_table
from mission.predictive.planner import table_configuration
from mission.predictive.value_table import ValueTable

_LEGS = re.compile(r"(\d+(?:\.\d+)?)-(\d+(?:\.\d+)?)")
_FIGURES = (".png", ".pdf", ".svg")


def study(
    runs: Annotated[int, typer.Option(min=1, help="Runs for each planner.")] = 20,
    seed: Annotated[int, typer.Option(min=0, help="Of all targets and noise.")] = 1,
    target_speed_max: Annotated[float, typer.Option(help="Highest speed of the target, m/s.")] = 5.0,
    wind: Annotated[float, typer.Option(help="Steady wind, m/s; the circle grows with it.")] = 0.0,
    legs: Annotated[str, typer.Option(help="How long the target keeps a course and speed, s.")] = "40-200",
    duration: Annotated[float, typer.Option(help="Of each run, s.")] = 1200.0,
    planner: Annotated[list[PlannerName] | None, typer.Option(help="Compare only this one (repeatable).")] = None,
    perfect_sensors: Annotated[
        bool, typer.Option("--perfect-sensors", help="Let the planners know the truth.")
    ] = False,
    jobs: Annotated[int | None, typer.Option(min=1, help="Processes; by default one for each core.")] = None,
    json: JsonOption = None,
    out: Annotated[Path | None, typer.Option(help="Draw the figure into this file (png, pdf, svg).")] = None,
) -> None:
    """Compare planners against many random targets, without an autopilot.

    Target to 5 m/s, aircraft at 10 m/s on circles of 50 m, band 100 to 500 m, left side; noisy laser and gimbal go
    through the real filter to the real planners. lvfg and park are guidance laws of the literature.

    Example: sidelong study --runs 50 --planner predictive --planner paper --out study.png
    """
    checked_output(json)
    _checked_figure(out)
    planners = tuple(dict.fromkeys(planner)) if planner else tuple(PlannerName)
    settings = _settings(runs, seed, target_speed_max, wind, legs, duration, planners, perfect_sensors)
    with Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
        console=Console(stderr=True),
        transient=True,
    ) as bar:
        table = _value_table(settings, bar) if PlannerName.PREDICTIVE in planners else None
        flying = bar.add_task("runs", total=runs * len(planners))
        result = run_study(settings, table, jobs, lambda done: bar.advance(flying, done))
    if str(json) != "-":
        console.print(study_title(result))
        console.print(study_table(result))
    write_json(json, study_json(result))
    if out is not None:
        # Only the figure needs matplotlib, which takes a second to load.
        from app.study.figure import write_figure  # noqa: PLC0415

        try:
            write_figure(result, out)
        except OSError as error:
            raise InputError(f"{out}: cannot be written ({error.strerror}); give another file to --out.") from error


def _value_table(settings: StudySettings, bar: Progress) -> ValueTable:
    computing = bar.add_task("value table", total=100)
    configuration = table_configuration(settings.aircraft(), settings.requirement(), settings.wind_speed_m_s)
    table = value_table(configuration, lambda share: bar.update(computing, completed=round(100 * share)))
    bar.remove_task(computing)
    return table


def _settings(
    runs: int,
    seed: int,
    target_speed_max: float,
    wind: float,
    legs: str,
    duration: float,
    planners: tuple[PlannerName, ...],
    perfect_sensors: bool,
) -> StudySettings:
    airspeed_m_s = StudySettings().airspeed_m_s
    if not 0.0 <= target_speed_max < airspeed_m_s:
        raise InputError(
            f"--target-speed-max: {target_speed_max:g} m/s is not from 0 to below the airspeed, {airspeed_m_s:g}."
        )
    if not 0.0 <= wind <= 0.7 * airspeed_m_s:
        raise InputError(f"--wind: {wind:g} m/s is not from 0 to {0.7 * airspeed_m_s:g} m/s.")
    if not 10.0 <= duration <= 86400.0:
        raise InputError(f"--duration: {duration:g} s is not from 10 s to a day.")
    match = _LEGS.fullmatch(legs)
    if match is None or not 0.0 < float(match[1]) <= float(match[2]):
        raise InputError(f"--legs: {legs!r} is no range of seconds such as 40-200.")
    return StudySettings(
        planners,
        runs,
        seed,
        target_speed_max,
        wind,
        (float(match[1]), float(match[2])),
        perfect_sensors,
        duration,
    )


def _checked_figure(out: Path | None) -> None:
    """Complain about a figure that cannot be written before the work begins."""
    if out is None:
        return
    if out.suffix.lower() not in _FIGURES:
        raise InputError(f"{out}: a figure is written as {', '.join(_FIGURES)}; give --out such a file name.")
    if not out.parent.is_dir():
        raise InputError(f"{out}: there is no folder {out.parent}; create it or give another file to --out.")

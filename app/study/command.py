"""``sidelong study``: planners compared over many random targets."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from app.commands.output import JsonOption, checked_output, console, write_json
from app.errors import InputError
from app.study.recorded import recorded_targets
from app.study.report import study_json, study_table, study_title
from app.study.settings import PlannerName, StudySettings
from app.study.study import run_study
from app.value_cache import value_table
from mission.feasibility import unflyable
from mission.predictive_planner import table_configuration
from mission.value_table import ValueTable

_LEGS = re.compile(r"(\d+(?:\.\d+)?)-(\d+(?:\.\d+)?)")
_ROOMY_RADIUS_M = 105.0  # the widest circle that leaves room in the band
_FIGURES = (".png", ".pdf", ".svg")


def study(
    targets: Annotated[
        list[Path] | None,
        typer.Option(help="A folder of recorded targets (.csv with t_s,east_m,north_m or time,lat,lon; .gpx)."),
    ] = None,
    runs: Annotated[int | None, typer.Option(min=1, help="Targets: 20 random ones, or all recorded.")] = None,
    noise_draws: Annotated[int, typer.Option(min=1, help="Fly each target so often, with other noise.")] = 1,
    seed: Annotated[int, typer.Option(min=0, help="Of all targets and noise.")] = 1,
    airspeed: Annotated[float, typer.Option(help="Of the aircraft, m/s.")] = 10.0,
    radius: Annotated[
        float | None,
        typer.Option(help="Of its circles, m; by default 50 at 10 m/s, to 105 at more; grown with wind."),
    ] = None,
    target_speed_max: Annotated[
        float | None,
        typer.Option(
            help="Highest speed of the target, m/s; recorded ones whose 95th percentile is above are skipped."
        ),
    ] = None,
    wind: Annotated[float, typer.Option(help="Steady wind, m/s.")] = 0.0,
    legs: Annotated[str, typer.Option(help="How long a random target keeps a course and speed, s.")] = "40-200",
    duration: Annotated[
        float | None, typer.Option(help="Of each run at most, s: 1200, or a recorded target's whole track.")
    ] = None,
    planner: Annotated[list[PlannerName] | None, typer.Option(help="Compare only this one (repeatable).")] = None,
    perfect_sensors: Annotated[
        bool, typer.Option("--perfect-sensors", help="Let the planners know the truth.")
    ] = False,
    jobs: Annotated[int | None, typer.Option(min=1, help="Processes; by default one for each core.")] = None,
    json: JsonOption = None,
    out: Annotated[Path | None, typer.Option(help="Draw the figure into this file (png, pdf, svg).")] = None,
) -> None:
    """Compare planners against many targets, random or recorded, without an autopilot.

    Band 100 to 500 m, left side; noisy laser and gimbal go through the real filter to the real planners. lvfg and
    park are guidance laws of the literature. A random target's side is that of its course; a recorded one's that of
    the course it made good in 30 s, once it has moved 10 m. Its track is smoothed over 2.5 s.

    Example: sidelong study --runs 50 --planner predictive --planner paper --out study.png

    Recorded: sidelong study --targets tracks --airspeed 12 --radius 40 --target-speed-max 5 --noise-draws 3
    """
    checked_output(json)
    _checked_figure(out)
    planners = tuple(dict.fromkeys(planner)) if planner else tuple(PlannerName)
    settings = _settings(
        runs, seed, airspeed, radius, target_speed_max, wind, legs, duration, planners, perfect_sensors, targets
    )
    settings = replace(settings, noise_draws=noise_draws)
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
        flying = bar.add_task("runs", total=settings.all_runs * len(planners))
        result = run_study(settings, table, jobs, lambda done: bar.advance(flying, done))
    for name, reason in settings.skipped:
        console.print(f"skipped {name}: {reason}")
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
    runs: int | None,
    seed: int,
    airspeed_m_s: float,
    radius_m: float | None,
    target_speed_max_m_s: float | None,
    wind_m_s: float,
    legs: str,
    duration_s: float | None,
    planners: tuple[PlannerName, ...],
    perfect_sensors: bool,
    targets: list[Path] | None,
) -> StudySettings:
    if not 3.0 < airspeed_m_s <= 80.0:
        raise InputError(f"--airspeed: {airspeed_m_s:g} m/s is not from 3 to 80 m/s.")
    if target_speed_max_m_s is None:
        target_speed_max_m_s = 0.5 * airspeed_m_s
    if not 0.0 <= target_speed_max_m_s < airspeed_m_s:
        raise InputError(
            f"--target-speed-max: {target_speed_max_m_s:g} m/s is not from 0 to below the airspeed, {airspeed_m_s:g}."
        )
    if not 0.0 <= wind_m_s <= 0.7 * airspeed_m_s:
        raise InputError(f"--wind: {wind_m_s:g} m/s is not from 0 to {0.7 * airspeed_m_s:g} m/s.")
    if radius_m is None:
        still_air_radius_m = min(50.0 * max(1.0, (airspeed_m_s / 10.0) ** 2), _ROOMY_RADIUS_M)
    else:
        still_air_radius_m = radius_m / (1.0 + wind_m_s / airspeed_m_s) ** 2
    if duration_s is not None and not 10.0 <= duration_s <= 86400.0:
        raise InputError(f"--duration: {duration_s:g} s is not from 10 s to a day.")
    match = _LEGS.fullmatch(legs)
    if match is None or not 0.0 < float(match[1]) <= float(match[2]):
        raise InputError(f"--legs: {legs!r} is no range of seconds such as 40-200.")
    settings = StudySettings(
        planners,
        20 if runs is None else runs,
        seed,
        target_speed_max_m_s,
        wind_m_s,
        (float(match[1]), float(match[2])),
        perfect_sensors,
        1200.0 if duration_s is None else duration_s,
        airspeed_m_s,
        still_air_radius_m,
    )
    reasons = unflyable(settings.aircraft(), settings.requirement())
    if reasons:
        raise InputError("infeasible: " + "; ".join(map(str, reasons)) + ".")
    if targets is None:
        return settings
    found = recorded_targets(targets, target_speed_max_m_s)
    return replace(
        settings,
        tracks=found.flown[:runs],
        runs=len(found.flown[:runs]),
        skipped=found.skipped,
        duration_s=math.inf if duration_s is None else duration_s,
    )


def _checked_figure(out: Path | None) -> None:
    """Complain about a figure that cannot be written before the work begins."""
    if out is None:
        return
    if out.suffix.lower() not in _FIGURES:
        raise InputError(f"{out}: a figure is written as {', '.join(_FIGURES)}; give --out such a file name.")
    if not out.parent.is_dir():
        raise InputError(f"{out}: there is no folder {out.parent}; create it or give another file to --out.")

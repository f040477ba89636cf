"""``sidelong replay``: a recorded flight through the same filter and planner."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated

import typer
from rich.progress import Progress
from rich.text import Text

from app.assembly import watch_of
from app.commands.output import JsonOption, checked_output, console, write_json
from app.config import load_config
from app.console import clock
from app.errors import InputError
from app.records.tlog import is_tlog, read_tlog, summary
from app.records.truth import read_truth
from app.replay import LogReplay, announcements, require_sightings
from app.summary import Gatherer, summarise
from app.telemetry import Telemetry

_MOST_LISTED = 12


def replay(
    log: Annotated[Path, typer.Argument(help="A recorded tlog.", show_default=False)],
    truth: Annotated[Path | None, typer.Option(help="CSV with the true track, to measure errors by.")] = None,
    config: Annotated[Path | None, typer.Option(help="Configuration (TOML).")] = None,
    planner: Annotated[str | None, typer.Option(help="predictive or paper.")] = None,
    quiet: Annotated[bool, typer.Option("--quiet", help="Print the summary only.")] = False,
    json: JsonOption = None,
) -> None:
    """Run the filter and the planner over a recorded flight: what was decided, and how far off the estimate was.

    Example: sidelong replay flight.tlog --truth flight.truth.csv
    """
    checked_output(json)
    settings = load_config(config, {"planner": {"name": planner}})
    if not log.is_file():
        raise InputError(f"{log}: there is no such file; give the path of a recorded log.")
    if not is_tlog(log):
        raise InputError(f"{log}: holds no whole MAVLink frame; give a tlog.")
    true_track = read_truth(truth) if truth is not None else None
    watch = watch_of(settings)
    telemetry = Telemetry()
    steps = LogReplay(watch, telemetry)
    gatherer = Gatherer(settings.requirement.requirement())
    start_s: float | None = None
    with Progress(console=console, transient=True, disable=not console.is_terminal) as progress:
        task = progress.add_task(log.name, total=1.0)
        messages = read_tlog(log, telemetry.wanted, lambda share: progress.update(task, completed=share))
        for step in steps.run(messages):
            gatherer.observe(step.snapshot)
            if start_s is None and step.snapshot.estimate is not None:
                start_s = step.snapshot.time_s
            if not quiet:
                for said in announcements(step.commands):
                    progress.console.print(Text(f"{clock(said.time_s):>7}  {said.text}"))
    require_sightings(watch.tracker.sightings, str(log), lambda: _listed(log))
    result = summarise(
        gatherer,
        watch.snapshot(),
        truth=true_track,
        plane=steps.plane,
        start_s=start_s if start_s is not None else -math.inf,
        sightings=watch.tracker.sightings,
        rejected=watch.tracker.rejected,
        outcome="replayed",
    )
    console.print(result.table())
    write_json(json, result.as_json())


def _listed(log: Path) -> str:
    counts = summary(log).most_common()
    names = list(dict.fromkeys(name for (name, _system, _component), _count in counts))
    return ", ".join(names[:_MOST_LISTED]) + (" and others" if len(names) > _MOST_LISTED else "")

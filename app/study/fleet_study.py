"""A study with several aircraft on each target: joint decisions, compared with laws that hold phases."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from typing import Any

import numpy as np
from rich import box
from rich.table import Table

from sidelong.app.study.fleet import FleetPlannerName, FleetResult, run_fleet
from sidelong.app.study.measures import OF_FLEETS, ON_FLAT_GROUND, decision_ms
from sidelong.app.study.parallel import Workers, parallel
from sidelong.app.study.report import targets_json
from sidelong.app.study.settings import StudySettings
from sidelong.mission.predictive.value_table import ValueTable

Fleets = Mapping[FleetPlannerName, Sequence[FleetResult]]


def fly_fleets(
    settings: StudySettings,
    table: ValueTable,
    workers: Workers,
    progress: Callable[[int], None],
    planners: Sequence[FleetPlannerName] = tuple(FleetPlannerName),
) -> Fleets:
    """Return all runs of each planner, in order. progress is called after each run."""
    tasks = ((settings, number, table, planner) for number in settings.numbers for planner in planners)
    found: dict[tuple[FleetPlannerName, int], FleetResult] = {}
    with closing(parallel(workers, run_fleet, tasks)) as flying:
        for (_, number, _, planner), result in flying:
            found[planner, number] = result
            progress(1)
    return {planner: [found[planner, number] for number in settings.numbers] for planner in planners}


def fleet_table(fleets: Fleets) -> Table:
    """Return the figures for people: means, and the worst of all runs."""
    table = Table("mean/worst", *fleets, box=box.SIMPLE_HEAD)
    for of in OF_FLEETS:
        table.add_row(of.label, *(of.cell(values_of(runs, of.name)) for runs in fleets.values()))
    return table


def values_of(runs: Sequence[object], name: str) -> np.ndarray:
    """Return a measure of each run."""
    return np.array([getattr(run, name) for run in runs], float)


def fleet_json(settings: StudySettings, fleets: Fleets) -> dict[str, Any]:
    """Return the summary that ``--json`` writes."""
    return {
        "planners": {planner.value: _figures(runs) for planner, runs in fleets.items()},
        "fleet": settings.config.requirement.fleet_size,
        **targets_json(settings),
    }


def _figures(runs: Sequence[FleetResult]) -> dict[str, Any]:
    each = zip(*(run.aircraft for run in runs), strict=True)
    return {
        **{of.name: of.spread(values_of(runs, of.name)) for of in OF_FLEETS},
        "decision_ms": decision_ms(np.concatenate([run.decision_s for run in runs])),
        "aircraft": [{of.name: of.spread(values_of(own, of.name)) for of in ON_FLAT_GROUND} for own in each],
    }

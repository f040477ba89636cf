"""Some runs of one design and planner: what is handed to a process or to a worker of a cluster."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass

from sidelong.app.study.judging import RunResult
from sidelong.app.study.run import run
from sidelong.app.study.settings import Fidelity, PlannerName, StudySettings
from sidelong.mission.predictive.value_table import ValueTable

Designs = tuple[StudySettings, ...]


@dataclass(frozen=True, slots=True)
class Batch:
    """design: its place among the designs."""

    design: int
    planner: PlannerName
    numbers: tuple[int, ...]


Flown = tuple[Batch, list[RunResult]]
# Flies batches, each with the value table of its design where the planner needs one; returns them as they are done.
# What comes is asked for as there is room, so that a table is computed only when it is needed.
Executor = Callable[[Designs, Iterable[tuple[Batch, ValueTable | None]]], Iterator[Flown]]


def flown(designs: Designs, batch: Batch, table: ValueTable | None) -> Flown:
    """Fly a batch."""
    return batch, [one_flown(designs[batch.design], batch.planner, number, table) for number in batch.numbers]


def one_flown(
    settings: StudySettings, planner: PlannerName, number: int, table: ValueTable | None, keep_track: bool = False
) -> RunResult:
    """Fly one run, over flat ground or over hills."""
    if settings.fidelity is Fidelity.CLOSED_LOOP:
        # What is compiled takes a second to load.
        from sidelong.app.study.closed_loop import run_closed_loop  # noqa: PLC0415

        return run_closed_loop(settings, planner, number, table, keep_track)
    if settings.hills is None:
        return run(settings, planner, number, table, keep_track)
    from sidelong.app.study.hills import run_over  # noqa: PLC0415  # compiled code takes a second to load

    assert table is not None
    return run_over(settings, number, table, keep_track)

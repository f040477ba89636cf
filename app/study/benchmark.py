"""The benchmark of one-sided observation: fixed targets, aircraft and noise for all planners and controllers."""

from __future__ import annotations

import platform
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from dataclasses import asdict, dataclass, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from rich import box
from rich.table import Table

from sidelong.app.study.fleet import FleetPlannerName, FleetResult, fly_fleets, values_of
from sidelong.app.study.judging import BAND, LEAST, MOVES, REVERSALS, SIDE, decision_ms
from sidelong.app.study.recorded import RecordedTarget, own_route, recorded_targets, route_next_to
from sidelong.app.study.report import right_aligned
from sidelong.app.study.settings import CONTROLLER, OWN_PLANNERS, PREDICTIVE, Design, StudySettings, studied
from sidelong.app.study.study import ResultStore, Study, code_version, on_processes, table_of

VERSION = 1  # of the scenarios; results of different versions are not comparable

TRACKS = Path(__file__).with_name("tracks")
WITH_ROUTE = "predictive, route"
PAIR, PAIR_WITH_ROUTE, PHASED_PAIR = "pair, joint", "pair, route", "pair, phased"
_DRAWS, _SEED = 3, 1


@dataclass(frozen=True, slots=True)
class AircraftClass:
    airspeed_m_s: float
    radius_m: float
    target_speed_max_m_s: float


CLASSES = (AircraftClass(12.0, 40.0, 5.0), AircraftClass(20.0, 70.0, 9.0), AircraftClass(30.0, 105.0, 14.0))


@dataclass(frozen=True, slots=True, eq=False)
class Row:
    """Results of one planner with one aircraft: arrays (runs,) by the name of the measure."""

    aircraft: AircraftClass
    planner: str
    measures: dict[str, np.ndarray]
    decision_p99_ms: float


_MEASURES = (BAND, SIDE, LEAST, MOVES, REVERSALS)


class Benchmark:
    def __init__(
        self, places: list[Path] | None, planners: Sequence[str] | None, controller: str, runs: int | None
    ) -> None:
        """Read the targets. Raises InputError: there is no target that the aircraft can watch.

        Args:
            places: Folders of recorded targets in place of the own ones.
            planners: Fly only these, and neither pairs nor routes; None: all.
            controller: Command of the user's controller; empty without one.
            runs: Targets of each class, the first ones; None: all.
        """
        self.targets = [
            recorded_targets(places or [TRACKS], one.target_speed_max_m_s, route_next_to) for one in CLASSES
        ]
        own = *OWN_PLANNERS, *((CONTROLLER,) if controller else ())
        self._all = planners is None
        self._planners = own if planners is None else tuple(dict.fromkeys(planners))
        self._settings = [self._of(CLASSES[k], read.flown[:runs], controller) for k, read in enumerate(self.targets)]
        self.wall_s = 0.0

    def _of(self, one: AircraftClass, tracks: tuple[RecordedTarget, ...], controller: str) -> StudySettings:
        return StudySettings(
            planners=self._planners,
            runs=len(tracks),
            seed=_SEED,
            noise_draws=_DRAWS,
            config=studied(**asdict(one)),
            duration_s=float("inf"),
            tracks=tuple(replace(track, route=None) for track in tracks),
            controller=controller,
        )

    @property
    def total(self) -> int:
        each = len(self._planners) + (4 if self._all else 0)
        return sum(each * len(settings.numbers) for settings in self._settings)

    def fly(self, jobs: int | None, advance: Callable[[int], None]) -> list[Row]:
        """Fly everything and return the rows, by aircraft; advance receives the number of runs just flown."""
        begun_s = time.perf_counter()
        rows = [row for k in range(len(CLASSES)) for row in self._fly_class(k, jobs, advance)]
        self.wall_s = time.perf_counter() - begun_s
        return rows

    def _fly_class(self, k: int, jobs: int | None, advance: Callable[[int], None]) -> Iterator[Row]:
        settings, one = self._settings[k], CLASSES[k]
        found, routed = [Design(settings)], settings
        if self._all:
            routed = replace(settings, tracks=tuple(map(_with_route, self.targets[k].flown[: settings.runs])))
            found.append(Design(replace(routed, planners=(PREDICTIVE,))))
        with closing(ResultStore()) as store:
            study = Study(found, store)
            study.fly(on_processes(jobs), table_of, 1, advance)
            for result, name in zip(study.results(), ("", WITH_ROUTE), strict=False):
                for planner, own in result.planners.items():
                    yield Row(one, name or str(planner), own.measures, decision_ms(own.decision_s)["p99"])
        if not self._all:
            return
        for of, names in (
            (settings, {FleetPlannerName.JOINT: PAIR, FleetPlannerName.FIELD: PHASED_PAIR}),
            (routed, {FleetPlannerName.JOINT: PAIR_WITH_ROUTE}),
        ):
            pairs = replace(of, config=studied(**asdict(one), fleet_size=2))
            flown = fly_fleets(pairs, table_of(pairs), on_processes(jobs), advance, tuple(names))
            for steered, runs in flown.items():
                yield _pair_row(one, names[steered], runs)

    def json(self, rows: Sequence[Row]) -> dict[str, Any]:
        """Return rows and versions for ``--json``."""
        return {
            "benchmark": VERSION,
            "sidelong": code_version(),
            "python": platform.python_version(),
            "packages": {name: version(name) for name in ("numpy", "numba")},
            "machine": platform.machine(),
            "seed": _SEED,
            "noise_draws": _DRAWS,
            "controller": self._settings[0].controller or None,
            "tracks": {f"{t.key:016x}": t.name for of in self.targets for t in of.flown},
            "rows": [
                {
                    **asdict(row.aircraft),
                    "planner": row.planner,
                    "runs": len(row.measures["time_in_band"]),
                    **{of.name: of.spread(row.measures[of.name]) for of in _MEASURES},
                    "decision_p99_ms": row.decision_p99_ms,
                }
                for row in rows
            ],
            "wall_s": self.wall_s,
        }


def benchmark_table(rows: Sequence[Row]) -> Table:
    """Return the table for people of :meth:`Benchmark.fly`: means and worst runs."""
    headings = (*(of.heading for of in _MEASURES), "decision, ms")
    table = right_aligned(Table("aircraft", "planner", *headings, box=box.SIMPLE_HEAD, padding=(0, 0, 0, 1)), 2)
    before = None
    for row in rows:
        cells = (of.cell(row.measures[of.name]) for of in _MEASURES)
        first = f"{row.aircraft.airspeed_m_s:g} m/s" if row.aircraft is not before else ""
        table.add_row(first, row.planner, *cells, f"{row.decision_p99_ms:.2f}")
        before = row.aircraft
    return table


def _with_route(track: RecordedTarget) -> RecordedTarget:
    """Return a track with the route next to its file, or with its own path as the route."""
    if track.route is not None:
        return track
    return replace(track, route=own_route(track, np.random.default_rng((_SEED, track.key))))


def _pair_row(aircraft: AircraftClass, name: str, runs: Sequence[FleetResult]) -> Row:
    """Return the results of two aircraft: a share of time counts if one of them achieves it, moves count of both."""
    measures = {
        BAND.name: values_of(runs, "time_in_band_any"),
        SIDE.name: values_of(runs, "time_on_side_any"),
        LEAST.name: values_of(runs, LEAST.name),
        **{of.name: np.array([values_of(run.aircraft, of.name).sum() for run in runs]) for of in (MOVES, REVERSALS)},
    }
    return Row(aircraft, name, measures, decision_ms(np.concatenate([run.decision_s for run in runs]))["p99"])

"""A whole study: every planner over the same targets, for each design, on processes of this machine or a cluster.

Results are kept in a SQLite file under a key of everything that shaped a run: what is there is not flown again.
"""

from __future__ import annotations

import contextlib
import json
import math
import multiprocessing
import os
import signal
import sqlite3
import threading
import time
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Executor, Future, ProcessPoolExecutor, as_completed, wait
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, fields
from functools import cache
from hashlib import sha256
from importlib import import_module
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt

from sidelong.app.errors import InputError, missing_package
from sidelong.app.planners.registry import PLANNER_NAMES, planner_by_name
from sidelong.app.planners.value_cache import value_table
from sidelong.app.study.judging import JudgedTrack, RunResult
from sidelong.app.study.settings import MISSION_PLANNERS, PREDICTIVE, Design, StudySettings, shaping
from sidelong.estimators.compiled import code_digest, is_cached
from sidelong.mission.core.path import FloatArray
from sidelong.mission.fleet.team_planner import IN_TEAM
from sidelong.mission.predictive.planner import USUAL, table_configuration
from sidelong.mission.predictive.value_table import ValueTable

MEASURES = tuple(field.name for field in fields(RunResult) if field.type == "float")
_SCHEMA = f"""
CREATE TABLE runs (
    key TEXT PRIMARY KEY, planner TEXT NOT NULL, target TEXT NOT NULL, draw INTEGER NOT NULL,
    {", ".join(f"{name} REAL" for name in MEASURES)}, decision_s BLOB NOT NULL
) WITHOUT ROWID;
PRAGMA application_id = {0x51DE1043};
PRAGMA user_version = 5;
"""
# Values that do not belong to one run, or follow from its target.
_NOT_SHAPING = ("planners", "runs", "only", "tracks", "skipped", "noise_draws", "hills")


@cache
def code_version() -> str:
    """Return the version with a digest that changes with any code of the program."""
    try:
        package = version("sidelong")
    except PackageNotFoundError:
        package = "0"
    return f"{package}+{code_digest()}"


@dataclass(frozen=True, slots=True)
class RunId:
    key: str
    planner: str
    number: int
    target: str
    draw: int


def run_ids(settings: StudySettings, planner: str) -> Iterator[RunId]:
    """Yield the runs of a study; the key covers all that shapes a result, the code too."""
    values = {
        field.name: getattr(settings, field.name)
        for field in fields(settings)
        if field.name not in _NOT_SHAPING and not (field.name == "legs_s" and settings.tracks)
    }
    values |= {"config": shaping(settings.config), "version": code_version()}
    values["fleet_size"] = settings.config.requirement.fleet_size
    values["hills"] = None if settings.hills is None else settings.hills.digest
    design = json.dumps(values, sort_keys=True)
    for number in settings.numbers:
        draw, k = divmod(number, settings.runs)
        track = settings.tracks[k] if settings.tracks else None
        name, own = (f"random {k}", str(k)) if track is None else (track.name, f"{track.key:016x}{track.route_key}")
        key = sha256(f"{design} {planner} {own} {draw}".encode()).hexdigest()[:32]
        yield RunId(key, planner, number, name, draw)


def _contents(db: sqlite3.Connection) -> tuple[int, int, list[Any]]:
    """Return a file's marks and how everything in it was created, which runs nothing that the file defines."""
    application, version = (db.execute(f"PRAGMA {name}").fetchone()[0] for name in ("application_id", "user_version"))
    return application, version, db.execute("SELECT type, name, sql FROM sqlite_master ORDER BY name").fetchall()


class ResultStore:
    """The file, or without one a temporary place on disk that is gone afterwards."""

    def __init__(self, file: Path | None = None) -> None:
        """Open or create it. Raises InputError if it is another kind of file or cannot be written."""
        self.file = file
        with contextlib.closing(sqlite3.connect(":memory:")) as empty:
            empty.executescript(_SCHEMA)
            own = _contents(empty)
        try:
            self._db = sqlite3.connect("" if file is None else file, timeout=30.0)
            contents = _contents(self._db)
            if contents == (0, 0, []):
                self._db.executescript(_SCHEMA)
            elif contents != own:
                raise InputError(f"--store: {file} holds something else; give the name of a new file.")
        except sqlite3.Error as error:
            raise InputError(f"--store: {file} cannot be used ({error}); give the name of a new file.") from error

    def close(self) -> None:
        self._db.close()

    def missing(self, runs: Iterable[RunId]) -> list[RunId]:
        """Return the runs that are not stored."""
        return [run for run in runs if self._row(run) is None]

    def add(self, results: Iterable[tuple[RunId, RunResult]]) -> None:
        """Keep results, all or none of them. Raises InputError when the file cannot be written."""
        rows = [
            (
                *(run.key, run.planner, run.target, run.draw),
                *(getattr(result, name) for name in MEASURES),
                np.asarray(result.decision_s, "<f4").tobytes(),
            )
            for run, result in results
        ]
        try:
            with self._db:
                self._db.executemany(f"INSERT OR IGNORE INTO runs VALUES ({','.join('?' * len(rows[0]))})", rows)
        except sqlite3.Error as error:
            raise InputError(f"--store: {self.file} cannot be written ({error}); make room, then go on.") from error

    def results(self, runs: Iterable[RunId]) -> Iterator[tuple[RunId, RunResult]]:
        """Yield the stored ones of these runs with their results, without tracks."""
        for run in runs:
            row = self._row(run)
            if row is not None:
                values = dict(zip(MEASURES, (math.nan if one is None else one for one in row[4:-1]), strict=True))
                yield run, RunResult(**values, decision_s=np.frombuffer(row[-1], "<f4"), track=None)

    def _row(self, run: RunId) -> tuple[Any, ...] | None:
        found: tuple[Any, ...] | None = self._db.execute("SELECT * FROM runs WHERE key = ?", (run.key,)).fetchone()
        return found


_AHEAD = 3  # batches for each process or thread of a worker: what comes is asked for only as there is room
_ANSWER_S = 10.0
_SHARED_MAX = 8  # settings and tables of earlier designs

R = TypeVar("R")
Task = tuple[Any, ...]
Workers = AbstractContextManager[tuple[Executor, Callable[[], int]]]
"""Yields what runs tasks, and a function that returns how many to submit ahead."""


def parallel(
    workers: Workers, work: Callable[..., R], tasks: Iterable[Task]
) -> Generator[tuple[Task, R], None, None]:
    """Yield tasks with what ``work`` returns of their values, as they are done; an error ends all."""
    with workers as (executor, ahead):
        under_way: dict[Future[R], Task] = {}
        for task in tasks:
            under_way[executor.submit(work, *task)] = task
            if len(under_way) >= ahead():
                for done in wait(under_way, return_when=FIRST_COMPLETED).done:
                    yield under_way.pop(done), done.result()
        for done in as_completed(under_way):
            yield under_way[done], done.result()


class _InThisProcess(Executor):
    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        future: Future[Any] = Future()
        future.set_result(fn(*args, **kwargs))
        return future


@contextmanager
def on_processes(jobs: int | None) -> Iterator[tuple[Executor, Callable[[], int]]]:
    """Use parallel processes, one per core by default; one: this process. An error or interrupt ends them at once."""
    processes = jobs or os.cpu_count() or 1
    if processes == 1:
        yield _InThisProcess(), lambda: 1
        return
    # Not forked: a fork copies the locks that other threads of this process hold, and they stay locked. The parent
    # alone answers an interrupt, also while its workers import.
    answer = signal.signal(signal.SIGINT, signal.SIG_IGN)
    executor = ProcessPoolExecutor(processes, multiprocessing.get_context("spawn"), initializer=_begin)
    executor.submit(int)  # starts all
    signal.signal(signal.SIGINT, answer)
    try:
        yield executor, lambda: _AHEAD * processes
    except BaseException:
        for child in multiprocessing.active_children():
            child.terminate()
        raise
    finally:
        executor.shutdown(cancel_futures=True)


def _begin() -> None:
    """Set up a worker process: it leaves interrupts to its parent, and ends with it."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    assert parent is not None
    parent.join()
    os._exit(1)


@contextmanager
def on_cluster(
    address: str, announce: Callable[[str], None] = lambda _words: None
) -> Iterator[tuple[Executor, Callable[[], int]]]:
    """Use the workers of the Dask scheduler at ``address``, which may come, go and die; print its dashboard.

    Raises InputError when dask.distributed is not installed, no scheduler answers, a worker fails or runs other code.
    """
    try:
        distributed: Any = import_module("distributed")
    except ImportError as error:
        raise missing_package("--scheduler", "distributed") from error
    try:
        client = distributed.Client(address, timeout=_ANSWER_S, set_as_default=False)
    except (OSError, ValueError) as error:
        raise InputError(
            f"--scheduler: no Dask scheduler answers at {address} within {_ANSWER_S:g} s; "
            "is it running, and is the address right?"
        ) from error
    with client:
        workers = len(client.scheduler_info(n_workers=-1)["workers"])
        announce(f"{workers} workers; dashboard {client.dashboard_link}" if workers else "waiting for workers")
        executor = _OnCluster(client)
        try:
            yield executor, lambda: _AHEAD * max(sum(client.nthreads().values()), 1)
        except (InputError, GeneratorExit, KeyboardInterrupt):
            raise
        except Exception as error:
            raise InputError(
                f"--scheduler: a worker failed ({type(error).__name__}: {error}); "
                "install the same version of sidelong on every worker."
            ) from error
        finally:
            executor.shutdown()


class _OnCluster(Executor):
    def __init__(self, client: Any) -> None:
        self._client, self._executor = client, client.get_executor(pure=False)
        self._shared: dict[int, tuple[Any, Any]] = {}

    def submit(self, fn: Callable[..., Any], /, *args: Any, **_kwargs: Any) -> Future[Any]:
        future: Future[Any] = self._executor.submit(_checked, code_version(), fn, *map(self._held, args))
        return future

    def shutdown(self, wait: bool = False, *, cancel_futures: bool = True) -> None:
        self._executor.shutdown(wait=wait)

    def _held(self, value: Any) -> Any:
        """Return a value as the workers have it; settings, with recorded targets, and tables are brought there once.

        They are submitted, not scattered: the scheduler makes them again when the worker that holds them dies.
        """
        if not isinstance(value, StudySettings | ValueTable):
            return value
        if id(value) not in self._shared:
            if len(self._shared) > _SHARED_MAX:
                del self._shared[next(iter(self._shared))]
            self._shared[id(value)] = value, self._client.submit(_same, value, pure=False)
        return self._shared[id(value)][1]


def _same(value: R) -> R:
    return value


def _checked(version: str, work: Callable[..., R], *values: Any) -> R:
    if version != code_version():
        raise InputError(
            f"--scheduler: a worker runs sidelong {code_version()}, not {version}; "
            "install the same version on every worker."
        )
    return work(*values)


Progress = Callable[[int], None]
_TableOf = Callable[[StudySettings], ValueTable]


@dataclass(frozen=True, slots=True, eq=False)
class PlannerResult:
    """One planner's runs, in order: arrays (runs,) by the name of the measure, with the same gaps for all."""

    runs: tuple[RunId, ...]
    measures: dict[str, FloatArray]
    decision_s: npt.NDArray[np.float32]

    @staticmethod
    def of(runs: Iterable[tuple[RunId, RunResult]]) -> PlannerResult:
        """Collect results of one planner, at least one."""
        ids, results = zip(*runs, strict=True)
        measures = {name: np.array([getattr(one, name) for one in results]) for name in MEASURES}
        return PlannerResult(ids, measures, np.concatenate([one.decision_s for one in results]))

    def __getitem__(self, name: str) -> FloatArray:
        return self.measures[name]


@dataclass(frozen=True, slots=True, eq=False)
class StudyResult:
    """Of one design. wall_s: how long the whole study took."""

    design: Design
    planners: dict[str, PlannerResult]
    wall_s: float

    @property
    def settings(self) -> StudySettings:
        return self.design.settings

    @property
    def simulated_s(self) -> float:
        return sum(float(planner["duration_s"].sum()) for planner in self.planners.values())


class Study:
    def __init__(self, designs: Sequence[Design], store: ResultStore) -> None:
        self.designs, self.store = tuple(designs), store
        self.wall_s = 0.0
        self.total = sum(len(d.settings.planners) * len(d.settings.numbers) for d in designs)

    def missing(self) -> int:
        """Return how many runs have to be flown."""
        return sum(len(missing) for _, _, missing in self._missing())

    def fly(self, workers: Workers, tables: _TableOf, batch_size: int, progress: Progress) -> None:
        """Fly and store what is missing; ``progress`` is called with the number of runs of each batch."""
        begun_s = time.perf_counter()

        def batches() -> Iterator[Task]:
            for settings, planner, missing in self._missing():
                table = tables(settings) if missing and planner == PREDICTIVE else None
                for i in range(0, len(missing), batch_size):
                    yield settings, planner, tuple(missing[i : i + batch_size]), table

        try:
            with contextlib.closing(parallel(workers, flown, batches())) as flying:
                for (_, _, runs, _), results in flying:
                    self.store.add(zip(runs, results, strict=True))
                    progress(len(results))
        finally:
            self.wall_s += time.perf_counter() - begun_s

    def results(self) -> list[StudyResult]:
        """Sum up each design; all runs have to be there."""
        found = []
        for design in self.designs:
            runs = {name: run_ids(design.settings, name) for name in design.settings.planners}
            planners = {name: PlannerResult.of(self.store.results(own)) for name, own in runs.items()}
            found.append(StudyResult(design, planners, self.wall_s))
        return found

    def _missing(self) -> Iterator[tuple[StudySettings, str, list[RunId]]]:
        for design in self.designs:
            for planner in design.settings.planners:
                yield design.settings, planner, self.store.missing(run_ids(design.settings, planner))


def flown(settings: StudySettings, planner: str, runs: Sequence[RunId], table: ValueTable | None) -> list[RunResult]:
    """Fly some runs of a study, as a worker does; table: of the planner, None for one without."""
    return [one_flown(settings, planner, one.number, table) for one in runs]


def one_flown(
    settings: StudySettings, planner: str, number: int, table: ValueTable | None, keep_track: bool = False
) -> RunResult:
    """Fly one run: a planner by the whole core in a closed loop, a law by its commands alone."""
    # What is compiled takes a second to load.
    if planner in MISSION_PLANNERS:
        from sidelong.app.study.closed_loop import run  # noqa: PLC0415

        return run(settings, planner, number, table, keep_track)
    from sidelong.app.study.laws import run_law  # noqa: PLC0415

    return run_law(settings, planner, number, keep_track)


def is_compiled(*planners: str) -> bool:
    """Return whether runs of planners can be flown without compilation."""
    from sidelong.estimators.filters.imm_kernel import update  # noqa: PLC0415  # as above

    own = [one for one in planners if one in PLANNER_NAMES]
    return is_cached(update) and all(planner_by_name(one).is_compiled() for one in own)


def flown_again(flown: RunId, settings: StudySettings) -> JudgedTrack:
    """Return the path of a run, which is not kept: the run is flown again."""
    table = table_of(settings) if flown.planner == PREDICTIVE else None
    track = one_flown(settings, flown.planner, flown.number, table, keep_track=True).track
    assert track is not None
    return track


def table_of(settings: StudySettings, progress: Callable[[float], None] = lambda _share: None) -> ValueTable:
    """Return the predictive planner's value table; it is computed where none is kept."""
    wind_speed_m_s = settings.config.simulation.wind_speed_m_s
    own = IN_TEAM if settings.config.requirement.fleet_size > 1 else USUAL
    configuration = table_configuration(settings.aircraft(), settings.requirement(), wind_speed_m_s, own)
    return value_table(configuration, progress)

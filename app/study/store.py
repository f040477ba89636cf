"""Results of studies in a SQLite file: a row for each run as it comes, under a key of everything that shaped it.

A study begun again finds what is there and flies only the rest; studies may share a file.
"""

from __future__ import annotations

import contextlib
import json
import math
import sqlite3
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, fields
from functools import cache
from hashlib import sha256
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np

from sidelong.app.errors import InputError
from sidelong.app.study.judging import RunResult
from sidelong.app.study.settings import (
    StudySettings,
    shaping,
)
from sidelong.estimators.compiled import code_digest

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
    """Return the package's version and a digest of the code that shapes a run."""
    try:
        package = version("sidelong")
    except PackageNotFoundError:
        package = "0"
    return f"{package}+{code_digest()}"


@dataclass(frozen=True, slots=True)
class RunId:
    """Which run, and the key it is kept under."""

    key: str
    planner: str
    number: int
    target: str
    draw: int


def run_ids(settings: StudySettings, planner: str) -> Iterator[RunId]:
    """Return a design's runs of one planner, in order."""
    values = {
        field.name: getattr(settings, field.name)
        for field in fields(settings)
        if field.name not in _NOT_SHAPING and not (field.name == "legs_s" and settings.tracks)
    }
    values |= {"config": shaping(settings.config), "version": code_version()}
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
        """Return the runs of which there is no result yet."""
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
        """Return the results of runs, in their order; those that are not there are passed over."""
        for run in runs:
            row = self._row(run)
            if row is not None:
                values = dict(zip(MEASURES, (math.nan if one is None else one for one in row[4:-1]), strict=True))
                yield run, RunResult(**values, decision_s=np.frombuffer(row[-1], "<f4"), track=None)

    def _row(self, run: RunId) -> tuple[Any, ...] | None:
        found: tuple[Any, ...] | None = self._db.execute("SELECT * FROM runs WHERE key = ?", (run.key,)).fetchone()
        return found

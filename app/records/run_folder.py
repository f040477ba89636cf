"""The folder that a run leaves behind, and how many of them are kept."""

from __future__ import annotations

import contextlib
import ctypes
import json
import os
import shutil
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from itertools import count
from pathlib import Path
from typing import Any, NamedTuple, Self

from sidelong.app.errors import InputError
from sidelong.app.records.text_file import read_text, write_text

_SUMMARY_MAX_BYTES = 1 << 20
_LEAST_FREE_BYTES = 20_000_000
_RECORDED_BYTES_S = 17_000.0  # journal, tlog, links and truth of one aircraft: 60 MB an hour
_STAMP, _STAMP_LENGTH = "%Y%m%dT%H%M%SZ", 16
_MADE, _MADE_MAX_BYTES = ".sidelong", 200
_UNUSED_MAX = timedelta(days=366)  # a clock that is further beyond the latest run is not confirmed
_TIME_ERROR = 5  # of adjtimex: the clock is not synchronised


def recording(path: Path) -> Path:
    """Return the run folder or log at ``path``; for a journal its run folder. Raises InputError if there is none."""
    if not path.exists():
        raise InputError(f"{path}: there is no such run folder or log; give the path of one.")
    journals = RunFolder(path.parent).journal, FleetFolder(path.parent).journal
    return path.parent if path in journals else path


def check_space(parent: Path, duration_s: float, aircraft: int, warn: Callable[[str], object]) -> None:
    """Raise InputError if hardly any space is free in ``parent``, warn if it is less than the records need."""
    present = next(path for path in (parent.absolute(), *parent.absolute().parents) if path.exists())
    free = shutil.disk_usage(present).free
    needed = round(_RECORDED_BYTES_S * duration_s * aircraft)
    if free < _LEAST_FREE_BYTES:
        raise InputError(f"{parent}: only {free / 1e6:.1f} MB are free; free some space or give another --out.")
    if free < needed:
        warn(f"{parent}: {free / 1e6:.0f} MB are free, but the records will need about {needed / 1e6:.0f} MB")


class _File:
    def __init__(self, name: str) -> None:
        self._name = name

    def __get__(self, folder: _Folder, _kind: type) -> Path:
        return folder.path / self._name


_END_BYTES = 1 << 20
_LAST_EVENTS = tuple(f'"event":"{name}"'.encode() for name in ("ShutdownRequested", "End", "TakeoverFailed"))


@dataclass(frozen=True)
class _Folder:
    path: Path
    summary = _File("summary.json")
    made = _File(_MADE)  # that sidelong has made the folder: its number, and whether the clock was confirmed

    @classmethod
    def create(cls, parent: Path, now: datetime) -> Self:
        """Make a new folder in ``parent`` (made if missing), named by the time in UTC. Raises InputError.

        Only its owner can read it: it shows where people are.
        """
        stamp = now.astimezone(UTC).strftime(_STAMP)
        with _making(parent):
            parent.mkdir(mode=0o700, parents=True, exist_ok=True)
            runs = _runs(parent)
            number = 1 + max((run.number for run in runs), default=0)
            made = {"number": number, "clock_confirmed": _is_confirmed(now, runs, clock_is_synchronised())}
            for attempt in count(1):
                folder = cls(parent / (stamp if attempt == 1 else f"{stamp}-{attempt}"))
                with contextlib.suppress(FileExistsError):
                    folder.path.mkdir(mode=0o700)
                    with contextlib.suppress(OSError):  # a full disk: this run is then never deleted
                        folder.made.write_text(json.dumps(made), encoding="ascii")
                    return folder
        raise AssertionError("unreachable: counting does not end")

    def read_summary(self) -> dict[str, Any]:
        """Return the summary; raises InputError when the run did not get as far as writing one."""
        remedy = "the run has not ended in order; without this file its figures are made of the journal"
        text = read_text(self.summary, _SUMMARY_MAX_BYTES, remedy)
        with contextlib.suppress(ValueError, RecursionError):
            summary = json.loads(text)
            if isinstance(summary, dict):
                return summary
        raise InputError(f"{self.summary}: is no summary of a run; {remedy}.")

    def write_summary(self, summary: Mapping[str, Any]) -> None:
        write_text(self.summary, json.dumps(summary, indent=2) + "\n")
        self.summary.chmod(0o600)


class RunFolder(_Folder):
    journal = _File("journal.jsonl")
    tlog = _File("flight.tlog")
    truth = _File("truth.csv")
    links = _File("links.csv")
    video = _File("video.ts")

    def truncated(self) -> str:
        """Return why the journal ends before the flight did, '' if it does not."""
        if not self.summary.is_file():
            return "the program was killed, the disk was full, or the flight still goes on"
        lost = self.read_summary().get("records_lost", "")
        if isinstance(lost, str) and lost:
            return lost
        with contextlib.suppress(OSError), self.journal.open("rb") as file:
            file.seek(max(self.journal.stat().st_size - _END_BYTES, 0))
            end = file.read()
            return "" if any(name in end for name in _LAST_EVENTS) else "the end of the journal is missing"
        return ""

    @staticmethod
    def open(path: Path) -> RunFolder:
        """Return an existing run's folder; InputError: it is a fleet's, or has no journal."""
        run = RunFolder(path)
        if FleetFolder(path).journal.is_file():
            raise InputError(f"{path} is the run of a fleet; give the folder of one aircraft in it.")
        if not run.journal.is_file():
            raise InputError(f"{path} is no run folder: it has no {run.journal.name}; give a run folder or a log.")
        return run


class FleetFolder(_Folder):
    journal = _File("fleet.jsonl")

    def make(self, name: str) -> RunFolder:
        """Make the folder of one aircraft. Raises InputError if it cannot."""
        folder = RunFolder(self.path / name)
        with _making(self.path):
            folder.path.mkdir(parents=True)
        return folder


@contextlib.contextmanager
def _making(parent: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise InputError(f"no run folder can be made in {parent} ({error.strerror}); give another --out.") from error


def rotate(
    parent: Path,
    budget_bytes: float,
    keep: timedelta,
    now: datetime,
    log: Callable[[str], object],
    present: Path | None = None,
    synchronised: bool | None = None,
) -> int:
    """Delete run folders that sidelong has made beyond a budget, the oldest first, and those that are too old.

    None is deleted by a clock that is not confirmed now, or was not when the folder was made; ``present`` stays.
    synchronised: None: as the system reports. Returns the bytes that the folders take.
    """
    total = 0
    runs = sorted(_runs(parent), reverse=True)  # the last one first, whatever the clocks were
    is_confirmed = _is_confirmed(now, runs, clock_is_synchronised() if synchronised is None else synchronised)
    for run in runs:
        size = _size(run.path)
        too_old = is_confirmed and run.begun is not None and now - run.begun > keep
        if run.path != present and (too_old or total + size > budget_bytes):
            shutil.rmtree(run.path, ignore_errors=True)
            if not run.path.exists():
                why = f"older than {keep / timedelta(days=1):g} days" if too_old else "beyond the disk budget"
                log(f"{run.path} was deleted: {why}")
            size = _size(run.path)  # what could not be deleted
        total += size
    return total


class _Run(NamedTuple):
    """A run folder that sidelong has made; begun: None where the clock was not confirmed then."""

    number: int
    path: Path
    begun: datetime | None


def _runs(parent: Path) -> list[_Run]:
    found = []
    with contextlib.suppress(OSError):
        for path in parent.iterdir():
            with contextlib.suppress(OSError, ValueError, KeyError, TypeError):
                if path.is_symlink() or path.stat().st_uid != os.getuid():
                    continue
                with (path / _MADE).open("rb") as file:
                    made = json.loads(file.read(_MADE_MAX_BYTES))
                begun = datetime.strptime(path.name[:_STAMP_LENGTH], _STAMP).replace(tzinfo=UTC)
                found.append(_Run(int(made["number"]), path, begun if made["clock_confirmed"] is True else None))
    return found


def _is_confirmed(now: datetime, runs: list[_Run], synchronised: bool) -> bool:
    """Return whether to accept this computer's clock: it is synchronised, and goes on from the latest run."""
    latest = max((run.begun for run in runs if run.begun is not None), default=now)
    return synchronised and -timedelta(days=1) <= now - latest <= _UNUSED_MAX


def clock_is_synchronised() -> bool:
    """Return whether the system reports its clock as synchronised, by NTP or GPS; adjtimex(2)."""
    with contextlib.suppress(OSError, AttributeError):  # another system
        return bool(0 <= ctypes.CDLL(None).adjtimex(ctypes.create_string_buffer(512)) < _TIME_ERROR)
    return False


def _size(run: Path) -> int:
    size = 0
    with contextlib.suppress(OSError):  # a person may delete it in the meantime
        for path in run.rglob("*"):
            with contextlib.suppress(OSError):
                size += path.lstat().st_blocks * 512
    return size

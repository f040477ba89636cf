"""Damaged files by the thousand, over every reader, in processes of bounded memory."""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import resource
import signal
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path

from sidelong.app.planners.value_cache import value_table
from tests.faults.readers import TABLE, Reader, fault, readers

CPU_MAX_S, MEMORY_MAX_BYTES = 5.0, 512 << 20
_KEPT = 20  # faults reported in full


@dataclass(slots=True)
class Count:
    """What became of a reader's damaged files. faults: (seed, what was wrong), the first ones."""

    reader: str
    inputs: int = 0
    wrong: int = 0
    slowest_s: float = 0.0
    faults: list[tuple[str, str]] = field(default_factory=list)

    def add(self, other: Count) -> None:
        self.inputs += other.inputs
        self.wrong += other.wrong
        self.slowest_s = max(self.slowest_s, other.slowest_s)
        self.faults = (self.faults + other.faults)[:_KEPT]


class TooSlow(BaseException):
    """Not an Exception: a reader that catches everything must not catch this."""


def _too_slow(_number: int, _frame: object) -> None:
    raise TooSlow


_readers: dict[str, Reader] = {}
_folder: Path


def _begin(table: bytes) -> None:
    """Set a worker process up: from here on it may take this much more memory and no more."""
    global _folder  # noqa: PLW0603  # a worker's own
    _readers.update(readers(table))
    _folder = Path(tempfile.mkdtemp(prefix="sidelong-faults-"))
    used_bytes = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (used_bytes + MEMORY_MAX_BYTES, resource.RLIM_INFINITY))
    signal.signal(signal.SIGPROF, _too_slow)


def _read(name: str, seeds: range, campaign: int) -> Count:
    reader = _readers[name]
    count = Count(name)
    path = _folder / f"damaged{reader.suffix}"
    for seed in seeds:
        begun_s = time.process_time()
        signal.setitimer(signal.ITIMER_PROF, CPU_MAX_S)
        try:
            wrong = fault(reader, path, f"{campaign}/{name}/{seed}")
        except TooSlow:
            wrong = f"took more than {CPU_MAX_S:g} s of the processor"
        finally:
            signal.setitimer(signal.ITIMER_PROF, 0.0)
        count.inputs += 1
        count.slowest_s = max(count.slowest_s, time.process_time() - begun_s)
        if wrong is not None:
            count.wrong += 1
            count.faults.append((f"{campaign}/{name}/{seed}", wrong))
    count.faults = count.faults[:_KEPT]
    return count


def _end() -> None:
    for path in _folder.iterdir():
        path.unlink()
    _folder.rmdir()


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    """Let the processes see one thread: their libraries reserve memory for each."""
    before = os.environ.get("OPENBLAS_NUM_THREADS")
    os.environ["OPENBLAS_NUM_THREADS"] = "1"
    try:
        yield
    finally:
        os.environ.pop("OPENBLAS_NUM_THREADS")
        if before is not None:
            os.environ["OPENBLAS_NUM_THREADS"] = before


def run(
    inputs: int,
    campaign: int,
    processes: int = 2,
    names: Sequence[str] = (),
    batch: int = 100,
    progress: Callable[[float, int], object] = lambda _share, _wrong: None,
) -> list[Count]:
    """Give each reader (or those of ``names``) this many damaged files; return what became of them.

    progress receives of the share that is done, and of how many were wrong.
    """
    with tempfile.TemporaryDirectory() as folder:
        value_table(TABLE, directory=Path(folder))
        table = next(Path(folder).iterdir()).read_bytes()
    totals = {name: Count(name) for name in readers(table) if not names or name in names}
    context = multiprocessing.get_context("spawn")
    with _quiet(), ProcessPoolExecutor(processes, context, _begin, (table,)) as pool:
        work = [
            pool.submit(_read, name, range(first, min(first + batch, inputs)), campaign)
            for first in range(0, inputs, batch)
            for name in totals
        ]
        for number, done in enumerate(work, 1):
            count = done.result()
            totals[count.reader].add(count)
            progress(number / len(work), sum(total.wrong for total in totals.values()))
        for _ in range(processes):
            pool.submit(_end)
    return list(totals.values())

"""Batches flown by processes of this machine."""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import signal
from collections.abc import Iterable, Iterator
from queue import SimpleQueue

from sidelong.app.study.batch import Batch, Designs, Executor, Flown, flown
from sidelong.mission.predictive.value_table import ValueTable

_AHEAD = 2  # batches for each process: one in flight, one waiting


def on_processes(jobs: int | None) -> Executor:
    """Return a function that flies batches in parallel processes, one per core by default; one: in this process.

    An interrupt of the waiting process ends them immediately.
    """
    processes = jobs or os.cpu_count() or 1
    if processes == 1:
        return lambda designs, batches: (flown(designs, *task) for task in batches)

    def fly(designs: Designs, batches: Iterable[tuple[Batch, ValueTable | None]]) -> Iterator[Flown]:
        with uninterrupted():
            # Not forked: a fork copies the locks that other threads of this process hold, and they stay locked.
            pool = multiprocessing.get_context("spawn").Pool(processes, _begin, (designs,))
        done: SimpleQueue[Flown | BaseException] = SimpleQueue()
        under_way = 0
        with pool:
            for task in batches:
                pool.apply_async(_fly, task, callback=done.put, error_callback=done.put)
                under_way += 1
                if under_way >= _AHEAD * processes:
                    yield _taken(done)
                    under_way -= 1
            for _ in range(under_way):
                yield _taken(done)

    return fly


def _taken(done: SimpleQueue[Flown | BaseException]) -> Flown:
    result = done.get()
    if isinstance(result, BaseException):
        raise result
    return result


@contextlib.contextmanager
def uninterrupted() -> Iterator[None]:
    """Let processes begin that an interrupt does not reach, not even while they import."""
    answer = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, answer)


_designs: Designs


def _begin(designs: Designs) -> None:
    """Set up a worker process. The parent alone answers an interrupt, by ending its workers."""
    global _designs  # noqa: PLW0603  # what a worker needs is too large to come with every task
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # for one that comes later, in place of another
    _designs = designs


def _fly(batch: Batch, table: ValueTable | None) -> Flown:
    return flown(_designs, batch, table)

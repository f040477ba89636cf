"""Batches of runs flown in parallel, by processes of this machine or by the workers of a Dask cluster."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Executor, Future, ProcessPoolExecutor, as_completed, wait
from contextlib import AbstractContextManager, contextmanager
from importlib import import_module
from typing import Any, TypeVar

from sidelong.app.errors import InputError, missing_package
from sidelong.app.study.settings import StudySettings
from sidelong.app.study.store import code_version
from sidelong.mission.predictive.value_table import ValueTable

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

        They are not scattered but submitted: then the scheduler has them made again when the worker that holds them
        dies.
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

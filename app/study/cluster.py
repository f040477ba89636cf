"""Batches flown by the workers of a Dask cluster: they may come, go and die."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from importlib import import_module
from itertools import count
from typing import Any, TypeVar

from sidelong.app.errors import InputError, missing_package
from sidelong.app.study.batch import Batch, Designs, Executor, Flown, flown
from sidelong.app.study.store import code_version
from sidelong.mission.predictive.value_table import ValueTable

_AHEAD = 3  # batches for each thread of the workers
_TRIES = 5  # of a batch whose workers died under it
_ANSWER_S = 10.0

T = TypeVar("T")


def on_cluster(address: str, announce: Callable[[str], None] = lambda _words: None) -> Executor:
    """Return what flies batches on the workers of the scheduler at ``address``; its dashboard is printed.

    Raises InputError when dask.distributed is not installed; when flying, if no scheduler answers or its workers run
    other code.
    """
    try:
        distributed: Any = import_module("distributed")
    except ImportError as error:
        raise missing_package("--scheduler", "distributed") from error

    def fly(designs: Designs, batches: Iterable[tuple[Batch, ValueTable | None]]) -> Iterator[Flown]:
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
            yield from _Flying(client, designs).results(batches)

    return fly


class _Flying:
    def __init__(self, client: Any, designs: Designs) -> None:
        self._client = client
        self._numbers = count()
        # Not scattered but submitted: then the scheduler can have it made again when the worker that holds it dies.
        self._designs = self._shared(designs)
        self._table: tuple[ValueTable, Any] | None = None
        self._under_way: dict[Any, tuple[Batch, Any, int]] = {}

    def results(self, batches: Iterable[tuple[Batch, ValueTable | None]]) -> Iterator[Flown]:
        try:
            for batch, table in batches:
                self._submit(batch, self._held(table), 1)
                while len(self._under_way) >= max(_AHEAD * sum(self._client.nthreads().values()), _AHEAD):
                    yield from self._done()
            while self._under_way:
                yield from self._done()
        finally:
            self._client.cancel(list(self._under_way))

    def _held(self, table: ValueTable | None) -> Any:
        """Return the table as the workers have it: brought there once."""
        if table is None:
            return None
        if self._table is None or self._table[0] is not table:
            self._table = table, self._shared(table)
        return self._table[1]

    def _shared(self, value: T) -> Any:
        return self._client.submit(_same, value, key=f"sidelong-shared-{id(self)}-{next(self._numbers)}")

    def _submit(self, batch: Batch, table: Any, tries: int) -> None:
        key = f"sidelong-batch-{id(self)}-{next(self._numbers)}"
        future = self._client.submit(_fly, code_version(), self._designs, batch, table, key=key)
        self._under_way[future] = batch, table, tries

    def _done(self) -> Iterator[Flown]:
        """Wait for a batch at least; what died with its workers is sent again."""
        distributed: Any = import_module("distributed")
        with self._client.as_current():
            done = distributed.wait(list(self._under_way), return_when="FIRST_COMPLETED").done
        for future in done:
            batch, table, tries = self._under_way.pop(future)
            error = future.exception()
            if error is None:
                yield future.result()
            elif isinstance(error, distributed.KilledWorker) and tries < _TRIES:
                self._submit(batch, table, tries + 1)
            elif isinstance(error, InputError):
                raise error
            else:
                raise InputError(
                    f"--scheduler: a worker failed ({type(error).__name__}: {error}); "
                    "install the same version of sidelong on every worker."
                ) from error


def _same(value: T) -> T:
    return value


def _fly(version: str, designs: Designs, batch: Batch, table: ValueTable | None) -> Flown:
    if version != code_version():
        raise InputError(
            f"--scheduler: a worker runs sidelong {code_version()}, not {version}; "
            "install the same version on every worker."
        )
    return flown(designs, batch, table)

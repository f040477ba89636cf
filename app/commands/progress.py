"""How far the work is, on the terminal."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from time import monotonic

from rich.console import Console
from rich.markup import escape
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TaskID,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

from sidelong.app.commands.output import console, warn
from sidelong.app.link.message import plain

_SHARE_EVERY_S = 10.0
_PRINTED_EVERY_S = 30.0  # where there is no terminal


def progress_bar(name: str) -> tuple[Progress, TaskID]:
    """Return a bar that is gone when it ends, with its task from 0 to 1; none where there is no terminal."""
    progress = Progress(console=console, transient=True, disable=not console.is_terminal)
    return progress, progress.add_task(escape(plain(name)), total=1.0)


@contextmanager
def share_progress(name: str, clock_s: Callable[[], float] = monotonic) -> Iterator[Callable[[float], None]]:
    """Yield a function that takes the share 0..1 done: a bar, or without a terminal a line every ten seconds."""
    bar, task = progress_bar(name)
    announced_s = clock_s()

    def advance(share: float) -> None:
        nonlocal announced_s
        bar.update(task, completed=share)
        if bar.disable and clock_s() - announced_s >= _SHARE_EVERY_S:
            announced_s = clock_s()
            warn(f"{name}: {100.0 * share:.0f} %")

    with bar:
        yield advance


def table_progress(announce: Callable[[str], None]) -> Callable[[float], None]:
    """Return a callback that reports the progress of the value table's computation in steps of 25 %."""
    printed = -1.0

    def progress(share: float) -> None:
        nonlocal printed
        if printed < 0.0 or share - printed >= 0.25:
            printed = share
            announce(f"computing the planner's value table, once for this configuration: {100.0 * share:.0f} %")

    return progress


@contextmanager
def runs_progress(runs: int) -> Iterator[tuple[Callable[[int], None], Callable[[float], None]]]:
    """Yield the callbacks for finished runs and the value table's share: a bar, or lines without a terminal."""
    terminal = Console(stderr=True)
    if not terminal.is_terminal:
        yield _lines(terminal, runs), lambda _share: None
        return
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    with Progress(*columns, TimeRemainingColumn(), console=terminal, transient=True) as bar:
        flying = bar.add_task("runs", total=runs)
        table = bar.add_task("value table", total=100, visible=False)

        def computing(share: float) -> None:
            bar.update(table, completed=round(100 * share), visible=share < 1.0)

        yield lambda done: bar.advance(flying, done), computing


def _lines(terminal: Console, runs: int) -> Callable[[int], None]:
    begun_s = announced_s = monotonic()
    flown = 0

    def advance(done: int) -> None:
        nonlocal flown, announced_s
        flown += done
        now_s = monotonic()
        if now_s - announced_s >= _PRINTED_EVERY_S:
            announced_s = now_s
            left_min = (now_s - begun_s) / flown * (runs - flown) / 60.0
            terminal.print(f"{flown} of {runs} runs, {left_min:.0f} min left", highlight=False)

    return advance

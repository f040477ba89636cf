"""How far the work is, on the terminal."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from time import monotonic

from rich.console import Console
from rich.markup import escape
from rich.progress import Progress

from sidelong.app.commands.output import console, warn
from sidelong.app.link.message import plain

_SHARE_EVERY_S = 10.0


@contextmanager
def share_progress(
    name: str, clock_s: Callable[[], float] = monotonic, on: Console = console
) -> Iterator[Callable[[float], None]]:
    """Yield a function that takes the share 0..1 done: a bar, or without a terminal a line every ten seconds."""
    bar = Progress(console=on, transient=True, disable=not on.is_terminal)
    task = bar.add_task(escape(plain(name)), total=1.0)
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
def runs_progress(runs: int) -> Iterator[Callable[[int], None]]:
    """Yield a function that takes how many runs are finished since the last call."""
    flown = 0
    with share_progress(f"{runs} runs", on=Console(stderr=True)) as advance:

        def finished(count: int) -> None:
            nonlocal flown
            flown += count
            advance(flown / runs)

        yield finished

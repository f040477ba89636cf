"""What the commands write: on the terminal, with the progress of long work, and the JSON summary."""

from __future__ import annotations

import contextlib
import json
import math
import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from time import monotonic
from typing import Annotated, Any, TextIO, cast

from rich.console import Console
from rich.markup import escape
from rich.measure import Measurement
from rich.progress import Progress
from rich.table import Table

from sidelong.app.commands.options import OUTPUT
from sidelong.app.errors import InputError
from sidelong.app.link.message import plain
from sidelong.app.process import abandon
from sidelong.app.records.text_file import write_text

_WIDE = 400  # characters, more than any table


class _Standard:
    """The current standard output, or standard error on request.

    Shielded, it never raises: if the reader closes the pipe or the disk is full, further output is dropped, and
    ``lost`` holds the reason. A character that the encoding lacks is printed as ``?``.
    """

    def __init__(self) -> None:
        self.to_stderr = self.shielded = False
        self.lost: str | None = None

    @property
    def stream(self) -> TextIO:
        stream = sys.stderr if self.to_stderr else sys.stdout
        proxied: TextIO = getattr(stream, "rich_proxied_file", stream)  # what rich's live display has put before it
        return proxied

    def write(self, text: str) -> int:
        stream = self.stream
        encoding = stream.encoding or "utf-8"
        self._tried(lambda: stream.write(text.encode(encoding, "replace").decode(encoding)))
        return len(text)

    def flush(self) -> None:
        self._tried(self.stream.flush)

    def __getattr__(self, name: str) -> Any:
        return getattr(self.stream, name)

    def _tried(self, work: Callable[[], object]) -> None:
        if self.lost is not None:
            return
        try:
            work()
        except OSError as error:
            if not self.shielded:
                raise
            self.lost = error.strerror
            abandon(self.stream)


class _Console(Console):
    def on_broken_pipe(self) -> None:
        abandon(standard.stream)
        raise SystemExit(0)  # the reader closed the pipe


standard = _Standard()
console = _Console(file=cast(TextIO, standard), highlight=False, markup=False)


def say(text: str) -> None:
    """Print a line, which a narrow terminal does not break."""
    console.print(text, soft_wrap=True)


def print_whole(table: Table) -> None:
    """Print a table with all its columns: on a narrow terminal rather broken lines than a column less."""
    needed = Measurement.get(console, console.options.update_width(_WIDE), table).maximum
    _Console(file=cast(TextIO, standard), highlight=False, width=max(console.width, needed)).print(table)


@contextmanager
def shielded_output() -> Iterator[None]:
    """Shield the body of the ``with`` from errors of writing to the terminal."""
    standard.shielded = True
    try:
        yield
    finally:
        standard.shielded = False


def warn(text: str) -> None:
    """Print to standard error; a closed one is ignored."""
    with contextlib.suppress(OSError):
        print(f"sidelong: {text}", file=sys.stderr)


JsonOption = Annotated[Path | None, OUTPUT("--json", help="Write the summary there as JSON; -: standard output.")]


def write_json(path: Path | None, values: dict[str, Any]) -> None:
    """Write values to a file, '-': standard output, None: nowhere. Raises InputError where it cannot be written."""
    if path is None:
        return
    text = json.dumps(_finite(values), indent=2, allow_nan=False) + "\n"
    with writing(path, "--json"):
        if str(path) == "-":
            print(text, end="", flush=True)
        else:
            write_text(path, text)


def print_notes(notes: Iterable[str | None]) -> None:
    for note in filter(None, notes):
        say(f"note: {note}")


def warn_of_log(source: Path, warning: str) -> None:
    """Print what keeps the results of a log from being those of one flight; nothing if the warning is empty."""
    if warning:
        say(f"{source.name}: {warning}")


@contextlib.contextmanager
def writing(path: Path, option: str, what: str = "file") -> Iterator[None]:
    """Raise InputError, which names the option, if the body of the ``with`` cannot write."""
    try:
        yield
    except OSError as error:
        if isinstance(error, BrokenPipeError) and str(path) == "-":
            raise  # the reader closed standard output
        raise InputError(f"{path}: cannot be written ({error.strerror}); give another {what} to {option}.") from error


def checked_output(path: Path | None) -> None:
    """Complain about an output file that cannot be written before the work begins; - moves other output to stderr."""
    if str(path) == "-":
        standard.to_stderr = True
    else:
        checked_file("--json", path)


def checked_file(option: str, path: Path | None) -> None:
    """Complain about a file that cannot be written, before the work begins. Raises InputError naming the option."""
    if path is None:
        return
    with writing(path, option):  # a name may be too long
        is_folder = path.is_dir()
        path.exists()
    if is_folder:
        raise InputError(f"{path} is a folder; give a file to {option}.")
    if not path.parent.is_dir():
        raise InputError(f"{path}: there is no folder {path.parent}; create it or give another file to {option}.")


def _finite(value: Any) -> Any:
    """JSON has no infinity: what is infinite (the time between moves at a stationary target) is null."""
    if isinstance(value, dict):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


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

"""Shut down the process on request, even if threads of a library are blocked.

MAVSDK's blocking calls run in threads that cannot be cancelled. Python waits for such threads without a time limit:
when ``asyncio.run`` ends (see :mod:`sidelong.app.event_loop`), and again when the interpreter ends. One call that
never returns would block both.
"""

from __future__ import annotations

import atexit
import contextlib
import os
import signal
import sys
import threading
import time
from collections.abc import Iterator
from typing import TYPE_CHECKING, NoReturn, TextIO

if TYPE_CHECKING:
    import asyncio

INTERRUPTED = 130  # the exit code
_THREADS_END_S = 1.0
_HEEDED_AGAIN_S = 0.05
_again: threading.Timer | None = None  # when a dropped interrupt comes


@contextlib.contextmanager
def ends_within(seconds: float, what: str) -> Iterator[None]:
    """End the process with exit code 1 unless this is left within ``seconds``: a last resort, not a way to end."""

    def end() -> None:
        print(f"sidelong: {what} took more than {seconds:g} s and was left off.", file=sys.stderr)
        _end_at_once(1)

    timer = threading.Timer(seconds, end)
    timer.daemon = True
    timer.start()
    try:
        yield
    finally:
        timer.cancel()


@contextlib.contextmanager
def fails_with(alongside: asyncio.Task[None]) -> Iterator[None]:
    """Raise the error of a task that fails inside this context: what waits for its work would never end."""
    import asyncio  # noqa: PLC0415  # it takes a moment to load, and most commands do not need it

    inside = asyncio.current_task()
    assert inside is not None

    def cancel(ended: asyncio.Task[None]) -> None:
        if not ended.cancelled() and ended.exception() is not None:
            inside.cancel()

    alongside.add_done_callback(cancel)
    try:
        yield
    except asyncio.CancelledError:
        failed = alongside.exception() if alongside.done() and not alongside.cancelled() else None
        if failed is None:
            raise
        inside.uncancel()
        raise failed from None
    finally:
        alongside.remove_done_callback(cancel)


def heed_interrupts() -> None:
    """Let a signal that asks the program to end raise KeyboardInterrupt, unless it is ignored, as nohup has it."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, signal.default_int_handler)


def handle_next(unraisable: sys.UnraisableHookArgs) -> None:
    """Serve as ``sys.unraisablehook``: an interrupt that came where Python drops exceptions comes again.

    So it does while a library calls back, as the compiler does for half a minute.
    """
    global _again  # noqa: PLW0603  # as there is one hook and one main thread
    if not isinstance(unraisable.exc_value, KeyboardInterrupt):
        sys.__unraisablehook__(unraisable)
        return
    main = threading.main_thread().ident
    assert main is not None
    _again = threading.Timer(_HEEDED_AGAIN_S, signal.pthread_kill, (main, signal.SIGINT))
    _again.daemon = True
    _again.start()


def interrupt_dropped() -> bool:
    """Return whether a library turned an interrupt into an error; cancel its pending repetition."""
    if _again is not None:
        _again.cancel()
    return _again is not None


def open_standard_streams() -> None:
    """Open the standard streams that a service manager or shell (``>&-``) has closed, leading nowhere.

    Otherwise Python has None in their place, and the next file opened gets the number of a standard stream.
    """
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # takes the lowest free number, which is this one
    sys.stdin = sys.stdin or open(0, encoding="utf-8", closefd=False)  # noqa: SIM115  # as long as the process
    sys.stdout = sys.stdout or open(1, "w", encoding="utf-8", closefd=False)  # noqa: SIM115
    sys.stderr = sys.stderr or open(2, "w", encoding="utf-8", closefd=False)  # noqa: SIM115


def exit_process(code: int) -> NoReturn:
    """End the process when what was registered for its end is done, at once where a thread is stuck.

    Python's own way takes every object apart first: a tenth of a short command's time. It would also end by SIGINT
    itself, whatever was made of it, where that came inside an exec().
    """
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)  # it ends; a signal now would only change the exit code
    deadline_s = time.monotonic() + _THREADS_END_S
    threads = [thread for thread in threading.enumerate() if thread is not threading.main_thread()]
    for thread in threads:
        if not thread.daemon:
            thread.join(max(0.0, deadline_s - time.monotonic()))
            if thread.is_alive():
                _end_at_once(code)
    atexit._run_exitfuncs()
    _end_at_once(code)


def _end_at_once(code: int) -> NoReturn:
    _flush()
    os._exit(code)


def _flush() -> None:
    """Write what is left, or let it go where that is not possible."""
    for stream in (sys.stdout, sys.stderr):
        try:
            stream.flush()
        except (OSError, ValueError):
            abandon(stream)


def abandon(stream: TextIO) -> None:
    """Let a stream that cannot be written lead nowhere, so that what it still holds is not tried again."""
    with contextlib.suppress(OSError, ValueError):
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, stream.fileno())
        os.close(nowhere)
        stream.flush()

"""This process and those that it starts: search path of modules, event loop, interrupts, and the end.

A folder of a user may hold a ``mission.py`` or a ``numpy.py``, and ROS puts its folders on PYTHONPATH, which Python
searches before installed packages. MAVSDK's blocking calls run in threads that cannot be cancelled. Python waits for
such threads without a time limit when ``asyncio.run`` ends, and again when the interpreter ends.
"""

from __future__ import annotations

import atexit
import contextlib
import os
import shlex
import shutil
import signal
import sys
import threading
import time
from collections.abc import Coroutine, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn, TextIO, TypeVar

if TYPE_CHECKING:
    import asyncio

T = TypeVar("T")

INTERRUPTED = 130  # the exit code
_THREADS_END_S = 1.0
_HEEDED_AGAIN_S = 0.05
_again: threading.Timer | None = None  # when a dropped interrupt comes


def prefer_installed_packages() -> None:
    """Search PYTHONPATH and the working folder after installed packages, except where sidelong itself is there."""
    own = str(Path(__file__).parents[2])  # that of the package's folder
    named = os.environ.get("PYTHONPATH", "").split(os.pathsep)
    last = {os.path.abspath(folder) for folder in named} | {os.getcwd()}  # noqa: PTH100, PTH109  # may not exist
    last -= {own}
    sys.path.sort(key=lambda folder: os.path.abspath(folder) in last)  # noqa: PTH100


def program() -> str:
    """Return the program's name as a reader has to type it: its path, where no ``sidelong`` is on the path."""
    called = Path(sys.argv[0])
    if called.name != "sidelong" or shutil.which("sidelong"):
        return "sidelong"
    near = os.path.relpath(called)
    return shlex.quote(str(called.absolute()) if near.startswith("..") else near)


def helper_command(module: str, *arguments: str) -> tuple[str, ...]:
    """Return the command line that runs one of our modules as a process of its own."""
    return (sys.executable, "-P", "-m", module, *arguments)


def helper_environment() -> dict[str, str]:
    """Return the environment of such a process: ours, with this process's search path in its order."""
    return os.environ | {"PYTHONPATH": os.pathsep.join(folder for folder in sys.path if folder)}


def run(main: Coroutine[Any, Any, T]) -> T:
    """Do as ``asyncio.run``, without waiting for calls that still block a thread when ``main`` is done."""
    import asyncio  # noqa: PLC0415  # it takes a moment to load, and most commands do not need it
    from concurrent.futures import ThreadPoolExecutor  # noqa: PLC0415

    class Threads(ThreadPoolExecutor):
        def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
            super().shutdown(wait=False, cancel_futures=True)

    async def with_threads() -> T:
        asyncio.get_running_loop().set_default_executor(Threads())
        return await main

    return asyncio.run(with_threads())


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
    import asyncio  # noqa: PLC0415  # as above

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

"""A process with a thread that never comes back, in a process of its own."""

import asyncio
import subprocess
import sys

import pytest

from sidelong.app.process import fails_with

LEFT = """
import asyncio, threading
from sidelong.app import process
async def main():
    begun = threading.Event()
    asyncio.get_running_loop().run_in_executor(None, lambda: (begun.set(), threading.Event().wait()))
    begun.wait()
    print("done")
    return 3
process.exit_process(process.run(main()))
"""

HELD_UP = """
import threading
from sidelong.app import process
with process.ends_within(0.2, "closing"):
    threading.Event().wait()
"""

IN_TIME = """
import threading
from sidelong.app import process
with process.ends_within(0.5, "closing"):
    pass
threading.Event().wait(0.7)
process.exit_process(0)
"""


@pytest.mark.parametrize(
    ("code", "exit_code", "out", "complaint"),
    [
        (LEFT, 3, "done\n", ""),
        (HELD_UP, 1, "", "sidelong: closing took more than 0.2 s and was left off.\n"),
        (IN_TIME, 0, "", ""),
    ],
    ids=["left", "held up", "in time"],
)
def test_it_ends(code, exit_code, out, complaint):
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60.0, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (exit_code, out, complaint)


LATE_SIGNAL = """
import atexit, os, signal
from sidelong.app import process
signal.signal(signal.SIGTERM, signal.default_int_handler)
atexit.register(lambda: os.kill(os.getpid(), signal.SIGTERM))
process.exit_process(3)
"""


def test_a_signal_at_the_very_end_changes_no_exit_code():
    done = subprocess.run([sys.executable, "-c", LATE_SIGNAL], capture_output=True, timeout=60.0, check=False)
    assert (done.returncode, done.stderr) == (3, b"")


DEAF = """
import signal
from sidelong.app import cli
class Deaf:
    def __del__(self):
        signal.raise_signal(signal.SIGINT)  # where Python drops exceptions, as in a callback of a library
def work(_arguments):
    Deaf()
    {}
cli.app = work
cli.main()
"""


@pytest.mark.parametrize("then", ["signal.pause()", "raise RuntimeError('no compiled object yet')"])
def test_an_interrupt_that_is_dropped_ends_it_all_the_same(then):
    code = [sys.executable, "-c", DEAF.format(then)]
    done = subprocess.run(code, capture_output=True, timeout=60.0, check=False)
    assert (done.returncode, done.stderr) == (130, b"sidelong: interrupted.\n")


@pytest.mark.parametrize("closed", [">&-", "2>&-", "<&- >&- 2>&-"])
def test_closed_standard_streams_are_no_error(closed, tmp_path):
    command = f'"{sys.executable}" -m sidelong.app terrain no-such-folder {closed}'
    assert subprocess.run(command, shell=True, check=False, stderr=subprocess.DEVNULL).returncode == 2
    command = f'"{sys.executable}" -m sidelong.app init "{tmp_path / "m.toml"}" {closed}'
    assert subprocess.run(command, shell=True, check=False).returncode == 0


@pytest.mark.parametrize("fails", [True, False])
def test_what_waits_for_a_task_ends_with_its_error(fails):
    async def works():
        if fails:
            raise ZeroDivisionError("a listener failed")

    async def waits():
        with fails_with(asyncio.create_task(works())):
            await asyncio.wait_for(asyncio.Event().wait(), 0.2)

    with pytest.raises(ZeroDivisionError if fails else TimeoutError):
        asyncio.run(waits())

"""Run ``sidelong`` commands, each in this process or, where the process itself is tested, in one of its own."""

from __future__ import annotations

import contextlib
import io
import subprocess
import sys
from pathlib import Path
from unittest import mock

from sidelong.app.cli import run
from sidelong.app.study import prediction

SIDELONG = Path(sys.executable).parent / "sidelong"

FEW_FLIGHTS = """
from sidelong.app.__main__ import main
from sidelong.app.study import prediction
prediction.FLIGHTS = prediction.FLIGHTS_MAX = 3
prediction.FLIGHT_S = 60.0
main()
"""
"""The commands as a program.

What ``check`` and a launch predict flies 3 and 4 minutes instead of 200 to 800 and 40, which take 3 s of each launch.
"""
PROGRAM = [sys.executable, "-c", FEW_FLIGHTS]


def new_process(*arguments: object, timeout_s: float = 280.0) -> subprocess.CompletedProcess[str]:
    """Run a command in a new process, as a person does."""
    command = [*PROGRAM, *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=timeout_s, check=False)


def sidelong(*arguments: object) -> subprocess.CompletedProcess[str]:
    """Run a command in this process, from its words to its exit code: a start of Python takes a second."""
    words = [str(one) for one in arguments]
    out, err = io.StringIO(), io.StringIO()
    few = mock.patch.object(prediction, "FLIGHT_S", 60.0) if words[0] == "launch" else contextlib.nullcontext()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err), few:
        code = run(words)
    return subprocess.CompletedProcess(words, code, out.getvalue(), err.getvalue())


def runs_for(process: subprocess.Popen[str], seconds: float) -> bool:
    """Wait for a process, and return whether it still runs after this many seconds."""
    with contextlib.suppress(subprocess.TimeoutExpired):
        process.wait(seconds)
    return process.poll() is None

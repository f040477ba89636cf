"""Run ``sidelong`` commands, each in this process or, where the process itself is tested, in one of its own."""

from __future__ import annotations

import contextlib
import io
import subprocess
import sys
from pathlib import Path

from sidelong.app.cli import run

SIDELONG = Path(sys.executable).parent / "sidelong"

FEW_FLIGHTS = """
from sidelong.app.__main__ import main
from sidelong.app.study import prediction
prediction.FLIGHTS = prediction.FLIGHTS_MAX = 3
main()
"""
"""The commands as a program, whose ``check`` flies 3 simulated flights instead of 20 to 80."""


def new_process(*arguments: object, timeout_s: float = 280.0) -> subprocess.CompletedProcess[str]:
    """Run a command in a new process, as a person does."""
    command = [str(SIDELONG), *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=timeout_s, check=False)


def sidelong(*arguments: object) -> subprocess.CompletedProcess[str]:
    """Run a command in this process, from its words to its exit code: a start of Python takes a second."""
    words = [str(one) for one in arguments]
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        code = run(words)
    return subprocess.CompletedProcess(words, code, out.getvalue(), err.getvalue())


def runs_for(process: subprocess.Popen[str], seconds: float) -> bool:
    """Wait for a process, and return whether it still runs after this many seconds."""
    with contextlib.suppress(subprocess.TimeoutExpired):
        process.wait(seconds)
    return process.poll() is None

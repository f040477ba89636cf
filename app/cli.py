"""The command line: one function a command, errors as one sentence."""

from __future__ import annotations

import sys
import traceback
from typing import NoReturn

import typer

from app.commands.check import check
from app.commands.connect import connect
from app.commands.export import export
from app.commands.init import init
from app.commands.launch import launch
from app.commands.replay import replay
from app.commands.report import report
from app.commands.terrain import terrain
from app.ending import leave
from app.errors import FlightError, InputError
from app.study.command import study
from sitl.cli import run as sitl

_HELP = """Watch a moving ground target from one side with a fixed-wing UAV.

The aircraft (PX4 or ArduPlane) flies circles beside the target, reads laser and gimbal, and moves the circle as the
target moves. It observes; it carries no other function.

Begin with: sidelong launch
"""

app = typer.Typer(
    name="sidelong", help=_HELP, no_args_is_help=True, rich_markup_mode=None, pretty_exceptions_enable=False
)
for command in (launch, connect, replay, report, export, check, init, study, terrain):
    app.command()(command)
app.command(name="sitl")(sitl)


def main() -> NoReturn:
    """Run the command line. Exit codes: 0 done, 1 the flight failed, 2 wrong input, 130 interrupted."""
    code = 0
    try:
        app()
    except SystemExit as end:
        code = int(end.code or 0)
    except InputError as error:
        code = _complain(error, 2)
    except FlightError as error:
        code = _complain(error, 1)
    except KeyboardInterrupt:
        code = 130
    except BrokenPipeError:
        code = 0
    except Exception:
        traceback.print_exc()
        code = 1
    leave(code)


def _complain(error: Exception, code: int) -> int:
    print(f"sidelong: {error}", file=sys.stderr)
    return code

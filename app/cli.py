"""The command line: one function a command, errors as one sentence."""

from __future__ import annotations

import contextlib
import errno
import gc
import sys
import traceback
from difflib import get_close_matches
from importlib import import_module
from typing import Annotated, Any, NoReturn

import typer
from typer.core import TyperCommand, TyperGroup

from sidelong.app.errors import FlightError, InputError, Interrupted
from sidelong.app.link.message import plain
from sidelong.app.process import INTERRUPTED, exit_process, handle_next, heed_interrupts, interrupt_dropped

_HELP = """Watch a moving ground target from one side with a fixed-wing UAV.

The aircraft (PX4 or ArduPlane) flies circles next to the target, reads laser and gimbal, and moves the circle as the
target moves. It observes; it carries no other function.

Begin with: sidelong launch
"""

# Each command with its module and its short help: a module is loaded when its command is called.
COMMANDS = {
    "launch": ("sidelong.app.commands.launch", "Fly next to a moving target, in simulation or with a vehicle."),
    "serve": ("sidelong.app.commands.serve", "Wait on board for the vehicle, and watch on request."),
    "status": ("sidelong.app.commands.serve", "Print what sidelong serve does now."),
    "watch": ("sidelong.app.commands.serve", "Ask sidelong serve to watch, or to resume."),
    "release": ("sidelong.app.commands.serve", "Ask sidelong serve to end the watch."),
    "confirm": ("sidelong.app.commands.serve", "Confirm that what the payload follows is the target."),
    "prepare": ("sidelong.app.commands.prepare", "Compile and compute ahead what a first flight needs."),
    "connect": ("sidelong.app.commands.connect", "List detected components and failing pre-flight checks."),
    "payload": ("sidelong.app.commands.payload", "Read a payload by its own protocol, publish it as MAVLink."),
    "camera": ("sidelong.app.commands.camera", "Track a target in a video, and lead the gimbal."),
    "replay": ("sidelong.app.commands.replay", "Run filter and planner over a recorded flight."),
    "report": ("sidelong.app.commands.report", "Write one HTML page about a flight."),
    "export": ("sidelong.app.commands.export", "Write a flight for other programs."),
    "check": ("sidelong.app.commands.check", "Check whether a requirement can be kept."),
    "sign": ("sidelong.app.commands.sign", "Make a key for signed links, give it to a vehicle."),
    "init": ("sidelong.app.commands.init", "Write a configuration file with every key explained."),
    "study": ("sidelong.app.commands.study", "Compare planners over many targets."),
    "route": ("sidelong.app.commands.route", "Check a route of the target, or make one of a flight."),
    "terrain": ("sidelong.app.commands.terrain", "Print what elevation data covers and where it is void."),
    "sitl": ("sidelong.sitl.cli", "Fly a simulated vehicle that speaks MAVLink."),
}


_NO_NUMBER = "this is not a number; give one without a unit and with a decimal point, such as 1200 or 4.5"
_OTHERWISE = {
    "--fidelity": "every study flies the closed loop; leave it out",
    "--track": "write the name of the track behind that of its file, FILE#NAME",
}


class _Commands(TyperGroup):
    def list_commands(self, ctx: Any) -> list[str]:
        return list(COMMANDS)

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        if cmd_name == "help":
            print(ctx.get_help())
            raise typer.Exit
        if cmd_name in COMMANDS:
            return load_command(cmd_name)
        near = get_close_matches(cmd_name, COMMANDS, 1)
        if near:
            ctx.fail(f"No such command {cmd_name!r}. Did you mean {near[0]!r}?")
        return None

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        listed = {name: TyperCommand(name, help=text, rich_markup_mode=None) for name, (_, text) in COMMANDS.items()}
        width = formatter.width - 6 - max(map(len, listed))
        with formatter.section("Commands"):
            formatter.write_dl([(name, command.get_short_help_str(width)) for name, command in listed.items()])


def help_groups(command: Any, context: Any) -> dict[str, list[tuple[str, str]]]:
    """Return (name, help) of each argument and option, by the group's title, in the order of their definition."""
    groups: dict[str, list[tuple[str, str]]] = {}
    for one in command.get_params(context):
        record = one.get_help_record(context)
        if record is not None:
            other = "Arguments" if one.param_type_name == "argument" else "Options"
            groups.setdefault(getattr(one, "rich_help_panel", None) or other, []).append(record)
    return groups


def _instead(option: str) -> str:
    """Return what takes the place of an unknown option, such as a key of its name, as a sentence; '' if nothing."""
    from sidelong.app.config import Config  # noqa: PLC0415  # only for an option that does not exist

    if option in _OTHERWISE:
        return f"{option}: {_OTHERWISE[option]}."
    name = option.lstrip("-").replace("-", "_")
    keys = [(section, key) for section, kind in Config() for key in type(kind).model_fields]
    named = [(key != name, section, key) for section, key in keys if f"{key}_".startswith(f"{name}_")]
    if not option.startswith("--") or not named:
        return ""
    _, section, key = min(named)
    return f"{option} is a key of the configuration: give --set {section}.{key}=VALUE."


class _Command(TyperCommand):
    """One command: options in groups; invalid values are reported with sidelong's own messages only."""

    def format_options(self, ctx: Any, formatter: Any) -> None:
        for title, records in help_groups(self, ctx).items():
            with formatter.section(title):
                formatter.write_dl(records)

    def make_context(self, *arguments: Any, **options: Any) -> Any:
        try:
            return super().make_context(*arguments, **options)
        except typer.TyperException as error:
            option = getattr(error, "option_name", "")
            if instead := _instead(option):
                raise InputError(instead) from error
            text = error.format_message().replace("Value error, ", "").rstrip(".")
            text = text.replace("Input should be a valid number, unable to parse string as a number", _NO_NUMBER)
            raise InputError(f"{text}; see sidelong {self.name} --help.") from error


def load_command(name: str) -> Any:
    """Import a command of COMMANDS by its name and return it as a click command."""
    gc.disable()
    module = import_module(COMMANDS[name][0])
    gc.freeze()  # to look through all this for garbage, again and again while more came, took a tenth of a start
    gc.enable()
    single = typer.Typer(add_completion=False, rich_markup_mode=None, pretty_exceptions_enable=False)
    single.command(name, cls=_Command)(getattr(module, "run" if name == "sitl" else name))
    command = typer.main.get_command(single)
    command.help = (command.help or "").replace("\nFor example:", "\n\b\nFor example:")  # lines as they are
    return command


app = typer.Typer(
    name="sidelong",
    cls=_Commands,
    help=_HELP,
    no_args_is_help=True,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
)


def _print_version(wanted: bool) -> None:
    if wanted:
        from importlib.metadata import version  # noqa: PLC0415  # it takes a while to load

        print(f"sidelong {version('sidelong')}")
        raise typer.Exit


@app.callback()
def _options(
    version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version and exit.")
    ] = False,
) -> None: ...


def main() -> NoReturn:
    heed_interrupts()
    sys.unraisablehook = handle_next
    exit_process(run())


def run(arguments: list[str] | None = None) -> int:
    """Run one command (None: of the process) and print an error as one sentence.

    Returns the exit code: 0 done, 1 the flight failed, 2 wrong input, 130 interrupted.
    """
    try:
        try:
            app(arguments)
        except SystemExit as end:
            code = int(end.code or 0)
            if code == INTERRUPTED:  # typer's word for an interrupt
                raise KeyboardInterrupt from end
            return code
    except InputError as error:
        return _complain(error, 2)
    except FlightError as error:
        return _complain(error, 1)
    except Interrupted as interrupted:
        return _complain(interrupted, INTERRUPTED)
    except KeyboardInterrupt:
        return _complain("interrupted.", INTERRUPTED)
    except BrokenPipeError:
        return 0
    except MemoryError:
        return _complain("there is not enough memory; a flight takes about 300 MB, the first compilation 1 GB.", 1)
    except Exception as error:
        if interrupt_dropped():
            return _complain("interrupted.", INTERRUPTED)
        if isinstance(error, OSError) and error.errno in (errno.ENOSPC, errno.EDQUOT):
            return _complain(f"the output cannot be written ({error.strerror}); free some space for it.", 2)
        with contextlib.suppress(OSError):
            traceback.print_exc()
        return 1
    return 0


def _complain(complaint: Exception | str, code: int) -> int:
    with contextlib.suppress(OSError):
        print(f"sidelong: {plain(str(complaint))}", file=sys.stderr)
    return code

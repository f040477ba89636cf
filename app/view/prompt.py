"""Changes typed at the terminal in flight: a line, confirmed once, becomes a request like the page's buttons."""

from __future__ import annotations

import asyncio
import os
import re
import sys
import termios
import tty
from collections.abc import Callable
from contextlib import suppress
from typing import Any, Literal

from sidelong.app.flight.loop import Wish
from sidelong.mission.control.mission_change import describe_change
from sidelong.mission.core.events import MissionChange, OperatorRequest

WHO = "the terminal"
HELP = "type c to change radius, band, height or side, or to hold, resume, confirm or end"
_EXAMPLES = "radius 80 | band 120-450 | height 90 | side right | hold | resume | this is it | end"
_LENGTH_MAX = 60
_ENTER, _ESCAPE, _ERASE = ("\r", "\n"), "\x1b", ("\x7f", "\b")
_NUMBER = r"(\d+(?:\.\d+)?)"
_ORDERS: dict[str, Literal["hold", "resume", "confirm", "end"]] = {
    "hold": "hold",
    "resume": "resume",
    "this is it": "confirm",
    "end": "end",
}


def read_wish(line: str) -> Wish | None:
    """Return the change requested by a line, its time not set; None if the line is invalid.

    Several changes are separated by commas: radius 80, side left.
    """
    order = _ORDERS.get(line.strip())
    if order is not None:
        return OperatorRequest(0.0, order, who=WHO)
    values: dict[str, Any] = {}
    for part in line.split(","):
        match part.split(maxsplit=1):
            case ["radius" | "height" as name, text] if re.fullmatch(_NUMBER, text.strip()):
                values[f"{name}_m"] = float(text)
            case ["band", text] if band := re.fullmatch(rf"{_NUMBER}\s*(?:-|to)\s*{_NUMBER}", text.strip()):
                values["range_min_m"], values["range_max_m"] = map(float, band.groups())
            case ["side", text]:
                values["side"] = text.strip()
            case _:
                return None
    return MissionChange(0.0, **values, who=WHO)


class Prompt:
    """The line as it is typed. ``text``: shown to the operator; ``wish``: called with each confirmed request."""

    def __init__(self, wish: Callable[[Wish], object]) -> None:
        self._wish = wish
        self._line: str | None = None  # None: nothing is being typed
        self._asked: Wish | None = None
        self.text = HELP

    def key(self, key: str) -> None:
        """Take one character."""
        if self._asked is not None:
            asked, self._asked = self._asked, None
            self._show(None)
            if key in ("y", "Y"):
                self._wish(asked)
        elif self._line is None:
            if key == "c":
                self._show("")
        elif key == _ESCAPE:
            self._show(None)
        elif key in _ERASE:
            self._show(self._line[:-1])
        elif key in _ENTER:
            self._ask(self._line)
        elif key.isprintable() and len(self._line) < _LENGTH_MAX:
            self._show(self._line + key)

    def _ask(self, line: str) -> None:
        self._asked = read_wish(line)
        if self._asked is None:
            self._show("", f"not understood: {line!r}; " if line else "")
            return
        asked = self._asked
        words = describe_change(asked) if isinstance(asked, MissionChange) else line.strip()
        self.text = f"{words}: y does it, any other key leaves it"

    def _show(self, line: str | None, before: str = "") -> None:
        self._line = line
        self.text = HELP if line is None else f"{before}> {line or f'({_EXAMPLES}; Esc leaves)'}"


class Keyboard:
    """Characters of a terminal as they are typed, to a ``Prompt``; made and stopped in the running event loop."""

    def __init__(self, descriptor: int, prompt: Prompt) -> None:
        self._descriptor, self._prompt = descriptor, prompt
        self._before = termios.tcgetattr(descriptor)
        tty.setcbreak(descriptor, termios.TCSANOW)  # Ctrl-C stays what it is
        asyncio.get_running_loop().add_reader(descriptor, self._read)

    def stop(self) -> None:
        """Leave the terminal as it was."""
        asyncio.get_running_loop().remove_reader(self._descriptor)
        with suppress(termios.error):  # it is gone
            termios.tcsetattr(self._descriptor, termios.TCSANOW, self._before)

    def _read(self) -> None:
        try:
            typed = os.read(self._descriptor, 1024)
        except OSError:
            typed = b""
        if not typed:
            asyncio.get_running_loop().remove_reader(self._descriptor)
        for key in typed.decode(errors="replace"):
            self._prompt.key(key)


def keyboard_descriptor() -> int | None:
    """Return standard input where a person can type there, and is meant for us: not in the background of a shell."""
    with suppress(OSError, ValueError, AttributeError):
        descriptor = sys.stdin.fileno()
        if os.isatty(descriptor) and os.tcgetpgrp(descriptor) == os.getpgrp():
            return descriptor
    return None

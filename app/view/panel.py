"""The terminal display: a status panel with decisions above it, or plain lines; changes are typed at it."""

from __future__ import annotations

import asyncio
import math
import os
import re
import sys
import termios
import tty
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import replace
from typing import Any, Literal, Self

from rich.console import Console, RenderableType
from rich.live import Live
from rich.panel import Panel as Border
from rich.table import Table
from rich.text import Text

from sidelong.app.config import Config
from sidelong.app.flight.loop import Wish
from sidelong.app.link.message import plain
from sidelong.estimators.estimate import TrackQuality
from sidelong.estimators.frames import LocalPlane
from sidelong.mission.control.mission_change import describe_change
from sidelong.mission.control.present import Phase, Present, VehicleStatus
from sidelong.mission.core.events import Announce, MissionChange, OperatorRequest
from sidelong.mission.core.requirement import Requirement

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
    """Return the change of a line such as "radius 80, side left", its time not set; None if the line is invalid."""
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
        """Act on a pressed key: c begins a line, Enter asks, y sends it, Escape drops it."""
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
        """Read no more, and give the terminal its settings back."""
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


REFRESH_HZ = 4.0
_PLAIN_LINE_EVERY_S = 60.0  # of the vehicle's time
_STANDING_M_S = 0.3
_GAUGE_CELLS = 24
_LOW_BATTERY_PERCENT, _POOR_LINK_PERCENT = 25, 80
_OLD_S = 2.0  # a sensor silent for longer is marked
STYLES = {
    "decision": "cyan",
    "track": "magenta",
    "link": "red",
    "yield": "bold red",
    "operator": "yellow",
    "refused": "yellow",
    "end": "bold",
    "alarm": "bold red",
    "clear": "green",
}
_PHASE_STYLES = {Phase.WATCHING: "green", Phase.HOLDING: "yellow", Phase.YIELDED: "red", Phase.ENDED: "red"}
_QUALITY_STYLES = {TrackQuality.GOOD: "green", TrackQuality.COASTING: "yellow", TrackQuality.LOST: "bold red"}


class Panel:
    """The terminal: a panel at its bottom with messages above it; else plain lines. Use as ``with``.

    keyboard: file descriptor of the terminal for typed changes of a single aircraft; None: there is none.
    """

    def __init__(
        self, console: Console, quiet: bool = False, keyboard: int | None = None, names_targets: bool = False
    ) -> None:
        self.console, self.quiet, self.names_targets = console, quiet, names_targets
        self._descriptor = keyboard
        self._live: Live | None = None
        self._aircraft: list[AircraftDisplay] = []
        self._typed: Keyboard | None = None

    def __enter__(self) -> Self:
        if self.console.is_terminal and not self.quiet:
            # The panel is made when it is drawn, by a thread of its own: showing a snapshot costs the loop nothing.
            self._live = Live(
                get_renderable=self._drawn, console=self.console, refresh_per_second=REFRESH_HZ, transient=True
            )
            self._live.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self._typed is not None:
            self._typed.stop()
            self._typed = None
        if self._live is not None:
            self._live.stop()
            self._live = None

    def of(self, name: str = "") -> AircraftDisplay:
        """Return the display of one aircraft; '' where it is the only one."""
        display = AircraftDisplay(self, name)
        self._aircraft.append(display)
        return display

    def note(self, text: str) -> None:
        self.print(Text(plain(text)))

    def print(self, text: Text) -> None:
        if not self.quiet:
            self.console.print(text, soft_wrap=self._live is None)

    def typed(self, ask: Callable[[Wish], None]) -> Prompt | None:
        """Read what is typed at the terminal into a prompt; None where no person can type."""
        if self._live is None or self._descriptor is None:
            return None
        prompt = Prompt(ask)
        self._typed = Keyboard(self._descriptor, prompt)
        return prompt

    def _drawn(self) -> RenderableType:
        if len(self._aircraft) == 1 and not self._aircraft[0].name:
            return self._aircraft[0].panel()
        table = Table.grid(padding=(0, 2))
        for one in self._aircraft:
            table.add_row(Text(one.name, style="bold"), *map(Text, one.cells()))
        return table


class AircraftDisplay:
    """A ``FlightDisplay`` of one aircraft on the terminal."""

    def __init__(self, terminal: Panel, name: str) -> None:
        self._terminal, self.name = terminal, name
        self._prompt: Prompt | None = None
        self._start_s: float | None = None  # None: not taken over yet, and times mean nothing to a person
        self._duration_s: float | None = None
        self._snapshot: Present | None = None
        self._plain_s = -math.inf

    def begin(self, plane: LocalPlane, request: Callable[[Wish], None], config: Config | None = None) -> None:
        def wish(asked: Wish) -> None:
            if self._snapshot is not None and math.isfinite(self._snapshot.time_s):
                request(replace(asked, time_s=self._snapshot.time_s))

        self._prompt = None if self.name else self._terminal.typed(wish)

    def show_picture(self, picture: Callable[[], bytes]) -> None:
        """Show no picture: a terminal has none."""

    def watching_began(self, start_s: float, duration_s: float | None) -> None:
        self._start_s, self._duration_s = start_s, duration_s

    def note(self, text: str) -> None:
        self._terminal.note(self._named(text))

    def _named(self, text: str) -> str:
        return f"{self.name}: {text}" if self.name else text

    def say(self, announcement: Announce) -> None:
        terminal = self._terminal
        if announcement.kind == "alarm" and not terminal.quiet and terminal.console.is_terminal:
            terminal.console.bell()
        since = "" if self._start_s is None else clock(max(announcement.time_s - self._start_s, 0.0))
        text = f"{since:>7}  {self._named(plain(announcement.text))}"
        terminal.print(Text(text, style=STYLES.get(announcement.kind, "")))

    def show(self, snapshot: Present) -> None:
        self._snapshot, terminal = snapshot, self._terminal
        if terminal._live is None and snapshot.time_s - self._plain_s >= _PLAIN_LINE_EVERY_S:
            self._plain_s = snapshot.time_s
            terminal.print(Text(self._line(snapshot)))

    def _line(self, shown: Present) -> str:
        parts = [*filter(None, self.cells())]
        if self._start_s is not None:
            parts.append(f"moves {shown.moves}")
        if shown.upload_failures:
            parts.append(f"failed uploads {shown.upload_failures}")
        return f"{self._time(shown):>7}  " + self._named("  ".join([*parts, *shown.impaired_inputs]))

    def cells(self) -> tuple[str, ...]:
        """Return its row of the fleet's table; empty cells before its first state."""
        shown = self._snapshot
        if shown is None:
            return ("",) * 7
        range_m, estimate, height_m = shown.range_m, shown.estimate, shown.height_m
        to = f" to {shown.target}" if self._terminal.names_targets else ""
        percent = None if shown.vehicle is None else shown.vehicle.battery_percent
        return (
            f"{shown.phase} {shown.mode}".strip(),
            f"{shown.side} side",
            "" if range_m is None else f"range {range_m:.0f} m{to}",
            f"height {height_m:.0f} m" if math.isfinite(height_m) else "",
            "" if range_m is None else f"target {target_motion(shown)}",
            "" if range_m is None or estimate is None else f"track {estimate.quality}",
            "" if percent is None else f"battery {percent} %",
        )

    def _time(self, shown: Present) -> str:
        if self._start_s is None or not math.isfinite(shown.time_s):
            return "-:--"
        of = "" if self._duration_s is None else f"/{clock(self._duration_s)}"
        return clock(max(shown.time_s - self._start_s, 0.0)) + of

    # -- the panel -----------------------------------------------------------------------------------------

    def panel(self) -> RenderableType:
        shown = self._snapshot
        if shown is None:
            return Text("")
        table = Table.grid(padding=(0, 2))
        for name, text in self._rows(shown):
            table.add_row(Text(name, style="dim"), text)
        style = _PHASE_STYLES.get(shown.phase, "")
        title = Text(f" {shown.phase} · {shown.mode} · {self._time(shown)} ", style=f"bold {style}".strip())
        width = min(self._terminal.console.width, 92)
        return Border(table, title=title, title_align="left", border_style=style or "none", width=width)

    def _rows(self, shown: Present) -> Iterator[tuple[str, Text]]:
        range_m, estimate = shown.range_m, shown.estimate
        if range_m is None or estimate is None:
            yield "target", Text("not seen yet")
        else:
            yield "range", _gauge(range_m, shown.requirement)
            within_m = estimate.ellipse_95.semi_major_m
            known = Text(f"{target_motion(shown)}, 95 % within {within_m:.1f} m, track ")
            known.append(estimate.quality, _QUALITY_STYLES[estimate.quality])
            yield "target", known
        yield "circle", Text(self._circle(shown))
        sensors = Text()
        for name, age_s in (("laser", shown.time_s - shown.range_s), ("gimbal", shown.time_s - shown.gimbal_s)):
            words = f"{name} {age_s:.1f} s ago" if math.isfinite(age_s) else f"no {name}"
            sensors.append(words + "   ", "" if age_s <= _OLD_S else "yellow")
        sensors.append("link ok" if shown.connected else "link lost", "" if shown.connected else "bold red")
        bank = "" if shown.attitude is None else f"   bank {math.degrees(shown.attitude.roll_rad):.0f}°"
        sensors.append(f"{bank}   wind {shown.wind.speed_m_s:.1f} m/s")
        yield "sensors", sensors
        if shown.impaired_inputs:
            yield "inputs", Text(", ".join(shown.impaired_inputs), style="yellow")
        if shown.vehicle is not None:
            yield "vehicle", _vehicle(shown.vehicle)
        if shown.decision is not None:
            yield "decided", Text(plain(shown.decision.reason), style="cyan")
        if self._prompt is not None:
            yield "keys", Text(plain(self._prompt.text), style="dim" if self._prompt.text == HELP else "yellow")

    @staticmethod
    def _circle(shown: Present) -> str:
        words = [f"moves {shown.moves}", f"uploads {shown.uploads}"]
        if shown.upload_failures:
            words.append(f"failed {shown.upload_failures}")
        if shown.plan is not None:
            words.insert(0, f"R {shown.plan.circle.radius_m:.0f} m")
        if shown.coming is not None:
            words.append(f"leaving for the next in {max(shown.coming.departure_s - shown.time_s, 0.0):.0f} s")
        return ", ".join(words)


def clock(time_s: float) -> str:
    """Return a time as minutes:seconds."""
    return f"{int(time_s // 60):d}:{int(time_s % 60):02d}"


def _gauge(range_m: float, requirement: Requirement) -> Text:
    """Return the range as a mark between least and greatest allowed; the mark is red outside."""
    min_m, max_m = requirement.range_min_m, requirement.range_max_m
    share = (range_m - min_m) / (max_m - min_m)
    cell = min(max(int(share * _GAUGE_CELLS), 0), _GAUGE_CELLS - 1)
    inside = 0.0 <= share <= 1.0
    text = Text(f"{range_m:4.0f} m   {min_m:.0f} ")
    text.append("─" * cell, "dim")
    text.append("●", "bold green" if inside else "bold red")
    text.append("─" * (_GAUGE_CELLS - 1 - cell), "dim")
    text.append(f" {max_m:.0f} m")
    return text


def _vehicle(status: VehicleStatus) -> Text:
    text, percent = Text(), status.battery_percent
    if percent is not None:
        text.append(f"battery {percent} %   ", "bold red" if percent < _LOW_BATTERY_PERCENT else "")
    if status.gps is not None:
        text.append(f"GPS {status.gps}   ", "" if status.gps_good else "bold red")
    if status.link_percent is not None:
        text.append(f"link {status.link_percent} %", "" if status.link_percent >= _POOR_LINK_PERCENT else "yellow")
    return text


def target_motion(shown: Present) -> str:
    """Return the target's motion in words."""
    assert shown.estimate is not None
    if shown.estimate.speed_m_s < _STANDING_M_S:
        return "standing"  # its course is noise
    return f"{shown.estimate.speed_m_s:.1f} m/s to {math.degrees(shown.estimate.course_rad) % 360.0:03.0f}°"

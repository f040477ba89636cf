"""The terminal of a fleet: a panel with a row for each aircraft and messages above it; else plain lines."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

from rich.console import Console
from rich.table import Table
from rich.text import Text

from sidelong.app.flight.loop import Wish
from sidelong.app.link.message import plain
from sidelong.app.view.panel import STYLES, LivePanel, clock, target_motion
from sidelong.estimators.frames import LocalPlane
from sidelong.mission.control.present import Present
from sidelong.mission.core.events import Announce

_PLAIN_LINE_EVERY_S = 60.0  # of the vehicle's time


class AircraftDisplay:
    """A ``FlightDisplay`` of one aircraft among several."""

    def __init__(self, name: str, line: Callable[[Text], None], names_target: bool, plain_lines: bool) -> None:
        self.name, self._line, self._names_target, self._plain_lines = name, line, names_target, plain_lines
        self.snapshot: Present | None = None
        self._start_s: float | None = None
        self._announced_s = -math.inf
        self._request: Callable[[Wish], None] | None = None

    def begin(self, plane: LocalPlane, request: Callable[[Wish], None]) -> None:
        self._request = request

    def ask(self, wish: Wish) -> None:
        """Pass a person's wish on to the aircraft, at its own time."""
        if self._request is not None and self.snapshot is not None and math.isfinite(self.snapshot.time_s):
            self._request(replace(wish, time_s=self.snapshot.time_s))

    def engage(self, start_s: float, duration_s: float | None) -> None:
        self._start_s = start_s

    def note(self, text: str) -> None:
        self._line(Text(f"{self.name}: {plain(text)}"))

    def say(self, announcement: Announce) -> None:
        text = f"{self._since(announcement.time_s):>7}  {self.name}: {plain(announcement.text)}"
        self._line(Text(text, style=STYLES.get(announcement.kind, "")))

    def show(self, snapshot: Present) -> None:
        self.snapshot = snapshot
        if self._plain_lines and snapshot.time_s - self._announced_s >= _PLAIN_LINE_EVERY_S:
            self._announced_s = time_s = snapshot.time_s
            self._line(Text(f"{self._since(time_s):>7}  {self.name}: " + "  ".join(filter(None, self.cells()))))

    def cells(self) -> tuple[str, ...]:
        """Return the present state, in the columns of the panel."""
        shown = self.snapshot
        if shown is None:
            return ("", "", "", "", "", "")
        range_m = shown.range_m
        height_m = shown.height_m
        to = f" to {shown.target}" if self._names_target else ""
        percent = None if shown.vehicle is None else shown.vehicle.battery_percent
        return (
            f"{shown.phase} {shown.mode}".strip(),
            f"{shown.side} side",
            "" if range_m is None else f"range {range_m:.0f} m{to}",
            f"height {height_m:.0f} m" if math.isfinite(height_m) else "",
            target_motion(shown) if range_m is not None else "",
            "" if percent is None else f"battery {percent} %",
        )

    def _since(self, time_s: float) -> str:
        return "" if self._start_s is None else clock(max(time_s - self._start_s, 0.0))


class FleetPanel(LivePanel):
    """The terminal of all aircraft. names_targets: there are several targets."""

    def __init__(self, console: Console, quiet: bool = False, names_targets: bool = False) -> None:
        super().__init__(console, quiet)
        self._names_targets = names_targets
        self._aircraft: list[AircraftDisplay] = []

    def of(self, name: str) -> AircraftDisplay:
        """Return the display of one aircraft."""
        display = AircraftDisplay(name, self._print, self._names_targets, plain_lines=self._live is None)
        self._aircraft.append(display)
        return display

    def _panel(self) -> Table:
        table = Table.grid(padding=(0, 2))
        for one in self._aircraft:
            table.add_row(Text(one.name, style="bold"), *map(Text, one.cells()))
        return table

"""The terminal: one live status line, decisions above it; plain lines when it is no terminal."""

from __future__ import annotations

import math
import time
from types import TracebackType

from rich.console import Console
from rich.live import Live
from rich.text import Text

from mission.events import Announce
from mission.watch import Snapshot

_REFRESH_S = 0.25
_PLAIN_LINE_EVERY_S = 60.0  # of the vehicle's time
_STYLES = {
    "decision": "cyan",
    "track": "magenta",
    "link": "red",
    "yield": "bold red",
    "operator": "yellow",
    "end": "bold",
}


def clock(time_s: float) -> str:
    """Return minutes:seconds."""
    return f"{int(time_s // 60):d}:{int(time_s % 60):02d}"


class ConsoleDisplay:
    """A ``Display`` on the terminal. Times are shown since ``start_s`` of the vehicle's clock."""

    def __init__(self, console: Console, quiet: bool = False) -> None:
        self.start_s = 0.0
        self.duration_s: float | None = None
        self._console, self._quiet = console, quiet
        self._live: Live | None = None
        self._shown_s = 0.0
        self._plain_s = -math.inf

    def __enter__(self) -> ConsoleDisplay:
        if self._console.is_terminal and not self._quiet:
            self._live = Live(Text(""), console=self._console, refresh_per_second=1.0 / _REFRESH_S, transient=True)
            self._live.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._live is not None:
            self._live.stop()
            self._live = None

    def note(self, text: str) -> None:
        """Print a line about the proceedings."""
        if not self._quiet:
            self._console.print(Text(text))

    def say(self, announcement: Announce) -> None:
        if self._quiet:
            return
        since_s = max(announcement.time_s - self.start_s, 0.0)
        style = _STYLES.get(announcement.kind, "")
        self._console.print(Text(f"{clock(since_s):>7}  {announcement.text}", style=style))

    def show(self, state: Snapshot) -> None:
        if self._quiet:
            return
        now_s = time.monotonic()
        if now_s - self._shown_s < _REFRESH_S:
            return
        self._shown_s = now_s
        if self._live is not None:
            self._live.update(Text(self.line(state), style="bold"))
        elif state.time_s - self._plain_s >= _PLAIN_LINE_EVERY_S:
            self._plain_s = state.time_s
            self._console.print(Text(self.line(state)))

    def line(self, state: Snapshot) -> str:
        """Return the status line."""
        parts = [clock(max(state.time_s - self.start_s, 0.0))]
        if self.duration_s is not None:
            parts[0] += f"/{clock(self.duration_s)}"
        parts.append(f"{state.phase} {state.mode}".strip())
        aircraft, estimate = state.aircraft, state.estimate
        if aircraft is not None and estimate is not None:
            range_m = math.hypot(aircraft.east_m - estimate.east_m, aircraft.north_m - estimate.north_m)
            parts.append(f"range {range_m:3.0f} m")
            parts.append(f"target {estimate.speed_m_s:.1f} m/s to {math.degrees(estimate.course_rad) % 360:03.0f}°")
            parts.append(f"track {estimate.quality}")
        parts.append(f"moves {state.moves}")
        if state.upload_failures:
            parts.append(f"failed uploads {state.upload_failures}")
        return "  ".join(parts)

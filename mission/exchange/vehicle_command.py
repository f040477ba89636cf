"""One command, repeated until it is acknowledged. Source: <https://mavlink.io/en/services/command.html>."""

from __future__ import annotations

import math
from dataclasses import dataclass

from sidelong.mission.exchange.outbox import Outbox
from sidelong.mission.exchange.reports import CommandAcknowledged

_ANSWER_S, _TRIES = 1.0, 4
ACCEPTED, NOT_NOW, IN_PROGRESS = 0, 1, 5  # of MAV_RESULT
_IN_PROGRESS_S, _IN_PROGRESS_MAX_S = 10.0, 30.0  # after each such answer; after the first one
_RESULTS = {
    0: "accepted",
    1: "temporarily rejected",
    2: "denied",
    3: "unsupported",
    4: "failed",
    5: "in progress",
    6: "cancelled",
    7: "sent as COMMAND_LONG only",
    8: "sent as COMMAND_INT only",
    9: "unsupported frame",
}


@dataclass(frozen=True, slots=True)
class VehicleCommand:
    """A MAV_CMD with its parameters: COMMAND_LONG, or COMMAND_INT where it has a frame (NaN: unused)."""

    command: int
    params: tuple[float, ...]
    frame: int | None = None
    x: int = 0
    y: int = 0
    z: float = 0.0


def describe_result(result: int | None) -> str:
    """Return a MAV_RESULT in words."""
    return "no answer" if result is None else _RESULTS.get(result, f"result {result}")


class CommandExchange:
    """One command until it is answered."""

    def __init__(self, outbox: Outbox, command: VehicleCommand) -> None:
        self._outbox, self._command = outbox, command
        self._sends = 0
        self.done = False
        self.result: int | None = None  # MAV_RESULT once ``done``; None: no answer; 5: still in progress
        self.next_timer_s = math.inf
        self._in_progress_until_s = math.inf
        self._send()

    @property
    def accepted(self) -> bool:
        """Whether the command was acknowledged as accepted."""
        return self.done and self.result == ACCEPTED

    def receive(self, report: CommandAcknowledged) -> None:
        """Process an acknowledgement."""
        if self.done or report.command != self._command.command:
            return
        if report.result == IN_PROGRESS:
            now_s = self._outbox.link_s
            self._in_progress_until_s = min(self._in_progress_until_s, now_s + _IN_PROGRESS_MAX_S)
            self.next_timer_s = min(now_s + _IN_PROGRESS_S, self._in_progress_until_s)
            return
        self.done, self.result, self.next_timer_s = True, report.result, math.inf

    def expire(self) -> None:
        """Repeat the command, or give up."""
        now_s = self._outbox.link_s
        if self.done or now_s < self.next_timer_s:
            return
        if now_s >= self._in_progress_until_s:
            self.done, self.result, self.next_timer_s = True, IN_PROGRESS, math.inf
        elif self._sends < _TRIES:
            self._send()
        else:
            self.done, self.next_timer_s = True, math.inf

    def _send(self) -> None:
        command = self._command
        size, unused = (7, 0.0) if command.frame is None else (4, math.nan)
        values = [*command.params, *([unused] * (size - len(command.params)))]
        fields = {f"param{i}": float(value) for i, value in enumerate(values, 1)}
        if command.frame is None:
            self._outbox.send("COMMAND_LONG", command=command.command, confirmation=self._sends, **fields)
        else:
            place = {"x": command.x, "y": command.y, "z": command.z}
            fixed = {"frame": command.frame, "current": 0, "autocontinue": 0}
            self._outbox.send("COMMAND_INT", command=command.command, **fixed, **fields, **place)
        self._sends += 1
        self.next_timer_s = self._outbox.link_s + _ANSWER_S

"""A controller in another process: a CSV row with the states of aircraft and target in, a turn rate out."""

from __future__ import annotations

import math
import os
import select
import shlex
import subprocess
import time
from types import TracebackType

from sidelong.app.errors import InputError
from sidelong.estimators.estimate import TargetEstimate
from sidelong.mission.core.plan import AircraftState

COLUMNS = (
    *("time_s", "aircraft_east_m", "aircraft_north_m", "aircraft_course_rad", "ground_speed_m_s"),
    *("turn_rate_rad_s", "turn_rate_max_rad_s", "target_east_m", "target_north_m", "target_velocity_east_m_s"),
    *("target_velocity_north_m_s", "target_sigma_m", "range_min_m", "range_max_m", "side"),
)
"""Columns of a row; docs/how-to/benchmark.md describes them."""

_START_S, _ANSWER_S, _END_S = 60.0, 10.0, 2.0
_ANSWER_MAX_BYTES = 200


class ExternalController:
    """One controller process for one run; a context manager that ends it."""

    def __init__(self, command: str, curvature_max_per_m: float, range_m: tuple[float, float], side: str) -> None:
        """Start the process and send the header.

        Args:
            command: Program and arguments; no shell interprets them.
            curvature_max_per_m: Largest curvature that the aircraft flies, 1/m.
            range_m: Least and greatest range, m.

        Raises:
            InputError: The command is empty, or the program cannot be started.
        """
        if not command.strip():
            raise InputError("--controller: the command is empty; give a program and its arguments.")
        self._command, self._curvature_max_per_m = command, curvature_max_per_m
        self._constant = f"{range_m[0]:g},{range_m[1]:g},{side}\n"
        self._rows, self._wait_s, self._answers = 0, _START_S, b""
        try:
            self._process = subprocess.Popen(
                shlex.split(command), stdin=subprocess.PIPE, stdout=subprocess.PIPE, bufsize=0
            )
        except (OSError, ValueError) as error:
            raise InputError(f"--controller: {command!r} cannot be started ({error}); give a command.") from error
        self._send(",".join(COLUMNS) + "\n")

    def __call__(self, aircraft: AircraftState, target: TargetEstimate) -> float:
        """Return the curvature that the controller commands, 1/m, positive to the right and not limited.

        Raises:
            InputError: The process has ended, does not answer in time, or answers something else than a number.
        """
        speed_m_s, p = max(aircraft.ground_speed_m_s, 1.0), target.covariance
        sigma_m = math.sqrt(max(0.5 * (p[0, 0] + p[1, 1]), 0.0))
        values = (
            *(aircraft.time_s, aircraft.east_m, aircraft.north_m, aircraft.course_rad, speed_m_s),
            *(speed_m_s * aircraft.curvature_per_m, speed_m_s * self._curvature_max_per_m),
            *(target.east_m, target.north_m, target.velocity_east_m_s, target.velocity_north_m_s, sigma_m),
        )
        self._send(",".join(f"{value:.6f}" for value in values) + "," + self._constant)
        self._rows += 1
        answer = self._line()
        try:
            turn_rate_rad_s = float(answer)
        except ValueError:
            turn_rate_rad_s = math.nan
        if not math.isfinite(turn_rate_rad_s):
            raise self._error(f"answered {answer[:40]!r}", "print one turn rate in rad/s for each row")
        return turn_rate_rad_s / speed_m_s

    def __enter__(self) -> ExternalController:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """End the process: its input ends first, then it is killed."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.close()
        try:
            self._process.wait(_END_S if kind is None else 0.0)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._process.stdout.close()

    def _send(self, words: str) -> None:
        """Write a row. Raises InputError where the process does not read, or has answered before it."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        early, free, _ = select.select([self._process.stdout], [self._process.stdin], [], _ANSWER_S)
        if self._answers or (early and os.read(self._process.stdout.fileno(), 1)):
            raise self._error("answered before it got a row", "print one turn rate for each row, none for the header")
        if not free:
            raise self._error("did not read in time", "read each row before it answers")
        try:
            self._process.stdin.write(words.encode())
        except OSError as error:
            raise self._ended() from error

    def _line(self) -> str:
        """Return the next line of the answers."""
        assert self._process.stdout is not None
        until_s, self._wait_s = time.monotonic() + self._wait_s, _ANSWER_S
        while b"\n" not in self._answers:
            ready, _, _ = select.select([self._process.stdout], [], [], max(until_s - time.monotonic(), 0.0))
            if not ready:
                raise self._error("did not answer in time", "flush its output after each row")
            found = os.read(self._process.stdout.fileno(), 4096)
            if not found:
                raise self._ended()
            self._answers += found
            if len(self._answers) > _ANSWER_MAX_BYTES:
                raise self._error("answered too much", "print one turn rate in rad/s for each row")
        line, _, self._answers = self._answers.partition(b"\n")
        return line.decode(errors="replace").strip()

    def _ended(self) -> InputError:
        try:
            code = str(self._process.wait(_END_S))
        except subprocess.TimeoutExpired:
            code = "none"
        return self._error(f"ended (exit code {code})", "read rows until its input ends")

    def _error(self, what: str, remedy: str) -> InputError:
        return InputError(f"--controller: {self._command!r} {what} after row {self._rows}; it has to {remedy}.")

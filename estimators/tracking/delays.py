"""Delays of laser and gimbal stamps, fitted to the readings of the last minutes.

A payload that stamps its readings late shows the target displaced by the distance that the aircraft has flown in that
time. While the aircraft circles, the displacement circles with it. A real target does not do so for minutes.

On a steady circle about a standing target, a payload whose angles are relative to the aircraft looks the same if it
is late and if the target is elsewhere, turned about the circle's centre. A change of circle shows the difference, and
until then the standard deviations of the delays are large.

Source: docs/explanation/filter.md#delays.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from sidelong.estimators.filters.biases import Delays
from sidelong.estimators.rotations import Quaternion, normalized, rotate, sight_direction
from sidelong.estimators.sensing.readings import AttitudeReading, GimbalReading, PositionReading
from sidelong.estimators.settings import TrackerSettings
from sidelong.estimators.tracking.delay_scene import MAX_DELAY_S, MIN_DELAY_S, STIFF_M, Scene

FloatArray = npt.NDArray[np.float64]

_WINDOW_S = 300.0
_SAMPLE_EVERY_S = 0.19  # five of each reading in a second are enough
_READINGS_MIN, _SPAN_MIN_S = 50, 12.0
_GAP_MAX_S = 3.0  # of positions and attitudes
# The next fit comes when the readings span a fifth more, within these limits: a large delay is found early.
_GROWTH, _EVERY_MIN_S, _EVERY_MAX_S = 0.2, 10.0, 60.0
# Standard deviations stated, of those assumed. Of readings: a target's own motion is not quite the noise that the fit
# takes it for. Of priors: on a steady circle, a late gimbal differs from a yaw error by the prior of that alone.
_READINGS_SIGMAS, _PRIORS_SIGMAS = 4.0, 2.0
_RANGE_BIAS_SIGMA_M = 3.0  # holds the error of the target's height, too
_STARTS_S = (
    (0.0, 0.0),
    (2.0, 2.0),
    (1.0, 1.0),
    (0.0, 2.0),
    (2.0, 0.0),
)  # from the last fit, a lesser minimum may hold


class DelayFit:
    """Collects readings with the stamps that they came with, and fits the delays.

    Args:
        settings: noise and priors.
        parent_from_mount: how the gimbal's base is turned against the airframe.

    Attributes:
        frame: of the lines of sight; empty before the first.
    """

    def __init__(self, settings: TrackerSettings, parent_from_mount: Quaternion) -> None:
        self._latencies_s = settings.latencies_s
        delay_s, yaw_rad = settings.latency_sigma_s, settings.yaw_bias_sigma_rad
        self._sigmas = np.array([delay_s, delay_s, max(yaw_rad, 1e-6), _RANGE_BIAS_SIGMA_M])
        self._noise = settings.yaw_sigma_rad, settings.range_sigma_m
        self._parent_from_mount = parent_from_mount
        self._positions, self._attitudes = _Log(5), _Log(4)
        self._gimbals, self._ranges = _Log(4), _Log(2)
        self.frame, self._next_s = "", 0.0
        self._begin()

    def _begin(self) -> None:
        self._shared, self._scale_m, self._fits = np.zeros(4), STIFF_M, 0

    def clear(self) -> None:
        """Forget the readings of laser and gimbal: another device is used now."""
        self._gimbals.clear()
        self._ranges.clear()
        self._begin()

    def position(self, p: PositionReading) -> None:
        """Take a position of the aircraft.

        Args:
            p: The position.
        """
        self._positions.add(p.time_s, p.east_m, p.north_m, p.velocity_east_m_s, p.velocity_north_m_s)

    def attitude(self, a: AttitudeReading) -> None:
        """Take an attitude of the aircraft.

        Args:
            a: The attitude.
        """
        self._attitudes.add(a.time_s, a.roll_rad, a.pitch_rad, a.yaw_rad)

    def gimbal(self, reading: GimbalReading) -> None:
        """Take a line of sight, with its own stamp.

        Args:
            reading: The line of sight.
        """
        if reading.frame != self.frame:
            self.frame = reading.frame
            self._gimbals.clear()
        time_s = reading.time_s - self._latencies_s[0]
        if self._gimbals.takes(time_s):
            direction = sight_direction(normalized(reading.quaternion_wxyz))
            if reading.frame != "earth":
                direction = rotate(self._parent_from_mount, direction)
            self._gimbals.add(time_s, *direction)

    def range(self, time_s: float, slant_range_m: float) -> None:
        """Take a range, with its own stamp.

        Args:
            time_s: Stamp of the reading, vehicle's clock, s.
            slant_range_m: Slant range, m.
        """
        self._ranges.add(time_s - self._latencies_s[1], slant_range_m)

    def updated(self, now_s: float) -> Delays | None:
        """Estimate the delays from time to time.

        Args:
            now_s: Time of the latest reading, vehicle's clock, s.

        Returns:
            New delays; None between two estimates, and while they are unknown.
        """
        if abs(now_s - self._next_s) < _EVERY_MAX_S and now_s < self._next_s:
            return None
        span_s = now_s - self._gimbals.oldest_s(now_s - _WINDOW_S)
        self._next_s = now_s + min(max(_GROWTH * span_s, _EVERY_MIN_S), _EVERY_MAX_S)
        return self.fit(now_s)

    def fit(self, now_s: float) -> Delays | None:
        """Estimate the delays from the readings of the last minutes.

        Args:
            now_s: Time of the latest reading, vehicle's clock, s.

        Returns:
            The delays; None while there are too few readings.
        """
        since_s = now_s - _WINDOW_S
        positions, attitudes, gimbals, ranges = (
            log.since(since_s) for log in (self._positions, self._attitudes, self._gimbals, self._ranges)
        )
        logs = [positions, gimbals, ranges] if self.frame == "earth" else [positions, gimbals, ranges, attitudes]
        if min(map(len, logs)) < 2:
            return None
        first_s = max(float(log[0, 0]) for log in logs) + MAX_DELAY_S
        last_s = min(float(log[-1, 0]) for log in logs) + MIN_DELAY_S
        gaps_s = [
            (log[k, 0] + MIN_DELAY_S, log[k + 1, 0] + MAX_DELAY_S)
            for log in (positions, *logs[3:])
            for k in np.flatnonzero(np.diff(log[:, 0]) > _GAP_MAX_S)
        ]
        gimbals, ranges = _between(gimbals, first_s, last_s, gaps_s), _between(ranges, first_s, last_s, gaps_s)
        if last_s - first_s < _SPAN_MIN_S or min(len(gimbals), len(ranges)) < _READINGS_MIN:
            return None
        scene = Scene(positions, attitudes, gimbals, ranges, self.frame, self._noise)
        best, scale_m = scene.solve(self._sigmas, self._shared, self._scale_m, self._fits > 0)
        other = np.array([*_STARTS_S[self._fits % len(_STARTS_S)], 0.0, 0.0])
        another, another_scale_m = scene.solve(self._sigmas, other, STIFF_M, settled=False)
        if another.cost < best.cost:
            best, scale_m = another, another_scale_m
        self._shared, self._scale_m, self._fits = best.shared, scale_m, self._fits + 1
        gimbal_s, range_s = (best.shared[:2] + self._latencies_s).tolist()
        yaw_rad = float(best.shared[2])
        information = best.information / _READINGS_SIGMAS**2 + np.diag((_PRIORS_SIGMAS * self._sigmas) ** -2)
        gimbal_sigma_s, range_sigma_s, yaw_sigma_rad, _ = np.sqrt(np.diag(np.linalg.inv(information))).tolist()
        return Delays(gimbal_s, range_s, gimbal_sigma_s, range_sigma_s, yaw_rad, yaw_sigma_rad)


class _Log:
    """Rows of numbers, the first of which is the time: those of the last minutes."""

    def __init__(self, columns: int) -> None:
        self._rows = np.empty((1024, columns))
        self._count, self._newest_s = 0, -math.inf

    def takes(self, time_s: float) -> bool:
        """Return whether to keep a row of this time; forget all if the clock is set back."""
        if time_s < self._newest_s - _GAP_MAX_S:
            self.clear()
        return time_s > self._newest_s + _SAMPLE_EVERY_S

    def add(self, *row: float) -> None:
        """Keep a row if :meth:`takes` returns True."""
        if not self.takes(row[0]):
            return
        if self._count == len(self._rows):
            kept = self.since(row[0] - _WINDOW_S).copy()
            if len(kept) > len(self._rows) // 2:
                self._rows = np.empty((2 * len(self._rows), len(row)))
            self._rows[: len(kept)], self._count = kept, len(kept)
        self._rows[self._count] = row
        self._newest_s = row[0]
        self._count += 1

    def since(self, time_s: float) -> FloatArray:
        """Return the rows from a time on, (n, columns)."""
        rows = self._rows[: self._count]
        return rows[np.searchsorted(rows[:, 0], time_s) :]

    def oldest_s(self, time_s: float) -> float:
        """Return the time of the first row from a time on; infinity without one."""
        rows = self.since(time_s)
        return float(rows[0, 0]) if len(rows) else math.inf

    def clear(self) -> None:
        """Forget all rows."""
        self._count, self._newest_s = 0, -math.inf


def _between(log: FloatArray, first_s: float, last_s: float, gaps_s: list[tuple[float, float]]) -> FloatArray:
    """Return the rows between two times and outside gaps."""
    time_s = log[:, 0]
    kept = (time_s >= first_s) & (time_s <= last_s)
    for begin_s, end_s in gaps_s:
        kept &= (time_s < begin_s) | (time_s > end_s)
    return log[kept]

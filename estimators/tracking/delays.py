"""Delays and large errors of laser and gimbal, fitted to the readings of the last minutes.

A payload that stamps its readings late shows the target displaced by the distance that the aircraft has flown in that
time. While the aircraft circles, the displacement circles with it. A real target does not do so for minutes.

On a steady circle about a standing target, a payload whose angles are relative to the aircraft looks the same if it
is late and if the target is elsewhere, turned about the circle's centre. A change of circle shows the difference, and
until then the standard deviations of the delays are large.

Errors of the gimbal's yaw and of the ranges are as small as their priors say, or far beyond: the mounting or the
laser is wrong. The second fit has to explain the readings far better than the first. It also tries a factor of the
ranges.

Source: docs/explanation/filter.md#delays.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable

import numpy as np

from sidelong.estimators.filters.biases import Delays
from sidelong.estimators.rotations import Quaternion, normalized, rotate, sight_direction
from sidelong.estimators.sensing.readings import AttitudeReading, GimbalReading, PositionReading
from sidelong.estimators.settings import TrackerSettings
from sidelong.estimators.terrain.ground import Ground
from sidelong.estimators.tracking.band_kernel import FloatArray
from sidelong.estimators.tracking.delay_scene import MAX_DELAY_S, MIN_DELAY_S, STIFF_M, Fit, Scene

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
# A fit with large errors is tried where the other one is strained: it needs large delays or errors, or a target that
# turns with the aircraft. It has to be far better (evidence: difference of -ln likelihood), and its errors have to be
# larger than those that a target's own motion looks like.
_STRAINED, _TURNS_M, _ERRING_SPAN_S = 1.5, 0.15, 20.0
_EVIDENCE = 50.0
_CALM_M, _CALMER = 0.1, 0.5  # the target then turns hardly at all, or far less
_CALM_ON_HILLS_M, _CALMER_ON_HILLS = 0.2, 0.1  # the same as evidence of its own, where the ends lie on wrong hills
# A delay at the end of its range fits nothing.
_DELAYS_MIDDLE_S, _DELAYS_REACH_S = (MIN_DELAY_S + MAX_DELAY_S) / 2.0, 0.45 * (MAX_DELAY_S - MIN_DELAY_S)
_YAW_MIN_RAD, _RANGE_MIN_M, _FACTOR_MIN = math.radians(4.0), 15.0, 0.08
_RANGE_SHARE_MAX = 0.5  # ranges that shrink to nothing would put the target at the aircraft
_FACTOR_FROM_M, _FACTOR_BETTER, _FACTOR_STEPS, _FACTORS = 10.0, 10.0, 3, (0.25, 4.0)
_FACTOR_STARTS = 1.4, 0.7  # from 1, a lesser minimum may hold


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
        self._may_err = yaw_rad > 0.0  # or the biases are not estimated
        self._noise = settings.yaw_sigma_rad, settings.range_sigma_m
        self._pitch_sigma_rad = math.hypot(settings.pitch_sigma_rad, settings.pitch_bias_sigma_rad)
        self._on_ground = self._on_hills = False  # whether the ranges are those to the ground, and that is hilly
        self._ground_sigma_m = 0.0
        self._parent_from_mount = parent_from_mount
        self._positions, self._attitudes = _Log(5), _Log(4)
        self._gimbals, self._ranges = _Log(4), _Log(2)
        self.frame, self._next_s = "", 0.0
        self._begin()

    def _begin(self) -> None:
        self._fits = 0
        self._sound: Fit | None = None
        self._erring: Fit | None = None  # while that explains the readings far better
        self._factor = 1.0  # of the ranges, in that

    def stand_on(self, ground: Ground) -> None:
        """Let lines of sight end on a ground."""
        self._on_hills = bool(np.ptp(ground.heights_m))
        # Flat ground is too high or too low as a whole, which is the bias of the ranges.
        self._ground_sigma_m = ground.sigma_m if self._on_hills else 0.0

    @property
    def finds_yaw_error(self) -> bool:
        """Whether a large yaw error explains the readings far better."""
        return self._erring is not None

    @property
    def on_hills(self) -> bool:
        """Whether the ranges are those at which lines of sight meet hills."""
        return self._on_ground and self._on_hills

    def clear(self) -> None:
        """Forget the readings of laser and gimbal: another target is seen now."""
        self._gimbals.clear()
        self._ranges.clear()

    def clear_device(self) -> None:
        """Forget the readings and the errors that were found: another device is used now."""
        self.clear()
        self._begin()

    def position(self, p: PositionReading) -> None:
        """Take a position of the aircraft."""
        self._positions.add(p.time_s, p.east_m, p.north_m, p.velocity_east_m_s, p.velocity_north_m_s)

    def attitude(self, a: AttitudeReading) -> None:
        """Take an attitude of the aircraft."""
        self._attitudes.add(a.time_s, a.roll_rad, a.pitch_rad, a.yaw_rad)

    def gimbal(self, reading: GimbalReading) -> None:
        """Take a line of sight, with its own stamp."""
        if reading.frame != self.frame:
            self.frame = reading.frame
            self._gimbals.clear()
        time_s = reading.time_s - self._latencies_s[0]
        if self._gimbals.takes(time_s):
            direction = sight_direction(normalized(reading.quaternion_wxyz))
            if reading.frame != "earth":
                direction = rotate(self._parent_from_mount, direction)
            self._gimbals.add(time_s, *direction)

    def range(self, time_s: float, slant_range_m: float, on_ground: bool = False) -> None:
        """Take a range, with its own stamp.

        Args:
            time_s: Stamp of the reading, vehicle's clock, s.
            slant_range_m: Slant range, m.
            on_ground: Whether it is where a line of sight meets the ground, in place of a laser's.
        """
        if on_ground is not self._on_ground:
            self._on_ground = on_ground
            self._ranges.clear()
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

        @functools.cache  # most fits of a moment share a factor
        def scene(factor: float) -> Scene:
            on_ground = (self._pitch_sigma_rad, self._ground_sigma_m) if self._on_ground else None
            return Scene(positions, attitudes, gimbals, ranges * (1.0, factor), self.frame, self._noise, on_ground)

        best = self._fit_sound(scene(1.0))
        strained = best.scale_m > _TURNS_M or (abs(best.shared) > _STRAINED * self._sigmas).any()
        if self._erring is not None or (strained and self._may_err and last_s - first_s > _ERRING_SPAN_S):
            best = self._fit_erring(scene, best, float(np.median(ranges[:, 1])))
        gimbal_s, range_s = (best.shared[:2] + self._latencies_s).tolist()
        tan_yaw, range_m = best.shared[2:].tolist()  # the scene is linear in it
        priors = self._sigmas
        if self._erring is None or self._on_ground:
            range_m = 0.0  # it may be the target's height
        if self._erring is not None:  # of an error that is there, nothing is known before
            priors = np.maximum(priors, abs(best.shared))
        information = best.information / _READINGS_SIGMAS**2 + np.diag((_PRIORS_SIGMAS * priors) ** -2)
        gimbal_sigma_s, range_sigma_s, yaw_sigma_rad, range_sigma_m = np.sqrt(np.diag(np.linalg.inv(information)))
        if self._on_ground:
            range_s, range_sigma_s = self._latencies_s[1], 0.0
        return Delays(
            gimbal_s,
            range_s,
            float(gimbal_sigma_s),
            float(range_sigma_s),
            math.atan(tan_yaw),
            float(yaw_sigma_rad),
            range_m,
            float(range_sigma_m),
            self._factor,
        )

    def _fit_sound(self, scene: Scene) -> Fit:
        """Return the best fit with errors as small as the priors say."""
        before, sigmas = self._sound, self._sigmas
        start = np.array([*_STARTS_S[self._fits % len(_STARTS_S)], 0.0, 0.0])
        fits = (
            scene.solve(sigmas, np.zeros(4), settled=False)
            if before is None
            else scene.solve(sigmas, before.shared, before.scale_m, settled=True),
            scene.solve(sigmas, start, settled=False),
        )
        self._sound = min(fits, key=lambda one: one.cost)
        self._fits += 1
        return self._sound

    def _fit_erring(self, scene: Callable[[float], Scene], sound: Fit, range_m: float) -> Fit:
        """Return the best fit with large errors; the one without them if that explains the readings as well.

        Args:
            scene: Returns the readings with ranges multiplied by a factor.
            sound: The fit without large errors.
            range_m: Usual slant range as reported, m.
        """
        before = self._erring

        def fit(factor: float, start: FloatArray, scale_m: float = STIFF_M, *, settled: bool = False) -> Fit:
            return scene(factor).solve(self._sigmas, start, scale_m, settled=settled, erring=True)

        tried = [(self._factor, fit(self._factor, sound.shared))]
        if before is not None:
            tried.append((self._factor, fit(self._factor, before.shared, before.scale_m, settled=True)))
        elif not self._on_ground:
            other = _FACTOR_STARTS[self._fits % len(_FACTOR_STARTS)]
            tried.append((other, fit(other, sound.shared)))
        factor, best = min(tried, key=lambda one: one[1].cost)
        for _ in range(0 if self._on_ground else _FACTOR_STEPS):
            other = factor - float(best.shared[3]) / range_m
            if abs(best.shared[3]) < _FACTOR_FROM_M or not _FACTORS[0] < other < _FACTORS[1]:
                break
            another = fit(other, best.shared * (1.0, 1.0, 1.0, 0.0))
            if another.cost > best.cost - _FACTOR_BETTER:
                break
            best, factor = another, other
        (tan_yaw, bias_m), off_s = abs(best.shared[2:]), abs(best.shared[:2] - _DELAYS_MIDDLE_S)
        is_long = not self._on_ground and (bias_m > _RANGE_MIN_M or abs(factor - 1.0) > _FACTOR_MIN)
        is_large = is_long or tan_yaw > _YAW_MIN_RAD
        is_possible = off_s.max() < _DELAYS_REACH_S and bias_m < _RANGE_SHARE_MAX * factor * range_m
        is_calmer = best.scale_m < max(_CALM_M, _CALMER * sound.scale_m)
        evidence = sound.cost - best.cost
        is_better = evidence > -_EVIDENCE if before is not None else evidence > _EVIDENCE and is_calmer
        if self.on_hills:  # the ends of lines that are turned wrongly lie on other hills: they fit nothing well
            is_better |= best.scale_m < _CALM_ON_HILLS_M and best.scale_m < _CALMER_ON_HILLS * sound.scale_m
        if is_large and is_possible and is_better:
            self._erring, self._factor = best, factor
            return best
        self._erring, self._factor = None, 1.0
        return sound


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

"""Which reading of laser and gimbal makes the target move plausibly.

The aircraft circles, so a wrong frame of the gimbal or a wrong unit of the laser makes the apparent target circle as
well. Each hypothesis (a frame of the line of sight, a factor of the range) gives a series of apparent target
positions. A target that moves at constant velocity for some seconds leaves small residuals about a straight line; a
wrong hypothesis leaves residuals of the size of the aircraft's own circle. One more hypothesis is the constant yaw
error that fits best.

If the apparent target jumps, the hypotheses are compared with its motion until then: by the right one it goes on.

The height over the ground is a second, independent witness of the range's unit: slant range and line of sight put
the target at a height. If a unit puts it on the ground, and the reported range far above or below, the unit is found
even where noise at long range hides the difference in motion. The ground is flat at the height of home, or the
elevation data.

Source: docs/health.md#contradictions-of-the-payload.
"""

from __future__ import annotations

import itertools
import math
import operator
import statistics
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from sidelong.estimators.rotations import Quaternion
from sidelong.estimators.sensing.line_of_sight import line_of_sight
from sidelong.estimators.sensing.readings import AttitudeReading, GimbalReading, PositionReading
from sidelong.mission.core.path import FloatArray

FRAMES = ("earth", "vehicle", "body")
FACTORS = {
    10.0: "a tenth of the distance: decimetres are read as centimetres",
    0.1: "ten times the distance: decimetres are read as metres",
    1.0 / 0.3048: "0.3 of the distance: metres are read as feet",
    0.3048: "3.3 times the distance: feet are read as metres",
    100.0: "a hundredth of the distance: metres are read as centimetres",
    0.01: "a hundred times the distance: centimetres are read as metres",
}
"""By what a range has to be multiplied, and what is then wrong with it."""

WINDOW_S = 12.0
"""How far back a verdict looks, at two samples a second."""
_SAMPLES, _SAMPLES_MIN, _SPAN_MIN_S = 24, 12, 6.0
_TURNED_MIN_RAD = 0.8
_WRONG_M, _BETTER_SHARE, _AS_GOOD_SHARE = 8.0, 0.5, 0.7
_OWN_SHARE = 0.3
_JUMP_M, _DRIVES_M_S = 40.0, 15.0
_STEPS_MIN, _APPARENT_M_S = 3, 30.0
OFTEN = 3
"""How many of the last jumps are remembered."""
_LATELY_S, _LATELY_MIN, _CONTINUED_MIN = 6.0, 6, 5  # samples before and after a change
_CONTINUED_M, _DRIFTS_M_S, _DISCONTINUED = 15.0, 1.5, 2.0
_TRIM_SHARE = 0.8  # of the samples: a line is fitted to those, without outliers
_LEVEL_SHARE, _OFF_LEVEL_SHARE = 0.3, 0.5  # of the aircraft's height over the ground
_HEIGHT_MIN_M = 25.0
_PITCH_NOISE_RAD = math.radians(2.0)  # six standard deviations
_DOWN_MIN, _GROUND_STEPS = 0.02, 4  # how far a line of sight points down, and how its end on hills is found
_TURN_MIN_RAD = math.radians(35.0)  # the track estimates less than that
_TURNED_SHARE = 0.25  # as _BETTER_SHARE: this hypothesis is fitted, so it fits a target that turns, too
_SCALES = 0.8, 1.25  # of a yaw error's fit, which leaves the length of the line of sight free
_DELAYS_S = -1.5, 3.5  # half a second more than those that the track finds and corrects
_FIT_M, _FIT_SHARE = 8.0, 0.01  # residual of a target that turns, and of noise as a share of the range
_DISCRIMINATES, _LEVEL_LATELY_S = 2.0, 60.0

GroundHeight = Callable[[float, float], float]
"""Returns the height of the ground above home at a position (east, north); NaN where unknown."""


@dataclass(frozen=True, slots=True)
class Verdict:
    """What is wrong with the payload.

    Attributes:
        frame: the gimbal's true frame where its flags are wrong, else None.
        factor: what the range has to be multiplied with, 1 where its unit is right.
        is_turned: whether the gimbal's yaw has a large constant error.
    """

    frame: str | None
    factor: float
    is_turned: bool = False


SOUND = Verdict(None, 1.0)
TURNED = Verdict(None, 1.0, is_turned=True)


class _Sample(NamedTuple):
    """What was received at one time; ``sighted_m`` is the apparent target, by the frame as flagged."""

    time_s: float
    turned_rad: float
    own_m: tuple[float, float, float]
    sighted_m: tuple[float, float, float]
    attitude: AttitudeReading
    gimbal: GimbalReading
    range_m: float
    off_level: float  # how far the target is off the ground, as a share of the own height over it; NaN: unknown


class _Motion(NamedTuple):
    """A target's position at a time, and its velocity."""

    time_s: float
    position_m: FloatArray
    velocity_m_s: FloatArray


class MotionFit:
    """Collects two samples a second and compares the hypotheses.

    Attributes:
        ground: The elevation data; None: the ground is flat at the height of home.
        changed_s: When the apparent target jumped, last.
        jumped_s: When it jumped farther than a target can drive, last.
        jumps_s: When it did so, the last times.
        yaw_error_rad: The constant yaw error that fits best; once established, it stays.
    """

    def __init__(self, parent_from_mount: Quaternion) -> None:
        self.ground: GroundHeight | None = None
        self.changed_s = self.jumped_s = -math.inf
        self.jumps_s: deque[float] = deque(maxlen=OFTEN)
        self.yaw_error_rad = 0.0
        self._parent_from_mount = parent_from_mount
        self._samples: deque[_Sample] = deque(maxlen=_SAMPLES)
        self._jumped: _Sample | None = None
        self._before: _Motion | None = None  # until the latest change
        self._flagged = ""
        self._level_s = -math.inf  # when the target was on the ground, last

    def clear(self) -> None:
        """Forget all samples."""
        self._samples.clear()

    def add(
        self,
        position: PositionReading,
        attitude: AttitudeReading,
        gimbal: GimbalReading,
        slant_range_m: float,
        turned_rad: float,
    ) -> None:
        """Take one sample.

        Args:
            position: of the aircraft, of about the same time as the others.
            attitude: of the aircraft.
            gimbal: the line of sight as reported.
            slant_range_m: as reported; NaN: there is no laser, and the line of sight ends on the ground.
            turned_rad: how far the aircraft has turned since the flight began, either way.
        """
        own_m = position.east_m, position.north_m, position.height_m
        sighted_m = self._apparent_m(own_m, slant_range_m, self._direction(attitude, gimbal, gimbal.frame))
        is_ranged = not math.isnan(slant_range_m)
        off_level = self._off_level(own_m, sighted_m) if is_ranged else 0.0
        if self._samples and is_ranged is math.isnan(self._samples[-1].range_m):
            self._samples.clear()
        sample = _Sample(position.time_s, turned_rad, own_m, sighted_m, attitude, gimbal, slant_range_m, off_level)
        samples, jumped, now_s = self._samples, self._jumped, position.time_s
        self._jumped = None
        self._flagged = self._flagged or gimbal.frame
        jump_m = math.dist(sighted_m, samples[-1].sighted_m) if samples else 0.0
        # A wrong frame lets it jump on and on.
        jumps = jump_m > self._jump_m(sample) and abs(now_s - self.changed_s) > WINDOW_S and self._drove()
        if jumps or gimbal.frame != self._flagged:
            if jumped is None or jumped.gimbal.frame != gimbal.frame or jumped.range_m == slant_range_m:
                self._jumped = sample  # an outlier, unless the next one is like it, with a range of its own
                return
            if jump_m > _JUMP_M:
                self._change(jumped.time_s, jump_m)
            self._flagged = gimbal.frame
            samples.clear()  # what was before would hide the change
            samples.append(jumped)
        samples.append(sample)

    def _jump_m(self, sample: _Sample) -> float:
        """Return how far a jump goes: noise of the pitch, too, moves the end of a line of sight on the ground."""
        if not math.isnan(sample.range_m):
            return _JUMP_M
        down_m = max(sample.own_m[2] - sample.sighted_m[2], 1.0)
        noise_m = _PITCH_NOISE_RAD * math.dist(sample.own_m, sample.sighted_m) ** 2 / down_m
        return _JUMP_M + noise_m if self.ground is None else math.inf  # on hills it jumps from one to the next

    def _drove(self) -> bool:
        """Return whether the apparent target moved until now as slowly as one that drives; True: not known."""
        speeds_m_s = [
            math.dist(one.sighted_m, then.sighted_m) / (one.time_s - then.time_s)
            for then, one in itertools.pairwise(self._samples)
            if one.time_s > then.time_s  # a position may serve two samples
        ]
        return len(speeds_m_s) < _STEPS_MIN or statistics.median(speeds_m_s) <= _APPARENT_M_S

    def _change(self, now_s: float, jump_m: float) -> None:
        """Remember the target's motion until it jumped."""
        since_s = now_s - self._samples[-1].time_s
        self.changed_s = now_s
        if jump_m > _JUMP_M + _DRIVES_M_S * since_s:
            self.jumped_s = now_s
            self.jumps_s.append(now_s)
        lately = [one for one in self._samples if now_s - one.time_s < _LATELY_S]
        if len(lately) < _LATELY_MIN:  # after dropouts: fewer but older ones
            lately = [one for one in self._samples if now_s - one.time_s < WINDOW_S][-_LATELY_MIN:]
        self._before = _motion(lately) if len(lately) >= _LATELY_MIN else None

    @property
    def level_direction(self) -> tuple[float, float] | None:
        """East and north of the latest line of sight, as flagged; None before the first."""
        if not self._samples:
            return None
        last = self._samples[-1]
        range_m = max(math.dist(last.sighted_m, last.own_m), 1.0)
        return (last.sighted_m[0] - last.own_m[0]) / range_m, (last.sighted_m[1] - last.own_m[1]) / range_m

    @property
    def off_ground_m(self) -> float:
        """How far the target is above or below the elevation data; NaN without them, and without a laser."""
        ground = self.ground
        if ground is None or not self._samples or math.isnan(self._samples[-1].range_m):
            return math.nan
        off_m = [abs(one.sighted_m[2] - ground(one.sighted_m[0], one.sighted_m[1])) for one in self._samples]
        known_m = [one for one in off_m if not math.isnan(one)]
        return statistics.median(known_m) if 2 * len(known_m) > len(off_m) else math.nan

    def verdict(self, established: Verdict = SOUND) -> Verdict | None:
        """Return what is wrong, ``SOUND`` where nothing is, None while it cannot be known.

        Args:
            established: what was found to be wrong before; it holds until what is reported fits clearly better.
        """
        samples = self._samples
        if established.frame == self._flagged:  # the flags are corrected; until then a wrong target moved
            established, self._before = SOUND, None
        is_recent = bool(samples) and samples[-1].time_s - self.changed_s < WINDOW_S
        if established == SOUND and is_recent and (found := self._continued()) is not None:
            return found
        if not self._is_enough():
            return None
        shares = sorted(one.off_level for one in samples)
        off_level = math.nan if math.isnan(sum(shares)) else shares[len(shares) // 2]
        unit_is_right, unit_is_wrong = off_level < _LEVEL_SHARE, off_level > _OFF_LEVEL_SHARE
        if unit_is_right and not math.isnan(samples[-1].range_m):
            self._level_s = samples[-1].time_s
        as_reported_m = self._residual_as_reported_m()
        if established == SOUND and as_reported_m < _WRONG_M and not unit_is_wrong:
            return SOUND
        times_s = np.array([one.time_s for one in samples])
        sighted_m = np.array([one.sighted_m for one in samples])
        residual_m, own_residual_m, as_reported_m = self._residuals_of_hypotheses_m(times_s, sighted_m, established)
        if established != SOUND:
            if established.factor != 1.0 and not math.isnan(off_level):
                return SOUND if unit_is_right else established
            return SOUND if as_reported_m < _AS_GOOD_SHARE * residual_m[established] else established
        if unit_is_wrong:
            factor = self._unit_by_height(sighted_m, residual_m, own_residual_m)
            if factor is not None:
                return Verdict(None, factor)
        if as_reported_m < _WRONG_M:
            return SOUND
        if unit_is_right:
            residual_m = {verdict: one_m for verdict, one_m in residual_m.items() if verdict.factor == 1.0}
        best = min(residual_m, key=residual_m.__getitem__)
        if residual_m[best] > _AS_GOOD_SHARE * as_reported_m:
            return SOUND
        return None if residual_m[best] > _BETTER_SHARE * as_reported_m else best

    def _is_enough(self) -> bool:
        """Return whether there are enough samples, and the aircraft has turned over them."""
        samples = self._samples
        if len(samples) < _SAMPLES_MIN or samples[-1].turned_rad - samples[0].turned_rad < _TURNED_MIN_RAD:
            return False
        return samples[-1].time_s - samples[0].time_s >= _SPAN_MIN_S

    def _continued(self) -> Verdict | None:
        """Return the reading of the payload by which the target goes on as before the change; None: it is none."""
        before = self._before
        if before is None or len(self._samples) < _CONTINUED_MIN:
            return None
        times_s = np.array([one.time_s for one in self._samples])
        sighted_m = np.array([one.sighted_m for one in self._samples])
        verdicts, positions_m = self._hypotheses(sighted_m)
        since_s = times_s - before.time_s
        expected_m = before.position_m + since_s[:, None] * before.velocity_m_s
        off_m = np.median(np.linalg.norm(positions_m - expected_m[:, None, :], axis=2), axis=0)
        reported_off_m = np.linalg.norm(sighted_m - expected_m, axis=1)
        reported_m = float(np.median(reported_off_m))
        best = int(off_m.argmin())
        near_m = _CONTINUED_M + _DRIFTS_M_S * float(np.median(since_s))
        if reported_m < near_m:  # outliers, no change
            self.changed_s = self.jumped_s = -math.inf
            kept = [one for one, off in zip(self._samples, reported_off_m, strict=True) if off < _JUMP_M]
            self._samples.clear()
            self._samples.extend(kept)
            return None
        return verdicts[best] if off_m[best] < near_m and reported_m > _DISCONTINUED * near_m else None

    def _residual_as_reported_m(self) -> float:
        """Return the same as ``_residuals_m`` of what was reported, in a third of the time for so few numbers."""
        samples, count = self._samples, len(self._samples)
        middle_s = sum([one.time_s for one in samples]) / count
        since_s = [one.time_s - middle_s for one in samples]
        spread_s2 = sum(map(operator.mul, since_s, since_s))
        off_m2 = [0.0] * count
        for values_m in zip(*(one.sighted_m for one in samples), strict=True):
            mean_m = sum(values_m) / count
            speed_m_s = sum(map(operator.mul, values_m, since_s)) / spread_s2
            off_m2 = [
                sum_m2 + (off_m := value_m - mean_m - speed_m_s * one_s) * off_m
                for sum_m2, value_m, one_s in zip(off_m2, values_m, since_s, strict=True)
            ]
        return math.sqrt(statistics.median(off_m2))

    def _apparent_m(
        self, own_m: tuple[float, float, float], range_m: float, direction: tuple[float, float, float]
    ) -> tuple[float, float, float]:
        """Return the end of a line of sight (east, north, up), on the ground where there is no range."""
        east, north, up = direction
        if math.isnan(range_m):
            range_m = own_m[2] / max(-up, _DOWN_MIN)
            if self.ground is not None:
                for _ in range(_GROUND_STEPS):
                    ground_m = self.ground(own_m[0] + range_m * east, own_m[1] + range_m * north)
                    if math.isnan(ground_m):
                        break
                    range_m = (own_m[2] - ground_m) / max(-up, _DOWN_MIN)
        return own_m[0] + range_m * east, own_m[1] + range_m * north, own_m[2] + range_m * up

    def _off_level(self, own_m: tuple[float, float, float], target_m: tuple[float, float, float]) -> float:
        ground_m = 0.0 if self.ground is None else self.ground(target_m[0], target_m[1])
        over_m = own_m[2] - ground_m
        return abs(target_m[2] - ground_m) / over_m if over_m >= _HEIGHT_MIN_M else math.nan

    def _unit_by_height(
        self, sighted_m: FloatArray, residual_m: dict[Verdict, float], own_residual_m: float
    ) -> float | None:
        """Return the unit that puts the target on the ground and lets it move plausibly; None: there is none."""
        off_level = {factor: self._median_off_level(factor, sighted_m) for factor in FACTORS}
        factor = min(FACTORS, key=off_level.__getitem__)
        if not off_level[factor] < _LEVEL_SHARE:
            return None
        range_m = factor * float(np.median([one.range_m for one in self._samples]))
        fits_m = _FIT_M + _FIT_SHARE * range_m
        # A hill may look like a wrong unit, but not all of a sudden, nor does the target then stand still: with a
        # wrong factor it moves with a part of the aircraft's own motion, which has to be visible.
        lately = 0.0 <= self._samples[-1].time_s - self._level_s < _LEVEL_LATELY_S
        if not lately and abs(factor - 1.0) * own_residual_m < _DISCRIMINATES * fits_m:
            return None
        return factor if residual_m[Verdict(None, factor)] < fits_m else None

    def _median_off_level(self, factor: float, sighted_m: FloatArray) -> float:
        """Return how far off the ground a factor puts the target; infinite where that is unknown."""
        own_m = np.array([one.own_m for one in self._samples])
        target_m = own_m + factor * (sighted_m - own_m)
        off_level = [
            self._off_level(own, (east_m, north_m, up_m))
            for own, (east_m, north_m, up_m) in zip(own_m.tolist(), target_m.tolist(), strict=True)
        ]
        return math.inf if any(map(math.isnan, off_level)) else statistics.median(off_level)

    def _residuals_of_hypotheses_m(
        self, times_s: FloatArray, sighted_m: FloatArray, established: Verdict
    ) -> tuple[dict[Verdict, float], float, float]:
        """Return the residual of every other reading of the payload, of the aircraft's motion, and as reported."""
        own_m = np.array([one.own_m for one in self._samples])
        verdicts, positions_m = self._hypotheses(sighted_m)
        scale = 1.0
        if not established.is_turned:
            self.yaw_error_rad, scale = _yaw_error_rad(times_s, own_m, sighted_m - own_m)
        turned_m = own_m + _turned(sighted_m - own_m, -self.yaw_error_rad)
        others_m = np.stack((turned_m, own_m, sighted_m), axis=1)
        *residuals_m, turned_residual_m, straight_m, as_reported_m = _residuals_m(
            times_s, np.concatenate((positions_m, others_m), axis=1)
        ).tolist()
        # Any range that is divided by enough puts the target at the aircraft, which flies straight at times, too.
        residual_m = {
            verdict: math.inf if verdict.factor < 1.0 and one_m > _OWN_SHARE * straight_m else one_m
            for verdict, one_m in zip(verdicts, residuals_m, strict=True)
        }
        is_turn = established.is_turned or (
            abs(self.yaw_error_rad) >= _TURN_MIN_RAD
            and _SCALES[0] <= scale <= _SCALES[1]
            and turned_residual_m <= _TURNED_SHARE * as_reported_m
            and not self._may_be_late()
        )
        residual_m[TURNED] = turned_residual_m if is_turn else math.inf
        return residual_m, straight_m, as_reported_m

    def _may_be_late(self) -> bool:
        """Return whether a delay of the gimbal looks like the yaw error: angles against north lag on a circle."""
        samples = self._samples
        turned_rad = np.unwrap([one.attitude.yaw_rad for one in samples])
        lag_rad = -self.yaw_error_rad * (samples[-1].time_s - samples[0].time_s)
        least_rad, most_rad = sorted(delay_s * float(turned_rad[-1] - turned_rad[0]) for delay_s in _DELAYS_S)
        return self._flagged == "earth" and least_rad <= lag_rad <= most_rad

    def _hypotheses(self, sighted_m: FloatArray) -> tuple[list[Verdict], FloatArray]:
        """Return every other reading of the payload, and the targets (n, k, 3) that the samples then show."""
        samples = self._samples
        own_m = np.array([one.own_m for one in samples])
        verdicts = [Verdict(frame, 1.0) for frame in FRAMES if frame != self._flagged]
        positions_m = [
            np.array(
                [
                    self._apparent_m(one.own_m, one.range_m, self._direction(one.attitude, one.gimbal, verdict.frame))
                    for one in samples
                ]
            )
            for verdict in verdicts
        ]
        verdicts += [Verdict(None, factor) for factor in FACTORS]
        positions_m += [own_m + factor * (sighted_m - own_m) for factor in FACTORS]
        return verdicts, np.stack(positions_m, axis=1)

    def _direction(
        self, attitude: AttitudeReading, gimbal: GimbalReading, frame: str | None
    ) -> tuple[float, float, float]:
        """Return the unit vector (east, north, up) of a line of sight, if its frame is this one."""
        if gimbal.frame != frame:
            gimbal = replace(gimbal, frame=frame)  # type: ignore[arg-type]
        sight = line_of_sight(gimbal, attitude, self._parent_from_mount)
        level = math.cos(sight.depression_rad)
        return (
            level * math.sin(sight.bearing_rad),
            level * math.cos(sight.bearing_rad),
            -math.sin(sight.depression_rad),
        )


def _motion(samples: Sequence[_Sample]) -> _Motion:
    """Return the motion between the medians of both halves, so that one outlier in each does no harm."""
    half = len(samples) // 2
    first, last = (
        np.array([(one.time_s, *one.sighted_m) for one in some]) for some in (samples[:half], samples[half:])
    )
    (first_s, *first_m), (last_s, *last_m) = np.median(first, axis=0), np.median(last, axis=0)
    return _Motion(last_s, np.array(last_m), (np.array(last_m) - np.array(first_m)) / max(last_s - first_s, 1.0))


def _yaw_error_rad(times_s: FloatArray, own_m: FloatArray, way_m: FloatArray) -> tuple[float, float]:
    """Return the constant yaw error without which the target moves straightest, and by what the ways then stretch.

    Least squares: own + c * way + s * (way, turned right by 90 degrees) = place + velocity * time.

    Args:
        times_s: of the samples, (n,).
        own_m: the aircraft, (n, 3).
        way_m: from there to the apparent target, (n, 3).
    """
    since_s, none = times_s - times_s.mean(), np.zeros(len(times_s))
    one = none + 1.0
    east = np.stack([way_m[:, 0], way_m[:, 1], -one, none, -since_s, none], axis=1)
    north = np.stack([way_m[:, 1], -way_m[:, 0], none, -one, none, -since_s], axis=1)
    known_m = -own_m[:, :2].T.ravel()
    (cosine, sine, *_), *_ = np.linalg.lstsq(np.concatenate([east, north]), known_m, rcond=None)
    return -math.atan2(sine, cosine), math.hypot(cosine, sine)


def _turned(way_m: FloatArray, angle_rad: float) -> FloatArray:
    """Return ways (n, 3), each turned right by an angle about the vertical."""
    cosine, sine = math.cos(angle_rad), math.sin(angle_rad)
    east_m, north_m, up_m = way_m.T
    return np.stack([cosine * east_m + sine * north_m, cosine * north_m - sine * east_m, up_m], axis=1)


def _residuals_m(times_s: FloatArray, positions_m: FloatArray) -> FloatArray:
    """Return the median distance of positions (n, k, 3) from a straight line in time, for each k.

    The line is fitted twice, the second time without the farthest positions: an outlier at either end tilts it.
    """
    weights = np.ones(positions_m.shape[:2])
    for _ in range(2):
        total = weights.sum(axis=0)
        middle_s, middle_m = times_s @ weights / total, np.einsum("nk,nki->ki", weights, positions_m) / total[:, None]
        since_s, centred_m = times_s[:, None] - middle_s, positions_m - middle_m
        weighted_s = weights * since_s
        velocity_m_s = np.einsum("nk,nki->ki", weighted_s, centred_m) / (weighted_s * since_s).sum(axis=0)[:, None]
        off_m2 = ((centred_m - since_s[:, :, None] * velocity_m_s) ** 2).sum(axis=2)
        weights = (off_m2 <= np.quantile(off_m2, _TRIM_SHARE, axis=0)).astype(float)
    distance_m: FloatArray = np.sqrt(np.median(off_m2, axis=0))
    return distance_m

"""Which reading of laser and gimbal makes the target move plausibly.

The aircraft circles, so a wrong frame of the gimbal or a wrong unit of the laser makes the apparent target circle as
well. Each hypothesis (a frame of the line of sight, a factor of the range) gives a series of apparent target
positions. A target that moves at constant velocity for some seconds leaves small residuals about a straight line; a
wrong hypothesis leaves residuals of the size of the aircraft's own circle. The height over the ground is not needed.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from sidelong.estimators.rotations import Quaternion
from sidelong.estimators.sensing.line_of_sight import line_of_sight
from sidelong.estimators.sensing.readings import AttitudeReading, GimbalReading, PositionReading

FloatArray = npt.NDArray[np.float64]

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
_WRONG_M, _BETTER_SHARE, _AS_GOOD_SHARE = 8.0, 0.3, 0.7
_OWN_SHARE = 0.3


@dataclass(frozen=True, slots=True)
class Verdict:
    """What is wrong with the payload.

    Attributes:
        frame: the gimbal's true frame where its flags are wrong, else None.
        factor: what the range has to be multiplied with, 1 where its unit is right.

    """

    frame: str | None
    factor: float


SOUND = Verdict(None, 1.0)


class MotionFit:
    """Collects two samples a second and compares the hypotheses."""

    def __init__(self, parent_from_mount: Quaternion) -> None:
        self._parent_from_mount = parent_from_mount
        self._samples: deque[tuple[float, float, FloatArray, float]] = deque(maxlen=_SAMPLES)
        self._flagged = ""

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
            slant_range_m: as reported.
            turned_rad: how far the aircraft has turned since the flight began, either way.

        """
        if gimbal.frame != self._flagged:
            self._flagged = gimbal.frame
            self._samples.clear()
        directions = np.empty((len(FRAMES), 3))
        for row, frame in zip(directions, FRAMES, strict=True):
            sight = line_of_sight(
                GimbalReading(gimbal.time_s, gimbal.quaternion_wxyz, frame, gimbal.source),  # type: ignore[arg-type]
                attitude,
                self._parent_from_mount,
            )
            level = math.cos(sight.depression_rad)
            row[:] = level * math.sin(sight.bearing_rad), level * math.cos(sight.bearing_rad), 0.0
            row[2] = -math.sin(sight.depression_rad)
        own = np.array((position.east_m, position.north_m, position.height_m))
        self._samples.append((position.time_s, turned_rad, np.vstack((directions, own)), slant_range_m))

    def verdict(self, established: Verdict = SOUND) -> Verdict | None:
        """Return what is wrong, ``SOUND`` where nothing is, None while it cannot be known.

        Args:
            established: what was found to be wrong before; it holds until what is reported fits clearly better.

        """
        if len(self._samples) < _SAMPLES_MIN:
            return None
        times_s = np.array([one[0] for one in self._samples])
        if times_s[-1] - times_s[0] < _SPAN_MIN_S or self._samples[-1][1] - self._samples[0][1] < _TURNED_MIN_RAD:
            return None
        rows = np.stack([one[2] for one in self._samples])  # (n, 4, 3)
        ranges_m = np.array([one[3] for one in self._samples])
        directions, own = rows[:, :3], rows[:, 3]
        flagged = FRAMES.index(self._flagged)
        frames = own[:, None] + ranges_m[:, None, None] * directions  # (n, 3, 3)
        factors = np.array(list(FACTORS))
        scaled = own[:, None] + (ranges_m[:, None] * factors)[:, :, None] * directions[:, flagged, None]  # (n, k, 3)
        residual_m = _residuals_m(times_s, np.concatenate((frames, scaled, own[:, None]), axis=1))
        as_reported_m = residual_m[flagged]
        if established != SOUND:
            at = (
                FRAMES.index(established.frame)
                if established.frame
                else len(FRAMES) + list(FACTORS).index(established.factor)
            )
            return SOUND if as_reported_m < _AS_GOOD_SHARE * residual_m[at] else established
        # Any range that is divided by enough puts the target at the aircraft, which flies straight at times, too.
        residual_m, own_m = residual_m[:-1], residual_m[-1]
        shrunk = np.flatnonzero(factors < 1.0) + len(FRAMES)
        residual_m[shrunk[residual_m[shrunk] > _OWN_SHARE * own_m]] = math.inf
        best = int(np.argmin(residual_m))
        if as_reported_m < _WRONG_M or residual_m[best] > _AS_GOOD_SHARE * as_reported_m:
            return SOUND
        if residual_m[best] > _BETTER_SHARE * as_reported_m:
            return None
        return Verdict(FRAMES[best], 1.0) if best < len(FRAMES) else Verdict(None, float(factors[best - len(FRAMES)]))


def _residuals_m(times_s: FloatArray, positions_m: FloatArray) -> FloatArray:
    """Return the median distance of positions (n, k, 3) from a straight line in time, for each k."""
    design = np.stack((np.ones_like(times_s), times_s - times_s.mean()), axis=1)
    flat = positions_m.reshape(times_s.size, -1)
    fitted = design @ np.linalg.lstsq(design, flat, rcond=None)[0]
    off = (flat - fitted).reshape(positions_m.shape)
    distance: FloatArray = np.sqrt(np.median((off**2).sum(axis=2), axis=0))
    return distance

"""Whether range and angles agree with the aircraft's height: a wrong unit or sign shows there."""

from __future__ import annotations

import math
import statistics
from collections import deque

from sidelong.app.payload.driver import AircraftPose, AnglesMeasured, RangeMeasured
from sidelong.estimators.rotations import from_roll_pitch_yaw, rotate, sight_direction

_HEIGHT_MIN_M, _DEPRESSION_MIN = 30.0, math.sin(math.radians(5.0))
_KEPT, _NEEDED = 50, 10
_FACTOR_MAX = 2.0  # hills, and a target that is not at the height of home, stay below it
_APART_MAX_S = 0.5


class Consistency:
    """Compares slant range times the sine of the depression with the height above home, by the median of 50."""

    def __init__(self) -> None:
        self._ratios: deque[float] = deque(maxlen=_KEPT)

    def add(self, measured: RangeMeasured, angles: AnglesMeasured | None, pose: AircraftPose | None) -> None:
        """Take a range with the latest angles and the latest pose of the aircraft."""
        if angles is None or pose is None or pose.height_m < _HEIGHT_MIN_M:
            return
        if abs(measured.time_s - angles.time_s) > _APART_MAX_S:
            return
        direction = sight_direction(angles.quaternion_wxyz)
        if angles.frame == "body":
            direction = rotate(from_roll_pitch_yaw(pose.roll_rad, pose.pitch_rad, 0.0), direction)
        if abs(direction[2]) >= _DEPRESSION_MIN:
            self._ratios.append(measured.slant_range_m * direction[2] / pose.height_m)

    @property
    def ratio(self) -> float | None:
        """Height by the payload over height by the autopilot; None while it is not known, as on the ground."""
        return statistics.median(self._ratios) if len(self._ratios) >= _NEEDED else None

    @property
    def fault(self) -> str:
        """What does not agree, and what to set; empty where it agrees or is not known."""
        ratio = self.ratio
        if ratio is None or 1.0 / _FACTOR_MAX <= ratio <= _FACTOR_MAX:
            return ""
        if ratio < 0.0:
            return "it looks up while the target is below: set payload.flip_pitch = true"
        what = f"range and angles put the target {ratio:.2g} times as far below as the autopilot's height"
        for factor in (10.0, 0.1, 100.0, 0.01):
            if 1.0 / _FACTOR_MAX <= ratio / factor <= _FACTOR_MAX:
                return f"{what}: set payload.range_unit_m to {1.0 / factor:g} times its present value"
        return f"{what}: check the mount and payload.angles_relative_to"

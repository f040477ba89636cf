"""Whether the sightings agree with the track.

If more than ``_REJECTED_SHARE`` of the sightings of 30 s are rejected, laser and line of sight do not agree. Lines of
sight without a range, and fixes of a beacon or camera, count as rejected beyond what only 5 % of good ones exceed
(``_POOR_NIS``): the filter adapts to wrong ones. So does the estimated pitch error: if it stays unexpected for
``_PITCH_LASTS_S``, the ground or the height of the aircraft is wrong. Next to other sightings, ``_FIXES_SHARE`` of
the fixes is enough.

Source: docs/health.md#contradictions-of-the-payload.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Sequence

from sidelong.estimators.sensing.sighting import AnySighting, Fix, SightingOutcome
from sidelong.estimators.tracking.payload_fit import OFTEN

_JUMPS_S = 60.0
_JUMPS = (
    f"the target's position jumped {OFTEN} times in {_JUMPS_S:.0f} s: check what the laser meets instead of it, "
    "and what the gimbal points at"
)
_REJECTED_SHARE, _ACCEPTED_AGAIN, _WINDOW_S, _SIGHTINGS_MIN = 0.25, 0.15, 30.0, 20
_FIXES_SHARE, _FIXES_MIN = 0.5, 10  # of fixes next to other sightings
_POOR_NIS = 5.991  # chi-square of two numbers, 95 %
_PITCH_LASTS_S = 20.0
_OFF_SIGHT = (
    "without a laser, they do not fit a target that moves on the ground: check the camera's field of view, its image "
    "axes and its delay, the gimbal's frame flags, and that the tracker follows the target"
)
_OFF_FIXES = (
    "the positions that beacon or camera report do not fit one another: check that one device alone reports, and "
    "that its error is as large as it states"
)
_OFF_BEACON = (
    "the position that beacon or camera report is not where the payload sees the target: check which target each of "
    "them follows, and how late the beacon is"
)

_KINDS = 3
_RANGED, _ANGLES, _FIX = range(_KINDS)


def _kind(sighting: AnySighting) -> int:
    return _FIX if isinstance(sighting, Fix) else _RANGED if sighting.has_range else _ANGLES


class SightingsCheck:
    """Counts the outcomes of sightings.

    Attributes:
        fault: what is wrong with laser and line of sight together, against the track; empty while nothing is.
    """

    def __init__(self) -> None:
        self.fault = ""
        self._rejected: deque[list[int]] = deque()  # second, sightings of each kind, rejected of each kind
        self._pitch_off_s = math.inf  # since when the pitch error is unexpected

    def note(
        self,
        time_s: float,
        outcomes: Sequence[SightingOutcome],
        jumps_s: Sequence[float] = (),
        pitch_error_rad: Callable[[], float] = lambda: 0.0,
    ) -> None:
        """Process the outcomes of sightings.

        Args:
            time_s: Time on the vehicle's clock, s.
            outcomes: What the tracker returned.
            jumps_s: When the apparent target jumped, the last times.
            pitch_error_rad: Returns the gimbal's pitch error, if it is beyond what the settings expect; else 0.
        """
        second = math.floor(time_s)
        is_new = not self._rejected or self._rejected[-1][0] != second
        if is_new:
            self._rejected.append([second, *(2 * _KINDS * [0])])
        counts = self._rejected[-1]
        for one in outcomes:
            kind = _kind(one.sighting)
            counts[1 + kind] += 1
            counts[1 + _KINDS + kind] += not one.accepted or (kind != _RANGED and one.nis > _POOR_NIS)
        if not is_new:
            return
        while self._rejected[0][0] < second - _WINDOW_S or self._rejected[0][0] > second:
            self._rejected.popleft()
        _, *numbers = map(sum, zip(*self._rejected, strict=True))
        given, rejected = numbers[:_KINDS], numbers[_KINDS:]
        total, fixes = sum(given), given[_FIX]
        share = sum(rejected) / total if total >= _SIGHTINGS_MIN else 0.0
        off_fixes = _FIXES_MIN <= fixes < total and rejected[_FIX] > _FIXES_SHARE * fixes
        covered = second - self._rejected[0][0] >= 0.8 * _WINDOW_S
        jumps = len(jumps_s) == OFTEN and 0.0 <= time_s - jumps_s[0] < _JUMPS_S
        by_angles = 2 * given[_ANGLES] > total
        pitch_rad = pitch_error_rad() if by_angles else 0.0
        self._pitch_off_s = min(self._pitch_off_s, time_s) if pitch_rad else math.inf
        off_ground = time_s - self._pitch_off_s > _PITCH_LASTS_S
        if self.fault:
            if share < _ACCEPTED_AGAIN and not jumps and not off_ground and not off_fixes:
                self.fault = ""
        elif jumps:
            self.fault = _JUMPS
        elif covered and (off_fixes or (share > _REJECTED_SHARE and fixes)):
            self.fault = _OFF_FIXES if fixes == total else _OFF_BEACON
        elif covered and share > _REJECTED_SHARE:
            self.fault = (
                f"{100.0 * share:.0f} % of those of {_WINDOW_S:.0f} s were rejected: laser and line of sight "
                "do not agree; check the gimbal's frame flags and mounting and the laser's unit"
            )
            if by_angles:
                self.fault = _OFF_SIGHT
        elif off_ground:
            self.fault = (
                f"without a laser, they look {abs(math.degrees(pitch_rad)):.1f} degrees too "
                f"{'high' if pitch_rad > 0.0 else 'low'} for a target on the ground: check the heights of home, "
                "ground and aircraft, the gimbal's pitch and the camera's field of view"
            )

"""Whether laser and gimbal agree with each other, with the aircraft's motion and with the track.

Rules
-----
1. A laser whose range stays the same to ``_SAME_RANGE_M`` while the aircraft turns by ``_TURNED_RAD``, or comes
   ``_CLOSED_M`` nearer along the line of sight, is stuck. So is one whose range stays the same to ``_EXACT_M`` while
   the line of sight turns by ``_SWEPT_RAD``: going past a target changes the distance to it.
2. A gimbal whose orientation stays the same to ``_SAME_SIGHT`` during that turn is frozen: a line of sight to
   a target turns relative to north as well as to the aircraft. So is one whose yaw alone stays the same during two
   such turns.
3. Of the ways to read the gimbal's frame and the laser's unit, the right one makes the target move straight
   (:mod:`sidelong.mission.health.motion_fit`), and puts it on the ground.
4. If more than ``_REJECTED_SHARE`` of the sightings of 30 s are rejected, laser and line of sight do not agree.
   Lines of sight without a range, and fixes of a beacon or camera, count as rejected beyond what only 5 % of good
   ones exceed (``_POOR_NIS``): the filter adapts to wrong ones. So does the estimated pitch error: if it stays
   unexpected for ``_PITCH_LASTS_S``, the ground or the height of the aircraft is wrong. Next to other sightings,
   ``_FIXES_SHARE`` of the fixes is enough.

While rules 1 to 3 find a fault, the device's readings are not used; a constant yaw error is corrected instead, if the
gimbal keeps level. An apparent target that jumps farther than it can
drive makes the payload suspect for ``SUSPECT_S``, in which rules 1 to 3 come to a result.

Source: docs/health.md#contradictions-of-the-payload.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Sequence

from sidelong.estimators.frames import wrap_rad
from sidelong.estimators.rotations import Quaternion, sight_direction
from sidelong.estimators.sensing.readings import (
    IMAGE_TRACKER,
    AttitudeReading,
    GimbalReading,
    PositionReading,
    RangeReading,
    Source,
)
from sidelong.estimators.sensing.sighting import AnySighting, Fix, SightingOutcome
from sidelong.mission.core.inputs import Input
from sidelong.mission.health.motion_fit import FACTORS, OFTEN, SOUND, WINDOW_S, GroundHeight, MotionFit

_SAME_RANGE_M, _SAME_SIGHT = 0.5, 5e-4
_SAME_S, _TURNED_RAD, _SAME_COUNT = 5.0, 0.8, 5
_EXACT_M, _SWEPT_RAD = 0.1, 0.3  # an eighth of the angle's square, times the range: 3 m at 300 m
_MOVES_AGAIN = 3
_CLOSED_M, _PASSED_RAD = 40.0, 0.25
_SAMPLE_EVERY_S, _JUDGE_EVERY_S, _FRESH_S = 0.45, 1.0, 0.6
_MARGIN_S = 1.0
_LASER_SILENT_S = 10.0  # after that, lines of sight are judged without ranges
_FOUND_AFTER, _CLEARED_AFTER = 3, 6  # judgements in a row
_CORRECTED_AFTER = 5  # readings in a row
_FLYING_M_S = 5.0
SUSPECT_S, _CHANGED_S = 15.0, 30.0
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


_STUCK = "it repeats the same range while the aircraft turns: check its power, its lens and its driver"
_FROZEN = "its orientation is frozen while the aircraft turns: check its power, its mode and its driver"
_YAW_FROZEN = "its yaw is frozen while the aircraft turns: check its pan motor, its pan limits and its driver"
_OFF_GROUND_M = 25.0  # six times the usual error of elevation data
_OFF_GROUND = (
    f"by laser and gimbal the target is more than {_OFF_GROUND_M:.0f} m above or below its ground; "
    "check the tiles, home, and what the laser meets"
)


_KINDS = 3
_RANGED, _ANGLES, _FIX = range(_KINDS)


def _kind(sighting: AnySighting) -> int:
    return _FIX if isinstance(sighting, Fix) else _RANGED if sighting.has_range else _ANGLES


class _Repeats:
    """Notices a value that stays the same although the aircraft's motion has to change it.

    Args:
        same: By how much the value may differ.
    """

    def __init__(self, same: float) -> None:
        self._same = same
        self._anchor: tuple[float, ...] = (math.inf,)
        self._travelled: tuple[float, ...] = ()
        self.since_s = 0.0
        self._count = self._moved = 0
        self.found = False

    def note(self, values: tuple[float, ...], time_s: float, travelled: tuple[float, ...]) -> bool:
        """Take a value; return whether the finding has changed.

        Args:
            values: the value, a tuple of numbers.
            time_s: of the reading.
            travelled: motions of the aircraft since the flight began; one that has changed by 1 changes the value.
        """
        before, same = self.found, self._same
        for then, now in zip(self._anchor, values, strict=False):
            if abs(now - then) > same:
                break
        else:
            self._count += 1
            self._moved = 0
            if not before and self._count >= _SAME_COUNT and time_s - self.since_s >= _SAME_S:
                moves = zip(travelled, self._travelled, strict=True)
                self.found = any(abs(now - then) >= 1.0 for now, then in moves)
            return self.found is not before
        self._moved += 1
        if not before or self._moved >= _MOVES_AGAIN:
            self.found = False
            self._anchor, self.since_s, self._travelled, self._count = values, time_s, travelled, 0
        return self.found is not before


class PayloadCheck:
    """Finds what is wrong with laser and gimbal.

    Attributes:
        laser_fault: what is wrong with the laser and what to do, in one sentence; empty while nothing is.
        gimbal_fault: the same of the gimbal.
        sightings_fault: the same of both together, against the track.
        terrain_fault: how the elevation data contradicts laser and gimbal, while these agree with each other.
        yaw_error_rad: a large constant error of the gimbal's yaw that can be corrected; 0: none is known.
        is_news: whether a fault may have come or gone since ``faults`` was called last.
        wrong_since_s: since when the readings may have been wrong, while there is a fault of laser or gimbal.
    """

    def __init__(self, parent_from_mount: Quaternion = (1.0, 0.0, 0.0, 0.0)) -> None:
        self.laser_fault = self.gimbal_fault = self.sightings_fault = self.terrain_fault = ""
        self._off_ground = self._corrected = 0  # judgements, and readings with other flags, in a row
        self.wrong_since_s = math.inf
        self.yaw_error_rad = 0.0
        self.is_news = False
        self._fit = MotionFit(parent_from_mount)
        self._expect_another_laser()
        self._expect_another_gimbal()
        self._position: PositionReading | None = None
        self._attitude: AttitudeReading | None = None
        self._range: RangeReading | None = None
        self._gimbal_source: Source | None = None
        self._course_rad: float | None = None
        self._turned_rad = self._closed = self._passed = self._swept_rad = 0.0
        self._sight: tuple[float, float] | None = None
        self._sampled_s = self._judged_s = -math.inf
        self._agreeing = 0
        self._verdict = self._established = SOUND
        self._frame_fault = self._unit_fault = ""
        self._rejected: deque[list[int]] = deque()  # second, sightings of each kind, rejected of each kind
        self._pitch_off_s = math.inf  # since when the pitch error is unexpected

    def stand_on(self, ground: GroundHeight) -> None:
        """Compare heights with this ground.

        Args:
            ground: Returns the height of the ground at a position.
        """
        self._fit.ground = ground

    def attitude(self, reading: AttitudeReading) -> None:
        """Process the aircraft's attitude."""
        self._attitude = reading

    def position(self, reading: PositionReading) -> None:
        """Process the aircraft's position; its course gives how far it has turned."""
        before, self._position = self._position, reading
        east_m_s, north_m_s = reading.velocity_east_m_s, reading.velocity_north_m_s
        if east_m_s * east_m_s + north_m_s * north_m_s < _FLYING_M_S**2:
            self._course_rad = None
            return
        course_rad = math.atan2(east_m_s, north_m_s)
        if self._course_rad is not None and before is not None:
            self._move(before, reading)
            self._turned_rad += abs(wrap_rad(course_rad - self._course_rad))
        self._course_rad = course_rad

    def _move(self, before: PositionReading, now: PositionReading) -> None:
        """Add up how far the aircraft has come along the line of sight, and by what angle it has gone past."""
        if self._sight is None or self._range is None:
            return
        east_m, north_m = now.east_m - before.east_m, now.north_m - before.north_m
        east, north = self._sight
        self._closed += (east_m * east + north_m * north) / _CLOSED_M
        self._passed += (north_m * east - east_m * north) / max(self._range.slant_range_m, 50.0) / _PASSED_RAD

    def _sweep(self, sight: tuple[float, float] | None) -> None:
        """Take the newest line of sight, and add up by what angle it has turned."""
        before, self._sight = self._sight, sight
        if before is not None and sight is not None:
            across, along = before[1] * sight[0] - before[0] * sight[1], before[0] * sight[0] + before[1] * sight[1]
            self._swept_rad += math.atan2(across, along)

    def is_suspect(self, time_s: float) -> bool:
        """Return whether the apparent target has jumped lately, and it is not known yet whether there is a fault."""
        return 0.0 <= time_s - self.jumped_s < SUSPECT_S

    @property
    def jumped_s(self) -> float:
        """When the apparent target jumped farther than a target can drive, last; -inf: never."""
        return self._fit.jumped_s

    def expect_another_target(self) -> None:
        """Begin again with another target: the payload is being turned to it."""
        self._fit.clear()

    def range(self, reading: RangeReading) -> None:
        """Process a range of the laser in use."""
        if self._range is not None and reading.source != self._range.source:
            self._expect_another_laser()
            self.judge_afresh()
        self._range = reading
        values = (reading.slant_range_m,)
        news = self._range_repeats.note(values, reading.time_s, (self._turned_rad / _TURNED_RAD, self._closed))
        if self._range_stays.note(values, reading.time_s, (self._swept_rad / _SWEPT_RAD,)) or news:
            self._settle()

    def gimbal_axis(self, reading: GimbalReading) -> None:
        """Process the axis of a gimbal, which is not the line of sight if a camera tracks a target off it."""
        turns, passed = self._turned_rad / _TURNED_RAD, self._passed
        news = self._sight_repeats.note(reading.quaternion_wxyz, reading.time_s, (turns, passed))
        forward, right, _ = sight_direction(reading.quaternion_wxyz)
        if self._yaw_repeats.note((math.atan2(right, forward),), reading.time_s, (turns / 2.0, passed / 2.0)) or news:
            self._settle()

    def gimbal(self, reading: GimbalReading, ends_on_ground: bool = False) -> None:
        """Process a line of sight in use.

        Args:
            reading: The line of sight.
            ends_on_ground: whether it counts without a range, as it ends on known ground.
        """
        if reading.source != self._gimbal_source:
            self._gimbal_source = reading.source
            self._expect_another_gimbal()
            self.judge_afresh()
        if self._frame_fault:
            self._corrected = self._corrected + 1 if reading.frame == self._established.frame else 0
            if self._corrected >= _CORRECTED_AFTER:  # at once: on a straight leg no motion could show it
                self.judge_afresh()
                self._settle()
        if reading.source.message != IMAGE_TRACKER:
            self.gimbal_axis(reading)
        position, attitude, now_s = self._position, self._attitude, reading.time_s
        if now_s - self._sampled_s < _SAMPLE_EVERY_S or position is None or attitude is None:
            if now_s < self._sampled_s:  # the clock was set back
                self._sampled_s = self._judged_s = -math.inf
            return
        # Angles relative to north need no attitude, and are used while it is silent.
        needed = (position,) if reading.frame == "earth" else (position, attitude)
        if any(abs(now_s - one.time_s) > _FRESH_S for one in needed):
            return
        slant, slant_range_m = self._range, math.nan
        if slant is not None and abs(now_s - slant.time_s) <= _FRESH_S:
            slant_range_m = slant.slant_range_m
        elif not ends_on_ground or (slant is not None and abs(now_s - slant.time_s) <= _LASER_SILENT_S):
            return
        self._sampled_s = now_s
        if self._is_stuck or self._is_frozen:
            self._fit.clear()
        else:
            self._fit.add(position, attitude, reading, slant_range_m, self._turned_rad)
            self._sweep(self._fit.level_direction)
        if reading.time_s - self._judged_s >= _JUDGE_EVERY_S:
            self._judged_s = reading.time_s
            self._judge(reading.frame)
            self._settle()

    def sightings(
        self, time_s: float, outcomes: Sequence[SightingOutcome], pitch_error_rad: Callable[[], float] = lambda: 0.0
    ) -> None:
        """Process the outcomes of sightings.

        Args:
            time_s: Time on the vehicle's clock, s.
            outcomes: What the tracker returned.
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
        jumps_s = self._fit.jumps_s
        jumps = len(jumps_s) == OFTEN and 0.0 <= time_s - jumps_s[0] < _JUMPS_S
        by_angles = 2 * given[_ANGLES] > total
        pitch_rad = pitch_error_rad() if by_angles else 0.0
        self._pitch_off_s = min(self._pitch_off_s, time_s) if pitch_rad else math.inf
        off_ground = time_s - self._pitch_off_s > _PITCH_LASTS_S
        if self.sightings_fault:
            if share < _ACCEPTED_AGAIN and not jumps and not off_ground and not off_fixes:
                self.sightings_fault = ""
        elif jumps:
            self.sightings_fault = _JUMPS
        elif covered and (off_fixes or (share > _REJECTED_SHARE and fixes)):
            self.sightings_fault = _OFF_FIXES if fixes == total else _OFF_BEACON
        elif covered and share > _REJECTED_SHARE:
            self.sightings_fault = (
                f"{100.0 * share:.0f} % of those of {_WINDOW_S:.0f} s were rejected: laser and line of sight "
                "do not agree; check the gimbal's frame flags and mounting and the laser's unit"
            )
            if by_angles:
                self.sightings_fault = _OFF_SIGHT
        elif off_ground:
            self.sightings_fault = (
                f"without a laser, they look {abs(math.degrees(pitch_rad)):.1f} degrees too "
                f"{'high' if pitch_rad > 0.0 else 'low'} for a target on the ground: check the heights of home, "
                "ground and aircraft, the gimbal's pitch and the camera's field of view"
            )

    @property
    def _is_stuck(self) -> bool:
        return self._range_repeats.found or self._range_stays.found

    @property
    def _is_frozen(self) -> bool:
        return self._sight_repeats.found or self._yaw_repeats.found

    def _expect_another_laser(self) -> None:
        self._range_repeats, self._range_stays = _Repeats(_SAME_RANGE_M), _Repeats(_EXACT_M)

    def _expect_another_gimbal(self) -> None:
        self._sight_repeats, self._yaw_repeats = _Repeats(_SAME_SIGHT), _Repeats(_SAME_SIGHT)

    def judge_afresh(self) -> None:
        """Judge another device, or lines of sight that come without the yaw error from now on."""
        self._fit.clear()
        self._established = self._verdict = SOUND
        self._frame_fault = self._unit_fault = ""
        self.yaw_error_rad = 0.0

    def _judge(self, flagged: str) -> None:
        verdict = self._fit.verdict(self._established)
        if verdict is None:
            return
        self._judge_terrain(sound=verdict == SOUND)
        # Just after a change half of the samples are older: several judgements have to agree.
        self._agreeing = self._agreeing + 1 if verdict == self._verdict else 1
        self._verdict = verdict
        if verdict == self._established or self._agreeing < (_CLEARED_AFTER if verdict == SOUND else _FOUND_AFTER):
            return
        self._established = verdict
        self._frame_fault = self._unit_fault = ""
        self.yaw_error_rad = 0.0
        if verdict.frame is not None:
            self._frame_fault = (
                f"its frame flags are wrong: they mean {_FRAME_WORDS[flagged]}, but the angles are "
                f'{_FRAME_WORDS[verdict.frame]}; correct the flags, or set sensors.gimbal_frame = "{verdict.frame}"'
            )
        elif verdict.is_turned and flagged != "body":
            self.yaw_error_rad, self.is_news = self._fit.yaw_error_rad, True
        elif verdict.is_turned:  # about which axis is not known
            self._frame_fault = yaw_fault(self._fit.yaw_error_rad)
        elif verdict != SOUND:
            self._unit_fault = f"it reports {FACTORS[verdict.factor]}; correct its unit"

    def _judge_terrain(self, *, sound: bool) -> None:
        off = sound and self._fit.off_ground_m > _OFF_GROUND_M
        self._off_ground = self._off_ground + 1 if off else 0
        before = self.terrain_fault
        if self._off_ground >= _CLEARED_AFTER:
            self.terrain_fault = _OFF_GROUND
        elif not off:
            self.terrain_fault = ""
        self.is_news |= before != self.terrain_fault

    def _settle(self) -> None:
        before = self.laser_fault, self.gimbal_fault
        self.laser_fault = _STUCK if self._is_stuck else self._unit_fault
        frozen = _FROZEN if self._sight_repeats.found else _YAW_FROZEN if self._yaw_repeats.found else ""
        self.gimbal_fault = frozen or self._frame_fault
        self.is_news |= before != (self.laser_fault, self.gimbal_fault)
        if not any(before) and (self.laser_fault or self.gimbal_fault):
            repeats = self._range_repeats, self._range_stays, self._sight_repeats, self._yaw_repeats
            since_s = [one.since_s for one in repeats if one.found]
            if self._frame_fault or self._unit_fault:
                since_s.append(self._judged_s - WINDOW_S)
                if self._judged_s - self._fit.changed_s < _CHANGED_S:
                    since_s.append(self._fit.changed_s)
            self.wrong_since_s = min(since_s) - _MARGIN_S

    def faults(self) -> dict[Input, str]:
        """Return the faults by input; empty text where there is none."""
        self.is_news = False
        return {
            Input.LASER: self.laser_fault,
            Input.GIMBAL: self.gimbal_fault,
            Input.SIGHTINGS: self.sightings_fault,
            Input.TERRAIN: self.terrain_fault,
        }


def yaw_fault(yaw_error_rad: float) -> str:
    """Return what is wrong with a gimbal whose yaw is off, and what to do."""
    return (
        f"its yaw is off by about {math.degrees(yaw_error_rad):+.0f} degrees: check its mounting and its heading, "
        "or correct sensors.mount_deg"
    )


_FRAME_WORDS = {
    "earth": "relative to north",
    "vehicle": "relative to the aircraft's heading",
    "body": "relative to the airframe",
}

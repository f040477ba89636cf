"""Readings in, estimate out. Source: docs/explanation/how-it-works.md."""

from __future__ import annotations

import math
from bisect import insort
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from operator import attrgetter
from typing import TYPE_CHECKING

import numpy as np

from sidelong.estimators.estimate import TargetEstimate, TrackQuality
from sidelong.estimators.filters.biases import Biases, Calibration, Delays
from sidelong.estimators.frames import wrap_rad
from sidelong.estimators.rotations import Quaternion, from_roll_pitch_yaw, multiply
from sidelong.estimators.sensing.pose import PoseHistory, ReadingHistory, gimbal_at
from sidelong.estimators.sensing.readings import (
    BEACON_MESSAGES,
    IMAGE_TRACKER,
    AttitudeReading,
    GimbalReading,
    PositionReading,
    RangeReading,
    Reading,
    Source,
    TargetFixReading,
)
from sidelong.estimators.sensing.sighting import (
    AnySighting,
    BeaconErrors,
    Fix,
    Sighting,
    SightingOutcome,
    lever_arm_plane_m,
    line_of_sight,
)
from sidelong.estimators.settings import SourceChoice, TrackerSettings
from sidelong.estimators.tracking.payload_fit import PayloadFit, WrongBearings
from sidelong.estimators.tracking.sources import SourceSelector, range_rank, sight_rank
from sidelong.estimators.tracking.track import Track

if TYPE_CHECKING:
    from sidelong.estimators.terrain.ground import Ground


_SPAN_S = 12.0
_WAIT_S = 1.5
_WAITING_MAX = 32  # so that what has waited is never long to take in
# Timeout of the laser. After it one line of sight per interval is used, with an uninformative range.
_BEGINNING_S = 3.0
_SILENT_S, _ALONE_EVERY_S = 1.0, 0.2
_UNKNOWN_M, _REACH_M = 2e3, 5_000.0
_GRAZES = 1.25  # a line of sight that its usual error makes longer than this says little of where it ends
_time_s = attrgetter("time_s")


class Pairing:
    """Makes sightings of ranges, lines of sight and poses of different times.

    Readings are kept with their stamps; they were made by a delay earlier. A range waits until gimbal and aircraft
    are known on both sides of its time, and takes what lies between. It gives up after ``_WAIT_S``. Over known
    ground, while the laser is silent, a line of sight alone becomes a sighting.

    Source: docs/explanation/filter.md#measurement.
    """

    def __init__(self, settings: TrackerSettings, poses: PoseHistory) -> None:
        self._settings = settings
        self._poses = poses
        self.gimbal_delay_s, self.range_delay_s = settings.latencies_s
        self.range_factor = 1.0
        self.wrong_bearings: WrongBearings | None = None  # at which lines of sight go without their ranges
        self._gimbals: ReadingHistory[GimbalReading] = ReadingHistory(_SPAN_S)
        self._ranges: ReadingHistory[RangeReading] = ReadingHistory(_SPAN_S)
        self._has_arm = any(settings.lever_arm_body_m)
        self.parent_from_mount = from_roll_pitch_yaw(*settings.mount_roll_pitch_yaw_rad)
        self._paired_s, self._begun_s = -math.inf, math.inf
        self._has_image = False  # a camera's tracker reports the target's place in the image
        self.alone: list[float] = []  # times of lines of sight that go without a range
        self.ground: Ground | None = None
        self.waiting: list[RangeReading] = []

    def add_gimbal(self, gimbal: GimbalReading) -> bool:
        """Store a line of sight; return whether it is new and its quaternion is a rotation."""
        w, x, y, z = gimbal.quaternion_wxyz
        if not 0.9 < w * w + x * x + y * y + z * z < 1.1 or not self._gimbals.add(gimbal):
            return False
        by_image = gimbal.source.message == IMAGE_TRACKER
        self._has_image |= by_image
        if self.ground is None or (self._has_image and not by_image):  # nothing keeps the axis on the target
            return True
        # A camera's tracker, or the laser, may begin a little later than the gimbal.
        self._begun_s = min(self._begun_s, gimbal.time_s)
        if gimbal.time_s - self._begun_s < _BEGINNING_S:
            return True
        last_s = self.alone[-1] if self.alone else self._paired_s
        if gimbal.time_s - self._ranges.newest_s > _SILENT_S and gimbal.time_s - last_s >= _ALONE_EVERY_S:
            self.alone.append(gimbal.time_s)
            del self.alone[:-_WAITING_MAX]
        return True

    def change_gimbals(self, changed: Callable[[GimbalReading], GimbalReading]) -> None:
        """Replace each stored line of sight by what ``changed`` makes of it."""
        before, self._gimbals = self._gimbals, ReadingHistory(_SPAN_S)
        for gimbal in before.since(-math.inf):
            self._gimbals.add(changed(gimbal))

    def add_range(self, reading: RangeReading) -> None:
        """Store a range until it can be paired."""
        if self._ranges.add(reading):
            insort(self.waiting, reading, key=_time_s)
            del self.waiting[:-_WAITING_MAX]

    def completed(self) -> list[Sighting]:
        """Return the sightings that can be made now, oldest first."""
        sightings: list[Sighting] = []
        position_s, gimbal_s = self._poses.positions.newest_s, self._gimbals.newest_s
        newest_s = max(position_s, gimbal_s, self._ranges.newest_s)
        known_s, sighted_s = position_s, gimbal_s - self.gimbal_delay_s
        known_s = known_s if known_s <= sighted_s else sighted_s
        needs_attitude = self._needs_attitude
        if needs_attitude:
            known_s = min(known_s, self._poses.attitudes.newest_s)
        # A gimbal that is later than the laser is waited for.
        known_s += self.range_delay_s
        later_s = self.gimbal_delay_s - self.range_delay_s
        wait_s = _WAIT_S + later_s if later_s > 0.0 else _WAIT_S
        while self.waiting and (known_s >= self.waiting[0].time_s or newest_s - self.waiting[0].time_s > wait_s):
            reading = self.waiting.pop(0)
            sighting = self._sighting(reading.time_s - self.range_delay_s, reading, needs_attitude)
            if sighting is not None:
                sightings.append(sighting)
        known_s += self.gimbal_delay_s - self.range_delay_s
        while self.alone and known_s >= self.alone[0]:
            sighting = self._sighting(self.alone.pop(0) - self.gimbal_delay_s, None, needs_attitude)
            if sighting is not None:
                sightings.append(sighting)
        return sightings

    def set_delays(self, delays: Delays | None) -> None:
        """Use other delays, or the configured ones; whole milliseconds, so that a replay computes the same."""
        used_s, self.range_factor = self._settings.latencies_s, 1.0
        if delays is not None:
            used_s = round(delays.gimbal_s, 3), round(delays.range_s, 3)
            self.range_factor = round(delays.range_factor, 3)
        self.gimbal_delay_s, self.range_delay_s = used_s

    def repeated(self, since_s: float) -> list[Sighting]:
        """Return the paired sightings since a time, computed again with the present delays."""
        self._paired_s = -math.inf
        waiting = {reading.time_s for reading in self.waiting}
        readings = [reading for reading in self._ranges.since(since_s) if reading.time_s not in waiting]
        delay_s, needed = self.range_delay_s, self._needs_attitude
        sightings = (self._sighting(reading.time_s - delay_s, reading, needed) for reading in readings)
        return [sighting for sighting in sightings if sighting is not None]

    @property
    def _needs_attitude(self) -> bool:
        newest = self._gimbals.newest()
        return self._has_arm or (newest is not None and newest.frame != "earth")

    def _sighting(self, time_s: float, reading: RangeReading | None, needs_attitude: bool) -> Sighting | None:
        """Return the sighting at a time, with a range or where the line of sight meets the ground."""
        settings = self._settings
        position = self._poses.position_at(time_s)
        between = gimbal_at(self._gimbals, time_s + self.gimbal_delay_s)
        if position is None or between is None:
            return None
        gimbal, gap_s = between
        needs_attitude = needs_attitude or gimbal.frame != "earth"  # the newest may be of another frame
        attitude = self._poses.attitude_at(time_s) if needs_attitude else None
        if attitude is None and needs_attitude:
            return None
        sight = line_of_sight(gimbal, attitude, self.parent_from_mount)
        arm_m = (0.0, 0.0, 0.0) if attitude is None else lever_arm_plane_m(settings.lever_arm_body_m, attitude)
        aircraft_m = position.east_m + arm_m[0], position.north_m + arm_m[1], position.height_m + arm_m[2]
        has_range = reading is not None
        if reading is not None:
            range_m = self.range_factor * reading.slant_range_m
            range_sigma_m = reading.sigma_m or settings.range_sigma_m
            if self.wrong_bearings is not None:
                attitude = attitude or self._poses.attitude_at(time_s)
                if self.wrong_bearings.hold(sight.bearing_rad, attitude):
                    has_range, range_sigma_m = False, _UNKNOWN_M
        elif self.ground is not None:
            error_rad = math.hypot(settings.pitch_sigma_rad, settings.pitch_bias_sigma_rad)
            level_m, behind_m = (
                self.ground.cut_m(*aircraft_m, sight.bearing_rad, depression_rad, _REACH_M)
                for depression_rad in (sight.depression_rad, sight.depression_rad - error_rad)
            )
            if level_m is None or behind_m is None or behind_m > _GRAZES * level_m:
                return None
            range_m, range_sigma_m = level_m / math.cos(sight.depression_rad), _UNKNOWN_M
        else:
            return None
        attitude_sigma_rad = 0.0 if gimbal.frame == "earth" else settings.attitude_sigma_rad
        # Several ranges between two lines of sight share the noise of these: none may count it as its own.
        shared = 1.0
        if gap_s:
            shared = math.sqrt(max(1.0, gap_s / max(abs(time_s - self._paired_s), 1e-3)))
        self._paired_s = time_s if time_s > self._paired_s else self._paired_s
        position_m = settings.position_sigma_m  # alike in all three axes it adds to each measured number separately
        yaw_rad, pitch_rad = shared * settings.yaw_sigma_rad, shared * settings.pitch_sigma_rad
        cosine = math.cos(sight.depression_rad)
        level_m = range_m * (cosine if cosine > 0.01 else 0.01)
        return Sighting(
            time_s,
            range_m,
            sight.bearing_rad,
            sight.depression_rad,
            math.hypot(range_sigma_m, position_m),
            math.hypot(yaw_rad, attitude_sigma_rad, position_m / level_m),
            math.hypot(pitch_rad, attitude_sigma_rad, position_m / range_m),
            *aircraft_m,
            quality=None if reading is None else reading.quality,
            has_range=has_range,
        )


__all__ = ["SourceChoice", "Tracker", "TrackerSettings"]

_AGREES_RAD, _AGREES_M, _AGREES_SIGMAS = math.radians(10.0), 30.0, 4.0
_FOLLOWS_RAD = math.radians(5.0)
_LATE_S = 0.4  # of a payload with this delay or more, the present estimate is mostly a prediction
_REPEATED_S = 8.0  # of readings that the track is made of again when the delays are corrected
_YAW_SIGMA_MIN_RAD, _YAW_SHARED_RAD = math.radians(0.1), math.radians(1.5)
_YAW_UNEXPECTED_RAD, _YAW_SIGMAS = math.radians(4.0), 4.0  # of the gimbal's mounting
_YAW_FOUND_SIGMA_RAD, _YAW_KNOWN_RAD = math.radians(3.0), math.radians(10.0)  # by the motion of the apparent target
_PITCH_SIGMAS = 3.0
# Of a laser; smaller errors are the filter's alone. Fitted together with a target that turns, they are less sure.
_RANGE_UNEXPECTED_M, _RANGE_SIGMAS, _FACTOR_STEP = 10.0, 8.0, 0.03
_STEP_LARGE_S = 0.3  # of a delay: the sightings until then show another place
_RANGE_FOUND_SHARE = 0.04  # the filter knows the error less well than the fit, which sees minutes
_RANGE_SIGMA_SHARE = 0.1  # an error may grow with the range, or be the pitch's


class Tracker:
    """Pose history, source selection, pairing, payload fit and track in one interface. Time comes from the readings.

    A reading may come late or out of order by a few seconds. Readings of a laser or gimbal that the payload fit finds
    faulty are not used, and the sightings made with them are undone.
    """

    def __init__(self, settings: TrackerSettings) -> None:
        self._settings = settings
        self._poses = PoseHistory()
        self._pairing = Pairing(settings, self._poses)
        self.ranges = SourceSelector(range_rank, settings.range_source)
        self.gimbals = SourceSelector(sight_rank, settings.gimbal_source)
        self._fixes = SourceSelector(sight_rank, settings.fix_source)
        self._beacon = BeaconErrors()
        self._contradicting: dict[Source, Quaternion] = {}  # of refused gimbals: their orientation at that time
        self._track = Track(settings)
        self.payload = PayloadFit(settings, self._pairing.parent_from_mount)
        self._yaw_errors_rad: dict[Source, float] = {}  # large ones, which every line of sight is corrected by first
        self.turns = 0  # how often the lines of sight were turned back by a large yaw error
        self._suspected = False  # from the time that the payload turns out to be wrong until it agrees again
        self.delays: Delays | None = None  # None while nothing else is known than the setting
        self.corrections = 0  # how often the sightings until then turned out to show another place
        self._found_errors = Biases.prior(settings)  # with which the track was last restarted
        self._delays_of: dict[tuple[Source | None, Source | None], Delays] = {}
        self._devices: tuple[Source | None, Source | None] = None, None
        self.sightings = 0
        self.rejected = 0

    def add(self, reading: Reading) -> tuple[SightingOutcome, ...]:
        """Process a reading; return the outcome of each sighting that it completed."""
        sightings: list[AnySighting] = []
        match reading:
            case PositionReading():
                self._poses.positions.add(reading)
                self.payload.position(reading)
            case RangeReading():
                self._add_range(reading)
            case GimbalReading():
                self._add_gimbal(reading)
            case AttitudeReading():
                self._poses.attitudes.add(reading)
                self.payload.attitude(reading)
            case TargetFixReading():
                sightings += self._usable_fix(reading)
        if self._pairing.waiting or self._pairing.alone:
            sightings += self._pairing.completed()
            at_all_bearings = self._pairing.wrong_bearings is None
            for sighting in sightings:  # ends of lines of sight on the ground take the place of ranges
                if not sighting.has_range and at_all_bearings and isinstance(sighting, Sighting):
                    self.payload.ground_range(sighting.time_s + self._pairing.gimbal_delay_s, sighting.slant_range_m)
        if not sightings:
            return ()
        outcomes = []
        for sighting in sightings:
            outcome = self._track.add(sighting)
            outcomes.append(outcome)
            self.sightings += 1
            self.rejected += not outcome.accepted
        return tuple(outcomes)

    def _follow_payload(self, now_s: float) -> None:
        """Use what the payload fit has found: the one place that corrects, and that undoes wrong sightings."""
        payload = self.payload
        payload.is_changed = False
        devices = self.gimbals.chosen, self.ranges.chosen
        if devices != self._devices:
            if None not in self._devices:
                self._set_delays(self._delays_of.get(devices))
            self._devices = devices
        if payload.wrong_bearings is not self._pairing.wrong_bearings:
            self._pairing.wrong_bearings = payload.wrong_bearings
            self._restart(Biases.prior(self._settings), now_s, large=True)
        faulty = bool(payload.laser_fault or payload.gimbal_fault)
        if faulty is not self._suspected:
            self._suspected = faulty
            self.corrections += 1
            if faulty:
                self._track.forget_since(payload.wrong_since_s)
            else:  # what the track was made from has turned out to be wrong
                payload.restart()
                self._track.begin_again()
        if payload.yaw_error_rad:
            self._correct_yaw(payload.yaw_error_rad)
        found, payload.found = payload.found, None
        if found is None or faulty:
            return
        if payload.on_hills and payload.finds_yaw_error:  # the lines of sight end elsewhere
            self._correct_yaw(found.yaw_bias_rad)
            return
        self._correct(found, devices, now_s)

    def _correct(self, found: Delays, devices: tuple[Source | None, Source | None], now_s: float) -> None:
        """Replace the delays and errors in use by those that were found, if these are credible and differ."""
        payload, used_s = self.payload, self.payload.used_s
        errs = self._errs_otherwise(found) and not payload.drifts
        if not payload.is_late:
            found = replace(found, gimbal_s=used_s[0], range_s=used_s[1])
        if payload.is_late or errs or payload.drifts:
            self._set_delays(found)
            # The payload's errors were estimated with the previous delays and would change only slowly.
            apart_s = max(abs(found.gimbal_s - used_s[0]), abs(found.range_s - used_s[1]))
            large = errs or (payload.is_confirmed and apart_s > _STEP_LARGE_S)
            self._restart(self._biases_with(found), now_s, large=large)
        elif payload.is_confirmed:
            self.delays = found
        else:
            return  # nothing is known better than before
        self._delays_of[devices] = found

    def _set_delays(self, delays: Delays | None) -> None:
        self.delays = delays
        self._pairing.set_delays(delays)
        self.payload.used_s = self._pairing.gimbal_delay_s, self._pairing.range_delay_s

    def _errs_otherwise(self, found: Delays) -> bool:
        """Return whether the payload's errors that were found with the delays differ clearly from those in use."""
        known = self._track.calibration
        yaw_sigma_rad = math.hypot(found.yaw_sigma_rad, known.yaw_sigma_rad)
        range_sigma_m = math.hypot(found.range_bias_sigma_m, known.range_sigma_m)
        return (
            abs(found.yaw_bias_rad - known.yaw_bias_rad) > max(_YAW_UNEXPECTED_RAD, _YAW_SIGMAS * yaw_sigma_rad)
            or abs(found.range_bias_m - known.range_bias_m) > max(_RANGE_UNEXPECTED_M, _RANGE_SIGMAS * range_sigma_m)
            or abs(found.range_factor - self._pairing.range_factor) > _FACTOR_STEP
        )

    def _biases_with(self, found: Delays) -> Biases:
        """Return the payload's errors with other delays; those before were found with wrong delays."""
        prior = Biases.prior(self._settings)
        variance = float(prior.covariance[0, 0])
        if variance == 0.0:
            return prior
        sigma_rad = math.hypot(found.yaw_sigma_rad, _YAW_SIGMA_MIN_RAD)
        mean, covariance = prior.mean.copy(), prior.covariance.copy()
        if not self.payload.drifts:
            sigma_rad = min(math.sqrt(variance), sigma_rad)
        mean[0], covariance[0, 0] = found.yaw_bias_rad, sigma_rad**2
        if abs(found.range_bias_m) > _RANGE_UNEXPECTED_M:
            mean[2] = found.range_bias_m
            covariance[2, 2] += (_RANGE_FOUND_SHARE * found.range_bias_m) ** 2
        return Biases(mean, covariance)

    @property
    def latencies_s(self) -> tuple[float, float]:
        """The delays of gimbal and laser as configured."""
        return self._settings.latencies_s

    def _add_gimbal(self, given: GimbalReading) -> None:
        reading, payload, used = self.corrected(given), self.payload, self.gimbals.chosen
        if used is None or reading.source is used or reading.source == used:
            payload.gimbal(reading, self.ends_on_ground)
            if payload.is_changed:
                self._follow_payload(reading.time_s)
                reading = self.corrected(given)
        elif used.message == IMAGE_TRACKER:
            payload.gimbal_axis(reading)
        # A camera's line of sight is made with its gimbal's.
        if payload.gimbal_fault and (used is None or reading.source == used or used.message == IMAGE_TRACKER):
            return
        if not self.gimbals.accepts(reading.source, reading.time_s, lambda: self._points_at_track(reading)):
            return
        self._pairing.add_gimbal(reading)

    def corrected(self, reading: GimbalReading) -> GimbalReading:
        """Return a line of sight in the configured frame, if any, without the large yaw error, if one is known."""
        frame = self._settings.gimbal_frame
        if frame is not None and reading.frame != frame:
            reading = replace(reading, frame=frame)
        error_rad = self._yaw_errors_rad.get(reading.source) if self._yaw_errors_rad else None
        return reading if error_rad is None else self._turned_back(reading, error_rad)

    def _turned_back(self, reading: GimbalReading, yaw_error_rad: float) -> GimbalReading:
        turn = from_roll_pitch_yaw(0.0, 0.0, -yaw_error_rad)
        if reading.frame != "earth":  # about the vertical, not about an axis of the mount
            w, x, y, z = mount = self._pairing.parent_from_mount
            turn = multiply(multiply((w, -x, -y, -z), turn), mount)
        return replace(reading, quaternion_wxyz=multiply(turn, reading.quaternion_wxyz))

    def _correct_yaw(self, yaw_error_rad: float) -> None:
        """Correct a large yaw error, and forget what was found before, unless that holds the error already."""
        source, payload = self.gimbals.chosen, self.payload
        payload.yaw_error_rad = 0.0
        if source is None or abs(wrap_rad(yaw_error_rad - self._track.calibration.yaw_bias_rad)) < _YAW_KNOWN_RAD:
            return
        self._yaw_errors_rad[source] = wrap_rad(self._known_yaw_error_rad + yaw_error_rad)
        self._pairing.change_gimbals(partial(self._turned_back, yaw_error_rad=yaw_error_rad))
        payload.turned_back()
        self._delays_of.clear()
        self._set_delays(None)
        biases = Biases.prior(self._settings)
        if biases.covariance[0, 0] > 0.0:
            biases.covariance[0, 0] += _YAW_FOUND_SIGMA_RAD**2
        self.turns += 1
        self._restart(biases, self._poses.positions.newest_s, large=True)

    def _restart(self, biases: Biases, now_s: float, *, large: bool) -> None:
        yaw_rad, _, range_m = abs(biases.mean - self._found_errors.mean).tolist()
        if large or yaw_rad > _YAW_SHARED_RAD or range_m > _RANGE_UNEXPECTED_M:
            self._found_errors = biases
            self.corrections += 1
        self._track.restart(biases, self._pairing.repeated(now_s - _REPEATED_S))

    def without_known_errors(self, sighting: AnySighting) -> AnySighting:
        """Return a sighting without the errors that were found, for a filter that does not know them."""
        return sighting.without(*self._found_errors.mean.tolist())

    @property
    def remaining_sigmas(self) -> tuple[float, float]:
        """Standard deviations of the errors of yaw, rad, and range, m, that ``without_known_errors`` leaves."""
        left, seen = self._found_errors.calibration, self._expected(self._poses.positions.newest_s)
        corrected_m = 0.0 if seen is None else (1.0 - self._pairing.range_factor) * seen[1]
        return left.yaw_sigma_rad, math.hypot(left.range_sigma_m, _RANGE_SIGMA_SHARE * corrected_m)

    @property
    def _known_yaw_error_rad(self) -> float:
        """The large error that the lines of sight in use are corrected by first."""
        source = self.gimbals.chosen
        return 0.0 if source is None else self._yaw_errors_rad.get(source, 0.0)

    @property
    def parent_from_mount(self) -> Quaternion:
        """How the gimbal's base is turned against the airframe."""
        return self._pairing.parent_from_mount

    def _points_at_track(self, reading: GimbalReading) -> bool:
        """Return whether a line of sight points at the track, or without one has turned since it contradicted it."""
        expected = self._expected(reading.time_s)
        attitude = self._poses.attitudes.newest()
        if expected is None or (attitude is None and reading.frame != "earth"):
            then = self._contradicting.get(reading.source)
            if then is None:
                return True
            cosine = abs(sum(a * b for a, b in zip(then, reading.quaternion_wxyz, strict=True)))  # of half the turn
            return 2.0 * math.acos(min(cosine, 1.0)) > _FOLLOWS_RAD
        sight = line_of_sight(reading, attitude, self._pairing.parent_from_mount)
        bearing_rad, slant_range_m, sigma_m = expected
        off_rad = abs(wrap_rad(sight.bearing_rad - bearing_rad))
        agrees = off_rad <= _AGREES_RAD + _AGREES_SIGMAS * sigma_m / slant_range_m
        if not agrees:
            self._contradicting[reading.source] = reading.quaternion_wxyz
        return agrees

    def _measures_track(self, reading: RangeReading) -> bool:
        """Return whether a range is that of the tracked target; True where there is no track to compare."""
        expected = self._expected(reading.time_s)
        if expected is None:
            return True
        _, range_m, sigma_m = expected
        off_m = self._pairing.range_factor * reading.slant_range_m - range_m
        return abs(off_m) <= _AGREES_M + _AGREES_SIGMAS * sigma_m

    def _expected(self, time_s: float) -> tuple[float, float, float] | None:
        """Return bearing, range and position sigma of the tracked target as it should be seen now."""
        estimate, position = self._track.estimate(time_s), self._poses.positions.newest()
        if estimate is None or estimate.quality is TrackQuality.LOST or position is None:
            return None
        east, north = estimate.east_m - position.east_m, estimate.north_m - position.north_m
        height_m = self._track.drop_m(position.height_m)
        sigma_m = math.sqrt(float(max(estimate.covariance[0, 0], estimate.covariance[1, 1])))
        return math.atan2(east, north), max(math.hypot(east, north, height_m), 1.0), sigma_m

    def _add_range(self, reading: RangeReading) -> None:
        payload = self.payload
        if self.ranges.may_use(reading.source):
            payload.range(reading)
            if payload.is_changed:
                self._follow_payload(reading.time_s)
        if payload.laser_fault and reading.source == self.ranges.chosen:
            return
        if not self.ranges.accepts(reading.source, reading.time_s, lambda: self._measures_track(reading)):
            return
        pointing = reading.sensor_quaternion_wxyz
        # The null rotation is what senders put there who know no better.
        if pointing is not None and pointing != (1.0, 0.0, 0.0, 0.0):
            self._add_gimbal(GimbalReading(reading.time_s, pointing, "body", reading.source))
        self._pairing.add_range(reading)

    def _usable_fix(self, reading: TargetFixReading) -> tuple[Fix, ...]:
        """Return a beacon's fix; a camera's where asked for, or while there is no laser that it may be made from."""
        if reading.source.message in BEACON_MESSAGES:
            sigma_m = self._beacon.sigma_m(reading.time_s, reading.sigma_m)
            return (Fix(reading.time_s, reading.east_m, reading.north_m, sigma_m),)
        laser_speaks = reading.time_s - self.ranges.received_s < self.ranges.silent_after_s
        if laser_speaks and self._settings.fix_source is None:
            return ()
        if not self._fixes.accepts(reading.source, reading.time_s):
            return ()
        time_s = reading.time_s - self._settings.gimbal_latency_s
        return (Fix(time_s, reading.east_m, reading.north_m, reading.sigma_m),)

    def stand_on(self, ground: Ground, angles_alone: bool = True) -> None:
        """Assume, before the first sighting, that the target stands on a ground.

        Lines of sight alone do not count where the gimbal follows the estimate, which would confirm itself.
        """
        self._track.stand_on(ground)
        if angles_alone:
            self._pairing.ground = ground
            self.payload.stand_on(bool(np.ptp(ground.heights_m)), ground.sigma_m)

    @property
    def ends_on_ground(self) -> bool:
        """Whether a line of sight alone counts: it ends on known ground."""
        return self._pairing.ground is not None

    def estimate(self, now_s: float) -> TargetEstimate | None:
        """Return the target predicted to ``now_s``, and of a late payload as it was last seen; None before that."""
        estimate, pairing = self._track.estimate(now_s), self._pairing
        if estimate is None or max(pairing.gimbal_delay_s, pairing.range_delay_s) < _LATE_S:
            return estimate
        return replace(estimate, as_seen=self.last_seen)

    @property
    def last_seen(self) -> TargetEstimate | None:
        """The estimate as of the last sighting; None before the first."""
        return self._track.last_seen

    @property
    def remaining_errors(self) -> Calibration:
        """The errors of sightings, from which a large error of the yaw is already removed."""
        return self._track.calibration

    @property
    def calibration(self) -> Calibration:
        """The estimated errors of the payload, with their standard deviations."""
        known = self.remaining_errors
        if not self._yaw_errors_rad:
            return known
        return replace(known, yaw_bias_rad=wrap_rad(self._known_yaw_error_rad + known.yaw_bias_rad))

    @property
    def range_error(self) -> tuple[float, float]:
        """By what the ranges are multiplied, and their bias after that, m; 0 while it is that of a usual laser."""
        bias_m = 0.0 if self.delays is None else self.delays.range_bias_m
        return self._pairing.range_factor, bias_m if abs(bias_m) > _RANGE_UNEXPECTED_M else 0.0

    @property
    def unexpected_pitch_rad(self) -> float:
        """The gimbal's pitch error, if it is far beyond what the settings expect; else 0."""
        error_rad = self.calibration.pitch_bias_rad
        return error_rad if abs(error_rad) > _PITCH_SIGMAS * self._settings.pitch_bias_sigma_rad else 0.0

    @property
    def unexpected_yaw_rad(self) -> float:
        """The gimbal's yaw error, if it is far beyond what the settings expect; else 0.

        Until the circle changes, a delay looks like it: the standard deviation of the fit shows how far.
        """
        known, fitted = self.calibration, 0.0 if self.delays is None else self.delays.yaw_sigma_rad
        sigma_rad = max(self._settings.yaw_bias_sigma_rad, known.yaw_sigma_rad, fitted)
        limit_rad = max(_YAW_UNEXPECTED_RAD, _YAW_SIGMAS * sigma_rad)
        return known.yaw_bias_rad if abs(known.yaw_bias_rad) > limit_rad else 0.0

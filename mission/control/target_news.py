"""Announcements about the target and errors of the payload, where an unseen target can be, and whether it is one.

Source: docs/how-to/read-the-terminal.md; docs/health.md#the-target-is-not-seen.
"""

from __future__ import annotations

import itertools
import math
import statistics
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from sidelong.estimators.estimate import TargetEstimate, TrackQuality
from sidelong.estimators.filters.biases import Calibration, Delays
from sidelong.estimators.frames import wrap_rad
from sidelong.estimators.sensing.sighting import AnySighting, Sighting, SightingOutcome
from sidelong.estimators.tracking.payload_fit import WrongBearings
from sidelong.estimators.tracking.track import RESTARTED
from sidelong.estimators.tracking.tracker import Tracker
from sidelong.mission.core.events import Announce
from sidelong.mission.core.plan import AircraftState
from sidelong.mission.core.requirement import Requirement
from sidelong.mission.geometry.approach import Reach

# A shorter gap is not announced: lasers often miss for some seconds.
_AFTER_S = 8.0
_DELAY_STEP_S = 0.1  # a smaller change of a delay is not announced
_YAW_STEP_RAD = math.radians(5.0)  # nor of the gimbal's mounting
_YAW_LASTS_S = 30.0
_FACTOR_STEP, _RANGE_STEP_M = 0.05, 10.0
_GROUP, _OBJECTED = 5, 3  # sightings before and after a step, and how many the track's filter has to object to
_GAP_S = 1.5  # after a longer gap, and longer than each group, the filter's gate is too wide for an objection
_STEP_M, _NOISES = 8.0, 2.5  # a smaller step, or one of less than this many sigmas of two sightings, is noise
_OBJECTED_NIS = 6.0  # of two or three measured numbers: beyond it one in ten
_LASTS_S, _AGREE_S = 2.0, 60.0
_JUDGE_S, _SHADOW_S, _SPACED_S, _SHADOW_COUNT = 1.0, 12.0, 0.8, 9
_SHADOW_FLOWN_M, _SHADOW_SHARE, _SHADOW_SPEED_SHARE = 20.0, 0.3, 0.6
_SHADOW_PARTS = 5  # of which one may be outliers


class PayloadNews:
    """Announces the errors of the payload that are corrected: until they are found, the target is elsewhere.

    A yaw error below 35 degrees has to last: that of a target which drives in circles, as the aircraft does, comes
    and goes.
    """

    def __init__(self, tracker: Tracker) -> None:
        self._tracker = tracker
        self._delays_s = tracker.latencies_s  # as announced
        self._range = 1.0, 0.0
        self._yaw_rad, self._yaw_since_s, self._turns = 0.0, math.inf, 0
        self._drift = ""
        self._wrong_bearings: WrongBearings | None = None

    def announce(self, time_s: float) -> tuple[Announce, ...]:
        """Return announcements of the errors that differ clearly from those announced last."""
        texts = [*self._of_delays(self._tracker.delays), *self._of_drift()]
        if not self._tracker.payload.drifts:
            texts += [*self._of_yaw(time_s), *self._of_range()]
        texts += self._of_bearings(self._tracker.payload.wrong_bearings)
        return tuple(Announce(time_s, "sensor", text) for text in texts)

    def _of_delays(self, delays: Delays | None) -> tuple[str, ...]:
        if delays is None:
            return ()
        now_s = delays.gimbal_s, delays.range_s
        if max(abs(now - before) for now, before in zip(now_s, self._delays_s, strict=True)) < _DELAY_STEP_S:
            return ()
        self._delays_s = now_s
        return (f"delays of the payload found and corrected: {delays}",)

    def _of_drift(self) -> tuple[str, ...]:
        before, self._drift = self._drift, self._tracker.payload.drift_news
        return (self._drift,) if self._drift and self._drift != before else ()

    def _of_yaw(self, time_s: float) -> tuple[str, ...]:
        tracker, is_certain = self._tracker, self._tracker.turns != self._turns
        yaw_rad = tracker.calibration.yaw_bias_rad if is_certain else tracker.unexpected_yaw_rad
        limit_rad = _YAW_STEP_RAD if self._yaw_rad else 0.0
        if not is_certain:
            if yaw_rad == 0.0 or abs(wrap_rad(yaw_rad - self._yaw_rad)) <= limit_rad:
                self._yaw_since_s = math.inf
                return ()
            self._yaw_since_s = min(self._yaw_since_s, time_s)
            if time_s - self._yaw_since_s < _YAW_LASTS_S:
                return ()
        self._turns, self._yaw_rad, self._yaw_since_s = tracker.turns, yaw_rad, math.inf
        if abs(yaw_rad) < _YAW_STEP_RAD:
            return ("the gimbal's yaw needs no correction any more",)
        return (
            f"the gimbal's yaw is off by about {math.degrees(yaw_rad):+.0f} degrees, and corrected: check its "
            "mounting and the aircraft's heading, or correct sensors.mount_deg",
        )

    def _of_range(self) -> tuple[str, ...]:
        (then, then_m), (factor, bias_m) = self._range, self._tracker.range_error
        if abs(factor - then) < _FACTOR_STEP and abs(bias_m - then_m) < _RANGE_STEP_M:
            return ()
        self._range = factor, bias_m
        errors = []
        if abs(factor - 1.0) >= _FACTOR_STEP:
            errors.append(f"are about {1.0 / factor:.2f} times the distance")
        if bias_m:
            errors.append(f"are off by about {bias_m:+.0f} m")
        text = " and ".join(errors) + ", and corrected: check its unit and its mounting, and the gimbal's pitch"
        return (f"the laser's ranges {text if errors else 'need no correction any more'}",)

    def _of_bearings(self, wrong: WrongBearings | None) -> tuple[str, ...]:
        before, self._wrong_bearings = self._wrong_bearings, wrong
        if (wrong is None) is (before is None):
            return ()
        text = "are right at all bearings again"
        if wrong is not None:
            text = f"are {wrong}, and left out there: check its window and what is in its path"
        return (f"the laser's ranges {text}",)


@dataclass(frozen=True, eq=False)
class _Seen:
    """One sighting, with what was known of the payload and the aircraft; few of them are looked at closely."""

    time_s: float
    sighting: AnySighting
    calibration: Callable[[], Calibration]
    aircraft_m: tuple[float, float]
    objected: bool  # by the track's filter

    @cached_property
    def place_m(self) -> tuple[float, float]:
        """Where it puts the target, east and north."""
        seen, errors = self.sighting, self.calibration()
        if not isinstance(seen, Sighting):
            return seen.east_m, seen.north_m
        bearing_rad = seen.bearing_rad - errors.yaw_bias_rad
        level_m = (seen.slant_range_m - errors.range_bias_m) * math.cos(seen.depression_rad + errors.pitch_bias_rad)
        east_m, north_m = level_m * math.sin(bearing_rad), level_m * math.cos(bearing_rad)
        return seen.aircraft_east_m + east_m, seen.aircraft_north_m + north_m

    @cached_property
    def sigma_m(self) -> float:
        """Standard deviation of that, over both axes."""
        return math.sqrt(float(self.sighting.covariance.trace()))


def _median(group: Sequence[_Seen], speed_m_s: float, sigma_m: float) -> tuple[tuple[float, float], bool]:
    """Return the median place of a group, and whether nearly all of it is one object of that speed at most."""
    places_m = np.array([one.place_m for one in group])
    east_m, north_m = np.median(places_m, axis=0).tolist()
    far_m = speed_m_s * (group[-1].time_s - group[0].time_s) + _NOISES * sigma_m
    near = np.hypot(places_m[:, 0] - east_m, places_m[:, 1] - north_m) < far_m
    return (east_m, north_m), int(near.sum()) >= _GROUP - 1


def _when_s(group: Sequence[_Seen], end: int) -> float:
    """Return the time of a group's median place; of one with a gap in it, which mixes two times, that of an end."""
    has_gap = any(one.time_s - before.time_s > _GAP_S for before, one in itertools.pairwise(group))
    return group[end if has_gap else _GROUP // 2].time_s


class AnotherObject:
    """Whether the payload may follow another object than the target, by where it sees it.

    Two signs: five sightings lie farther from the five before than a target drives in that time, or the sighted
    position moves as the aircraft does (its own shadow). Both positions then have to be kept clear until the
    sightings agree for a minute, or an operator confirms the object.
    """

    def __init__(self) -> None:
        self.reason = ""  # in words; '' if it is the target
        self.is_shadow = False  # so that it can neither be watched nor be kept clear of
        self._since_s = self._judged_s = -math.inf  # of the last sign, and of the last look at the aircraft's motion
        self._left: tuple[float, Reach] | None = None  # what the payload turned away from, with the time of that
        self._lately: deque[_Seen] = deque(maxlen=2 * _GROUP)
        self._moved: deque[_Seen] = deque()
        # A step that has still to last: its times, where it was before and after it, and the noise of both.
        self._step: tuple[float, float, tuple[float, float], tuple[float, float], float] | None = None
        self._news: list[str] = []

    def note(
        self,
        outcomes: Sequence[SightingOutcome],
        aircraft: AircraftState,
        calibration: Callable[[], Calibration],
        requirement: Requirement,
    ) -> None:
        """Process the outcomes of sightings in the order of their times."""
        speed_m_s = requirement.target_speed_max_m_s
        for outcome in outcomes:
            sighting = outcome.sighting
            objected = not outcome.accepted or outcome.reason == RESTARTED or outcome.nis > _OBJECTED_NIS
            if self._lately and sighting.time_s <= self._lately[-1].time_s:
                continue
            here_m = aircraft.east_m, aircraft.north_m
            seen = _Seen(sighting.time_s, sighting, calibration, here_m, objected)
            self._lately.append(seen)
            if not self._moved or seen.time_s >= self._moved[-1].time_s + _SPACED_S:
                self._moved.append(seen)
            if self._step is None:
                self._look_for_step(speed_m_s)
            elif seen.time_s >= self._step[1] + _LASTS_S:
                self._confirm_step(speed_m_s)
            if seen.time_s >= self._judged_s + _JUDGE_S:
                self._judged_s = seen.time_s
                self._look_for_shadow(seen.time_s, speed_m_s, aircraft.ground_speed_m_s)
            if self.reason and seen.time_s >= self._since_s + _AGREE_S:
                self._end(f"{_AGREE_S:.0f} s without a contradiction")

    def suspect(
        self,
        time_s: float,
        reason: str,
        is_shadow: bool = False,
        left: tuple[float, Reach] | None = None,
    ) -> None:
        """Process a sign that it is another object; left: where the target was last, and when."""
        self._left = self._left or left
        if not self.reason:
            self._news.append(f"{reason}: both positions are kept clear until you confirm what is seen")
        self.reason, self.is_shadow, self._since_s = reason, is_shadow, time_s

    def explain(self, why: str) -> None:
        """Take what is seen for the target, and judge it by what is seen from now on."""
        if self.reason:
            self._end(why)
        self._lately.clear()
        self._moved.clear()
        self._step = None

    def _end(self, why: str) -> None:
        self._news.append(f"what is seen is taken as the target: {why}")
        self.reason, self._left, self.is_shadow = "", None, False
        self._lately.clear()

    def left(self, time_s: float) -> Reach | None:
        """Return where the object is that the payload turned away from; None if it did not, or it is over."""
        return None if self._left is None else self._left[1].after(time_s - self._left[0])

    def announce(self, time_s: float) -> tuple[Announce, ...]:
        """Return what is new."""
        news, self._news = self._news, []
        return tuple(Announce(time_s, "track", text) for text in news)

    def _look_for_step(self, speed_m_s: float) -> None:
        if len(self._lately) < 2 * _GROUP:
            return
        lately = list(self._lately)
        before, after = lately[:_GROUP], lately[_GROUP:]
        gap_s = after[0].time_s - before[-1].time_s
        if gap_s < _GAP_S or gap_s < max(one[-1].time_s - one[0].time_s for one in (before, after)):
            objected = 0
            for one in after:  # nearly always none
                objected += one.objected
            if objected < _OBJECTED:
                return
        sigma_m = math.hypot(before[-1].sigma_m, after[0].sigma_m)
        (left_m, is_left_one), (now_m, is_now_one) = (_median(group, speed_m_s, sigma_m) for group in (before, after))
        step_m, since_s = math.dist(left_m, now_m), _when_s(after, -1) - _when_s(before, 0)
        if not (is_left_one and is_now_one) or step_m - speed_m_s * since_s < max(_STEP_M, _NOISES * sigma_m):
            return
        self._step = before[-1].time_s, after[0].time_s, left_m, now_m, sigma_m

    def _confirm_step(self, speed_m_s: float) -> None:
        """Take a step as one if the sightings are still there: a hedge or dust hides the target for moments."""
        assert self._step is not None
        (left_s, now_s, left_m, now_m, sigma_m), self._step = self._step, None
        lately = list(self._lately)[-_GROUP:]
        there_m, _ = _median(lately, speed_m_s, sigma_m)
        self._lately.clear()
        self._lately.extend(lately)
        if math.dist(there_m, left_m) < math.dist(there_m, now_m):
            return
        step_m, known = math.dist(left_m, now_m), self.left(now_s)
        is_back = known is not None and known.holds(*now_m, _STEP_M)
        if known is None or is_back:  # else it is still where it was seen before the first doubt
            self._left = left_s, Reach(*left_m, 2.0 * sigma_m, speed_m_s)
        verb = "jumped back" if is_back else "jumped"
        reason = f"the payload may follow another object: what it sees {verb} by {step_m:.0f} m"
        self.suspect(lately[-1].time_s, reason)

    def _look_for_shadow(self, now_s: float, speed_m_s: float, ground_speed_m_s: float) -> None:
        while self._moved[0].time_s < now_s - _SHADOW_S:
            self._moved.popleft()
        if now_s - self._moved[0].time_s < 0.8 * _SHADOW_S or len(self._moved) < _SHADOW_COUNT:
            return
        if speed_m_s > _SHADOW_SPEED_SHARE * ground_speed_m_s:
            return  # a target of that speed can drive as the aircraft flies
        # Plain numbers: arrays of a dozen positions cost ten times as much.
        moved = self._moved
        own_east_m, own_north_m = [one.aircraft_m[0] for one in moved], [one.aircraft_m[1] for one in moved]
        apart_east_m = [one.place_m[0] - one.aircraft_m[0] for one in moved]
        apart_north_m = [one.place_m[1] - one.aircraft_m[1] for one in moved]
        east_m, north_m = statistics.median(apart_east_m), statistics.median(apart_north_m)
        differs_m2 = [
            (east - east_m) ** 2 + (north - north_m) ** 2
            for east, north in zip(apart_east_m, apart_north_m, strict=True)
        ]
        # The distance that one part of them exceeds, between the two next to it.
        ordered = sorted(differs_m2)
        at, share = divmod((_SHADOW_PARTS - 1) * (len(ordered) - 1), _SHADOW_PARTS)
        below_m, above_m = math.sqrt(ordered[at]), math.sqrt(ordered[at + 1])
        limit_m = below_m + (above_m - below_m) * share / _SHADOW_PARTS
        diagonal_m = math.hypot(max(own_east_m) - min(own_east_m), max(own_north_m) - min(own_north_m))
        if limit_m >= _SHADOW_SHARE * 0.5 * diagonal_m:
            return  # as nearly always: no positions within a box lie farther from their mean
        # The motion that rests on the others may be that of one outlier.
        kept_m = [
            one.aircraft_m for one, off_m2 in zip(moved, differs_m2, strict=True) if math.sqrt(off_m2) <= limit_m
        ]
        mean_m = [statistics.fmean(axis_m) for axis_m in zip(*kept_m, strict=True)]
        flown_m = math.sqrt(statistics.fmean([math.dist(own, mean_m) ** 2 for own in kept_m]))
        if flown_m > _SHADOW_FLOWN_M and limit_m < _SHADOW_SHARE * flown_m:
            first = self._moved[0]
            left = first.time_s, Reach(*first.place_m, 2.0 * first.sigma_m, speed_m_s)
            reason = "the payload may follow another object: what it sees moves with the aircraft, as its shadow"
            self.suspect(now_s, reason, is_shadow=True, left=left)


class TargetNews:
    """Announces when the target comes in sight or out of it, and when it is lost."""

    def __init__(self) -> None:
        self._announced = ""

    def announce(self, time_s: float, estimate: TargetEstimate) -> tuple[Announce, ...]:
        """Return what has changed since the last announcement."""
        unseen_s = time_s - estimate.last_sighting_s
        sight = "unseen" if unseen_s > _AFTER_S else "seen"
        if estimate.quality is TrackQuality.LOST:
            sight = "lost"
        before, self._announced = self._announced, sight
        if sight == before:
            return ()
        texts = {
            "seen": "the target is in sight" + (" again" if before else ""),
            "unseen": f"the target has not been seen for {unseen_s:.0f} s; its track goes on by its last motion",
            "lost": f"the target is lost: {estimate.reason or f'not seen for {unseen_s:.0f} s'}; searching for it",
        }
        return (Announce(time_s, "track", texts[sight]),)


BLIND_S = 20.0  # longer than a laser or a beacon misses
_PROBATION_S = 8.0  # a payload that reports a wrong target is found out within this time
# As 72 recorded targets move within 20 to 300 s: they keep their course for this time, and the error of a position
# predicted so has this share of the distance at the target's mean speed as the standard deviation of each axis.
_COURSE_LASTS_S, _WAY_SHARE = 180.0, 0.42
_SPEED_OVER_S, _LEAST_SPEED_SHARE = 60.0, 0.2  # a target that stands may start: a share of its highest speed
_SIGMAS_95 = 2.448  # radius of the disk that contains 95 % of a Gaussian of two axes


class UnseenTarget:
    """Where the target can be while it is not seen."""

    def __init__(self, tracker: Tracker) -> None:
        self._tracker = tracker
        self._lost_s = -math.inf  # when the track was lost, last
        self._last: tuple[float, Reach] | None = None  # with the time that it holds for
        self._speed_m_s, self._noted_s = math.inf, -math.inf  # the target's, averaged while it is seen

    def note(self, estimate: TargetEstimate, speed_max_m_s: float) -> None:
        """Process the estimate of a target that is seen: its mean speed is what it may go on with."""
        self._speed_m_s = min(self._speed_m_s, speed_max_m_s)
        new = 1.0 - math.exp(-min(estimate.time_s - self._noted_s, BLIND_S) / _SPEED_OVER_S)
        self._speed_m_s += new * (estimate.speed_m_s - self._speed_m_s)
        self._noted_s = estimate.time_s

    def predicted(self, estimate: TargetEstimate, speed_max_m_s: float, lost_after_s: float) -> TargetEstimate:
        """Return the estimate of a target that is unseen for long, as recorded targets have moved on.

        The filter's own covariance grows as if each push of its motion model lasted.
        """
        unseen_s, seen = estimate.time_s - estimate.last_sighting_s, self._tracker.last_seen
        if seen is None or seen.last_sighting_s != estimate.last_sighting_s:  # by another aircraft of the fleet
            return estimate
        kept = math.exp(-unseen_s / _COURSE_LASTS_S)
        ahead_s = _COURSE_LASTS_S * (1.0 - kept)
        velocity_m_s = seen.velocity_east_m_s, seen.velocity_north_m_s
        usual_m_s = max(seen.speed_m_s, self._speed_m_s)  # infinite if it came out of sight before the first decision
        speed_m_s = max(min(usual_m_s, speed_max_m_s), _LEAST_SPEED_SHARE * speed_max_m_s)
        variance_m2 = 0.5 * float(seen.covariance[:2, :2].trace()) + (_WAY_SHARE * speed_m_s * unseen_s) ** 2
        return replace(
            estimate,
            east_m=seen.east_m + velocity_m_s[0] * ahead_s,
            north_m=seen.north_m + velocity_m_s[1] * ahead_s,
            velocity_east_m_s=velocity_m_s[0] * kept,
            velocity_north_m_s=velocity_m_s[1] * kept,
            covariance=np.diag([variance_m2] * 2 + [(_WAY_SHARE * speed_m_s) ** 2] * 2),
            quality=TrackQuality.LOST if unseen_s > lost_after_s else TrackQuality.COASTING,
            reason=f"no sighting for {unseen_s:.0f} s",
        )

    @staticmethod
    def density(predicted: TargetEstimate) -> Reach:
        """Return the disk that contains a target as it is predicted with 95 % probability."""
        radius_m = _SIGMAS_95 * math.sqrt(float(predicted.covariance[0, 0]))
        speed_m_s = _SIGMAS_95 * math.sqrt(float(predicted.covariance[2, 2]))
        velocity_m_s = predicted.velocity_east_m_s, predicted.velocity_north_m_s
        return Reach(predicted.east_m, predicted.north_m, radius_m, speed_m_s, velocity_m_s)

    def reach(self, now_s: float, estimate: TargetEstimate, fault: bool, speed_max_m_s: float) -> Reach | None:
        """Return where the target can be, None while it is seen; estimate: as :meth:`predicted`.

        A track that begins again may be a wrong one: it counts only some seconds later. With a fault of laser or
        gimbal the target can be wherever it can have gone.
        """
        unseen_s = now_s - estimate.last_sighting_s
        if estimate.quality is TrackQuality.LOST:
            self._lost_s = now_s
        if unseen_s <= BLIND_S and not fault:
            if now_s - self._lost_s >= _PROBATION_S or self._last is None:
                self._last = None
                return None
            since_s, reach = self._last
            return reach.after(now_s - since_s)
        if not fault:
            self._last = now_s, self.density(estimate)
            return self._last[1]
        speed_m_s = max(speed_max_m_s, estimate.speed_m_s)
        seen = self._tracker.last_seen
        if seen is not None and seen.last_sighting_s == estimate.last_sighting_s:
            east_m, north_m = seen.east_m, seen.north_m
            sigma_m = math.sqrt(max(seen.covariance[0, 0], seen.covariance[1, 1]))
        else:  # the fleet's estimate
            east_m = estimate.east_m - unseen_s * estimate.velocity_east_m_s
            north_m = estimate.north_m - unseen_s * estimate.velocity_north_m_s
            sigma_m = 0.0
        reach = Reach(east_m, north_m, 2.0 * sigma_m + speed_m_s * unseen_s, speed_m_s)
        self._last = now_s, reach
        return reach

"""Announcements about the target and errors of the payload, and where a target that is not seen can be.

Source: docs/how-to/read-the-terminal.md; docs/health.md#the-target-is-not-seen.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from enum import StrEnum

from sidelong.estimators.estimate import TargetEstimate, TrackQuality
from sidelong.estimators.filters.biases import Delays
from sidelong.estimators.frames import wrap_rad
from sidelong.estimators.sensing.sighting import SightingOutcome
from sidelong.estimators.tracking.track import RESTARTED
from sidelong.estimators.tracking.tracker import Tracker
from sidelong.mission.core.events import Announce
from sidelong.mission.geometry.retreat import Reach

# A shorter gap is not announced: lasers often miss for some seconds.
_AFTER_S = 8.0
_DELAY_STEP_S = 0.1  # a smaller change of a delay is not announced
_YAW_STEP_RAD = math.radians(5.0)  # nor of the gimbal's mounting
_YAW_LASTS_S = 30.0
_FACTOR_STEP, _RANGE_STEP_M = 0.05, 10.0
_JUMP_M = 30.0


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

    def announce(self, time_s: float) -> tuple[Announce, ...]:
        """Return announcements of the errors that differ clearly from those announced last.

        Args:
            time_s: Time on the vehicle's clock, s.
        """
        texts = [*self._of_delays(self._tracker.delays), *self._of_yaw(time_s), *self._of_range()]
        return tuple(Announce(time_s, "sensor", text) for text in texts)

    def _of_delays(self, delays: Delays | None) -> tuple[str, ...]:
        if delays is None:
            return ()
        now_s = delays.gimbal_s, delays.range_s
        if max(abs(now - before) for now, before in zip(now_s, self._delays_s, strict=True)) < _DELAY_STEP_S:
            return ()
        self._delays_s = now_s
        return (f"delays of the payload found and corrected: {delays}",)

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


class JumpNews:
    """Announces that the track has moved elsewhere: the payload may follow another target."""

    def __init__(self) -> None:
        self._restarted = False

    def note(self, outcomes: Sequence[SightingOutcome]) -> None:
        """Process the outcomes of sightings."""
        for outcome in outcomes:
            self._restarted |= outcome.reason == RESTARTED

    def announce(
        self, time_s: float, before: TargetEstimate | None, estimate: TargetEstimate | None
    ) -> tuple[Announce, ...]:
        """Return an announcement if the track has moved elsewhere since the last call.

        Args:
            time_s: Time on the vehicle's clock, s.
            before: Estimate at the last call.
            estimate: Present estimate.
        """
        restarted, self._restarted = self._restarted, False
        if not restarted or before is None or estimate is None:
            return ()
        jump_m = math.hypot(estimate.east_m - before.east_m, estimate.north_m - before.north_m)
        if jump_m < _JUMP_M:
            return ()
        text = f"the target's position jumped by {jump_m:.0f} m: check that the payload follows the right target"
        return (Announce(time_s, "track", text),)


class _Sight(StrEnum):
    SEEN = "seen"
    UNSEEN = "unseen"
    LOST = "lost"


class TargetNews:
    """Keeps the latest announcement."""

    def __init__(self) -> None:
        self._announced: _Sight | None = None

    def announce(self, time_s: float, estimate: TargetEstimate) -> tuple[Announce, ...]:
        """Announce changes of the target.

        Args:
            time_s: Time on the vehicle's clock, s.
            estimate: Estimate of the target.

        Returns:
            New announcements; empty if nothing has changed.
        """
        unseen_s = time_s - estimate.last_sighting_s
        sight = _Sight.SEEN
        if estimate.quality is TrackQuality.LOST:
            sight = _Sight.LOST
        elif unseen_s > _AFTER_S:
            sight = _Sight.UNSEEN
        before, self._announced = self._announced, sight
        if sight is before:
            return ()
        match sight:
            case _Sight.SEEN:
                text = "the target is in sight" + (" again" if before is not None else "")
            case _Sight.UNSEEN:
                text = f"the target has not been seen for {unseen_s:.0f} s; its track goes on by its last motion"
            case _Sight.LOST:
                text = (
                    f"the target is lost: {estimate.reason or f'not seen for {unseen_s:.0f} s'}; holding the circle"
                )
        return (Announce(time_s, "track", text),)


_BLIND_S = 20.0  # longer than a laser or a beacon misses
_PROBATION_S = 8.0  # a payload that reports a wrong target is found out within this time


class UnseenTarget:
    """Follows the track of one flight."""

    def __init__(self, tracker: Tracker) -> None:
        self._tracker = tracker
        self._lost_s = -math.inf  # when the track was lost, last
        self._last: tuple[float, Reach] | None = None  # with the time that it holds for

    def reach(self, now_s: float, estimate: TargetEstimate, fault: bool, speed_max_m_s: float) -> Reach | None:
        """Return where the target can be, None while it is seen and the payload's errors are known.

        A track that begins again may be a wrong one: it counts only some seconds later.

        Args:
            now_s: The vehicle's clock.
            estimate: Of the target.
            fault: Whether laser or gimbal have a fault: their silence then is no mere gap.
            speed_max_m_s: The target's highest speed.
        """
        unseen_s = now_s - estimate.last_sighting_s
        if estimate.quality is TrackQuality.LOST:
            self._lost_s = now_s
        if unseen_s <= _BLIND_S and not fault:
            if now_s - self._lost_s >= _PROBATION_S or self._last is None:
                self._last = None
                wander_m = self._tracker.payload.wander_m(now_s)
                return Reach(estimate.east_m, estimate.north_m, wander_m, estimate.speed_m_s) if wander_m else None
            since_s, reach = self._last
            return reach.after(now_s - since_s)
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

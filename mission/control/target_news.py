"""Announcements about the target and errors of the payload. Source: docs/how-to/read-the-terminal.md."""

from __future__ import annotations

import math
from collections.abc import Sequence
from enum import StrEnum

from sidelong.estimators.estimate import TargetEstimate, TrackQuality
from sidelong.estimators.filters.biases import Delays
from sidelong.estimators.frames import wrap_rad
from sidelong.estimators.sensing.sighting import SightingOutcome
from sidelong.estimators.tracking.track import RESTARTED
from sidelong.mission.core.events import Announce

# A shorter gap is not announced: lasers often miss for some seconds.
_AFTER_S = 8.0
_DELAY_STEP_S = 0.1  # a smaller change of a delay is not announced
_YAW_STEP_RAD = math.radians(5.0)  # nor of the gimbal's mounting
_YAW_LASTS_S = 30.0
_FACTOR_STEP, _RANGE_STEP_M = 0.05, 10.0
_JUMP_M = 30.0


class DelayNews:
    """Announces the estimated delays of the payload; ``latencies_s``: of gimbal and laser, as configured."""

    def __init__(self, latencies_s: tuple[float, float]) -> None:
        self._announced_s = latencies_s

    def announce(self, time_s: float, delays: Delays | None) -> tuple[Announce, ...]:
        """Return an announcement if a delay differs clearly from the one that was announced last.

        Args:
            time_s: Time on the vehicle's clock, s.
            delays: Estimated delays of the payload; None while unknown.
        """
        if delays is None:
            return ()
        now_s = delays.gimbal_s, delays.range_s
        if max(abs(now - before) for now, before in zip(now_s, self._announced_s, strict=True)) < _DELAY_STEP_S:
            return ()
        self._announced_s = now_s
        return (Announce(time_s, "sensor", f"delays of the payload found and corrected: {delays}"),)


class MountNews:
    """Announces a yaw error of the gimbal that no setting expects: until it is found, the target is elsewhere.

    The error has to last: that of a target which drives in circles, as the aircraft does, comes and goes.
    """

    def __init__(self) -> None:
        self._announced_rad = 0.0
        self._since_s = math.inf

    def announce(self, time_s: float, yaw_rad: float) -> tuple[Announce, ...]:
        """Return an announcement if the error differs clearly from the one that was announced last.

        Args:
            time_s: Time on the vehicle's clock, s.
            yaw_rad: The error beyond what is expected; 0: none.
        """
        limit_rad = _YAW_STEP_RAD if self._announced_rad else 0.0
        if yaw_rad == 0.0 or abs(wrap_rad(yaw_rad - self._announced_rad)) <= limit_rad:
            self._since_s = math.inf
            return ()
        self._since_s = min(self._since_s, time_s)
        return () if time_s - self._since_s < _YAW_LASTS_S else (self.found(time_s, yaw_rad),)

    def found(self, time_s: float, yaw_rad: float) -> Announce:
        """Return the announcement of an error that is certain.

        Args:
            time_s: Time on the vehicle's clock, s.
            yaw_rad: The error.
        """
        self._announced_rad, self._since_s = yaw_rad, math.inf
        if abs(yaw_rad) < _YAW_STEP_RAD:
            return Announce(time_s, "sensor", "the gimbal's yaw needs no correction any more")
        text = f"the gimbal's yaw is off by about {math.degrees(yaw_rad):+.0f} degrees, and corrected: check its "
        text += "mounting and the aircraft's heading, or correct sensors.mount_deg"
        return Announce(time_s, "sensor", text)


class RangeNews:
    """Announces large errors of the laser, which are corrected: until they are found, the target is elsewhere."""

    def __init__(self) -> None:
        self._announced = 1.0, 0.0

    def announce(self, time_s: float, factor: float, bias_m: float) -> tuple[Announce, ...]:
        """Return an announcement if the errors differ clearly from those that were announced last.

        Args:
            time_s: Time on the vehicle's clock, s.
            factor: By what the ranges are multiplied.
            bias_m: Their bias after that, m.
        """
        then, then_m = self._announced
        if abs(factor - then) < _FACTOR_STEP and abs(bias_m - then_m) < _RANGE_STEP_M:
            return ()
        self._announced = factor, bias_m
        errors = []
        if abs(factor - 1.0) >= _FACTOR_STEP:
            errors.append(f"are about {1.0 / factor:.2f} times the distance")
        if bias_m:
            errors.append(f"are off by about {bias_m:+.0f} m")
        text = " and ".join(errors) + ", and corrected: check its unit and its mounting, and the gimbal's pitch"
        return (
            Announce(time_s, "sensor", f"the laser's ranges {text if errors else 'need no correction any more'}"),
        )


class JumpNews:
    """Announces that the track has moved elsewhere: the payload may follow another target."""

    def __init__(self) -> None:
        self._restarted = False

    def note(self, outcomes: Sequence[SightingOutcome]) -> None:
        """Process the outcomes of sightings."""
        self._restarted |= any(one.reason == RESTARTED for one in outcomes)

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

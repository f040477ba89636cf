"""Kinematic plausibility check of the aircraft's own position.

A reading is accepted when the aircraft can have flown there from the last accepted one. The reference is dead
reckoning; the tolerance is the acceleration that is possible in the time between them. A rejected reading is replaced
by dead reckoning. It uses the reported velocity if that continues the last one, else the last velocity turned by the
bank angle. If the last accepted reading was the outlier, readings that follow from the one before it are accepted.
A new position that persists for ``_PROOF_S`` while GPS and EKF report no fault is accepted.
Positions that alternate between two places come from two vehicles. The way between positions has to be that of the
reported velocities, which the estimation interpolates with.

Source: docs/explanation/input-checks.md#plausibility.
"""

from __future__ import annotations

import math
from dataclasses import replace

from sidelong.estimators.sensing.readings import PositionReading
from sidelong.mission.core.requirement import GRAVITY_M_S2

_SLACK_M, _ACCELERATION_M_S2 = 15.0, 8.0
_GUST_M_S = 15.0
_DRIFT_M_S, _DRIFTING_MAX_S = 3.0, 10.0  # of dead reckoning
_VELOCITY_SLACK_M_S, _VELOCITY_RATE_M_S2 = 6.0, 15.0
_CLIMB_SLACK_M, _CLIMB_RATE_M_S = 20.0, 10.0
_PROOF_S = 15.0
SILENT_S = 3.0
"""Gap between two readings above which the next one counts as received after a telemetry gap."""
_CIRCLING_RAD, _OFF_CIRCLE_M = math.radians(12.0), 60.0
_ODD_S = 1.0  # an accepted reading may prove to be an outlier within this time after the one before it
_FLYING_M_S = 5.0
_SETTLED = 5  # consecutive readings before the reference position counts as reliable
_COMPARED_S, _COMPARED_SLACK_M, _COMPARED_SHARE, _OFF_MAX = 2.0, 8.0, 0.4, 4
_TURNS_MAX, _TURN_MAX_S, _SLOW_TURNS_MAX, _SLOW_TURN_MAX_S = 20, 0.5, 8, 3.0


class PositionCheck:
    """State of the position check.

    Attributes:
        accepted: The latest accepted or dead-reckoned position; None before the first one.
        rejected_since_s: Since when readings have been rejected (vehicle's clock); None while they are accepted.
        jump_m: How far the first rejected reading was from the reference.
        jump: What the first rejected reading contradicts, in words.
        two_places_m: Distance of two alternating positions; None while there is one position.
        slow_places_m: The same, if the second position is received seldom.
    """

    def __init__(self) -> None:
        self.accepted: PositionReading | None = None
        self._before: PositionReading | None = None  # the accepted reading before the latest one
        self.rejected_since_s: float | None = None
        self.jump_m, self.jump = 0.0, ""
        self.two_places_m: float | None = None
        self.slow_places_m: float | None = None
        self._slow_turns = 0
        self._readings = 0
        self._elsewhere: PositionReading | None = None
        self._elsewhere_since_s, self._elsewhere_count = 0.0, 0
        self._turns = 0
        self._drifted_m = 0.0

    def allow(self, drifted_m: float) -> None:
        """Increase the tolerance of the next reading: recent positions may have drifted."""
        self._drifted_m = drifted_m

    def shift(self, seconds: float) -> None:
        """Follow a jump of the vehicle's clock."""
        if self.accepted is not None:
            self.accepted = replace(self.accepted, time_s=self.accepted.time_s + seconds)
        self._before = None
        if self.rejected_since_s is not None:
            self.rejected_since_s += seconds
            self._elsewhere_since_s += seconds

    def stayed(self, place: PositionReading, passed_s: float, *, jumped: bool) -> bool:
        """Return whether the aircraft has moved no farther than ``passed_s`` allows, whatever its time stamps say.

        Args:
            place: The reported position.
            passed_s: Elapsed time.
            jumped: Whether rejected readings are jumps. They may continue or return; neither is flown motion.
        """
        places = (self.accepted, self._elsewhere if jumped and self.rejected_since_s is not None else None)
        return any(one is not None and _stayed(one, place, passed_s) for one in places)

    def take(
        self, reading: PositionReading, bank_rad: float, *, possible: bool, sound: bool
    ) -> PositionReading | None:
        """Return the reading, or dead reckoning in its place; None for a late reading that is not plausible.

        Args:
            reading: The reported position.
            bank_rad: The aircraft's present bank angle.
            possible: Whether the reading is within the absolute limits.
            sound: Whether GPS and EKF report no fault.
        """
        last = self.accepted
        if last is None:
            return self._accept(reading)
        step_s = reading.time_s - last.time_s
        if step_s <= 0.0:
            return (
                reading
                if possible and self.rejected_since_s is None and self._follows(last, reading, bank_rad)
                else None
            )
        before = self._before
        after_odd_one = (
            before is not None and reading.time_s - before.time_s <= _ODD_S and _reachable(before, reading, 0.0)
        )
        if possible and (after_odd_one or self._follows(last, reading, bank_rad)):
            return self._accept(reading)
        self._note_elsewhere(last, reading)
        proven = sound and reading.time_s - self._elsewhere_since_s >= _PROOF_S
        unsettled = self._readings < _SETTLED and self._elsewhere_count > self._readings
        if possible and (unsettled or proven):
            self._readings = self._elsewhere_count - 1
            return self._accept(reading)
        reckoned = _dead_reckoned(last, reading, bank_rad)
        self.accepted = reckoned
        return reckoned

    def _accept(self, reading: PositionReading) -> PositionReading:
        self._before = self.accepted if self.rejected_since_s is None else None
        self.accepted, self.rejected_since_s, self._drifted_m = reading, None, 0.0
        self._readings += 1
        return reading

    def _note_elsewhere(self, last: PositionReading, reading: PositionReading) -> None:
        before = self._elsewhere
        agrees = before is not None and _reachable(before, reading, 0.0)
        if self.rejected_since_s is None:
            # After a longer gap a rejected position cannot be explained by drift of dead reckoning.
            self.rejected_since_s = max(last.time_s, reading.time_s - _DRIFTING_MAX_S)
            self.jump_m = math.hypot(reading.east_m - last.east_m, reading.north_m - last.north_m)
            self.jump = _jump(last, reading, self.jump_m)
            in_turn = before is not None and reading.time_s - before.time_s < _TURN_MAX_S
            self._turns = self._turns + 1 if agrees and in_turn else 0
            slowly = before is not None and reading.time_s - before.time_s < _SLOW_TURN_MAX_S
            self._slow_turns = self._slow_turns + 1 if agrees and slowly else 0
            if self._slow_turns >= _SLOW_TURNS_MAX:
                self.slow_places_m = self.jump_m
            if self._turns >= _TURNS_MAX:
                self.two_places_m = self.jump_m
            self._elsewhere_since_s = reading.time_s
        elif not agrees:
            self._elsewhere_since_s = reading.time_s
        self._elsewhere_count = self._elsewhere_count + 1 if agrees else 1
        self._elsewhere = reading

    def _follows(self, last: PositionReading, reading: PositionReading, bank_rad: float) -> bool:
        reckoned_for_s = 0.0 if self.rejected_since_s is None else last.time_s - self.rejected_since_s
        return _reachable(last, reading, reckoned_for_s + self._drifted_m / _DRIFT_M_S) and (
            reading.time_s - last.time_s <= SILENT_S or _still_circles(last, reading, bank_rad)
        )


class VelocityCheck:
    """Compares the way between reported positions with the reported velocities, over ``_COMPARED_S`` at a time.

    Attributes:
        fault: How they contradict each other; empty while they agree.
    """

    def __init__(self) -> None:
        self.fault = ""
        self._since: PositionReading | None = None
        self._last: PositionReading | None = None
        self._flown_m = 0.0, 0.0  # by the velocities
        self._off = 0

    def take(self, reading: PositionReading) -> None:
        """Process a reading as it was reported."""
        since, last, self._last = self._since, self._last, reading
        if since is None or last is None or not 0.0 <= reading.time_s - last.time_s <= SILENT_S:
            self._since, self._flown_m = reading, (0.0, 0.0)
            return
        half_s = 0.5 * (reading.time_s - last.time_s)
        east_m = self._flown_m[0] + half_s * (last.velocity_east_m_s + reading.velocity_east_m_s)
        north_m = self._flown_m[1] + half_s * (last.velocity_north_m_s + reading.velocity_north_m_s)
        self._flown_m = east_m, north_m
        if reading.time_s - since.time_s < _COMPARED_S:
            return
        moved_m = reading.east_m - since.east_m, reading.north_m - since.north_m
        limit_m = _COMPARED_SLACK_M + _COMPARED_SHARE * max(math.hypot(*moved_m), math.hypot(east_m, north_m))
        self._off = self._off + 1 if math.dist(moved_m, self._flown_m) > limit_m else self._off - 1
        self._off = min(max(self._off, 0), _OFF_MAX)
        if self._off == _OFF_MAX:
            self.fault = "it moves otherwise than the reported velocity: check the autopilot and what feeds its EKF"
        elif self._off == 0:
            self.fault = ""
        self._since, self._flown_m = reading, (0.0, 0.0)


def _stayed(last: PositionReading, place: PositionReading, passed_s: float) -> bool:
    if math.hypot(last.velocity_east_m_s, last.velocity_north_m_s) < _FLYING_M_S:
        return False  # at rest the position shows no elapsed time
    moved_m = math.hypot(place.east_m - last.east_m, place.north_m - last.north_m)
    return moved_m < _SLACK_M + math.hypot(place.velocity_east_m_s, place.velocity_north_m_s) * passed_s


def _reachable(last: PositionReading, reading: PositionReading, reckoned_for_s: float) -> bool:
    """Return whether ``reading`` is kinematically reachable from ``last``.

    ``reckoned_for_s`` is how long ``last`` has been dead reckoned.
    """
    step_s = reading.time_s - last.time_s
    speed_m_s = math.hypot(last.velocity_east_m_s, last.velocity_north_m_s)
    off_m = math.hypot(
        reading.east_m - last.east_m - last.velocity_east_m_s * step_s,
        reading.north_m - last.north_m - last.velocity_north_m_s * step_s,
    )
    turned_m = min(0.5 * _ACCELERATION_M_S2 * step_s**2, (2.0 * speed_m_s + _GUST_M_S) * abs(step_s))
    if off_m > _SLACK_M + turned_m + _DRIFT_M_S * reckoned_for_s:
        return False
    climbed_m = reading.height_m - last.height_m - last.velocity_up_m_s * step_s
    if abs(climbed_m) > _CLIMB_SLACK_M + _CLIMB_RATE_M_S * (abs(step_s) + reckoned_for_s):
        return False
    return _velocity_follows(last, reading, speed_m_s, reckoned_for_s)


def _jump(last: PositionReading, reading: PositionReading, jump_m: float) -> str:
    """Return which of position, height and velocity has jumped, in words."""
    step_s = reading.time_s - last.time_s
    climbed_m = abs(reading.height_m - last.height_m - last.velocity_up_m_s * step_s)
    speed_m_s = math.hypot(last.velocity_east_m_s, last.velocity_north_m_s)
    if jump_m > _SLACK_M + speed_m_s * abs(step_s):
        return f"the position jumped by {length(jump_m)}"
    if climbed_m > _CLIMB_SLACK_M:
        return f"the height jumped by {length(climbed_m)}"
    if not _velocity_follows(last, reading, speed_m_s, 0.0):
        changed_m_s = math.hypot(
            reading.velocity_east_m_s - last.velocity_east_m_s, reading.velocity_north_m_s - last.velocity_north_m_s
        )
        return f"the velocity jumped by {changed_m_s:.0f} m/s"
    return f"the position jumped by {length(jump_m)}"


def length(metres: float) -> str:
    """Return a distance in words."""
    return f"{metres:.0f} m" if metres < 10_000.0 else f"{metres / 1000.0:.0f} km"


def _still_circles(last: PositionReading, reading: PositionReading, bank_rad: float) -> bool:
    """Return whether a position received after a telemetry gap is on the circle that was flown.

    If the aircraft was not turning, return True. The autopilot flies such a circle without commands.
    """
    if abs(bank_rad) < _CIRCLING_RAD:
        return True
    speed_m_s = math.hypot(last.velocity_east_m_s, last.velocity_north_m_s)
    radius_m = speed_m_s**2 / (GRAVITY_M_S2 * math.tan(abs(bank_rad)))
    moved_m = math.hypot(reading.east_m - last.east_m, reading.north_m - last.north_m)
    return moved_m <= 2.0 * radius_m + _OFF_CIRCLE_M


def _velocity_follows(
    last: PositionReading, reading: PositionReading, speed_m_s: float, reckoned_for_s: float
) -> bool:
    changed_m_s = math.hypot(
        reading.velocity_east_m_s - last.velocity_east_m_s, reading.velocity_north_m_s - last.velocity_north_m_s
    )
    possible_m_s = _VELOCITY_SLACK_M_S + _VELOCITY_RATE_M_S2 * abs(reading.time_s - last.time_s)
    return changed_m_s <= min(possible_m_s, 2.0 * speed_m_s + _GUST_M_S) + _DRIFT_M_S * reckoned_for_s


def _dead_reckoned(last: PositionReading, announced: PositionReading, bank_rad: float) -> PositionReading:
    """Return the dead-reckoned position at the time of a rejected reading."""
    step_s = announced.time_s - last.time_s
    east_m_s, north_m_s = last.velocity_east_m_s, last.velocity_north_m_s
    speed_m_s = math.hypot(east_m_s, north_m_s)
    if _velocity_follows(last, announced, speed_m_s, 0.0):
        now_east_m_s, now_north_m_s = announced.velocity_east_m_s, announced.velocity_north_m_s
    else:
        turned_rad = GRAVITY_M_S2 * math.tan(bank_rad) / max(speed_m_s, 5.0) * step_s
        sin_t, cos_t = math.sin(turned_rad), math.cos(turned_rad)
        now_east_m_s = east_m_s * cos_t + north_m_s * sin_t
        now_north_m_s = north_m_s * cos_t - east_m_s * sin_t
    return replace(
        last,
        time_s=announced.time_s,
        east_m=last.east_m + 0.5 * (east_m_s + now_east_m_s) * step_s,
        north_m=last.north_m + 0.5 * (north_m_s + now_north_m_s) * step_s,
        velocity_east_m_s=now_east_m_s,
        velocity_north_m_s=now_north_m_s,
        velocity_up_m_s=0.0,
    )

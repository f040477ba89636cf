"""Input plausibility monitor: checks vehicle and payload data before any decision uses them.

1. The vehicle's clock follows the vehicle's time stamps (:class:`sidelong.estimators.sensing.clock.VehicleClock`).
   While another clock is not confirmed, no payload data is used. One that restarts at zero means that the autopilot
   rebooted: Yield. If the reboot was some seconds ago, the aircraft has moved since.
2. The aircraft's position must be kinematically plausible (:class:`PositionCheck`). After ``BRIDGED_S`` of dead
   reckoning, or of a GPS or EKF fault, ``doubt`` is set: the aircraft holds its circle and nothing is decided. No new
   plan begins from the first fault on. If the clock stood still or was replaced, dead reckoning is not possible.
   After a telemetry gap the position may have drifted, and GPS and EKF report faults about a second late. So no plan
   begins and no detection is used until GPS and EKF have reported again.
3. A payload's stamp is compared with the vehicle's clock. A constant offset is corrected and reported. A single stamp
   that fits neither clock is rejected. The tracker receives nothing from a rejected source, so that another source
   may replace it. A stamp of 0 means "no stamp": the reading is treated as current.
4. Every quantity has limits; readings beyond them are dropped.
5. Two alternating clocks, or two alternating positions, mean two vehicles with one system id: Yield, latched.

Rejections, corrections and doubts are reported, each at most once in ``_REPEATED_AFTER_S``.

Source: docs/explanation/input-checks.md#plausibility.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any, Literal

from sidelong.estimators.sensing.clock import BOOTING_S, PROOF_S, SILENCE_MAX_S, SourceClock, VehicleClock
from sidelong.estimators.sensing.readings import (
    BEACON_MESSAGES,
    AttitudeReading,
    GimbalReading,
    PositionReading,
    RangeReading,
    Source,
    TargetFixReading,
)
from sidelong.mission.core.events import Announce, Event, NavigationReported, WindReported, YieldRequested
from sidelong.mission.core.inputs import Input
from sidelong.mission.core.requirement import GRAVITY_M_S2

_SLACK_M, _ACCELERATION_M_S2 = 15.0, 8.0
_GUST_M_S = 15.0
_RECKONING_DRIFT_M_S, _DRIFTING_MAX_S = 3.0, 10.0  # of dead reckoning
_VELOCITY_SLACK_M_S, _VELOCITY_RATE_M_S2 = 6.0, 15.0
_CLIMB_SLACK_M, _CLIMB_RATE_M_S = 20.0, 10.0
_PROOF_S = 15.0
SILENT_S = 3.0  # gap between two readings above which the next one counts as received after a telemetry gap
_CIRCLING_RAD, _OFF_CIRCLE_M = math.radians(12.0), 60.0
_ODD_S = 1.0  # an accepted reading may prove to be an outlier within this time after the one before it
_FLYING_M_S = 5.0
_SETTLED = 5  # consecutive readings before the reference position counts as reliable
_COMPARED_S, _COMPARED_SLACK_M, _COMPARED_SHARE, _OFF_MAX = 2.0, 8.0, 0.4, 4
_TURNS_MAX, _TURN_MAX_S, _SLOW_TURNS_MAX, _SLOW_TURN_MAX_S = 20, 0.5, 8, 3.0


class PositionCheck:
    """Kinematic check of the aircraft's own position.

    A reading is accepted when the aircraft can have flown there from the last accepted one. The reference is dead
    reckoning; the tolerance is the acceleration that is possible in the time between them. A rejected reading is
    replaced by dead reckoning, by the reported velocity if that continues the last one, else by the last velocity
    turned by the bank angle. If the last accepted reading was the outlier, readings that follow from the one before
    it are accepted. A new position that persists for ``_PROOF_S`` while GPS and EKF report no fault is accepted.
    Positions that alternate between two places come from two vehicles.
    """

    def __init__(self) -> None:
        self.accepted: PositionReading | None = None  # or dead-reckoned
        self._before: PositionReading | None = None  # the accepted reading before the latest one
        self.rejected_since_s: float | None = None  # by the vehicle's clock
        self.jump_m, self.jump = 0.0, ""  # how far, and in words what, the first rejected reading jumped
        self.two_places_m: float | None = None  # distance of two alternating positions
        self.slow_places_m: float | None = None  # the same, if the second is received seldom
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
        """Return whether ``passed_s`` suffices to fly here from the last accepted (jumped: or rejected) position."""
        places = (self.accepted, self._elsewhere if jumped and self.rejected_since_s is not None else None)
        return any(earlier is not None and _stayed(earlier, place, passed_s) for earlier in places)

    def take(
        self, reading: PositionReading, bank_rad: float, *, possible: bool, sound: bool
    ) -> PositionReading | None:
        """Return the reading, or dead reckoning in its place; None for a late reading that is not plausible.

        ``possible``: it is within the absolute limits; ``sound``: GPS and EKF report no fault.
        """
        last = self.accepted
        if last is None:
            return self._accept(reading)
        step_s = reading.time_s - last.time_s
        if step_s <= 0.0:
            is_good = possible and self.rejected_since_s is None and self._follows(last, reading, bank_rad)
            return reading if is_good else None
        before = self._before
        is_soon = before is not None and reading.time_s - before.time_s <= _ODD_S
        after_odd_one = before is not None and is_soon and _reachable(before, reading, 0.0)
        if possible and (after_odd_one or self._follows(last, reading, bank_rad)):
            return self._accept(reading)
        reckoned = _dead_reckoned(last, reading, bank_rad)
        self._note_elsewhere(last, reading, reckoned)
        proven = sound and reading.time_s - self._elsewhere_since_s >= _PROOF_S
        unsettled = self._readings < _SETTLED and self._elsewhere_count > self._readings
        if possible and (unsettled or proven):
            self._readings = self._elsewhere_count - 1
            return self._accept(reading)
        self.accepted = reckoned
        return reckoned

    def _accept(self, reading: PositionReading) -> PositionReading:
        self._before = self.accepted if self.rejected_since_s is None else None
        self.accepted, self.rejected_since_s, self._drifted_m = reading, None, 0.0
        self._readings += 1
        return reading

    def _note_elsewhere(self, last: PositionReading, reading: PositionReading, reckoned: PositionReading) -> None:
        before = self._elsewhere
        agrees = before is not None and _reachable(before, reading, 0.0)
        if self.rejected_since_s is None:
            # After a longer gap a rejected position cannot be explained by drift of dead reckoning.
            self.rejected_since_s = max(last.time_s, reading.time_s - _DRIFTING_MAX_S)
            self.jump_m = math.hypot(reading.east_m - reckoned.east_m, reading.north_m - reckoned.north_m)
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
        if not _reachable(last, reading, reckoned_for_s + self._drifted_m / _RECKONING_DRIFT_M_S):
            return False
        return reading.time_s - last.time_s <= SILENT_S or _still_circles(last, reading, bank_rad)


class VelocityCheck:
    """Compares the way between reported positions with the velocities, with which the estimation interpolates."""

    def __init__(self) -> None:
        self.fault = ""  # how they contradict each other; '' while they agree
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
    """Return whether a position can be flown to from another, that was dead reckoned for ``reckoned_for_s``."""
    step_s = reading.time_s - last.time_s
    passed_s = step_s if step_s >= 0.0 else -step_s
    speed_m_s = math.hypot(last.velocity_east_m_s, last.velocity_north_m_s)
    off_m = math.hypot(
        reading.east_m - last.east_m - last.velocity_east_m_s * step_s,
        reading.north_m - last.north_m - last.velocity_north_m_s * step_s,
    )
    turned_m, most_m = 0.5 * _ACCELERATION_M_S2 * step_s**2, (2.0 * speed_m_s + _GUST_M_S) * passed_s
    turned_m = turned_m if turned_m <= most_m else most_m
    if off_m > _SLACK_M + turned_m + _RECKONING_DRIFT_M_S * reckoned_for_s:
        return False
    climbed_m = reading.height_m - last.height_m - last.velocity_up_m_s * step_s
    limit_m = _CLIMB_SLACK_M + _CLIMB_RATE_M_S * (passed_s + reckoned_for_s)
    if not -limit_m <= climbed_m <= limit_m:
        return False
    return _velocity_follows(last, reading, speed_m_s, reckoned_for_s)


def _jump(last: PositionReading, reading: PositionReading, jump_m: float) -> str:
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
    """Return whether a position after a telemetry gap is on the circle that was flown; True if none was flown."""
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
    step_s, most_m_s = reading.time_s - last.time_s, 2.0 * speed_m_s + _GUST_M_S
    possible_m_s = _VELOCITY_SLACK_M_S + _VELOCITY_RATE_M_S2 * (step_s if step_s >= 0.0 else -step_s)
    possible_m_s = possible_m_s if possible_m_s <= most_m_s else most_m_s
    return changed_m_s <= possible_m_s + _RECKONING_DRIFT_M_S * reckoned_for_s


def _dead_reckoned(last: PositionReading, announced: PositionReading, bank_rad: float) -> PositionReading:
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


BRIDGED_S = 3.0
_FAULT_VALID_S = 30.0  # a link may be silent between two reports
_FAULT_DRIFT_M_S = 10.0  # drift of positions reported during a GPS or EKF fault
_AWAITED_S = 5.0  # timeout for GPS and EKF reports after a telemetry gap
_REPEATED_AFTER_S = 30.0
_SAME_HOME_M = 2.0  # altitudes of home that are reported for the same one
_SOURCES_MAX = 32
_REPEATS_S, _BEACON_SILENT_S = 20.0, 60.0
_DISPLACED_MIN = 3
_OVERTAKEN_S = 1.0
_BOOT_S = 4.0  # an autopilot that booted longer ago than this was silent and has moved

_SPEED_MAX_M_S, _CLIMB_MAX_M_S = 150.0, 60.0
_HEIGHT_MIN_M, _HEIGHT_MAX_M = -500.0, 12_000.0
_FROM_HOME_MAX_M = 200_000.0
_RANGE_MAX_M, _RANGE_SIGMA_MAX_M = 30_000.0, 1_000.0
_FIX_RANGE_MAX_M, _FIX_SIGMA_MAX_M = 50_000.0, 1_000.0
_NAMES = {RangeReading: "laser", GimbalReading: "gimbal", TargetFixReading: "camera"}

Payload = RangeReading | GimbalReading | TargetFixReading
Admitted = tuple[Event | None, tuple[Announce, ...]]


class Plausibility:
    """Input checks of one flight. Reported winds of ``wind_max_m_s`` and more are rejected."""

    def __init__(self, wind_max_m_s: float = math.inf) -> None:
        self.doubt: str | None = None  # why nothing may be decided now
        self.dead_reckoned = False  # the latest position is
        self.no_heartbeat = False  # the flight mode is too old for commands: set by the control step
        self.vehicle_silent = False  # the vehicle's clock stands still: likewise
        self.two_vehicles: str | None = None
        # Of home above that of the takeover: heights that pass count from the latter, as fences and layers do.
        self.home_m, self.home_is_fixed = 0.0, False
        self._home_altitude_m: float | None = None  # at the takeover
        self._home_next_m = math.nan  # as ``home_m``, until a second position confirms it
        self.clock = VehicleClock()
        self.position = PositionCheck()
        self.velocity = VelocityCheck()
        self._wind_max_m_s = wind_max_m_s
        self._bank_rad = 0.0
        self._displaced = 0  # positions in a row that are of another time, and elsewhere
        # Whether a stamp was overtaken by far, or rejected, since the latest accepted position.
        self._overtaken = self._refused = False
        self._faults: dict[str, tuple[float, float, str]] = {}  # by source: since, latest, what
        self._good_s: dict[str, float] = {}
        self._awaited_s: dict[str, float] = {}  # by source without a report since a telemetry gap: since when
        self._sources: dict[tuple[type, Source], SourceClock] = {}
        self._latest: dict[type, tuple[Source | None, SourceClock]] = dict.fromkeys(_NAMES, (None, SourceClock()))
        self._beacon: Source | None = None  # the one in use, and when it was received last
        self._beacon_s = self._repeated_s = -math.inf
        self._repeated = math.nan, math.nan  # its position, since the time above
        self._announced_s: dict[str, float] = {}
        self._announced: list[Announce] = []
        self._yield: YieldRequested | None = None
        self._judges: dict[type, Callable[[Any], Event | None]] = {
            AttitudeReading: self._attitude,
            PositionReading: self._position,
            **dict.fromkeys((RangeReading, GimbalReading, TargetFixReading), self._payload),
            WindReported: self._wind,
            NavigationReported: self._navigation,
        }

    @property
    def faulty(self) -> bool:
        """Whether GPS or EKF report a fault, or have not reported since an outage: nothing new should begin."""
        if not self._awaited_s and not self._faults:
            return False
        now_s = self.clock.now_s
        awaited = any(now_s - since_s < _AWAITED_S for since_s in self._awaited_s.values())
        return awaited or (bool(self._faults) and self._fault(now_s) is not None)

    @property
    def place_is_known(self) -> bool:
        """Whether the aircraft's position is good enough to locate a target from it."""
        return self.doubt is None and not self.faulty

    def admit(self, event: Event) -> Admitted:
        """Return the checked event, None if it is rejected, and the announcements for the operator."""
        kind, judges = type(event), self._judges
        if kind not in judges:
            return event, ()
        passed = judges[kind](event)
        if self._yield is not None:
            passed, self._yield = self._yield, None
        if not self._announced:
            return passed, ()
        announced, self._announced = tuple(self._announced), []
        return passed, announced

    def _announce(self, key: str, kind: Literal["position", "sensor"], text: str) -> None:
        now_s = self.clock.now_s
        if now_s - self._announced_s.get(key, -math.inf) >= _REPEATED_AFTER_S:
            self._announced_s[key] = now_s
            self._announced.append(Announce(now_s, kind, text))

    # -- the vehicle ---------------------------------------------------------------------------------------

    def _attitude(self, reading: AttitudeReading) -> Event | None:
        if abs(reading.roll_rad) > math.pi or abs(reading.pitch_rad) > math.pi or abs(reading.yaw_rad) > math.tau:
            return None
        if not self._on_time(reading.time_s, None):
            return None
        self._bank_rad = reading.roll_rad
        return reading

    def _above_first_home(self, reading: PositionReading) -> PositionReading:
        if reading.home_altitude_m is not None:
            if self._home_altitude_m is None or not self.home_is_fixed:
                self._home_altitude_m = reading.home_altitude_m
            moved_m = reading.home_altitude_m - self._home_altitude_m
            if moved_m == self._home_next_m == self.home_m:  # as nearly always: neither has changed
                return replace(reading, height_m=reading.height_m + self.home_m) if self.home_m else reading
            is_confirmed = abs(moved_m - self._home_next_m) <= _SAME_HOME_M
            if is_confirmed and abs(moved_m - self.home_m) > _SAME_HOME_M:
                self.home_m = moved_m if abs(moved_m) > _SAME_HOME_M else 0.0
            self._home_next_m = moved_m
        return replace(reading, height_m=reading.height_m + self.home_m) if self.home_m else reading

    def _position(self, reading: PositionReading) -> Event | None:
        reading = self._above_first_home(reading)
        possible = _possible(reading)
        if not self._on_time(reading.time_s, reading):
            self._refused = True
            return None
        if self.position.accepted is None and not possible:
            return None
        self._overtaken |= reading.time_s < self.clock.now_s - _OVERTAKEN_S
        self.velocity.take(reading)
        was_rejecting, last = self.position.rejected_since_s is not None, self.position.accepted
        if last is not None and reading.time_s - last.time_s > SILENT_S:
            self._awaited_s = dict.fromkeys((*self._good_s, *self._faults), reading.time_s)
        sound = not self._faults or self._fault(reading.time_s) is None
        taken = self.position.take(reading, self._bank_rad, possible=possible, sound=sound)
        if self.position.two_places_m is not None:
            self._yield_to_two(f"its positions take turns, {length(self.position.two_places_m)} apart")
        elif self.position.slow_places_m is not None:
            self._suspect_two(f"its positions take turns, {length(self.position.slow_places_m)} apart")
            self.position.slow_places_m = None
        if taken is None:
            return None
        self.dead_reckoned = taken is not reading
        if self.dead_reckoned and not was_rejecting:
            self._announce("jump", "position", f"{self.position.jump}: dead reckoning")
        elif self.position.accepted is reading:
            self._overtaken = self._refused = False
        if self._faults or self.doubt is not None or self.position.rejected_since_s is not None:
            self._judge(reading.time_s)
        return taken

    def _on_time(self, stamp_s: float, place: PositionReading | None) -> bool:
        """Return whether a stamp belongs to the vehicle's clock; ``place`` is the position reported with it."""
        clock = self.clock
        if clock.goes_on(stamp_s):
            self._displaced = 0
            return True
        ahead = 0.0 < stamp_s - clock.now_s <= SILENCE_MAX_S
        booted = clock.now_s > BOOTING_S and _BOOT_S < stamp_s - clock.questioned_for_s < BOOTING_S
        if (ahead or booted) and place is not None:
            # A clock that is put right after it stood has readings elsewhere, too: by that they are no jump.
            is_where_it_was = self.position.stayed(place, clock.questioned_for_s, jumped=not self._overtaken)
            self._displaced = 0 if is_where_it_was else self._displaced + 1
        is_followed = clock.take(stamp_s, PROOF_S if (ahead or booted) and self._displaced < _DISPLACED_MIN else None)
        if clock.two_lines_s is not None:
            self._yield_to_two(f"its clocks take turns, {clock.two_lines_s:.0f} s apart")
        elif clock.slow_lines_s is not None:
            self._suspect_two(f"its clocks take turns, {clock.slow_lines_s:.0f} s apart")
            clock.slow_lines_s = None
        if is_followed:
            if clock.returned and self.position.accepted is not None:
                # No time has gone by that the clock left out: the place is still to be held to.
                self.position.shift(clock.shift_s)
                self._faults = {
                    source: (since_s + clock.shift_s, latest_s + clock.shift_s, what)
                    for source, (since_s, latest_s, what) in self._faults.items()
                }
                self._good_s = {source: good_s + clock.shift_s for source, good_s in self._good_s.items()}
            if clock.restarted:
                self.position = PositionCheck()
                self._faults, self._good_s, self._awaited_s = {}, {}, {}  # they carry times of the old clock
                self._yield = YieldRequested(stamp_s, "the autopilot has restarted")
            return True
        return False

    @property
    def input_faults(self) -> dict[Input, str]:
        """Why the vehicle's clock and position are not trusted; empty text while they are."""
        off_s, clock = self.clock.in_question_s, ""
        if off_s is not None and self.clock.questioned_for_s > BRIDGED_S:
            clock = f"it is {_off(off_s)}, nothing is decided on it"
        return {Input.CLOCK: clock, Input.POSITION: self.velocity.fault}

    def _yield_to_two(self, how: str) -> None:
        if self.two_vehicles is None:
            self.two_vehicles = f"two vehicles speak with the same system id: {how}"
            self._yield = YieldRequested(self.clock.now_s, self.two_vehicles)

    def _suspect_two(self, how: str) -> None:
        text = f"a second vehicle may send with the same system id: {how}; its messages are not used"
        self._announce("second vehicle", "position", text)

    def _navigation(self, event: NavigationReported) -> Event:
        self._awaited_s.pop(event.source, None)
        if not event.fault:
            over, good_s = self._faults.pop(event.source, None), self._good_s.get(event.source, -math.inf)
            if over is not None and not self._faults:
                # It may have begun at any time since the last good word.
                self.position.allow(_FAULT_DRIFT_M_S * (self.clock.now_s - max(good_s, over[0] - _FAULT_VALID_S)))
            self._good_s[event.source] = self.clock.now_s
        else:
            now_s = self.clock.now_s  # it carries no time of its own
            since_s, _, _ = self._faults.get(event.source, (now_s, 0.0, ""))
            self._faults[event.source] = (since_s, now_s, event.fault)
        return event

    def _fault(self, now_s: float) -> tuple[float, str] | None:
        """Return since when GPS or EKF complain, and of what."""
        if not self._faults:
            return None
        faults = self._faults.values()
        valid = ((since_s, what) for since_s, latest_s, what in faults if now_s - latest_s < _FAULT_VALID_S)
        return min(valid, default=None)

    def _judge(self, now_s: float) -> None:
        """Update ``doubt``, and announce when it begins or ends."""
        fault, rejected_since_s = self._fault(now_s), self.position.rejected_since_s
        doubt, is_of_unknown_time = None, self._overtaken or self._refused  # then nothing is bridged from there
        if fault is not None and now_s - fault[0] > BRIDGED_S:
            doubt = fault[1]
        elif rejected_since_s is not None and (now_s - rejected_since_s > BRIDGED_S or is_of_unknown_time):
            doubt = self.position.jump
        if (doubt is None) is not (self.doubt is None):
            text = f"{doubt}: holding the circle, nothing is decided on it"
            text = text if doubt is not None else "the aircraft's position is accepted again"
            self._announced.append(Announce(now_s, "position", text))
        self.doubt = doubt

    def _wind(self, event: WindReported) -> Event | None:
        speed_m_s = math.hypot(event.east_m_s, event.north_m_s)
        if speed_m_s < self._wind_max_m_s:
            return event
        self._announce("wind", "position", f"a wind of {speed_m_s:.0f} m/s was reported: rejected")
        return None

    # -- the payload ---------------------------------------------------------------------------------------

    def _payload(self, reading: Payload) -> Event | None:
        clock = self.clock
        # While the vehicle's clock stands still there is nothing to compare a payload's clock with.
        kind = type(reading)
        if clock.now_s == -math.inf or clock.in_question or self.vehicle_silent:
            return None
        if kind is not GimbalReading and not self._credible(reading):
            return None
        if type(reading) is TargetFixReading and reading.source.message in BEACON_MESSAGES:
            if not self._is_of_first_beacon(reading.source):
                return None
            self._note_repeated(reading)
        if reading.time_s == 0.0:
            return replace(reading, time_s=self.clock.now_s)
        latest, source = self._latest[kind]
        if reading.source is not latest:
            known = self._sources.get((kind, reading.source))
            if known is None:
                if len(self._sources) >= _SOURCES_MAX:
                    return None
                known = self._sources[kind, reading.source] = SourceClock()
            source = known
            self._latest[kind] = reading.source, source
        before_s = source.ahead_s
        time_s = source.corrected_s(reading.time_s, clock)
        if source.ahead_s != before_s:
            name = _clock_of(reading)
            self._announced_s.pop(name, None)
            text = f"is {_off(source.ahead_s)}: corrected" if source.ahead_s else "agrees with the aircraft's again"
            self._announce(name, "sensor", f"{name} {text}")
        if time_s is None:
            name, off_s = _clock_of(reading), reading.time_s - self.clock.now_s
            self._announce(name, "sensor", f"{name} is {_off(off_s)}: what it stamps is refused")
            return None
        return reading if time_s == reading.time_s else replace(reading, time_s=time_s)

    def _is_of_first_beacon(self, source: Source) -> bool:
        """Return whether the beacon is the one in use: the mean of two targets is where neither of them is."""
        now_s = self.clock.now_s
        if self._beacon not in (None, source) and now_s - self._beacon_s < _BEACON_SILENT_S:
            name = f"{source.message} {source.sensor_id or ''}".strip()
            self._announce(name, "sensor", f"a second beacon ({name}, component {source.component_id}) is not used")
            return False
        self._beacon, self._beacon_s = source, now_s
        return True

    def _note_repeated(self, fix: TargetFixReading) -> None:
        """Report a beacon that repeats a position to the last digit: it may be an old one."""
        place, now_s = (fix.east_m, fix.north_m), self.clock.now_s
        if place != self._repeated:
            self._repeated, self._repeated_s = place, now_s
        elif now_s - self._repeated_s >= _REPEATS_S:
            self._repeated_s = math.inf  # once
            text = f"the beacon has reported the same position for {_REPEATS_S:.0f} s: the target stands, or the "
            self._announce("repeated", "sensor", text + "beacon repeats its last position")

    def _credible(self, reading: Payload) -> bool:
        match reading:
            case RangeReading():
                is_sigma = reading.sigma_m is None or 0.0 < reading.sigma_m <= _RANGE_SIGMA_MAX_M
                return is_sigma and 0.0 < reading.slant_range_m <= _RANGE_MAX_M
            case TargetFixReading():
                own = self.position.accepted
                if own is None or not 0.0 < reading.sigma_m <= _FIX_SIGMA_MAX_M:
                    return False
                return math.hypot(reading.east_m - own.east_m, reading.north_m - own.north_m) <= _FIX_RANGE_MAX_M
            case _:
                return True


def _possible(reading: PositionReading) -> bool:
    east_m_s, north_m_s = reading.velocity_east_m_s, reading.velocity_north_m_s
    return (
        reading.east_m * reading.east_m + reading.north_m * reading.north_m <= _FROM_HOME_MAX_M**2
        and _HEIGHT_MIN_M <= reading.height_m <= _HEIGHT_MAX_M
        and east_m_s * east_m_s + north_m_s * north_m_s <= _SPEED_MAX_M_S**2
        and -_CLIMB_MAX_M_S <= reading.velocity_up_m_s <= _CLIMB_MAX_M_S
    )


def _clock_of(reading: Payload) -> str:
    device = _NAMES[type(reading)] if reading.source.message not in BEACON_MESSAGES else "beacon"
    return f"the {device}'s clock (component {reading.source.component_id})"


def _off(seconds: float) -> str:
    return f"{abs(seconds):.{0 if abs(seconds) >= 10.0 else 1}f} s {'ahead' if seconds > 0.0 else 'behind'}"

"""The paper's planner: once a lap, at the switching heading, fly another lap or move the circle.

Rules
-----
1. The regular step is O2 = O1 + e on ABCD (17): it keeps the compass direction in which the circle lies from the
   target. It is taken when another lap would end outside [Dmin, C Dmax], and refused when ABCD has no room for it.
2. The circle is placed again next to the target (20-22) when it is not one of ours, when the regular step would not
   keep the required side of the target's motion, or when the circle dips below Dmin. Of ABCD and stretched laps
   that move takes the first which keeps its distance, or else the one that does best; the paper leaves it open. A
   circle flown the other way round is left at once, by turn, straight and turn.
3. A decision falls in the last call before the aircraft comes to A, once a lap.

Source: Liao et al., Defence Technology 16(4), 2020, equations 9-22.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from sidelong.estimators.estimate import TargetEstimate, TrackQuality
from sidelong.mission.core.circle import Circle
from sidelong.mission.core.path import Path
from sidelong.mission.core.plan import AircraftState, Decision, Plan
from sidelong.mission.core.requirement import Aircraft, Requirement, Wind
from sidelong.mission.geometry.approach import turn_straight_turn
from sidelong.mission.geometry.progress import WindError, flight_times_s, path_times_s
from sidelong.mission.paper.transition import abcd, departure_course_rad, min_move_m, stretched_lap
from sidelong.mission.viewpoint.watch_course import CourseHold, SidePolicy, Viewpoint, describe_move

Vector = tuple[float, float]


_LAP_STEPS = 720


class LapClock:
    """Time against turn on one circle in steady wind; the turn grows in the direction of flight, from north.

    A lap takes longer than in still air, by about 3 w^2 / 4 v^2 of it.
    """

    def __init__(self, circle: Circle, airspeed_m_s: float, wind: Wind) -> None:
        # A counter-clockwise lap is a clockwise one seen in the mirror that keeps north.
        mirrored = wind if circle.clockwise else Wind(-wind.east_m_s, wind.north_m_s)
        self._turns_rad = np.linspace(0.0, 2.0 * math.pi, _LAP_STEPS + 1)
        self._times_s = flight_times_s(circle.radius_m * self._turns_rad, self._turns_rad, airspeed_m_s, mirrored)
        self.lap_s = float(self._times_s[-1])

    def time_s(self, turn_rad: float) -> float:
        """Return the time at a turn counted from north, any number of laps."""
        laps, within_rad = divmod(turn_rad, 2.0 * math.pi)
        return laps * self.lap_s + float(np.interp(within_rad, self._turns_rad, self._times_s))

    def turn_rad(self, time_s: float) -> float:
        """Return the turn from north at a time: the inverse of :meth:`time_s`."""
        laps, within_s = divmod(time_s, self.lap_s)
        return laps * 2.0 * math.pi + float(np.interp(within_s, self._times_s, self._turns_rad))


@dataclass(frozen=True, slots=True)
class DepartureState:
    """A circle that is flown, now on ``course_rad``, and a target that is taken to keep its velocity."""

    circle: Circle
    course_rad: float
    clock: LapClock
    target_m: Vector
    velocity_m_s: Vector
    aircraft: Aircraft
    wind: Wind
    latency_s: float

    def target_after(self, wait_s: float) -> Vector:
        """Return (east, north) of the target after ``wait_s`` at its present velocity, m."""
        return (self.target_m[0] + self.velocity_m_s[0] * wait_s, self.target_m[1] + self.velocity_m_s[1] * wait_s)

    def min_range_m(self, path: Path, wait_s: float) -> float:
        """Return the least range while ``path`` is flown from ``wait_s`` on."""
        time_s = wait_s + path_times_s(path, self.aircraft.airspeed_m_s, self.wind)
        east_m = path.east_m - self.target_m[0] - self.velocity_m_s[0] * time_s
        north_m = path.north_m - self.target_m[1] - self.velocity_m_s[1] * time_s
        return float(np.min(np.hypot(east_m, north_m)))

    def move(self, to: Circle, wait_s: float, target_m: Vector, leaving_rad: float) -> Move:
        """Return the move that leaves the circle on a course, and the predicted range l_pre a lap later (12-15)."""
        at_m, later_m = self.circle.position_at_course(leaving_rad), self.target_after(wait_s + self.clock.lap_s)
        east_m, north_m = to.east_m - self.circle.east_m, to.north_m - self.circle.north_m
        return Move(to, wait_s, east_m, north_m, target_m, math.dist(at_m, later_m))


@dataclass(frozen=True, slots=True)
class Move:
    """A move to ``circle`` that departs from A in ``wait_s``; target_m and range_after_lap_m are those of then."""

    circle: Circle
    wait_s: float
    east_m: float
    north_m: float
    target_m: Vector
    range_after_lap_m: float

    @property
    def length_m(self) -> float:
        """How far the circle moves, m."""
        return math.hypot(self.east_m, self.north_m)


def next_move(situation: DepartureState, place: Callable[[Vector], Circle], lead_rad: float) -> Move:
    """Return the next move to the circle that ``place`` returns for the target's position (east, north).

    The aircraft leaves its circle ``lead_rad`` before the bearing of the move. That bearing depends on where the
    target is by then: found by iteration, which converges as the target is much slower than the aircraft.
    """
    circle, clock = situation.circle, situation.clock
    sense = 1.0 if circle.clockwise else -1.0
    begin_s = clock.time_s(sense * situation.course_rad)
    wait_s = situation.latency_s
    for _ in range(4):
        target_m = situation.target_after(wait_s)
        new = place(target_m)
        bearing_rad = math.atan2(new.east_m - circle.east_m, new.north_m - circle.north_m)
        leaving_rad = departure_course_rad(bearing_rad, lead_rad, circle.clockwise)
        turn_rad = sense * (leaving_rad - situation.course_rad) % (2.0 * math.pi)
        wait_s = clock.time_s(sense * situation.course_rad + turn_rad) - begin_s
        if wait_s < situation.latency_s:
            wait_s += clock.lap_s
    return situation.move(new, wait_s, target_m, leaving_rad)


def stand_off_m(aircraft: Aircraft, requirement: Requirement) -> float:
    """Return D = Dmin + R, the distance from the target to the circle's centre: the circle just touches Dmin."""
    return requirement.range_min_m + aircraft.radius_m


def circle_next_to(
    target_east_m: float, target_north_m: float, course_rad: float, aircraft: Aircraft, requirement: Requirement
) -> Circle:
    """Return the circle on the required side of a target that moves on ``course_rad`` (20-21)."""
    outward_rad, distance_m = course_rad + requirement.side.normal_turn_rad, stand_off_m(aircraft, requirement)
    return Circle(
        target_east_m + distance_m * math.sin(outward_rad),
        target_north_m + distance_m * math.cos(outward_rad),
        aircraft.radius_m,
        requirement.side.clockwise,
    )


_STRETCHES_RAD = (math.radians(60.0), math.radians(90.0), math.radians(120.0))
_DIP = 0.1  # of Dmin: noise and the flown radius reach below it by that much
_LONGEST_INTERVAL_S = 2.0  # between two calls; the first call after a pause counts as this much


@dataclass(frozen=True, slots=True)
class _Chosen:
    """A circle, and where the target was that it was chosen for.

    The paper carries on where a target that stands would be seen (1-4) and takes the error vector e from that (5-8).
    Without drift that is how far the target has moved since.

    placed: whether the planner put it next to the target; a circle found flown is only adopted.
    """

    circle: Circle
    target_m: Vector
    placed: bool

    def shifted(self, target_m: Vector) -> Circle:
        """Return the circle after the regular step O2 = O1 + e (17), for the target's present position."""
        east_m, north_m = target_m[0] - self.target_m[0], target_m[1] - self.target_m[1]
        return replace(self.circle, east_m=self.circle.east_m + east_m, north_m=self.circle.north_m + north_m)


class PaperPlanner:
    """Implements :class:`sidelong.mission.core.plan.Planner`; to be called at least every other second.

    psi_c_rad is the paper's; where the requirement is not feasible with it, give
    :func:`sidelong.mission.paper.scope.largest_psi_c_rad`, which shortens the transition until it fits.
    """

    def __init__(self, aircraft: Aircraft, requirement: Requirement, psi_c_rad: float = math.pi / 2) -> None:
        self._aircraft, self._requirement, self._psi_c_rad = aircraft, requirement, psi_c_rad
        self._min_move_m = min_move_m(aircraft.radius_m, self._psi_c_rad)
        self._chosen: _Chosen | None = None
        self._proposed: _Chosen | None = None
        self._last_s: float | None = None
        # The other side is nearer only when the target's line is crossed by as much as it may be approached.
        self._policy = SidePolicy(requirement, requirement.range_min_m)
        self._motion = CourseHold()
        self._viewpoint = Viewpoint(0.0, requirement.side, 0.0)
        self._decided_until_s = -math.inf
        self._arrival: tuple[Plan, float] | None = None

    def decide(
        self, aircraft: AircraftState, target: TargetEstimate, present: Plan, wind: Wind, latency_s: float
    ) -> Decision:
        """Decide at the switching heading of each lap; see :class:`sidelong.mission.core.plan.Planner`."""
        now_s = aircraft.time_s
        interval_s = _LONGEST_INTERVAL_S if self._last_s is None else min(now_s - self._last_s, _LONGEST_INTERVAL_S)
        self._last_s, target_m = now_s, target.position_m(now_s)
        chosen = self._flown(present.circle, target_m)
        self._viewpoint = self._policy.viewpoint(aircraft.east_m, aircraft.north_m, target)
        self._motion.update(target)
        if target.quality is TrackQuality.LOST:
            return Decision(now_s, None, "circling on: the target is lost")
        try:
            clock = LapClock(present.circle, self._aircraft.airspeed_m_s, wind)
            arrival_s = self._arrival_s(present, wind)
        except WindError as error:
            return Decision(now_s, None, f"circling on: {error}")
        if now_s < arrival_s:
            return Decision(now_s, None, "on the way to the new circle")
        if now_s < self._decided_until_s:
            return Decision(now_s, None, "decided for this lap")

        situation = DepartureState(
            present.circle,
            present.circle.course_at(aircraft.east_m, aircraft.north_m),
            clock,
            target_m,
            (0.0, 0.0) if self._motion.standing else (target.velocity_east_m_s, target.velocity_north_m_s),
            self._aircraft,
            wind,
            latency_s,
        )
        move = next_move(situation, chosen.shifted, self._psi_c_rad)
        transition: Path | None = None
        restarted = self._reason_to_place_again(situation, move, chosen.placed)
        if restarted is not None:
            move, transition = self._placed_again(situation)
        if move.wait_s - latency_s > 1.5 * interval_s:
            return Decision(now_s, None, f"next decision in {move.wait_s - latency_s:.0f} s")
        self._decided_until_s = now_s + move.wait_s + clock.lap_s / 2.0
        departure_s = now_s + move.wait_s
        moved = {"move_east_m": move.east_m, "move_north_m": move.north_m, "min_move_m": self._min_move_m}
        values = {**moved, "range_after_lap_m": move.range_after_lap_m, "departure_s": departure_s}
        if restarted is None:
            staying = self._reason_to_stay(move)
            if staying is not None:
                return Decision(now_s, None, staying, values)
            transition = abcd(present.circle, move.circle, self._psi_c_rad)
        self._proposed = _Chosen(move.circle, move.target_m, placed=True)
        why = restarted or self._range_words(situation, move)
        reason = f"moving {describe_move(move.east_m, move.north_m)}: {why}"
        return Decision(now_s, Plan(move.circle, transition, departure_s), reason, values)

    def _flown(self, circle: Circle, target_m: Vector) -> _Chosen:
        """Return what the circle that is flown was chosen for.

        A proposed circle waits next to the flown one until it is flown: an upload may fail.
        """
        if self._proposed is not None and self._proposed.circle == circle:
            self._chosen, self._proposed = self._proposed, None
        elif self._chosen is None or self._chosen.circle != circle:
            self._chosen = _Chosen(circle, target_m, placed=False)
            self._decided_until_s = -math.inf
        return self._chosen

    # -- why -----------------------------------------------------------------------------------------------

    def _reason_to_stay(self, regular: Move) -> str | None:
        if not self._must_move(regular):
            return f"another lap: after it the target would be {regular.range_after_lap_m:.0f} m away"
        if regular.length_m < self._min_move_m:
            needed = f"than the transition needs, {self._min_move_m:.1f} m"
            return f"another lap: the move of {regular.length_m:.1f} m is shorter {needed}"
        return None

    def _reason_to_place_again(self, situation: DepartureState, regular: Move, placed: bool) -> str | None:
        circle, side = situation.circle, self._viewpoint.side
        ends_badly = self._must_move(regular)
        if circle.clockwise != side.clockwise:
            return f"on the target's {side} the circle is flown the other way round"
        stays_on_side = not ends_badly and self._on_side(circle, regular.target_m)
        if not stays_on_side and not self._on_side(regular.circle, regular.target_m):
            return f"the circle is no longer on the target's {side}"
        lap_later_m = situation.target_after(regular.wait_s + situation.clock.lap_s)
        centre_m = circle.east_m, circle.north_m
        nearest_m = min(math.dist(centre_m, at_m) for at_m in (regular.target_m, lap_later_m)) - circle.radius_m
        if nearest_m < (1.0 - _DIP) * self._requirement.range_min_m:
            return f"the circle comes within {max(nearest_m, 0.0):.0f} m of the target"
        if ends_badly and not placed:
            return self._range_words(situation, regular)
        return None

    def _must_move(self, regular: Move) -> bool:
        """Return whether another lap would end outside [Dmin, C Dmax] (16)."""
        greatest_m = self._requirement.threshold * self._requirement.range_max_m
        return not self._requirement.range_min_m <= regular.range_after_lap_m <= greatest_m

    @staticmethod
    def _range_words(situation: DepartureState, move: Move) -> str:
        in_s = move.wait_s + situation.clock.lap_s
        return f"in {in_s:.0f} s the target would be {move.range_after_lap_m:.0f} m away"

    def _on_side(self, circle: Circle, target_m: Vector) -> bool:
        viewpoint = self._viewpoint
        outward_rad = math.atan2(circle.east_m - target_m[0], circle.north_m - target_m[1])
        return math.cos(outward_rad - viewpoint.course_rad - viewpoint.side.normal_turn_rad) >= 0.0

    # -- where to ------------------------------------------------------------------------------------------

    def _placed_again(self, situation: DepartureState) -> tuple[Move, Path | None]:
        """Return the move to the circle next to the target, and its path.

        None for the line where both ways to a circle of another kind overlap: the autopilot finds its own.
        """
        tried: list[tuple[float, Move, Path]] = []
        for lead_rad in (self._psi_c_rad, *_STRETCHES_RAD):
            by_abcd = not tried and lead_rad == self._psi_c_rad
            move = next_move(situation, self._alongside, lead_rad)
            present, new = situation.circle, move.circle
            if present.clockwise != new.clockwise or not math.isclose(present.radius_m, new.radius_m):
                return self._at_once(situation)
            if by_abcd and move.length_m < self._min_move_m:
                continue
            path = (abcd if by_abcd else stretched_lap)(present, new, lead_rad)
            min_m = situation.min_range_m(path, move.wait_s)
            if min_m >= (1.0 - _DIP) * self._requirement.range_min_m:
                return move, path
            tried.append((min_m, move, path))
        _, move, path = max(tried, key=lambda one: one[0])
        return move, path

    def _at_once(self, situation: DepartureState) -> tuple[Move, Path | None]:
        """Return the move as soon as it can be on board, by the turn that keeps farther from the target."""
        circle, wait_s = situation.circle, situation.latency_s
        turn = 1.0 if circle.clockwise else -1.0
        begin_s = situation.clock.time_s(turn * situation.course_rad)
        course_rad = turn * situation.clock.turn_rad(begin_s + wait_s)
        flown = course_rad, self._aircraft.airspeed_m_s, circle.curvature_per_m
        start = AircraftState(wait_s, *circle.position_at_course(course_rad), *flown)
        target_m = situation.target_after(wait_s)
        new = self._alongside(target_m)
        move = situation.move(new, wait_s, target_m, course_rad)
        ways = (turn_straight_turn(start, new, first * self._aircraft.radius_m) for first in (1.0, -1.0))
        paths = [path for path in ways if path is not None]
        return move, max(paths, key=lambda path: situation.min_range_m(path, wait_s)) if paths else None

    def _alongside(self, target_m: Vector) -> Circle:
        wanted = replace(self._requirement, side=self._viewpoint.side)
        return circle_next_to(*target_m, self._viewpoint.course_rad, self._aircraft, wanted)

    def _arrival_s(self, present: Plan, wind: Wind) -> float:
        """Return when the present plan reaches its circle; reckoned once a plan."""
        if present.transition is None:
            return -math.inf
        if self._arrival is None or self._arrival[0] is not present:
            flight_s = float(path_times_s(present.transition, self._aircraft.airspeed_m_s, wind)[-1])
            self._arrival = (present, present.departure_s + flight_s)
        return self._arrival[1]

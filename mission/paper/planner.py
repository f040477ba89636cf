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
from sidelong.mission.core.path import FloatArray, Path
from sidelong.mission.core.plan import AircraftState, Decision, Plan
from sidelong.mission.core.requirement import Aircraft, Requirement, Wind
from sidelong.mission.geometry.approach import turn_straight_turn
from sidelong.mission.geometry.switching import departure_course_rad, must_move, range_after_lap_m, turn_to_go_rad
from sidelong.mission.geometry.transition import TransitionError, abcd, min_move_m
from sidelong.mission.geometry.wind import LapClock, WindError, path_times_s
from sidelong.mission.viewpoint.course_hold import CourseHold
from sidelong.mission.viewpoint.descriptions import describe_move
from sidelong.mission.viewpoint.side_policy import SidePolicy, Viewpoint

Vector = tuple[float, float]


@dataclass(frozen=True, slots=True)
class DepartureState:
    """A circle that is flown, now on ``course_rad``, and a target that is taken to keep its velocity.

    latency_s: no move can depart earlier.
    """

    circle: Circle
    course_rad: float
    clock: LapClock
    target_m: Vector
    velocity_m_s: Vector
    airspeed_m_s: float
    wind: Wind
    latency_s: float

    def target_after(self, wait_s: float) -> Vector:
        """Return (east, north) of the target after ``wait_s`` at its present velocity, m."""
        return (
            self.target_m[0] + self.velocity_m_s[0] * wait_s,
            self.target_m[1] + self.velocity_m_s[1] * wait_s,
        )

    def min_range_m(self, path: Path, wait_s: float) -> float:
        """Return the least range while ``path`` is flown from ``wait_s`` on."""
        time_s = wait_s + path_times_s(path, self.airspeed_m_s, self.wind)
        east_m = path.east_m - self.target_m[0] - self.velocity_m_s[0] * time_s
        north_m = path.north_m - self.target_m[1] - self.velocity_m_s[1] * time_s
        return float(np.min(np.hypot(east_m, north_m)))


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
    """Return the next move to where ``place`` puts the circle for a target, leaving ``lead_rad`` before its bearing.

    Where the move leads depends on where the target is by then, and A on where it leads: found by repetition,
    which converges as the target is much slower than the aircraft.

    Args:
        place: Returns the circle for a position of the target.
    """
    circle, clock = situation.circle, situation.clock
    sense = 1.0 if circle.clockwise else -1.0
    begin_s = clock.time_s(sense * situation.course_rad)
    wait_s = situation.latency_s
    for _ in range(4):
        target_m = situation.target_after(wait_s)
        new = place(target_m)
        east_m, north_m = new.east_m - circle.east_m, new.north_m - circle.north_m
        leaving_rad = departure_course_rad(math.atan2(east_m, north_m), lead_rad, circle.clockwise)
        turn_rad = turn_to_go_rad(situation.course_rad, leaving_rad, circle.clockwise)
        wait_s = clock.time_s(sense * situation.course_rad + turn_rad) - begin_s
        if wait_s < situation.latency_s:
            wait_s += clock.lap_s
    range_m = range_after_lap_m(circle.position_at_course(leaving_rad), target_m, situation.velocity_m_s, clock.lap_s)
    return Move(new, wait_s, east_m, north_m, target_m, range_m)


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


def shifted(circle: Circle, east_m: float, north_m: float) -> Circle:
    """Return the circle after the regular step O2 = O1 + e (17)."""
    return Circle(circle.east_m + east_m, circle.north_m + north_m, circle.radius_m, circle.clockwise)


@dataclass(frozen=True, slots=True)
class RelativePosition:
    """The target as the aircraft sees it: horizontal range l and bearing theta."""

    range_m: float
    bearing_rad: float

    @staticmethod
    def of(east_m: float, north_m: float) -> RelativePosition:
        """Return the polar form of target minus aircraft; the bearing of a target right below is 0."""
        return RelativePosition(math.hypot(east_m, north_m), math.atan2(east_m, north_m))

    @property
    def east_m(self) -> float:
        """Metres east of the target from the aircraft."""
        return self.range_m * math.sin(self.bearing_rad)

    @property
    def north_m(self) -> float:
        """Metres north of the target from the aircraft."""
        return self.range_m * math.cos(self.bearing_rad)

    def after_flying(self, east_m: float, north_m: float) -> RelativePosition:
        """Return where a stationary target is seen once the aircraft has flown (east, north).

        This is the exact integral of l' = -v cos(theta - psi), theta' = (v / l) sin(theta - psi) (1-4) over any
        course and speed, wind included, so it does not drift with the step.
        """
        return RelativePosition.of(self.east_m - east_m, self.north_m - north_m)


def displacement_m(measured: RelativePosition, reference: RelativePosition) -> tuple[float, float]:
    """Return the error vector e (east, north): how far the target is from where a stationary one would be (5-8)."""
    return measured.east_m - reference.east_m, measured.north_m - reference.north_m


def stretched_lap(
    present: Circle, new: Circle, half_width_rad: float = math.radians(60.0), step_m: float = 2.0
) -> Path:
    """Return the stretched part of the lap, from ``half_width_rad`` before the move's bearing to as much after it.

    Raises:
        TransitionError: The circles differ in radius or direction, or W is not in (0, pi).
    """
    if present.clockwise != new.clockwise or not math.isclose(present.radius_m, new.radius_m):
        raise TransitionError("a stretched lap joins circles of one radius and one direction")
    if not 0.0 < half_width_rad < math.pi:
        raise TransitionError(f"half_width_rad must be in (0, pi), not {half_width_rad:.3f}")
    radius_m, width_rad = present.radius_m, half_width_rad
    move_east_m, move_north_m = new.east_m - present.east_m, new.north_m - present.north_m
    move_rad = math.atan2(move_east_m, move_north_m)
    swell_m = math.hypot(move_east_m, move_north_m) / float(_along(np.asarray(width_rad), width_rad))

    length_m = 2.0 * width_rad * radius_m + swell_m * width_rad
    turn_rad = _turns_rad(radius_m, swell_m, width_rad, max(3, math.ceil(length_m / step_m) + 1))
    # Along the move and to its right, from the point of the circle that is flown on the move's bearing.
    along_m = radius_m * np.sin(turn_rad) + swell_m * _along(turn_rad, width_rad)
    inward_m = radius_m * (1.0 - np.cos(turn_rad)) + swell_m * _inward(turn_rad, width_rad)
    right = 1.0 if present.clockwise else -1.0
    top_east_m, top_north_m = present.position_at_course(move_rad)
    start_rad = departure_course_rad(move_rad, width_rad, present.clockwise)
    return Path(
        _arc_m(turn_rad, radius_m, swell_m, width_rad),
        top_east_m + along_m * math.sin(move_rad) + right * inward_m * math.cos(move_rad),
        top_north_m + along_m * math.cos(move_rad) - right * inward_m * math.sin(move_rad),
        start_rad + right * (turn_rad + width_rad),
        right / (radius_m + swell_m * np.cos(math.pi * turn_rad / (2.0 * width_rad)) ** 2),
    )


def _arc_m(turn_rad: FloatArray, radius_m: float, swell_m: float, width_rad: float) -> FloatArray:
    a = math.pi / width_rad
    within_rad = turn_rad + width_rad
    return radius_m * within_rad + swell_m * 0.5 * (within_rad + np.sin(a * turn_rad) / a)


def _turns_rad(radius_m: float, swell_m: float, width_rad: float, count: int) -> FloatArray:
    """Return courses (relative to the move) whose points on the line lie about equally far apart."""
    even_rad = np.linspace(-width_rad, width_rad, 8 * count)
    arc_m = _arc_m(even_rad, radius_m, swell_m, width_rad)
    turns_rad = np.interp(np.linspace(0.0, arc_m[-1], count), arc_m, even_rad)
    turns_rad[0], turns_rad[-1] = -width_rad, width_rad
    return turns_rad


def _along(turn_rad: FloatArray, width_rad: float) -> FloatArray:
    """Return the integral of w(u) cos u from -W; at W it is I of the closed form."""
    a = math.pi / width_rad

    def antiderivative(u: FloatArray) -> FloatArray:
        # sin(b u) / b = u sinc(b u) holds for b = 0, that is W = pi, too.
        return 0.5 * np.sin(u) + 0.25 * u * (np.sinc((1 + a) * u / math.pi) + np.sinc((1 - a) * u / math.pi))

    total: FloatArray = antiderivative(turn_rad) - antiderivative(np.asarray(-width_rad))
    return total


def _inward(turn_rad: FloatArray, width_rad: float) -> FloatArray:
    """Return the integral of w(u) sin u from -W; it is zero again at W."""
    a = math.pi / width_rad

    def antiderivative(u: FloatArray) -> FloatArray:
        # (1 - cos b u) / b = b u^2 / 2 sinc^2(b u / 2)
        halves = (b * np.square(u) / 2.0 * np.square(np.sinc(b * u / (2.0 * math.pi))) for b in (1 + a, 1 - a))
        return 0.5 * (1.0 - np.cos(u)) + 0.25 * sum(halves)

    total: FloatArray = antiderivative(turn_rad) - antiderivative(np.asarray(-width_rad))
    return total


_STRETCHES_RAD = (math.radians(60.0), math.radians(90.0), math.radians(120.0))
_DIP = 0.1  # of Dmin: noise and the flown radius reach below it by that much
_LONGEST_INTERVAL_S = 2.0  # between two calls; the first call after a pause counts as this much


@dataclass(frozen=True, slots=True)
class _Chosen:
    """A circle, and where the target it was chosen for would be seen now had it stood still since.

    placed: whether the planner put it next to the target; a circle found flown is only adopted.
    """

    circle: Circle
    reference: RelativePosition
    placed: bool


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
        self._last: AircraftState | None = None
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
        interval_s = min(now_s - self._last.time_s, _LONGEST_INTERVAL_S) if self._last else _LONGEST_INTERVAL_S
        target_m = target.position_m(now_s)
        seen = RelativePosition.of(target_m[0] - aircraft.east_m, target_m[1] - aircraft.north_m)
        chosen = self._follow(aircraft, seen, present)
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
            self._aircraft.airspeed_m_s,
            wind,
            latency_s,
        )
        stood_m = tuple(
            at - moved for at, moved in zip(target_m, displacement_m(seen, chosen.reference), strict=True)
        )
        move = next_move(
            situation,
            lambda at_m: shifted(present.circle, at_m[0] - stood_m[0], at_m[1] - stood_m[1]),
            self._psi_c_rad,
        )
        transition: Path | None = None
        restarted = self._reason_to_place_again(situation, move, chosen.placed)
        if restarted is not None:
            move, transition = self._placed_again(situation)
        if move.wait_s - latency_s > 1.5 * interval_s:
            return Decision(now_s, None, f"next decision in {move.wait_s - latency_s:.0f} s")
        self._decided_until_s = now_s + move.wait_s + clock.lap_s / 2.0
        departure_s = now_s + move.wait_s
        values = {
            "move_east_m": move.east_m,
            "move_north_m": move.north_m,
            "min_move_m": self._min_move_m,
            "range_after_lap_m": move.range_after_lap_m,
            "departure_s": departure_s,
        }
        if restarted is None:
            staying = self._reason_to_stay(move)
            if staying is not None:
                return Decision(now_s, None, staying, values)
            transition = abcd(present.circle, move.circle, self._psi_c_rad)
        seen_then = RelativePosition.of(move.target_m[0] - aircraft.east_m, move.target_m[1] - aircraft.north_m)
        self._proposed = _Chosen(move.circle, seen_then, placed=True)
        why = restarted or self._range_words(situation, move)
        reason = f"moving {describe_move(move.east_m, move.north_m)}: {why}"
        return Decision(now_s, Plan(move.circle, transition, departure_s), reason, values)

    # -- the reference model -------------------------------------------------------------------------------

    def _follow(self, aircraft: AircraftState, seen: RelativePosition, present: Plan) -> _Chosen:
        """Carry the reference models on to now; return the one of the circle that is flown.

        A proposed circle waits next to the flown one until it is flown: an upload may fail.
        """
        last = self._last or aircraft
        flown_m = (aircraft.east_m - last.east_m, aircraft.north_m - last.north_m)
        self._last = aircraft
        known = [
            replace(chosen, reference=chosen.reference.after_flying(*flown_m))
            for chosen in (self._proposed, self._chosen)
            if chosen is not None
        ]
        flown = next((chosen for chosen in known if chosen.circle == present.circle), None)
        if flown is None:
            flown = _Chosen(present.circle, seen, placed=False)
            self._decided_until_s = -math.inf
        self._proposed = known[0] if self._proposed is not None and known[0] is not flown else None
        self._chosen = flown
        return flown

    # -- why -----------------------------------------------------------------------------------------------

    def _reason_to_stay(self, regular: Move) -> str | None:
        if not must_move(regular.range_after_lap_m, self._requirement):
            return f"another lap: after it the target would be {regular.range_after_lap_m:.0f} m away"
        if regular.length_m < self._min_move_m:
            return (
                f"another lap: the move of {regular.length_m:.1f} m is shorter "
                f"than the transition needs, {self._min_move_m:.1f} m"
            )
        return None

    def _reason_to_place_again(self, situation: DepartureState, regular: Move, placed: bool) -> str | None:
        circle, side = situation.circle, self._viewpoint.side
        ends_badly = must_move(regular.range_after_lap_m, self._requirement)
        if circle.clockwise != side.clockwise:
            return f"on the target's {side} the circle is flown the other way round"
        if not self._on_side(regular.circle, regular.target_m) and (
            ends_badly or not self._on_side(circle, regular.target_m)
        ):
            return f"the circle is no longer on the target's {side}"
        lap_later_m = situation.target_after(regular.wait_s + situation.clock.lap_s)
        nearest_m = min(_distance_m(circle, at_m) for at_m in (regular.target_m, lap_later_m)) - circle.radius_m
        if nearest_m < (1.0 - _DIP) * self._requirement.range_min_m:
            return f"the circle comes within {max(nearest_m, 0.0):.0f} m of the target"
        if ends_badly and not placed:
            return self._range_words(situation, regular)
        return None

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
            if not _alike(situation.circle, move.circle):
                return self._at_once(situation)
            if by_abcd and move.length_m < self._min_move_m:
                continue
            path = (abcd if by_abcd else stretched_lap)(situation.circle, move.circle, lead_rad)
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
        east_m, north_m = circle.position_at_course(course_rad)
        start = AircraftState(wait_s, east_m, north_m, course_rad, situation.airspeed_m_s, circle.curvature_per_m)
        target_m = situation.target_after(wait_s)
        new = self._alongside(target_m)
        range_m = range_after_lap_m((east_m, north_m), target_m, situation.velocity_m_s, situation.clock.lap_s)
        move = Move(new, wait_s, new.east_m - circle.east_m, new.north_m - circle.north_m, target_m, range_m)
        paths = [turn_straight_turn(start, new, first * self._aircraft.radius_m) for first in (1.0, -1.0)]
        found = [path for path in paths if path is not None]
        return move, max(found, key=lambda path: situation.min_range_m(path, wait_s)) if found else None

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


def _alike(a: Circle, b: Circle) -> bool:
    return a.clockwise == b.clockwise and math.isclose(a.radius_m, b.radius_m)


def _distance_m(circle: Circle, target_m: Vector) -> float:
    return math.hypot(circle.east_m - target_m[0], circle.north_m - target_m[1])

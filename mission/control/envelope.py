"""The envelope monitor: what is flown, once a second, against what was planned, and against what was assumed.

What is judged is the aircraft's own height and position against plan, floor, ceiling, ground and fences; the target's
speed, home, airspeed, bank and roll rate against what was assumed of them; and whether orders get through. A limit
that the autopilot reports lower than configured, or that the aircraft does not reach, is learned: plans are made for
``aircraft``, whose circle is as wide as the limit asks for.

Source: docs/health.md#envelope; Beard and McLain, *Small Unmanned Aircraft*, 2012, chapter 9 (coordinated turn).
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import replace
from itertools import pairwise

from sidelong.estimators.sensing.readings import AttitudeReading
from sidelong.mission.control.present import Present
from sidelong.mission.control.surroundings import FlightBounds
from sidelong.mission.core.feasibility import fits_band
from sidelong.mission.core.inputs import Input
from sidelong.mission.core.plan import AircraftState, Plan
from sidelong.mission.core.requirement import GRAVITY_M_S2, Aircraft, Requirement, Wind, widest_radius_m
from sidelong.mission.geometry.line_kernel import craft_of, sharpness_per_m2
from sidelong.mission.geometry.progress import nearest_arc_m, point_at

_HEIGHT_M, _FLOOR_M, _CLEARANCE_M = 15.0, 5.0, 15.0  # how far an autopilot may be off the height of its plan
_PATH_M, _FENCE_M = 60.0, 15.0  # the same across its path; transitions are judged closer: see PlanChanges
_STRAYED_KEPT = math.exp(-1.0 / 60.0)  # of how far the aircraft strayed, in a second
_OFF_M = 20.0  # farther off its plan an aircraft may not roll as fast as it has to
_LASTS_S, _OVER_S = 2.0, 3.0  # a breach is reported after the one and is over after the other
# A target's way over two times, s, against its limit: the share of it and the speed, m/s, allowed for errors.
_PACES = ((10.0, 1.3, 1.2), (30.0, 1.15, 0.5))
_PACE_SETTLED_S, _PACE_LASTS_S, _SLOWEST_M_S = 30.0, 3.0, 1.0
_SEEN_S, _UNSEEN_S = 3.0, 20.0  # the target's position is uncertain after the one, and its track after the other
_HOME_M, _HOME_HEIGHT_M = 30.0, 5.0
_AIRSPEED_SHARE, _AIRSPEED_OVER_S = 0.3, 90.0  # moderate gusts last 20 s and look alike
_RESERVE, _LEAST_RESERVE = 1.25, 1.1  # of the radius, for what the autopilot corrects
_ROLL_SHARE = 0.5  # rad that the aircraft may turn on a circle in the time that it takes to roll into it
_ADAPTED_S = 10.0  # a limit that was learned is reported for this time at least
_STEADY_S, _STEADY_RAD, _TURNING_RAD = 3.0, math.radians(4.0), math.radians(5.0)
_SHORT_RAD, _WIDE_M, _WIDE_SHARE = math.radians(5.0), 10.0, 0.25
_ROLLED_RAD, _EVEN_RAD, _ROLL_SHORT = math.radians(9.0), math.radians(1.0), 0.8
_ROLLS = 3  # as fast as each other: a limit
_FASTER, _FASTEST_S = 1.3, 300.0  # no limit is what the aircraft rolled this much faster than within this time
_EFFICIENCY_MIN, _EFFICIENCY_MAX, _EFFICIENCY_OVER_S = 0.6, 1.0, 10.0


class _Approach:
    """Whether an error is within a tolerance, or decreases by a step in time; it may be larger for ``leaving_s``."""

    def __init__(self, tolerance: float, step: float, within_s: float, leaving_s: float) -> None:
        self.tolerance, self._step, self._within_s, self._leaving_s = tolerance, step, within_s, leaving_s
        self.begin()

    def begin(self) -> None:
        """Begin with another goal."""
        self._best, self._best_s = math.inf, -math.inf

    @property
    def arrives(self) -> bool:
        """Whether the goal has not been reached yet."""
        return self._best > self.tolerance

    def is_off(self, now_s: float, error: float) -> bool:
        """Return whether the error is too large and does not decrease."""
        if error <= self.tolerance or error < self._best - self._step:
            self._best, self._best_s = error, now_s
        return now_s - self._best_s > (self._within_s if self.arrives else self._leaving_s)


class _Turns:
    """What the aircraft reaches in turns: bank, roll rate, and the share of a coordinated turn."""

    def __init__(self) -> None:
        self.efficiency = 1.0
        self._rolls: deque[AttitudeReading] = deque()
        self._fastest_rad_s, self._fastest_s = 0.0, -math.inf
        self._steady_rolls: deque[tuple[float, float]] = deque(maxlen=_ROLLS)  # when, and how fast

    def note(self, reading: AttitudeReading) -> None:
        """Process an attitude."""
        rolls = self._rolls
        if rolls and abs(reading.time_s - rolls[-1].time_s) > _STEADY_S:
            rolls.clear()
        elif rolls and reading.time_s <= rolls[-1].time_s:
            return
        rolls.append(reading)
        while rolls[0].time_s < reading.time_s - _STEADY_S - 0.01:
            rolls.popleft()
        before = next(one for one in rolls if one.time_s >= reading.time_s - 1.01)
        rolled_rad = abs(reading.roll_rad - before.roll_rad)  # in a second
        if rolled_rad >= self._fastest_rad_s or reading.time_s - self._fastest_s > _FASTEST_S:
            self._fastest_rad_s, self._fastest_s = rolled_rad, reading.time_s

    def bank_rad(self) -> float | None:
        """Return the mean bank while it has been steady for some seconds; positive to the right."""
        rolls = [one.roll_rad for one in self._rolls]
        if not self._is_filled or max(rolls) - min(rolls) > _STEADY_RAD:
            return None
        return sum(rolls) / len(rolls)

    @property
    def _is_filled(self) -> bool:
        rolls = self._rolls
        return len(rolls) >= 3 and rolls[-1].time_s - rolls[0].time_s > 0.6 * _STEADY_S

    def learn(self, bank_rad: float, airspeed_m_s: float) -> None:
        """Compare the turn of a steady bank with that of a coordinated turn."""
        recent = self._rolls
        if abs(bank_rad) < 2.0 * _TURNING_RAD or airspeed_m_s <= 0.0:
            return
        passed_s = recent[-1].time_s - recent[0].time_s
        turned_rad = sum(math.remainder(b.yaw_rad - a.yaw_rad, math.tau) for a, b in pairwise(recent))
        share = turned_rad * airspeed_m_s / (passed_s * GRAVITY_M_S2 * math.tan(bank_rad))
        share = min(max(share, _EFFICIENCY_MIN), _EFFICIENCY_MAX)
        self.efficiency += (share - self.efficiency) / _EFFICIENCY_OVER_S

    def roll_limit_rad_s(self, *, is_off: bool) -> float:
        """Return the rate of several steady rolls off the plan that none exceeds by much; infinity: none is known."""
        recent, rolls = self._rolls, self._steady_rolls
        if is_off and self._is_filled:
            first, last = recent[0], recent[-1]
            rate = (last.roll_rad - first.roll_rad) / (last.time_s - first.time_s)
            off_rad = max(abs(one.roll_rad - first.roll_rad - rate * (one.time_s - first.time_s)) for one in recent)
            if abs(last.roll_rad - first.roll_rad) > _ROLLED_RAD and off_rad < _EVEN_RAD:
                if rolls and last.time_s - rolls[-1][0] < _STEADY_S:  # it goes on
                    rolls.pop()
                rolls.append((last.time_s, abs(rate)))
        if len(rolls) < _ROLLS or rolls[-1][0] - rolls[0][0] > _FASTEST_S:
            return math.inf
        rates_rad_s = [rate for _, rate in rolls]
        return max(rates_rad_s) if self._fastest_rad_s < _FASTER * min(rates_rad_s) else math.inf


class Envelope:
    """The monitor of one flight."""

    def __init__(self, bounds: FlightBounds, aircraft: Aircraft, requirement: Requirement) -> None:
        self.faults: dict[Input, str] = {}  # what is breached, in words, until it is over
        self.judges = True  # not so in the log of another program's flight
        self.aircraft, self.floor_m, self.off_m = aircraft, -math.inf, 0.0
        self._bounds, self._configured, self._requirement = bounds, aircraft, requirement
        self._since_s: dict[Input, float] = {}
        self._over_s: dict[Input, float] = {}
        self._kinds: dict[Input, str] = {}
        self._height = _Approach(_HEIGHT_M, 2.0, 12.0, 1.0)
        self._path = _Approach(_PATH_M, 10.0, 25.0, 2.0)
        self._to_m, self._plan = math.nan, None  # type: tuple[float, Plan | None]
        self._track: deque[tuple[float, float, float]] = deque()  # of the target: time, east and north
        self.target_before = (-math.inf, 0.0, 0.0)  # the same before it moved too fast
        self._wind, self._airspeed_m_s = Wind(), math.nan
        self.turns = _Turns()
        self.strayed_m = 0.0  # how far off its plan it was lately
        self._reported_rad = self._reached_rad = math.inf  # bank limits
        self._rolls_rad_s, self._short = math.inf, 0
        self._limit, self._learned_s, self._now_s = "", -math.inf, -math.inf  # what was learned last, and when

    @property
    def is_unflyable(self) -> bool:
        """Whether the plan cannot be flown by what was learned just now."""
        return self._learned_s == self._now_s and self.off_m > _OFF_M

    @property
    def has_room(self) -> bool:
        """Whether the narrowest circle that the aircraft can fly fits into the range band."""
        return self.aircraft is self._configured or fits_band(self.aircraft, self._requirement)

    def configure(self, aircraft: Aircraft, requirement: Requirement) -> None:
        """Use other limits, or another requirement, of an operator."""
        self._configured, self._requirement = aircraft, requirement
        self._learn()

    def forget_target(self) -> None:
        """Judge the target's speed by later estimates only."""
        self._track.clear()
        self.target_before = -math.inf, 0.0, 0.0

    def bank_limit_reported(self, bank_rad: float) -> None:
        """Process the autopilot's bank limit."""
        limit_rad = bank_rad if bank_rad < self._configured.bank_max_rad - 0.01 else math.inf
        if limit_rad != self._reported_rad:
            self._reported_rad = limit_rad
            self._learn(f"by its parameters it banks {math.degrees(bank_rad):.0f} degrees at most")

    def _judge_roll(self) -> None:
        """Learn a roll rate that the aircraft does not exceed when it is off its plan."""
        own, rate_rad_s = self.aircraft, self.turns.roll_limit_rad_s(is_off=self.off_m > _WIDE_M)
        planned_rad_s = own.airspeed_m_s**3 * sharpness_per_m2(own.airspeed_m_s, craft_of(own)) / GRAVITY_M_S2
        if rate_rad_s < min(_ROLL_SHORT * planned_rad_s, self._rolls_rad_s):
            self._rolls_rad_s = rate_rad_s
            self._learn(f"it rolls {math.degrees(rate_rad_s):.0f} degrees/s at most")

    def _learn(self, limit: str = "") -> None:
        """Widen the circle as far as bank and roll rate ask for, with a reserve where the band leaves room."""
        own = self._configured
        if limit:
            self._limit, self._learned_s = limit, self._now_s
        bank_rad = min(self._reported_rad, self._reached_rad)
        if bank_rad >= own.bank_max_rad and self._rolls_rad_s >= own.roll_rate_max_rad_s:
            self.aircraft = own
            return
        tangent = math.tan(own.bank_max_rad)
        if bank_rad < own.bank_max_rad:
            tangent = self.turns.efficiency * math.tan(bank_rad)
        rolls_rad_s = min(own.roll_rate_max_rad_s, self._rolls_rad_s)
        limited = replace(own, bank_max_rad=math.atan(tangent), roll_rate_max_rad_s=rolls_rad_s, configured=own)
        band_m = self._requirement.range_min_m, self._requirement.range_max_m
        speed_m_s, per_m = own.airspeed_m_s, 1.0 / (GRAVITY_M_S2 * tangent)
        spared_m = min(_RESERVE * (speed_m_s + self._wind.speed_m_s) ** 2 * per_m, widest_radius_m(*band_m))
        radius_m = max(own.radius_m, _LEAST_RESERVE * speed_m_s**2 * per_m, spared_m)
        if limited.roll_rate_max_rad_s < own.roll_rate_max_rad_s:
            while speed_m_s * limited.roll_s(1.0 / radius_m) > _ROLL_SHARE * radius_m:
                radius_m *= 1.02
        self.aircraft = replace(limited, radius_m=float(math.ceil(radius_m)))

    def _judge_bank(self, now: Present, here: AircraftState, plan: Plan) -> None:
        """Learn a bank that is not exceeded although the aircraft is carried out of its turn."""
        point = point_at(plan, nearest_arc_m(plan, here), here)
        self.off_m = math.hypot(here.east_m - point.east_m, here.north_m - point.north_m)
        self.strayed_m = max(self.strayed_m * _STRAYED_KEPT, 0.0 if self._path.arrives else self.off_m)
        self._judge_roll()
        bank_rad = self.turns.bank_rad()
        if bank_rad is None:
            self._short = 0
            return
        self.turns.learn(bank_rad, _airspeed_m_s(here, now.wind))
        sense = math.copysign(1.0, point.curvature_per_m)
        reached_rad = sense * bank_rad
        needed = here.ground_speed_m_s**2 * abs(point.curvature_per_m) / GRAVITY_M_S2 / self.turns.efficiency
        east_m, north_m = here.east_m - point.east_m, here.north_m - point.north_m
        right_m = east_m * math.cos(point.course_rad) - north_m * math.sin(point.course_rad)
        is_short = _TURNING_RAD < reached_rad < min(math.atan(needed), self.aircraft.bank_max_rad) - _SHORT_RAD
        is_wide = -sense * right_m > _WIDE_M + _WIDE_SHARE * plan.circle.radius_m
        self._short = self._short + 1 if is_short and is_wide else 0
        if self._short >= _LASTS_S:
            self._reached_rad, self._short = reached_rad, 0
            self._learn(f"it banks {math.degrees(reached_rad):.0f} degrees at most")
        elif abs(bank_rad) > self._reached_rad + _SHORT_RAD:
            self._reached_rad = math.inf
            self._learn()

    def step(self, now: Present) -> None:
        """Judge the present moment; ``faults`` has the result."""
        here, plan = now.aircraft, now.plan
        if not self.judges or here is None or plan is None:
            self.faults.clear()
            return
        if not now.phase.in_control:
            self._step_without_control(now, here, plan)
            return
        self._wind, self._now_s = now.wind, now.time_s
        if plan is not self._plan:
            self._plan = plan
            self._path.begin()
        self._judge_bank(now, here, plan)
        self._judge(now, Input.HEIGHT, *self._of_height(now, here, plan))
        self._judge(now, Input.FENCE, *self._of_fences(here))
        self._judge(now, Input.PATH, *self._of_path(here, plan))
        self._judge(now, Input.AIRCRAFT, *self._of_aircraft(now, here, plan), lasts_s=0.0)
        self._judge(now, Input.SPEED, *self._of_target(now), lasts_s=_PACE_LASTS_S)
        self._judge(now, Input.HOME, *_of_home(now), lasts_s=0.0)
        self._judge(now, Input.ORDERS, "orders", now.orders, lasts_s=0.0)

    def _step_without_control(self, now: Present, here: AircraftState, plan: Plan) -> None:
        """Judge what was breached when control was given up until it is over; the plan is not flown any more."""
        for watched in tuple(self.faults):
            kind, fault = self._of_height(now, here, plan) if watched is Input.HEIGHT else self._of_fences(here)
            if watched not in (Input.HEIGHT, Input.FENCE) or kind == "plan":
                del self.faults[watched]
            else:
                self._judge(now, watched, kind, fault)

    def _judge(self, now: Present, watched: Input, kind: str, fault: str, lasts_s: float = _LASTS_S) -> None:
        """Raise a fault that lasts, and drop it when it is over. kind: what of the input is breached."""
        if not fault:
            if watched in self._since_s:
                del self._since_s[watched]
            if watched not in self._over_s:
                self._over_s[watched] = now.time_s
            if watched in self.faults and now.time_s - self._over_s[watched] >= _OVER_S:
                del self.faults[watched]
            return
        self._over_s.pop(watched, None)
        if now.time_s - self._since_s.setdefault(watched, now.time_s) < lasts_s:
            return
        if watched not in self.faults or self._kinds[watched] != kind:
            self._kinds[watched], self.faults[watched] = kind, fault

    def _of_height(self, now: Present, here: AircraftState, plan: Plan) -> tuple[str, str]:
        bounds, height_m, to_m = self._bounds, now.height_m, plan.circle_height_m(self._bounds.height_m)
        heights = plan.heights
        is_between = heights is not None and (
            -_HEIGHT_M < (height_m - min(heights.from_m, to_m)) < abs(heights.from_m - to_m) + _HEIGHT_M
        )
        if not abs(to_m - self._to_m) < 2.0 or (is_between and nearest_arc_m(plan, here) < plan.transition_m):
            self._to_m = to_m  # on a transition the autopilot may change its height at any time
            self._height.begin()
        is_off = self._height.is_off(now.time_s, abs(height_m - to_m)) if math.isfinite(to_m) else False
        planned_m = to_m if math.isfinite(to_m) else math.inf
        self.floor_m = min(bounds.floor_m, planned_m - _FLOOR_M)
        stands = f"{height_m:.0f} m above home"
        clear_m = bounds.clear_m(here.east_m, here.north_m, height_m)
        if math.isfinite(clear_m) and clear_m < -min(_CLEARANCE_M, 0.5 * bounds.clearance_m):
            return "ground", f"{max(bounds.clearance_m + clear_m, 0.0):.0f} m above the ground, less than required"
        if height_m < self.floor_m and not (self._height.arrives and not is_off):
            return "floor", f"{stands}, below the floor of {bounds.floor_m:.0f} m"
        if height_m > max(bounds.ceiling_m, to_m + _FLOOR_M if math.isfinite(to_m) else -math.inf):
            return "ceiling", f"{stands}, above the ceiling of {bounds.ceiling_m:.0f} m"
        return "plan", f"{stands}, its plan is at {to_m:.0f} m" if is_off else ""

    def _of_fences(self, here: AircraftState) -> tuple[str, str]:
        inside_m = self._bounds.inside_m(here.east_m, here.north_m)
        is_out = inside_m < -max(_FENCE_M - self._bounds.margin_m, 0.0)
        return "fence", f"the aircraft is {-inside_m:.0f} m outside the fences" if is_out else ""

    def _of_path(self, here: AircraftState, plan: Plan) -> tuple[str, str]:
        self._path.tolerance = max(_PATH_M, plan.circle.radius_m)
        is_off = self._path.is_off(here.time_s, self.off_m)
        return "path", f"the aircraft is {self.off_m:.0f} m off its plan" if is_off else ""

    def _of_aircraft(self, now: Present, here: AircraftState, plan: Plan) -> tuple[str, str]:
        own = self.aircraft
        if not self.has_room:
            return "room", f"{self._limit}: no circle that it can fly fits between the least and the greatest range"
        is_adapted = own is self._configured or now.time_s - self._learned_s >= _ADAPTED_S
        if not is_adapted or plan.circle.radius_m < own.radius_m - 1.0:
            return self._limit, f"{self._limit}: planning for that, with circles of {own.radius_m:.0f} m"
        speed_m_s, share = _airspeed_m_s(here, now.wind), 1.0 / _AIRSPEED_OVER_S
        mean_m_s = own.airspeed_m_s if math.isnan(self._airspeed_m_s) else self._airspeed_m_s
        self._airspeed_m_s = mean_m_s = mean_m_s + share * (speed_m_s - mean_m_s)
        is_off = now.wind != Wind() and abs(mean_m_s / own.airspeed_m_s - 1.0) > _AIRSPEED_SHARE
        text = f"it flies {mean_m_s:.0f} m/s through the air, aircraft.airspeed_m_s is {own.airspeed_m_s:.0f}"
        return "airspeed", text if is_off else ""

    def _of_target(self, now: Present) -> tuple[str, str]:
        track, target = self._track, now.estimate
        unseen_s = math.inf if target is None or now.turn_payload else now.time_s - target.last_sighting_s
        if target is None or unseen_s > _SEEN_S:
            if unseen_s > _UNSEEN_S:
                track.clear()
            return "", ""
        track.append((now.time_s, *target.position_m(now.time_s)))
        limit_m_s, (longest_s, _, _) = max(now.requirement.target_speed_max_m_s, _SLOWEST_M_S), _PACES[-1]
        while track[0][0] < now.time_s - longest_s - _PACE_SETTLED_S:
            track.popleft()
        for over_s, share, error_m_s in _PACES:
            since = next((one for one in reversed(track) if one[0] <= now.time_s - over_s), None)
            if since is None or since[0] - track[0][0] < _PACE_SETTLED_S - over_s:
                continue
            pace_m_s = math.dist(since[1:], track[-1][1:]) / (now.time_s - since[0])
            if pace_m_s > share * limit_m_s + error_m_s:
                self.target_before = since
                text = f"{pace_m_s:.0f} m/s, its limit is {now.requirement.target_speed_max_m_s:g} m/s"
                return "speed", f"{text}: the payload may follow another object"
        return "", ""


def _of_home(now: Present) -> tuple[str, str]:
    away_m, above_m = now.home_moved_m
    if away_m <= _HOME_M and abs(above_m) <= _HOME_HEIGHT_M:
        return "", ""
    words = f"{abs(above_m):.0f} m {'higher' if above_m > 0.0 else 'lower'}"
    text = f"the autopilot's home was set elsewhere, {away_m:.0f} m away and {words}: plans keep their heights"
    return words, text


def _airspeed_m_s(here: AircraftState, wind: Wind) -> float:
    east_m_s = here.ground_speed_m_s * math.sin(here.course_rad) - wind.east_m_s
    return math.hypot(east_m_s, here.ground_speed_m_s * math.cos(here.course_rad) - wind.north_m_s)

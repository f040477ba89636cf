"""Guidance laws and programs of the user: a curvature in, the state out, without autopilot or missions.

They fly the simulator's airframe directly, and know the target by the product's own filter.
"""

from __future__ import annotations

import math
import os
import select
import shlex
import subprocess
import time
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from sidelong.app.errors import InputError
from sidelong.app.simulation.kinematic import Body, put_in_flight
from sidelong.app.simulation.target import STEP_S, Payload
from sidelong.app.study.judging import RunResult, judged
from sidelong.app.study.scene import StopWatch, StudyScene, first_circle, payload_of, scene, start_on
from sidelong.app.study.settings import CONTROLLER, LVFG, ORBIT, PARK, StudySettings
from sidelong.estimators.estimate import TargetEstimate
from sidelong.estimators.sensing.readings import AttitudeReading, PositionReading, Reading
from sidelong.estimators.sensing.sighting import AnySighting
from sidelong.estimators.tracking.tracker import Tracker
from sidelong.mission.core.circle import Circle
from sidelong.mission.core.path import FloatArray
from sidelong.mission.core.plan import AircraftState
from sidelong.mission.core.requirement import GRAVITY_M_S2
from sidelong.mission.laws.course_field import LateralGuidance, StandoffOrbit, VectorField
from sidelong.sitl.world import airframe
from sidelong.sitl.world.turbulence import turbulence

COLUMNS = (
    *("time_s", "aircraft_east_m", "aircraft_north_m", "aircraft_course_rad", "ground_speed_m_s"),
    *("turn_rate_rad_s", "turn_rate_max_rad_s", "target_east_m", "target_north_m", "target_velocity_east_m_s"),
    *("target_velocity_north_m_s", "target_sigma_m", "range_min_m", "range_max_m", "side"),
)  # columns of a row; docs/how-to/benchmark.md describes them

_START_S, _ANSWER_S, _END_S = 60.0, 10.0, 2.0
_ANSWER_MAX_BYTES = 200


class ExternalController:
    def __init__(self, command: str, curvature_max_per_m: float, range_m: tuple[float, float], side: str) -> None:
        """Start a command, which no shell interprets, and send the header. Raises InputError if it does not start."""
        if not command.strip():
            raise InputError("--controller: the command is empty; give a program and its arguments.")
        self._command, self._curvature_max_per_m = command, curvature_max_per_m
        self._constant = f"{range_m[0]:g},{range_m[1]:g},{side}\n"
        self._rows, self._wait_s, self._answers = 0, _START_S, b""
        try:
            self._process = subprocess.Popen(
                shlex.split(command), stdin=subprocess.PIPE, stdout=subprocess.PIPE, bufsize=0
            )
        except (OSError, ValueError) as error:
            raise InputError(f"--controller: {command!r} cannot be started ({error}); give a command.") from error
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._in, self._out = self._process.stdin, self._process.stdout
        self._send(",".join(COLUMNS) + "\n")

    def __call__(self, aircraft: AircraftState, target: TargetEstimate) -> float:
        """Return the curvature that the controller commands, 1/m, positive to the right and not limited.

        Raises InputError: the process has ended, does not answer in time, or answers something else than a number.
        """
        speed_m_s, p = max(aircraft.ground_speed_m_s, 1.0), target.covariance
        sigma_m = math.sqrt(max(0.5 * (p[0, 0] + p[1, 1]), 0.0))
        values = (
            *(aircraft.time_s, aircraft.east_m, aircraft.north_m, aircraft.course_rad, speed_m_s),
            *(speed_m_s * aircraft.curvature_per_m, speed_m_s * self._curvature_max_per_m),
            *(target.east_m, target.north_m, target.velocity_east_m_s, target.velocity_north_m_s, sigma_m),
        )
        self._send(",".join(f"{value:.6f}" for value in values) + "," + self._constant)
        self._rows += 1
        answer = self._line()
        try:
            turn_rate_rad_s = float(answer)
        except ValueError:
            turn_rate_rad_s = math.nan
        if not math.isfinite(turn_rate_rad_s):
            raise self._error(f"answered {answer[:40]!r}", "print one turn rate in rad/s for each row")
        return turn_rate_rad_s / speed_m_s

    def __enter__(self) -> ExternalController:
        return self

    def __exit__(self, kind: object, *_: object) -> None:
        """End the process: its input ends first, then it is killed."""
        self._in.close()
        try:
            self._process.wait(_END_S if kind is None else 0.0)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._out.close()

    def _send(self, words: str) -> None:
        """Write a row. Raises InputError where the process does not read, or has answered before it."""
        early, free, _ = select.select([self._out], [self._in], [], _ANSWER_S)
        if self._answers or (early and os.read(self._out.fileno(), 1)):
            raise self._error("answered before it got a row", "print one turn rate for each row, none for the header")
        if not free:
            raise self._error("did not read in time", "read each row before it answers")
        try:
            self._in.write(words.encode())
        except OSError as error:
            raise self._ended() from error

    def _line(self) -> str:
        """Return the next line of the answers."""
        until_s, self._wait_s = time.monotonic() + self._wait_s, _ANSWER_S
        while b"\n" not in self._answers:
            ready, _, _ = select.select([self._out], [], [], max(until_s - time.monotonic(), 0.0))
            if not ready:
                raise self._error("did not answer in time", "flush its output after each row")
            found = os.read(self._out.fileno(), 4096)
            if not found:
                raise self._ended()
            self._answers += found
            if len(self._answers) > _ANSWER_MAX_BYTES:
                raise self._error("answered too much", "print one turn rate in rad/s for each row")
        line, _, self._answers = self._answers.partition(b"\n")
        return line.decode(errors="replace").strip()

    def _ended(self) -> InputError:
        try:
            code = str(self._process.wait(_END_S))
        except subprocess.TimeoutExpired:
            code = "none"
        return self._error(f"ended (exit code {code})", "read rows until its input ends")

    def _error(self, what: str, remedy: str) -> InputError:
        return InputError(f"--controller: {self._command!r} {what} after row {self._rows}; it has to {remedy}.")


SEEN_EVERY = 2  # steps from one sighting, and one command, to the next
# Of the curvature limit: what correcting the flown line may ask for beyond the circle itself.
_BANK_RESERVE = 1.1

# The guidance laws, tuned by grid search over 20 other targets with perfect sensors: of those that always keep the
# band the one most on the side, with room to both edges. Radii 150 to 400 m, gains 0.25 to 2 1/s, look-aheads 40 to
# 180 m; the other way round they are on the side for 42 % of the time. The orbit: ten targets, radii 300 to 400 m,
# approaches 0.005 to 0.03 1/m, gains 0.25 to 1 1/s.
_FIELD_RADIUS_M, _FIELD_GAIN_PER_S = 350.0, 0.25
_LATERAL_RADIUS_M, _LATERAL_LOOK_AHEAD_M = 350.0, 80.0
_ORBIT_RADIUS_M, _ORBIT_GAIN_PER_S, _ORBIT_APPROACH_PER_M = 300.0, 0.25, 0.005

GuidanceLaw = Callable[[AircraftState, TargetEstimate], float]
Command = tuple[float, float]  # curvature, 1/m, positive to the right, and airspeed, m/s


class SteeredAircraft:
    """An aircraft that flies commanded curvatures, with a payload and the filter of its sightings."""

    def __init__(
        self,
        settings: StudySettings,
        flown: StudyScene,
        circle: Circle,
        height_m: float,
        noise_rng: np.random.Generator,
    ) -> None:
        own, wind = settings.aircraft(), settings.wind
        circle_bank_rad = math.atan(own.airspeed_m_s**2 / (GRAVITY_M_S2 * settings.still_air_radius_m))
        self._bank_max_rad = math.atan(_BANK_RESERVE * math.tan(circle_bank_rad))
        body = Body(own.airspeed_m_s, roll_rate_max_rad_s=own.roll_rate_max_rad_s, lag_s=settings.lag_s)
        self._craft = airframe.SimulatedAirframe(body.build, airframe.WindVector(wind.east_m_s, wind.north_m_s))
        put_in_flight(self._craft, start_on(settings, flown, circle), height_m)
        self._craft.turbulence = turbulence(settings.config.simulation.turbulence, noise_rng)
        errors, assumed = payload_of(settings)
        self._payload = Payload(errors, noise_rng)
        self.tracker = Tracker(replace(assumed, latency_sigma_s=0.0))  # its stamps are right
        self.command: Command = circle.curvature_per_m, own.airspeed_m_s
        self.rows: list[tuple[float, float, float]] = []

    def state(self, time_s: float) -> AircraftState:
        """Return the true state, its curvature from the bank."""
        craft = self._craft
        speed_m_s = craft.ground_speed_m_s
        curvature_per_m = GRAVITY_M_S2 * math.tan(craft.roll_rad) * self._across / max(speed_m_s, 1.0) ** 2
        return AircraftState(time_s, craft.east_m, craft.north_m, craft.course_rad, speed_m_s, curvature_per_m)

    @property
    def _across(self) -> float:
        """The share of the lateral acceleration, which is square to the nose, that turns the course in wind."""
        return max(math.cos(self._craft.course_rad - self._craft.heading_rad), 0.1)

    def look(self, time_s: float, target_east_m: float, target_north_m: float) -> list[AnySighting]:
        """Measure, and return the sightings that this completes."""
        craft = self._craft
        here_m = craft.east_m, craft.north_m, craft.height_m
        velocity_m_s = craft.velocity_east_m_s, craft.velocity_north_m_s
        readings: list[Reading] = [
            PositionReading(time_s, *here_m, *velocity_m_s, 0.0),
            AttitudeReading(time_s, craft.roll_rad, 0.0, craft.yaw_rad),
        ]
        to_m = craft.pointed_m((target_east_m - here_m[0], target_north_m - here_m[1], -here_m[2]))
        readings += self._payload.measure(time_s, round(1e3 * time_s), *to_m, heading_rad=craft.yaw_rad)
        return [outcome.sighting for reading in readings for outcome in self.tracker.add(reading)]

    def fly(self, time_s: float) -> None:
        """Note the position and fly the command for a step, within the bank limit."""
        craft, (curvature_per_m, airspeed_m_s) = self._craft, self.command
        self.rows.append((time_s, craft.east_m, craft.north_m))
        bank_rad = math.atan(craft.ground_speed_m_s**2 * curvature_per_m / (GRAVITY_M_S2 * self._across))
        bank_rad = max(-self._bank_max_rad, min(self._bank_max_rad, bank_rad))
        craft.fly(STEP_S, bank_rad, airspeed_m_s, 0.0)


def fly_steered(
    flown: StudyScene,
    crafts: Sequence[SteeredAircraft],
    estimate: Callable[[float, Sequence[Sequence[AnySighting]]], TargetEstimate | None],
    steer: Callable[[Sequence[AircraftState], TargetEstimate], Sequence[Command]],
) -> FloatArray:
    """Fly a run to its end, by the estimate of each aircraft's sightings and the commands of each.

    Returns time, aircraft and target (east, north) and course of the target, of each step, (crafts, n, 6).
    """
    time_s: FloatArray = STEP_S * np.arange(round(flown.duration_s / STEP_S), dtype=np.float64)
    truth = flown.target.sampled(time_s)
    for k, (now_s, (east_m, north_m)) in enumerate(zip(time_s.tolist(), truth[:, :2].tolist(), strict=True)):
        if k % SEEN_EVERY == 0:
            found = estimate(now_s, [craft.look(now_s, east_m, north_m) for craft in crafts])
            if found is not None:
                commands = steer([craft.state(now_s) for craft in crafts], found)
                for craft, command in zip(crafts, commands, strict=True):
                    craft.command = command
        for craft in crafts:
            craft.fly(now_s)
    return np.stack([np.hstack([np.array(craft.rows), truth[:, [0, 1, 4]]]) for craft in crafts])


def run_law(settings: StudySettings, planner: str, number: int, keep_track: bool = False) -> RunResult:
    """Fly one run by a law that circles the target, or by the user's controller, with the same noise for each."""
    flown = scene(settings, number)
    circle = first_circle(settings, flown)
    craft = SteeredAircraft(settings, flown, circle, settings.config.aircraft.height_m, flown.sensor_rng)
    watch, airspeed_m_s = StopWatch(), settings.aircraft().airspeed_m_s

    def fly(law: GuidanceLaw) -> FloatArray:
        (log,) = fly_steered(
            flown,
            [craft],
            lambda time_s, _seen: craft.tracker.estimate(time_s),
            lambda states, target: [(watch(lambda: law(states[0], target)), airspeed_m_s)],
        )
        return np.asarray(log)

    clockwise = settings.requirement().side.clockwise
    if planner == CONTROLLER:
        limit_per_m, wanted = _BANK_RESERVE / settings.still_air_radius_m, settings.config.requirement
        band_m = wanted.range_min_m, wanted.range_max_m
        with ExternalController(settings.controller, limit_per_m, band_m, wanted.side) as controller:
            return judged(settings, fly(controller), [], watch.taken_s, keep_track)
    law = {
        LVFG: VectorField(_FIELD_RADIUS_M, clockwise, _FIELD_GAIN_PER_S).curvature_per_m,
        ORBIT: StandoffOrbit(_ORBIT_RADIUS_M, clockwise, _ORBIT_GAIN_PER_S, _ORBIT_APPROACH_PER_M).curvature_per_m,
        PARK: LateralGuidance(_LATERAL_RADIUS_M, clockwise, _LATERAL_LOOK_AHEAD_M).curvature_per_m,
    }[planner]
    return judged(settings, fly(law), [], watch.taken_s, keep_track)

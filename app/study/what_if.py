"""A recorded flight flown on with other values: the closed loop next to the target as it was recorded."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np

from sidelong.app.analysis.replay import Replayed
from sidelong.app.analysis.score import Moment
from sidelong.app.analysis.truth import Truth
from sidelong.app.assembly import mission_controller_of
from sidelong.app.autopilots.autopilot import Autopilot
from sidelong.app.config import Config
from sidelong.app.link.message import Message
from sidelong.app.simulation.kinematic import Body, KinematicVehicle, Start
from sidelong.app.simulation.loop import ClosedLoop
from sidelong.app.simulation.payload import Payload, PayloadErrors
from sidelong.app.study.closed_loop import RATES, OnTicks, put_over
from sidelong.app.study.recorded import STEP_S, RecordedTarget
from sidelong.app.study.settings import LAG_S
from sidelong.estimators.frames import LocalPlane
from sidelong.estimators.sensing.readings import Reading
from sidelong.mission.control.controller import StandoffController
from sidelong.mission.control.present import Present
from sidelong.mission.core.circle import Circle
from sidelong.mission.core.events import StepOutput
from sidelong.mission.core.plan import AircraftState
from sidelong.mission.core.requirement import Wind
from sidelong.mission.exchange.dialect import Home
from sidelong.mission.exchange.mission_controller import DERIVED, InboundEvent, Output

_ON_CIRCLE_M = 50.0  # nearer to it, the aircraft flies the circle of its plan


def _from_line_m(circle: Circle, state: AircraftState) -> float:
    """Return how far an aircraft is from the line of a circle."""
    apart_m = math.hypot(state.east_m - circle.east_m, state.north_m - circle.north_m)
    return abs(apart_m - circle.radius_m)


def recorded_motion(moments: Sequence[Moment], from_s: float) -> RecordedTarget:
    """Return the target's motion in a recording from a moment on."""
    rows = np.array([(one.time_s - from_s, one.target_east_m, one.target_north_m) for one in moments]).T
    steps_s = np.arange(0.0, rows[0, -1], STEP_S)
    return RecordedTarget("recorded", *(np.interp(steps_s, rows[0], row) for row in rows[1:]))


class FlownOn(ClosedLoop[Message | Reading]):
    """A flight that leaves a recorded one at a moment.

    Args:
        config: The values to fly with.
        controller: Its control step, which has seen nothing yet.
        autopilot: Whose missions and guidance the simulated aircraft has.
        plane: Of the recording.
        home_altitude_m: Altitude of home above mean sea level.
        begin: The recorded state at that moment.
        wind: That blows.
        target: The recorded motion from that moment on.
    """

    def __init__(
        self,
        config: Config,
        controller: StandoffController,
        autopilot: Autopilot,
        plane: LocalPlane,
        home_altitude_m: float,
        begin: Present,
        wind: Wind,
        target: RecordedTarget,
    ) -> None:
        state, own, limits, sensors = begin.aircraft, config.aircraft, config.aircraft.aircraft(), config.sensors
        assert state is not None
        circle = None if begin.plan is None else begin.plan.circle
        if circle is None or _from_line_m(circle, state) > _ON_CIRCLE_M:
            place = state.east_m, state.north_m, state.course_rad
            circle = Circle.tangent_to(*place, limits.radius_m, config.requirement.requirement().side.clockwise)
        height_m = begin.height_m if math.isfinite(begin.height_m) else own.height_m
        home = Home(plane.origin_latitude_deg, plane.origin_longitude_deg, home_altitude_m)
        body = Body.configured(own, LAG_S[autopilot.key])
        errors = PayloadErrors(
            sensors.range_sigma_m, math.radians(sensors.angle_sigma_deg), pan_limit_rad=limits.pan_limit_rad
        )
        start = Start(plane, home, circle, height_m, state, begin.time_s)
        self._target, payload = OnTicks(target, target.duration_s), Payload(errors, np.random.default_rng(1))
        vehicle = KinematicVehicle(autopilot, body, wind, start, payload, self._target, RATES)
        super().__init__(vehicle)
        if controller.surroundings.ground is not None:
            put_over(vehicle, controller.surroundings.ground)
        self.telemetry.plane, self._plane, self._duration_s = plane, plane, target.duration_s
        self.controller, self._vehicle, self._begin_s = controller, vehicle, begin.time_s
        self._rows: list[tuple[float, float, float]] = []
        self._steps: list[Replayed] = []
        vehicle.flown = self._flown
        self.listeners.append(self._stepped)
        self.start(lambda _plane: mission_controller_of(config, controller, autopilot, plane, home), vehicle.mode)

    def _flown(self) -> None:
        craft = self._vehicle.craft
        self._rows.append((self._vehicle.flown_s, craft.east_m, craft.north_m))

    def _stepped(self, event: InboundEvent, outputs: tuple[Output, ...]) -> None:
        controller = self.controller
        derived = [output for output in outputs if isinstance(output, DERIVED)]
        commands = tuple(output for output in outputs if isinstance(output, StepOutput))
        self._steps += [Replayed(one, (), controller.estimate, controller.snapshot) for one in derived]
        self._steps.append(Replayed(event, commands, controller.estimate, controller.snapshot))

    def steps(self) -> Iterator[Replayed]:
        """Fly to the end of the recording; yield each step."""
        while True:
            yield from self._steps
            self._steps.clear()
            if self.simulated.time_s >= self._duration_s:
                return
            self.step()

    @property
    def truth(self) -> Truth:
        """The true tracks so far."""
        rows = np.array(self._rows)
        targets = [self._target.at(time_s) for time_s in rows[:, 0].tolist()]
        places = [self._plane.latitude_longitude_deg(one.east_m, one.north_m) for one in targets]
        own = [self._plane.latitude_longitude_deg(*row) for row in rows[:, 1:].tolist()]
        positions_deg = np.hstack([np.array(places), np.array(own)]).T
        count = len(rows)
        return Truth(rows[:, 0] + self._begin_s, positions_deg, np.full((2, count), np.nan), np.full(count, ""))

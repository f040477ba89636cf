"""A vehicle of :mod:`sidelong.sitl` in a closed loop: its modes, missions and guidance, without bytes and streams.

Readings are handed over decoded and status as messages, at fixed rates; only what the exchange sends passes as
frames. It flies by the simulator's own guidance, not by the model with which the way points are laid out.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import astuple, dataclass

from sidelong.app.autopilots.autopilot import Autopilot
from sidelong.app.config import AircraftSection
from sidelong.app.link.frames import Decoder
from sidelong.app.link.message import Message
from sidelong.app.simulation.target import STEP_S, Payload, Target
from sidelong.estimators.frames import LocalPlane
from sidelong.estimators.sensing.readings import AttitudeReading, PositionReading, Reading
from sidelong.mission.core.circle import Circle
from sidelong.mission.core.plan import AircraftState
from sidelong.mission.core.requirement import GRAVITY_M_S2, Wind
from sidelong.mission.exchange.dialect import Home
from sidelong.mission.upload.items import MissionLayout, circle_item
from sidelong.mission.upload.mission_item import e7
from sidelong.sitl import settings as sitl
from sidelong.sitl.arduplane import ArduPlaneMode, SimulatedArduPlane
from sidelong.sitl.protocol.transfer import Item
from sidelong.sitl.px4 import Px4Mode, SimulatedPx4
from sidelong.sitl.world import airframe

_ADDRESS = "loop"
_SYSTEM, _AUTOPILOT = 1, 1
_NAVIGATION_GOOD = 831  # all flags of a healthy EKF
_ROLL_LIMIT = {"arduplane": "ROLL_LIMIT_DEG", "px4": "FW_R_LIM"}


@dataclass(frozen=True, slots=True)
class Rates:
    """How often the vehicle sends, in hertz, 0: never; each divides ``tick_hz``."""

    tick_hz: int = 5
    position_hz: int = 5
    attitude_hz: int = 5
    gimbal_hz: int = 5
    laser_hz: int = 5
    status_hz: int = 1
    mission_current_hz: int = 1


LIVE_RATES = Rates(20, 10, 20, 10, 10, 1, 5)  # as a flight asks for them over a fast link


@dataclass(frozen=True, slots=True)
class Body:
    """What the aircraft can do, at the true airspeed at home's height; lag_s: time constant of the bank."""

    airspeed_m_s: float
    bank_max_rad: float = math.radians(45.0)
    roll_rate_max_rad_s: float = math.radians(60.0)
    lag_s: float = 0.45
    climb_m_s: float = 6.0
    descent_m_s: float = 4.0

    @staticmethod
    def configured(own: AircraftSection, lag_s: float) -> Body:
        """Return the body of a configured aircraft whose roll follows with ``lag_s``."""
        limits = own.aircraft()
        bank_rad, roll_rad_s = limits.bank_max_rad, limits.roll_rate_max_rad_s
        return Body(own.airspeed_m_s, bank_rad, roll_rad_s, lag_s, own.climb_m_s, own.descent_m_s)

    @property
    def build(self) -> airframe.AirframeParameters:
        return airframe.AirframeParameters(
            roll_time_constant_s=max(self.lag_s, STEP_S),  # shorter than a step: within it
            roll_rate_max_rad_s=self.roll_rate_max_rad_s,
            climb_max_m_s=self.climb_m_s,
            sink_max_m_s=self.descent_m_s,
        )


def put_in_flight(craft: airframe.SimulatedAirframe, state: AircraftState, height_m: float) -> None:
    """Let an airframe fly as in ``state``, over ground that it cannot touch."""
    craft.flying, craft.ground_m = True, -math.inf
    craft.east_m, craft.north_m, craft.height_m = state.east_m, state.north_m, height_m
    craft.velocity_east_m_s = state.ground_speed_m_s * math.sin(state.course_rad)
    craft.velocity_north_m_s = state.ground_speed_m_s * math.cos(state.course_rad)
    air_m_s = craft.velocity_east_m_s - craft.wind.east_m_s, craft.velocity_north_m_s - craft.wind.north_m_s
    craft.airspeed_m_s, craft.heading_rad = math.hypot(*air_m_s), math.atan2(*air_m_s)
    turn_rad_s = state.ground_speed_m_s * state.curvature_per_m
    craft.roll_rad = math.atan(craft.airspeed_m_s * turn_rad_s / GRAVITY_M_S2)


@dataclass(frozen=True, slots=True)
class Start:
    """How a flight begins: circling, with that circle as its mission. boot_s: the vehicle's clock then."""

    plane: LocalPlane
    home: Home
    circle: Circle
    height_m: float
    state: AircraftState
    boot_s: float = 100.0


class KinematicVehicle:
    """One vehicle of an autopilot's kind, with its payload, if any, and the target that this looks at.

    Attributes:
        time_s: since the start of the simulation.
        flown: called after each step of the airframe.
        seen_at_m: returns the height of the target's ground above home, from the aircraft's place (east, north,
            height) and the target's (east, north); None where the ground hides it. None: flat ground.
    """

    system_id = _SYSTEM

    def __init__(
        self,
        autopilot: Autopilot,
        body: Body,
        wind: Wind,
        start: Start,
        payload: Payload | None,
        target: Target,
        rates: Rates = Rates(),  # frozen
    ) -> None:
        self.target = target
        self.flown: Callable[[], object] = lambda: None
        self.seen_at_m: Callable[[tuple[float, float, float], float, float], float | None] | None = None
        self._autopilot, self._start = autopilot, start
        self._payload, self._rates = payload, rates
        tick_hz, *each_hz = astuple(rates)
        if any(tick_hz % rate_hz for rate_hz in each_hz if rate_hz):
            raise ValueError(f"the rates {tuple(each_hz)} do not divide {tick_hz} Hz")
        self._due = [
            [rate_hz > 0 and tick % (tick_hz // rate_hz) == 0 for rate_hz in each_hz] for tick in range(tick_hz)
        ]
        self.tick_s = 1.0 / tick_hz
        self._tick, self.time_s, self.flown_s = 0, 0.0, 0.0
        self._sent: list[Message | Reading] = []
        self._decoder = Decoder()
        self.simulated = self._in_flight(body, wind)
        self.craft = self.simulated.craft
        self._station = self.simulated.radio.connect(_ADDRESS, start.boot_s)

    def _in_flight(self, body: Body, wind: Wind) -> SimulatedArduPlane | SimulatedPx4:
        """Return the simulator's vehicle on its circle, with that as its mission, as an earlier upload left it."""
        autopilot, start = self._autopilot, self._start
        settings = sitl.Settings(
            sitl.Flavour(autopilot.key),
            system_id=self.system_id,
            airspeed_m_s=body.airspeed_m_s,
            wind=airframe.WindVector(wind.east_m_s, wind.north_m_s),
            home=sitl.HomePosition(start.home.latitude_deg, start.home.longitude_deg, start.home.altitude_m),
            payload=None,
        )
        is_px4 = settings.flavour is sitl.Flavour.PX4
        vehicle: SimulatedArduPlane | SimulatedPx4 = (
            SimulatedPx4(settings) if is_px4 else SimulatedArduPlane(settings)
        )
        vehicle.parameters.set(_ROLL_LIMIT[autopilot.key], math.degrees(body.bank_max_rad))
        vehicle.now_s, vehicle.armed = start.boot_s, True
        vehicle.craft.build = body.build
        put_in_flight(vehicle.craft, start.state, start.height_m)
        loiter = circle_item(start.circle, start.plane, start.height_m)
        head, tail = autopilot.head(start.home), autopilot.tail(start.home)
        layout = MissionLayout((*head, loiter, *tail), len(head), len(head), len(head) + 1, autopilot.min_items)
        items = layout.filled().items
        mission = vehicle.mission
        mission.begin(len(items))
        for index, i in enumerate(items):
            item = Item(i.command, i.frame, (i.param1, i.param2, i.param3, i.param4), i.x, i.y, i.z)
            mission.put(index, item, current=index == len(head))
        mission.finish()
        mission.index = len(head)
        vehicle.set_mode(Px4Mode.MISSION if is_px4 else ArduPlaneMode.AUTO)
        return vehicle

    # -- as the loop drives it -------------------------------------------------------------------------------

    @property
    def mode(self) -> str:
        return self._autopilot.mode_name(self.simulated.base_mode, self.simulated.mode)

    @property
    def state(self) -> AircraftState:
        """The true state, at the time flown up to."""
        craft = self.craft
        speed_m_s = craft.ground_speed_m_s
        curvature_per_m = craft.yaw_rate_rad_s / max(speed_m_s, 1.0)
        return AircraftState(self.flown_s, craft.east_m, craft.north_m, craft.course_rad, speed_m_s, curvature_per_m)

    def pilot_takes_over(self) -> None:
        """Move the sticks: the flight mode changes without any station's command."""
        self.simulated.set_mode(self.simulated.taken_over_mode)

    def advance(self, to_s: float) -> None:
        """Fly up to a time of the simulation's clock, and send what falls due on the way."""
        simulated, boot_s = self.simulated, self._start.boot_s
        while self.time_s < to_s - 1e-6:
            self._send_due()
            self._tick += 1
            self.time_s = self._tick / self._rates.tick_hz
            while self.flown_s < self.time_s - 1e-6:
                left_s = self.time_s - self.flown_s
                step_s = left_s if left_s < STEP_S else STEP_S
                self.flown_s += step_s
                simulated.step(boot_s + self.flown_s, step_s)
                self.flown()

    def take(self) -> list[Message | Reading]:
        """Return the messages sent since the last call."""
        if self.simulated.radio.outbox:
            self._take_answers()
        taken, self._sent = self._sent, []
        return taken

    def messages(self, packets: Iterable[Message | Reading], received_s: float) -> Iterable[Message | Reading]:
        """Return packets of :meth:`take`, which need no decoding."""
        return packets

    def receive(self, frame: bytes) -> None:
        """Take frames that are sent to the vehicle; its replies follow at once."""
        for message in self._station.parser.parse_buffer(frame) or ():
            self.simulated.handle(self._station, message)
        self._take_answers()

    def _take_answers(self) -> None:
        answers, self.simulated.radio.outbox = self.simulated.radio.outbox, []
        for _, frame in answers:
            self._sent += self._decoder.messages(frame, 0.0)

    # -- telemetry -------------------------------------------------------------------------------------------

    @property
    def boot_ms(self) -> int:
        """Time since the autopilot's boot, on the clock of its messages."""
        return round((self._start.boot_s + self.time_s) * 1000.0)

    def _say(self, name: str, **fields: object) -> None:
        self._sent.append(Message(name, self.system_id, _AUTOPILOT, fields, 0.0))

    def position(self, boot_ms: int) -> Message | Reading:
        """Return the true position as a reading; a subclass may return a message."""
        craft = self.craft
        place_m = craft.east_m, craft.north_m, craft.height_m
        velocity_m_s = craft.velocity_east_m_s, craft.velocity_north_m_s, craft.climb_m_s
        return PositionReading(1e-3 * boot_ms, *place_m, *velocity_m_s, self._start.home.altitude_m)

    def attitude(self, boot_ms: int) -> Message | Reading:
        """Return the true attitude as a reading; a subclass may return a message."""
        craft, yaw_rad = self.craft, math.remainder(self.craft.yaw_rad, math.tau)
        return AttitudeReading(1e-3 * boot_ms, craft.roll_rad, craft.pitch_rad, yaw_rad)

    def _send_due(self) -> None:
        craft, boot_ms = self.craft, self.boot_ms
        position, attitude, gimbal, laser, status, current = self._due[self._tick % len(self._due)]
        if attitude:
            self._sent.append(self.attitude(boot_ms))
        if position:
            self._sent.append(self.position(boot_ms))
        if status:
            self._send_status()
        if current:
            self._send_current()
        if self._payload is not None and gimbal:
            truth = self.target.at(self.time_s)
            ground_m: float | None = 0.0
            if self.seen_at_m is not None:
                here_m = craft.east_m, craft.north_m, craft.height_m
                ground_m = self.seen_at_m(here_m, truth.east_m, truth.north_m)
            if ground_m is not None:
                to_m = truth.east_m - craft.east_m, truth.north_m - craft.north_m, ground_m - craft.height_m
                self._sent += self._payload.measure(
                    self.time_s, boot_ms, *craft.pointed_m(to_m), heading_rad=craft.yaw_rad, with_range=laser
                )

    def _send_status(self) -> None:
        vehicle, wind = self.simulated, self.craft.wind
        self._say(
            "HEARTBEAT", autopilot=vehicle.autopilot_id, type=1, base_mode=vehicle.base_mode, custom_mode=vehicle.mode
        )
        self._say("GPS_RAW_INT", fix_type=3)
        if isinstance(vehicle, SimulatedArduPlane):
            from_deg = math.degrees(math.atan2(-wind.east_m_s, -wind.north_m_s))
            self._say("EKF_STATUS_REPORT", flags=_NAVIGATION_GOOD)
            speed_m_s = math.hypot(wind.east_m_s, wind.north_m_s)
            self._say("WIND", direction=from_deg, speed=speed_m_s, speed_z=0.0)
        else:
            self._say("ESTIMATOR_STATUS", flags=_NAVIGATION_GOOD)
            self._say("WIND_COV", wind_x=wind.north_m_s, wind_y=wind.east_m_s)

    def _send_current(self) -> None:
        """Report the mission's item, and the circle that is flown by command."""
        vehicle = self.simulated
        total = len(vehicle.mission.items())
        mission_id = 0
        if isinstance(vehicle, SimulatedArduPlane):
            total -= 1
        else:
            mission_id = vehicle.mission.mission_id
        self._say("MISSION_CURRENT", seq=vehicle.mission.index, total=total, mission_id=mission_id)
        if vehicle.mode == (ArduPlaneMode.GUIDED if isinstance(vehicle, SimulatedArduPlane) else Px4Mode.HOLD):
            place = vehicle.navigator.goal.ground_m
            x, y = e7(self._start.plane.latitude_longitude_deg(*place))
            if isinstance(vehicle, SimulatedArduPlane):
                self._say("POSITION_TARGET_GLOBAL_INT", lat_int=x, lon_int=y)
            elif vehicle.navigator.circle is not None:
                circle = vehicle.navigator.circle
                signed_m = circle.radius_m if circle.clockwise else -circle.radius_m
                self._say("ORBIT_EXECUTION_STATUS", x=x, y=y, radius=signed_m)

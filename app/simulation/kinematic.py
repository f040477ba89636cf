"""A light vehicle: it keeps and flies missions as an autopilot does, with the kinematics of the studies.

It speaks the mission protocol with the simulated vehicles' own stores and transfer, flies the legs and circles of its
mission by the autopilot's guidance law (:mod:`sidelong.mission.upload.line_tracking`), and rolls as
:class:`sidelong.app.simulation.airframe.KinematicAircraft`. Telemetry and payload are handed over decoded.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import astuple, dataclass, replace
from typing import Any

from pymavlink.dialects.v20 import all as mavlink

from sidelong.app.autopilots.autopilot import Autopilot
from sidelong.app.link.message import Message
from sidelong.app.simulation.airframe import KinematicAircraft
from sidelong.app.simulation.airframe_kernel import Body
from sidelong.app.simulation.payload import Payload
from sidelong.app.simulation.target import Target
from sidelong.app.simulation.wire import Decoder
from sidelong.estimators.frames import LocalPlane
from sidelong.mission.core.circle import Circle
from sidelong.mission.core.requirement import Wind
from sidelong.mission.exchange.dialect import Home
from sidelong.mission.exchange.layout import MissionLayout
from sidelong.mission.upload.items import circle_item
from sidelong.mission.upload.line_tracking import LineTracking, Point
from sidelong.mission.upload.mission_item import e7
from sidelong.sitl.arduplane.mission import ArduPlaneMission
from sidelong.sitl.arduplane.vehicle import QUIRKS as ARDUPLANE_QUIRKS
from sidelong.sitl.protocol.commands import ACCEPTED, DENIED, UNSUPPORTED, Command
from sidelong.sitl.protocol.transfer import Item, Transfer
from sidelong.sitl.px4.mission import Px4Mission
from sidelong.sitl.px4.vehicle import QUIRKS as PX4_QUIRKS

_STEP_S = 0.1  # of the kinematics
_SYSTEM, _AUTOPILOT = 1, 1
_ARMED_AND_CUSTOM = 217  # base mode
_NAVIGATION_GOOD = 831  # all flags of a healthy EKF
_MODES = {"AUTO": 10, "GUIDED": 15, "RTL": 11, "MISSION": 0x04040000, "LOITER": 0x03040000, "ALTCTL": 0x00020000}


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


LIVE_RATES = Rates(20, 10, 20, 10, 10, 1, 5)
"""As a flight asks for them over a fast link."""


@dataclass(frozen=True, slots=True)
class Start:
    """Where and how a flight begins: circling already, with that circle as its mission.

    Attributes:
        plane: of all positions; its origin is home.
        home: where heights count from.
        circle: flown at the start.
        height_m: above home.
        boot_s: the vehicle's clock at the start.
    """

    plane: LocalPlane
    home: Home
    circle: Circle
    height_m: float
    boot_s: float = 100.0


class KinematicVehicle:
    """One vehicle of an autopilot's kind, with its payload and the target that this looks at.

    Args:
        autopilot: whose missions, modes and guidance law it has.
        aircraft: where it is and what it can do.
        wind: that blows, and that it reports.
        start: how the flight begins.
        payload: what it carries, None: nothing.
        target: what the payload looks at.
        rates: how often it sends.

    Attributes:
        time_s: since the start of the simulation.
    """

    system_id = _SYSTEM

    def __init__(
        self,
        autopilot: Autopilot,
        aircraft: KinematicAircraft,
        wind: Wind,
        start: Start,
        payload: Payload | None,
        target: Target,
        rates: Rates = Rates(),  # frozen
    ) -> None:
        self.aircraft, self.target, self.height_m = aircraft, target, start.height_m
        self.mode = autopilot.mission_mode
        self.flown: Callable[[Body], object] = lambda _body: None
        self._autopilot, self._wind, self._start = autopilot, wind, start
        self._payload, self._rates = payload, rates
        tick_hz, *each_hz = astuple(rates)
        if any(tick_hz % rate_hz for rate_hz in each_hz if rate_hz):
            raise ValueError(f"the rates {tuple(each_hz)} do not divide {tick_hz} Hz")
        self._tracking: LineTracking = autopilot.tracking(aircraft.airspeed_m_s, wind)
        self._tick, self.time_s = 0, 0.0
        self._sent: list[Message] = []
        self._parser = mavlink.MAVLink(None)
        self._parser.robust_parsing = True
        self._packer = mavlink.MAVLink(None, srcSystem=_SYSTEM, srcComponent=_AUTOPILOT)
        self._decoder, self._station = Decoder(), object()  # the other end of the only link
        self._one_by_one = autopilot.quirks.stores_items_one_by_one
        self.mission: ArduPlaneMission | Px4Mission = self._make_mission()
        self._transfer = Transfer(
            mavlink.MAV_MISSION_TYPE_MISSION,
            self.mission,
            self,  # type: ignore[arg-type]  # it sends, and that is all
            ARDUPLANE_QUIRKS if self._one_by_one else PX4_QUIRKS,
            1.0,
            lambda _severity, _text: None,
            {},
        )
        self._previous: Point | None = None  # where the leg begins
        self._goal: Point | Circle = start.circle
        self._store_first_mission()

    # -- as the loop drives it -------------------------------------------------------------------------------

    @property
    def tick_s(self) -> float:
        """Time between two ticks."""
        return 1.0 / self._rates.tick_hz

    def advance(self, to_s: float) -> None:
        """Fly until a time, and send what is due on the way."""
        while self.time_s < to_s - 1e-6:
            self._send_due()
            self._tick += 1
            self.time_s = self._tick / self._rates.tick_hz
            while self.aircraft.body.time_s < self.time_s - 1e-6:
                self._fly(min(_STEP_S, self.time_s - self.aircraft.body.time_s))
            self._transfer.step(self.time_s)

    def take(self) -> list[Message]:
        """Return what was sent since the last call."""
        taken, self._sent = self._sent, []
        return taken

    def send(self, _station: object, message: Any) -> None:
        """Send what the mission protocol answers."""
        self._sent += self._decoder.messages(message.pack(self._packer), 0.0)

    def messages(self, packet: Message, received_s: float) -> Iterator[Message]:
        """Decode a packet of :meth:`take`: here they are messages already."""
        yield packet

    def receive(self, frame: bytes) -> None:
        """Take a frame of the ground's."""
        for message in self._parser.parse_buffer(frame) or ():
            kind = message.get_type()
            if kind in ("COMMAND_LONG", "COMMAND_INT"):
                command = Command.from_message(message)
                self.send(self._station, command.acknowledgement(self._command(command)))
            elif kind == "MISSION_SET_CURRENT":
                self.set_current(message.seq)
            elif kind.startswith("MISSION_"):
                self._transfer.handle(self._station, message, self.time_s)  # type: ignore[arg-type]

    # -- the mission -----------------------------------------------------------------------------------------

    def _make_mission(self) -> ArduPlaneMission | Px4Mission:
        if not self._one_by_one:
            return Px4Mission(lambda: self._begin_leg(self.mission.index, from_here=True))
        home = self._start.home
        place = e7((home.latitude_deg, home.longitude_deg))
        item = Item(mavlink.MAV_CMD_NAV_WAYPOINT, mavlink.MAV_FRAME_GLOBAL, (0.0,) * 4, *place, home.altitude_m)
        return ArduPlaneMission(item, lambda *_: None, lambda *_: None, lambda: True)

    def _store_first_mission(self) -> None:
        """Store the circle that is flown at the start, as an earlier upload would have."""
        circle, start = self._start.circle, self._start
        loiter = circle_item(circle, start.plane, start.height_m)
        head, tail = self._autopilot.head(start.home), self._autopilot.tail(start.home)
        layout = MissionLayout((*head, loiter, *tail), len(head), len(head), len(head) + 1, self._autopilot.min_items)
        items = layout.filled().items
        self.mission.begin(len(items))
        for index, i in enumerate(items):
            item = Item(i.command, i.frame, (i.param1, i.param2, i.param3, i.param4), i.x, i.y, i.z)
            self.mission.put(index, item, current=index == len(head))
        self.mission.finish()
        if isinstance(self.mission, ArduPlaneMission):
            self.mission.index = len(head)
            self.mission.resume()
        self._begin_leg(self.mission.index, from_here=False)

    def set_current(self, index: int) -> None:
        """Fly an item now, as MISSION_SET_CURRENT orders."""
        if isinstance(self.mission, ArduPlaneMission):
            if not self.mission.set_current(index):
                return
        elif 0 <= index < len(self.mission.items()):
            self.mission.index = index
        else:
            return
        self._begin_leg(self.mission.index, from_here=True)
        self._send_current()

    def _begin_leg(self, index: int, *, from_here: bool) -> None:
        items = self.mission.items()
        item = self.mission.item if isinstance(self.mission, ArduPlaneMission) else None
        if item is None:
            if not 0 <= index < len(items):
                return
            item = items[index]
        here = self.aircraft.body.east_m, self.aircraft.body.north_m
        if from_here:
            self._previous = here if self._tracking.first_is_line else None
        elif not isinstance(self._goal, Circle):
            self._previous = self._goal
        place = self._start.plane.east_north_m(item.latitude_deg, item.longitude_deg)
        if item.command == mavlink.MAV_CMD_NAV_WAYPOINT:
            self._goal = place
        else:
            radius_m = item.params[2] or self._start.circle.radius_m
            self._goal = Circle(*place, abs(radius_m), radius_m > 0.0)

    # -- flying ----------------------------------------------------------------------------------------------

    def _fly(self, step_s: float) -> None:
        state, tracking = self.aircraft.body, self._tracking
        at = state.east_m, state.north_m
        while not isinstance(self._goal, Circle) and tracking.is_done(at, self._previous, self._goal):
            if isinstance(self.mission, ArduPlaneMission):
                self.mission.advance()
            else:
                self.mission.index += 1
            self._begin_leg(self.mission.index, from_here=False)
        wanted = tracking.wanted_per_m(at, state.course_rad, state.speed_m_s, self._previous, self._goal)
        self.aircraft.step(wanted, step_s)
        self.flown(self.aircraft.body)

    # -- commands --------------------------------------------------------------------------------------------

    def _command(self, command: Command) -> int:
        match command.id:
            case mavlink.MAV_CMD_DO_SET_MODE:
                main, sub = int(command.number(2)), int(command.number(3))
                return self._set_mode(main if self._one_by_one else main << 16 | sub << 24)
            case mavlink.MAV_CMD_DO_REPOSITION if self._one_by_one and command.number(3) > 0.0:
                return self._fly_circle(command, command.number(3), command.number(4) == 0.0)
            case mavlink.MAV_CMD_DO_ORBIT if not self._one_by_one and command.number(1):
                return self._fly_circle(command, abs(command.number(1)), command.number(1) > 0.0)
        return UNSUPPORTED

    def _set_mode(self, custom_mode: int) -> int:
        mode = next((name for name, number in _MODES.items() if number == custom_mode), None)
        if mode is None:
            return DENIED
        self.mode = mode
        if mode == self._autopilot.mission_mode:
            self._begin_leg(self.mission.current_index(), from_here=True)
        elif mode == "RTL":
            self._goal = replace(self._start.circle, east_m=0.0, north_m=0.0)
        return ACCEPTED

    def _fly_circle(self, command: Command, radius_m: float, clockwise: bool) -> int:
        """Fly a circle by command: at once, and without a line that leads there."""
        place = self._start.plane.east_north_m(command.param(5), command.param(6))
        self._goal, self.mode = Circle(*place, radius_m, clockwise), self._autopilot.circle_mode
        self._send_circle()
        return ACCEPTED

    # -- telemetry -------------------------------------------------------------------------------------------

    @property
    def boot_ms(self) -> int:
        """The vehicle's clock."""
        return round((self._start.boot_s + self.time_s) * 1000.0)

    def _is_due(self, rate_hz: int) -> bool:
        return rate_hz > 0 and self._tick % (self._rates.tick_hz // rate_hz) == 0

    def _say(self, name: str, **fields: object) -> None:
        self._sent.append(Message(name, _SYSTEM, _AUTOPILOT, fields, 0.0))

    def _send_due(self) -> None:
        rates, state, boot_ms = self._rates, self.aircraft.body, self.boot_ms
        east_m_s = state.speed_m_s * math.sin(state.course_rad)
        north_m_s = state.speed_m_s * math.cos(state.course_rad)
        if self._is_due(rates.attitude_hz):
            roll_rad, yaw_rad = state.bank_rad, self.heading_rad
            self._say("ATTITUDE", time_boot_ms=boot_ms, roll=roll_rad, pitch=0.0, yaw=yaw_rad)
        if self._is_due(rates.position_hz):
            latitude_deg, longitude_deg = self._start.plane.latitude_longitude_deg(state.east_m, state.north_m)
            self._say(
                "GLOBAL_POSITION_INT",
                time_boot_ms=boot_ms,
                lat=round(latitude_deg * 1e7),
                lon=round(longitude_deg * 1e7),
                alt=round((self._start.home.altitude_m + self.height_m) * 1000.0),
                relative_alt=round(self.height_m * 1000.0),
                vx=round(north_m_s * 100.0),
                vy=round(east_m_s * 100.0),
                vz=0,
            )
        if self._is_due(rates.status_hz):
            self._send_status()
        if self._is_due(rates.mission_current_hz):
            self._send_current()
            self._send_circle()
        if self._payload is not None and self._is_due(rates.gimbal_hz):
            truth = self.target.at(self.time_s)
            line_m = truth.east_m - state.east_m, truth.north_m - state.north_m, -self.height_m
            with_range = self._is_due(rates.laser_hz)
            self._sent += self._payload.measure(
                self.time_s, boot_ms, *line_m, heading_rad=self.heading_rad, with_range=with_range
            )

    @property
    def heading_rad(self) -> float:
        """Where the nose points: the course through the air, clockwise from north."""
        state, wind = self.aircraft.body, self._wind
        east_m_s = state.speed_m_s * math.sin(state.course_rad) - wind.east_m_s
        north_m_s = state.speed_m_s * math.cos(state.course_rad) - wind.north_m_s
        return math.atan2(east_m_s, north_m_s)

    def _send_status(self) -> None:
        autopilot = self._autopilot.mav_autopilot
        mode = _MODES[self.mode]
        self._say("HEARTBEAT", autopilot=autopilot, type=1, base_mode=_ARMED_AND_CUSTOM, custom_mode=mode)
        self._say("GPS_RAW_INT", fix_type=3)
        wind = self._wind
        if self._one_by_one:
            from_deg = math.degrees(math.atan2(-wind.east_m_s, -wind.north_m_s))
            self._say("EKF_STATUS_REPORT", flags=_NAVIGATION_GOOD)
            self._say("WIND", direction=from_deg, speed=wind.speed_m_s, speed_z=0.0)
        else:
            self._say("ESTIMATOR_STATUS", flags=_NAVIGATION_GOOD)
            self._say("WIND_COV", wind_x=wind.north_m_s, wind_y=wind.east_m_s)

    def _send_circle(self) -> None:
        """Report the circle that is flown by command."""
        circle = self._goal
        if self.mode != self._autopilot.circle_mode or not isinstance(circle, Circle):
            return
        x, y = e7(self._start.plane.latitude_longitude_deg(circle.east_m, circle.north_m))
        if self._one_by_one:
            self._say("POSITION_TARGET_GLOBAL_INT", lat_int=x, lon_int=y)
        else:
            signed_m = circle.radius_m if circle.clockwise else -circle.radius_m
            self._say("ORBIT_EXECUTION_STATUS", x=x, y=y, radius=signed_m)

    def _send_current(self) -> None:
        mission = self.mission
        total = len(mission.items()) - (1 if self._one_by_one else 0)
        mission_id = mission.opaque_id() or 0
        self._say("MISSION_CURRENT", seq=mission.current_index(), total=total, mission_id=mission_id)

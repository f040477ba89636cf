"""What both autopilots have in common: modes, arming, the conversation with stations, and stepping the airframe."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Mapping
from enum import IntEnum
from typing import Any, ClassVar

import numpy as np
from pymavlink.dialects.v20 import all as mavlink

from sidelong.sitl.protocol.commands import ACCEPTED, DENIED, FAILED, UNSUPPORTED, Command, Handler
from sidelong.sitl.protocol.parameters import Parameters
from sidelong.sitl.protocol.radio import Radio, Signing, Station
from sidelong.sitl.protocol.transfer import RELATIVE_FRAMES, Item, Store, Transfer, TransferQuirks
from sidelong.sitl.settings import Release, Settings
from sidelong.sitl.world.airframe import (
    GRAVITY_M_S2,
    AirframeParameters,
    LocalPosition,
    SimulatedAirframe,
    quaternion,
)
from sidelong.sitl.world.geodesy import HomePlane
from sidelong.sitl.world.turbulence import turbulence

NAN = math.nan


class AutopilotTelemetry:
    """Builds messages by the method of their name, in lower case: one, several, or None if there is no data."""

    gps_fix: ClassVar[int]
    gps_dilution: ClassVar[tuple[int, int]]  # horizontal, vertical, times 100
    gps_accuracy_mm: ClassVar[tuple[int, int, int]]  # horizontal, vertical, speed
    home_quaternion: ClassVar[tuple[float, float, float, float]]
    parameter_capability: ClassVar[int]
    since_release: ClassVar[Mapping[int, Release]] = {}  # messages that older releases do not send

    def __init__(self, vehicle: SimulatedAutopilot) -> None:
        self._vehicle = vehicle
        self._craft = vehicle.craft

    def builder(self, message_id: int) -> Callable[[], Any] | None:
        """Return what builds a message; None if it is unknown to this release."""
        kind = mavlink.mavlink_map.get(message_id)
        if kind is None or self._vehicle.release < self.since_release.get(message_id, (0, 0)):
            return None
        return getattr(self, kind.msgname.lower(), None)

    def gimbal_manager_information(self) -> Any:
        """Return the limits of a gimbal that the autopilot manages; None if it pans all around."""
        settings = self._vehicle.settings
        if settings.payload is None or settings.device or settings.payload.pan_limit_deg >= 180.0:
            return None
        pan_rad, pitch_rad = math.radians(settings.payload.pan_limit_deg), 0.5 * math.pi
        flags = mavlink.GIMBAL_MANAGER_CAP_FLAGS_HAS_YAW_AXIS
        return mavlink.MAVLink_gimbal_manager_information_message(
            self._vehicle.boot_ms, flags, 1, 0.0, 0.0, -pitch_rad, 0.0, -pan_rad, pan_rad
        )

    @property
    def battery_percent(self) -> int:
        """Charge that falls evenly over the configured endurance, not below 5."""
        return max(5, 100 - int(100.0 * self._vehicle.now_s / self._vehicle.settings.endurance_s))

    def heartbeat(self) -> Any:
        vehicle, state = self._vehicle, mavlink.MAV_STATE_STANDBY
        if self._craft.flying:
            state = mavlink.MAV_STATE_CRITICAL if vehicle.failsafe else mavlink.MAV_STATE_ACTIVE
        return mavlink.MAVLink_heartbeat_message(
            mavlink.MAV_TYPE_FIXED_WING, vehicle.autopilot_id, vehicle.base_mode, vehicle.mode, state, 3
        )

    def system_time(self) -> Any:
        vehicle = self._vehicle
        unix_us = int((vehicle.settings.boot_unix_s + vehicle.now_s) * 1e6)
        return mavlink.MAVLink_system_time_message(unix_us, vehicle.boot_ms)

    def attitude(self) -> Any:
        craft, yaw_rad = self._craft, math.remainder(self._craft.yaw_rad, math.tau)
        return mavlink.MAVLink_attitude_message(
            self._vehicle.boot_ms, craft.roll_rad, craft.pitch_rad, yaw_rad, *craft.body_rates_rad_s
        )

    def attitude_quaternion(self) -> Any:
        craft = self._craft
        turned = quaternion(craft.roll_rad, craft.pitch_rad, craft.yaw_rad)
        return mavlink.MAVLink_attitude_quaternion_message(self._vehicle.boot_ms, *turned, *craft.body_rates_rad_s)

    def place_e7(self, east_m: float, north_m: float) -> tuple[int, int]:
        """Return (latitude, longitude) in units of 1e-7 degrees."""
        latitude_deg, longitude_deg = self._vehicle.plane.latitude_longitude_deg(east_m, north_m)
        return round(latitude_deg * 1e7), round(longitude_deg * 1e7)

    def altitude_m(self, height_m: float) -> float:
        return self._vehicle.home.altitude_m + height_m

    def global_position_int(self) -> Any:
        craft = self._craft
        heights_mm = (round(up_m * 1000.0) for up_m in (self.altitude_m(craft.height_m), craft.height_m))
        velocity_m_s = craft.velocity_north_m_s, craft.velocity_east_m_s, -craft.climb_m_s
        return mavlink.MAVLink_global_position_int_message(
            self._vehicle.boot_ms,
            *self.place_e7(craft.east_m, craft.north_m),
            *heights_mm,
            *(round(part_m_s * 100.0) for part_m_s in velocity_m_s),
            round(math.degrees(craft.yaw_rad) * 100.0) % 36000,
        )

    def local_position_ned(self) -> Any:
        craft = self._craft
        place_m = craft.north_m, craft.east_m, -craft.height_m
        velocity_m_s = craft.velocity_north_m_s, craft.velocity_east_m_s, -craft.climb_m_s
        return mavlink.MAVLink_local_position_ned_message(self._vehicle.boot_ms, *place_m, *velocity_m_s)

    def vfr_hud(self) -> Any:
        vehicle, craft = self._vehicle, self._craft
        return mavlink.MAVLink_vfr_hud_message(
            craft.measured_airspeed_m_s / craft.true_airspeed_ratio,
            craft.ground_speed_m_s,
            round(math.degrees(craft.yaw_rad)) % 360,
            45 if craft.flying else 100 if vehicle.lifting_off else 0,
            self.altitude_m(craft.height_m),
            craft.climb_m_s,
        )

    def gps_raw_int(self) -> Any:
        craft, altitude_mm = self._craft, round(self.altitude_m(self._craft.height_m) * 1000.0)
        place = *self.place_e7(craft.east_m, craft.north_m), altitude_mm
        course_cdeg = round(math.degrees(craft.course_rad) * 100.0) % 36000
        motion, satellites = (round(craft.ground_speed_m_s * 100.0), course_cdeg), 10
        fix = self.gps_fix, *place, *self.gps_dilution, *motion, satellites
        return mavlink.MAVLink_gps_raw_int_message(self._vehicle.boot_us, *fix, altitude_mm, *self.gps_accuracy_mm)

    def home_position(self) -> Any:
        vehicle, zeros = self._vehicle, (0.0,) * 3
        if not vehicle.home_known:
            return None
        place = *self.place_e7(0.0, 0.0), round(vehicle.home.altitude_m * 1000.0)
        return mavlink.MAVLink_home_position_message(
            *place, *zeros, list(self.home_quaternion), *zeros, vehicle.boot_us
        )

    def extended_sys_state(self) -> Any:
        undefined = mavlink.MAV_VTOL_STATE_UNDEFINED
        return mavlink.MAVLink_extended_sys_state_message(undefined, self._vehicle.landed_state)

    def battery_status(self) -> Any:
        return mavlink.MAVLink_battery_status_message(
            0,
            mavlink.MAV_BATTERY_FUNCTION_ALL,
            mavlink.MAV_BATTERY_TYPE_LIPO,
            32767,
            [16200] + [65535] * 9,
            1000,
            0,
            -1,
            self.battery_percent,
        )

    def autopilot_version(self) -> Any:
        capabilities = (
            self.parameter_capability
            | mavlink.MAV_PROTOCOL_CAPABILITY_MISSION_FLOAT
            | mavlink.MAV_PROTOCOL_CAPABILITY_MISSION_INT
            | mavlink.MAV_PROTOCOL_CAPABILITY_COMMAND_INT
            | mavlink.MAV_PROTOCOL_CAPABILITY_MISSION_FENCE
            | mavlink.MAV_PROTOCOL_CAPABILITY_MISSION_RALLY
            | mavlink.MAV_PROTOCOL_CAPABILITY_MAVLINK2
        )
        major, minor = self._vehicle.release
        version, unnamed = major << 24 | minor << 16 | mavlink.FIRMWARE_VERSION_TYPE_OFFICIAL, [0] * 8
        return mavlink.MAVLink_autopilot_version_message(
            capabilities, version, 0, 0, 0, unnamed, unnamed, unnamed, 0, 0, self._vehicle.system_id
        )


_ALTITUDE_GAIN_PER_S = 0.4
_TEXT_BYTES = 50
_GUST_STREAM = 3  # of the seed's children: 0 and 1 are the target's and the sensors', 2 the link's
_LIFT_OFF_FRACTION = 0.85  # of the cruise airspeed


class SimulatedAutopilot(ABC):
    autopilot_id: ClassVar[int]
    modes: ClassVar[type[IntEnum]]
    first_mode: ClassVar[int]
    self_flying: ClassVar[Collection[int]]  # modes
    mode_flags: ClassVar[tuple[int, int]]  # of MAV_MODE_FLAG, in other modes and in these
    navigation_period_s: ClassVar[float]
    taken_over_mode: ClassVar[int]  # when the pilot moves the sticks
    receives_once_a_loop: ClassVar[bool]  # or as soon as something comes
    home_known_s: ClassVar[float]  # after boot
    ready_s: ClassVar[float]  # after boot the vehicle can be armed
    unknown_interval_result: ClassVar[int]  # for an unknown message
    unknown_request_result: ClassVar[int]
    arming_refusal: ClassVar[tuple[int, str]]  # result and text if armed too early
    preflight_failure: ClassVar[str]  # until then, if the checks are requested
    armed_text: ClassVar[str]
    landed_text: ClassVar[str]
    roll_limit_parameter: ClassVar[str]  # degrees
    quirks: TransferQuirks
    default_interval_s: ClassVar[Mapping[int, float]]
    unsigned_messages: ClassVar[frozenset[int]] = frozenset({mavlink.MAVLINK_MSG_ID_RADIO_STATUS})

    def __init__(
        self, settings: Settings, build: AirframeParameters, heading_rad: float, parameters: Parameters
    ) -> None:
        self.settings, self.release = settings, settings.release_or_newest
        self.home = settings.home_or_default
        self.plane = HomePlane(self.home.latitude_deg, self.home.longitude_deg)
        self.craft = SimulatedAirframe(build, settings.wind, heading_rad, self.home.altitude_m)
        rng = np.random.default_rng(np.random.SeedSequence(settings.seed, spawn_key=(_GUST_STREAM,)))
        self.craft.turbulence = turbulence(settings.turbulence, rng)
        self.parameters = parameters
        signing = Signing(settings.signing_key, self.unsigned_messages)
        self.radio = Radio(settings.system_id, self.default_interval_s, signing, self._unix_s)
        self.system_id = settings.system_id
        self.now_s = 0.0
        self.mode = int(self.first_mode)
        self.reboot_ordered = False
        self._home_sent = self.armed = self.lifting_off = self.failsafe = False
        self._texts = 0  # that were too long for one message
        self.silenced: set[int] = set()  # messages withheld, as if the sender of them had died
        self.height_goal_m = self.roll_goal_rad = 0.0
        self.roi: LocalPosition | None = None  # where the payload has been turned to, until it has been
        self.gcs_received_s: float | None = None
        self.transfers: dict[int, Transfer] = {}
        self._navigate_s = 0.0
        self._limited_at, self._roll_limit_rad = -1, 0.0
        self.handlers: dict[int, Handler] = {
            mavlink.MAV_CMD_COMPONENT_ARM_DISARM: self._on_arm,
            mavlink.MAV_CMD_RUN_PREARM_CHECKS: self._on_checks,
            mavlink.MAV_CMD_DO_SET_MODE: self._on_set_mode,
            mavlink.MAV_CMD_DO_SET_ROI_LOCATION: self._on_roi,
            mavlink.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN: self._on_reboot,
        }

    def attach(self, mission: Store, telemetry: AutopilotTelemetry) -> None:
        """Connect the flavour's mission store and telemetry; fence and rally points are stored as a whole."""
        self._builder_of = telemetry.builder
        fence, rally = Store(mission.with_checksum), Store(mission.with_checksum)
        for mission_type, store in enumerate((mission, fence, rally)):
            self.transfers[mission_type] = Transfer(
                mission_type, store, self.radio, self.quirks, self.settings.link_rate, self.say, self.transfers
            )
        self._transferring = tuple(self.transfers.values())

    @abstractmethod
    def set_mode(self, mode: int) -> bool:
        """Change the flight mode; False if there is no such mode."""

    @abstractmethod
    def custom_mode(self, main: int, sub: int) -> int:
        """Return the custom mode of main and sub mode in a DO_SET_MODE."""

    @abstractmethod
    def navigate(self) -> float:
        """Fly the mode for a navigation period: set height_goal_m, return the lateral acceleration, m/s^2."""

    @abstractmethod
    def watch_links(self) -> None:
        """Enter and leave the failsafe of a lost ground station."""

    def on_armed(self) -> None:
        self.say(mavlink.MAV_SEVERITY_INFO, self.armed_text)

    @abstractmethod
    def set_current_item(self, index: int) -> bool: ...

    @property
    @abstractmethod
    def airspeed_goal_m_s(self) -> float:
        """Equivalent airspeed."""

    @property
    def base_mode(self) -> int:
        """base_mode of HEARTBEAT: mode flags, and whether it is armed."""
        flags = self.mode_flags[self.mode in self.self_flying]
        return int(flags | (mavlink.MAV_MODE_FLAG_SAFETY_ARMED if self.armed else 0))

    @property
    def ready(self) -> bool:
        """Whether arming is allowed: the start of the sensors is over."""
        return self.now_s >= self.ready_s

    @property
    def home_known(self) -> bool:
        return self.now_s >= self.home_known_s

    @property
    def boot_ms(self) -> int:
        return int(self.now_s * 1000.0 + 0.5)

    @property
    def boot_us(self) -> int:
        return int(self.now_s * 1e6 + 0.5)

    def step(self, now_s: float, dt_s: float) -> None:
        """Run timers, navigation and airframe for ``dt_s`` up to ``now_s``, s since boot."""
        self.now_s = now_s
        for transfer in self._transferring:
            if transfer.upload is not None or transfer.downloads:
                transfer.step(now_s)
        if now_s >= self._navigate_s:
            self._navigate_s += self.navigation_period_s
            self.watch_links()
            if not self._home_sent and self.home_known:
                self._home_sent = True
                self.broadcast_now(mavlink.MAVLINK_MSG_ID_HOME_POSITION)
            lateral_m_s2 = self.navigate()
            if self._limited_at != self.parameters.changes:
                self._limited_at = self.parameters.changes
                self._roll_limit_rad = math.radians(self.parameters.within(self.roll_limit_parameter, 5.0, 80.0))
            roll_rad, limit_rad = math.atan(lateral_m_s2 / GRAVITY_M_S2), self._roll_limit_rad
            self.roll_goal_rad = roll_rad if -limit_rad < roll_rad < limit_rad else math.copysign(limit_rad, roll_rad)
        craft = self.craft
        if craft.flying:
            climb_m_s = _ALTITUDE_GAIN_PER_S * (self.height_goal_m - craft.height_m) if self.armed else -math.inf
            craft.fly(dt_s, self.roll_goal_rad, self.airspeed_goal_m_s * craft.true_airspeed_ratio, climb_m_s)
            self.lifting_off = False
            if not craft.flying:
                self.disarm()
                self.say(mavlink.MAV_SEVERITY_INFO, self.landed_text)
        elif self.lifting_off and self.armed:
            craft.roll_on_ground(dt_s, _LIFT_OFF_FRACTION * self.settings.airspeed_m_s * craft.true_airspeed_ratio)
        elif craft.ground_speed_m_s > 0.0:
            craft.roll_on_ground(dt_s, None)

    def coast(self, dt_s: float) -> None:
        """Fly on without guidance, as while the autopilot restarts."""
        if self.craft.flying:
            self.craft.fly(dt_s, 0.0, self.craft.airspeed_m_s, 0.0)

    def reboot(self) -> None:
        """Start again from the first mode, with missions, parameters and arming kept."""
        self.now_s = self._navigate_s = 0.0
        self.reboot_ordered = self._home_sent = False
        self.gcs_received_s = None
        self.set_mode(self.first_mode)
        self.radio.restart(self.default_interval_s)

    @property
    def ground_silent_s(self) -> float:
        """Time since the last message of a ground station, on the station's clock, s; 0 before the first."""
        return 0.0 if self.gcs_received_s is None else (self.now_s - self.gcs_received_s) / self.settings.link_rate

    def descend_to(self, spot: LocalPosition) -> None:
        """Aim at a slope of 1 in 8 that ends below the ground, for a firm touch-down."""
        self.height_goal_m = min(self.craft.height_m, spot.distance_m(self.craft) / 8.0) - 2.0

    @property
    def landed_state(self) -> int:
        """MAV_LANDED_STATE: on ground, take-off (rolling) or in air."""
        if self.craft.flying:
            return int(mavlink.MAV_LANDED_STATE_IN_AIR)
        rolling = self.armed and self.lifting_off
        return int(mavlink.MAV_LANDED_STATE_TAKEOFF if rolling else mavlink.MAV_LANDED_STATE_ON_GROUND)

    def place_of(self, item: Item) -> LocalPosition:
        """Return where an item is; one at latitude and longitude 0, or of no height, is where the aircraft is."""
        if item.latitude_e7 == 0 and item.longitude_e7 == 0:
            east_m, north_m = self.craft.east_m, self.craft.north_m
        else:
            east_m, north_m = self.plane.east_north_m(item.latitude_deg, item.longitude_deg)
        height_m = item.altitude_m if item.frame in RELATIVE_FRAMES else item.altitude_m - self.home.altitude_m
        return LocalPosition(east_m, north_m, height_m if math.isfinite(height_m) else self.craft.height_m)

    @property
    def here(self) -> LocalPosition:
        return LocalPosition.of(self.craft)

    def say(self, severity: int, text: str) -> None:
        """Send a text, in chunks where it is longer than a message holds."""
        data = text.encode()
        chunks = [data[at : at + _TEXT_BYTES] for at in range(0, len(data), _TEXT_BYTES)] or [b""]
        self._texts += len(chunks) > 1
        number = self._texts if len(chunks) > 1 else 0
        for sequence, chunk in enumerate(chunks):
            self.radio.broadcast(mavlink.MAVLink_statustext_message(severity, chunk, number, sequence))

    def messages(self, message_id: int) -> list[Any]:
        """Build the messages of a telemetry id; empty if it is unknown or has no data now."""
        builder = self._builder_of(message_id)
        built = builder() if builder is not None and message_id not in self.silenced else None
        return built if isinstance(built, list) else [] if built is None else [built]

    def stream(self) -> None:
        """Send the messages that are due to each station."""
        self.radio.stream(self.now_s, self.messages)

    def handle(self, station: Station, message: Any) -> None:
        """Take a station's message; forward what others are addressed by, act on what this system is."""
        kind = message.get_type()
        source = (message.get_srcSystem(), message.get_srcComponent())
        if kind == "BAD_DATA" or source == (self.system_id, mavlink.MAV_COMP_ID_AUTOPILOT1):
            return
        station.received_s = self.now_s
        target = (getattr(message, "target_system", 0), getattr(message, "target_component", 0))
        if target != (self.system_id, mavlink.MAV_COMP_ID_AUTOPILOT1) and kind != "RADIO_STATUS":
            self.radio.forward(message, station)
        if target[0] in (0, self.system_id) and target[1] in (0, mavlink.MAV_COMP_ID_AUTOPILOT1):
            self.handle_own(station, message, kind)

    def handle_own(self, station: Station, message: Any, kind: str) -> None:
        """Process a message that is meant for this autopilot or for everyone."""
        if kind in ("COMMAND_LONG", "COMMAND_INT"):
            self.on_command(station, Command.from_message(message))
        elif kind == "HEARTBEAT":
            if self.is_ground_station(message):
                self.gcs_received_s = self.now_s
        elif kind.startswith("MISSION_"):
            self._on_mission(station, message)
        elif kind == "SETUP_SIGNING" and self.armed:
            self.say(mavlink.MAV_SEVERITY_WARNING, "ERROR: Won't setup signing when armed")
        elif kind == "SETUP_SIGNING":
            self.radio.signing.set_up(bytes(message.secret_key))
        elif kind.startswith("PARAM_"):
            self.parameters.handle(station, message, self.radio)
        elif kind == "SET_MODE":
            if message.base_mode & mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED:
                self.set_mode(message.custom_mode)
        elif kind == "TIMESYNC" and message.tc1 == 0:
            self.radio.send(station, mavlink.MAVLink_timesync_message(self.boot_us * 1000, message.ts1))
        elif kind == "PING" and message.target_system == 0:
            sender = message.get_srcSystem(), message.get_srcComponent()
            self.radio.send(station, mavlink.MAVLink_ping_message(message.time_usec, message.seq, *sender))

    def _unix_s(self) -> float:
        """Return the time of the stations' clock, which a simulation may run ahead of."""
        return self.settings.boot_unix_s + self.now_s / self.settings.link_rate

    def is_ground_station(self, heartbeat: Any) -> bool:
        """Whether this heartbeat keeps the failsafe for a lost link from acting."""
        return bool(heartbeat.type == mavlink.MAV_TYPE_GCS)

    def broadcast_now(self, message_id: int) -> None:
        """Send a message to all stations, beyond its rate."""
        for message in self.messages(message_id):
            self.radio.broadcast(message)

    def _on_mission(self, station: Station, message: Any) -> None:
        transfer = self.transfers.get(getattr(message, "mission_type", mavlink.MAV_MISSION_TYPE_MISSION))
        if message.get_type() == "MISSION_SET_CURRENT":
            if self.transfers[mavlink.MAV_MISSION_TYPE_MISSION].is_busy_with(station):
                self.say(mavlink.MAV_SEVERITY_CRITICAL, "WPM: IGN WP CURR CMD: Busy\t")
            elif self.set_current_item(message.seq):
                self.broadcast_now(mavlink.MAVLINK_MSG_ID_MISSION_CURRENT)
        elif transfer is not None:
            transfer.handle(station, message, self.now_s)
        elif message.get_type() != "MISSION_ACK":
            sender = (message.get_srcSystem(), message.get_srcComponent())
            unsupported = mavlink.MAV_MISSION_UNSUPPORTED
            self.radio.send(station, mavlink.MAVLink_mission_ack_message(*sender, unsupported, message.mission_type))

    def on_command(self, station: Station, command: Command) -> None:
        """Carry out a command and acknowledge it."""
        match command.id:
            case mavlink.MAV_CMD_SET_MESSAGE_INTERVAL:
                result = self._on_message_interval(station, command)
            case mavlink.MAV_CMD_REQUEST_MESSAGE:
                result = self._on_request_message(station, int(command.number(1)))
            case _:
                handler = self.handlers.get(command.id)
                result = handler(command) if handler is not None else UNSUPPORTED
        self.radio.send(station, command.acknowledgement(result))

    def _on_message_interval(self, station: Station, command: Command) -> int:
        message_id, interval_us = int(command.number(1)), command.number(2)
        if self._builder_of(message_id) is None:
            return self.unknown_interval_result
        default_s = self.default_interval_s.get(message_id, 0.0)
        station.stream(message_id, default_s if interval_us == 0 else max(0.0, interval_us / 1e6), self.now_s)
        return ACCEPTED

    def _on_request_message(self, station: Station, message_id: int) -> int:
        messages = self.messages(message_id)
        for message in messages:
            self.radio.send(station, message)
        return ACCEPTED if messages else self.unknown_request_result

    def _on_arm(self, command: Command) -> int:
        if command.param(1) == 1.0:
            return self.arm()
        if command.param(1) != 0.0:
            return UNSUPPORTED
        if self.craft.flying and command.param(2) != 21196.0:  # not forced
            return FAILED
        self.disarm()
        return ACCEPTED

    def _on_checks(self, _command: Command) -> int:
        if self.armed:
            return FAILED
        if not self.ready:
            self.say(mavlink.MAV_SEVERITY_CRITICAL, self.preflight_failure)
        return ACCEPTED

    def arm(self) -> int:
        """Arm the motors if ready; return the MAV_RESULT."""
        if not self.armed and not self.ready:
            result, text = self.arming_refusal
            self.say(mavlink.MAV_SEVERITY_CRITICAL, text)
            return result
        if not self.armed:
            self.armed = True
            self.on_armed()
        return ACCEPTED

    def disarm(self) -> None:
        self.armed = self.lifting_off = False

    def _on_reboot(self, command: Command) -> int:
        if command.param(1) != 1.0:
            return UNSUPPORTED
        if self.armed:
            return FAILED
        self.reboot_ordered = True
        return ACCEPTED

    def _on_roi(self, command: Command) -> int:
        place_deg = command.param(5), command.param(6)
        if not all(map(math.isfinite, place_deg)):
            return DENIED
        self.roi = LocalPosition(*self.plane.east_north_m(*place_deg), 0.0)
        return ACCEPTED

    def mode_of_command(self, command: Command) -> int | None:
        """Return the custom mode that a DO_SET_MODE requests, None if there is no such mode."""
        base_mode, main, sub = (int(command.number(number)) for number in (1, 2, 3))
        mode = self.custom_mode(main, sub)
        return mode if base_mode & mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED and mode in list(self.modes) else None

    def _on_set_mode(self, command: Command) -> int:
        mode = self.mode_of_command(command)
        return UNSUPPORTED if mode is None else self.change_mode(mode)

    def change_mode(self, mode: int) -> int:
        """Change to a custom mode; return the MAV_RESULT."""
        return ACCEPTED if self.set_mode(mode) else FAILED

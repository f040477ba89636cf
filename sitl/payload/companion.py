"""Laser and gimbal for someone else's vehicle: a companion component that looks at a simulated target from there."""

from __future__ import annotations

import math
import os
import socket
import time
from collections.abc import Callable
from contextlib import ExitStack, closing, suppress
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from pymavlink import mavutil
from pymavlink.dialects.v20 import all as mavlink

from sidelong.sitl.payload.devices import Device, Wired
from sidelong.sitl.payload.payload import PERIOD_S, Measurement, SimulatedPayload, TargetGeometry
from sidelong.sitl.protocol.radio import signing_time
from sidelong.sitl.settings import PayloadSettings
from sidelong.sitl.world.airframe import AirframeParameters, SimulatedAirframe, WindVector
from sidelong.sitl.world.geodesy import HomePlane
from sidelong.sitl.world.hills import Hills
from sidelong.sitl.world.motion import Motion
from sidelong.sitl.world.truth import TruthRow

if TYPE_CHECKING:
    from sidelong.sitl.payload.camera import GimbalCamera

_ASK_AGAIN_S = 2.0
_SETTLING_S = 2.2  # two heartbeats: what other vehicle is there has spoken by then
_HEARTBEAT_S = 1.0
_WAIT_S, _DEVICE_WAIT_S = 0.05, 0.005
# A device answers with its present sight: in a turn, that of 0.1 s ago is 2 degrees off. ArduPlane refuses
# an interval below 25 ms, and then stays at one message a second.
_DEVICE_PERIOD_S = 0.025
_RETRY_S = 0.5
_SCHEMES = ("tcpout", "udpin", "udpout")
_GIMBAL_INFORMATION = mavlink.MAVLINK_MSG_ID_GIMBAL_DEVICE_INFORMATION
_ASKED = (
    mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT,
    mavlink.MAVLINK_MSG_ID_ATTITUDE,
    mavlink.MAVLINK_MSG_ID_GIMBAL_DEVICE_SET_ATTITUDE,  # ArduPlane refuses, and sends it to a camera's gimbal
)
_ON_GROUND_M = 5.0  # height above home below which the vehicle is on the ground
_STEP_MIN_S = 1e-3
_STEP_BACK_S = 1.0  # a vehicle whose clock steps back by more than this has rebooted


class CompanionError(Exception):
    """The vehicle cannot be reached; the message gives the reason."""


class Companion(Wired):
    """Measures at each position the vehicle reports, stamped with that position's time.

    Pure: pass it the vehicle's messages, send the messages it returns. Nothing is measured before home is known; when
    the vehicle reboots, the target continues from its position. motion: of the target, in a plane with its origin at
    the vehicle's home. vehicle_id None: the first autopilot received. camera: in place of laser and gimbal, by the
    ground; the vehicle's gimbal manager turns it. Raises HillsError for unknown ground at home.
    """

    def __init__(
        self,
        payload: PayloadSettings,
        motion: Motion,
        seed: int,
        terrain: Path | None = None,
        vehicle_id: int | None = None,
        device: Device | None = None,
        camera: Callable[[Hills], GimbalCamera] | None = None,
    ) -> None:
        _, sensor_seed = np.random.SeedSequence(seed).spawn(2)
        super().__init__(device, round(payload.latency_s / _DEVICE_PERIOD_S))
        self._measured: tuple[float, Measurement] | None = None  # time, s
        self._payload, self._motion = SimulatedPayload(payload, sensor_seed), motion
        self._plane: HomePlane | None = None
        self._terrain, self._hills = terrain, Hills(None, HomePlane(0.0, 0.0))
        self._begin_s: float | None = None
        self._latest_s = 0.0
        self._craft = SimulatedAirframe(AirframeParameters(), WindVector())  # as reported
        self._camera_of = camera
        self._camera: GimbalCamera | None = None
        self.vehicle_id = vehicle_id
        self.on_truth: Callable[[TruthRow], None] = lambda _row: None

    @property
    def wants_home(self) -> bool:
        """Whether the local plane waits for the autopilot's HOME_POSITION."""
        return self._plane is None

    @property
    def period_s(self) -> float:
        """How often the vehicle's position and attitude are needed."""
        return PERIOD_S if self.device is None and self._camera_of is None else _DEVICE_PERIOD_S

    @property
    def time_s(self) -> float:
        """Time of the autopilot's last message, s since its boot."""
        return self._latest_s

    def handle(self, message: Any) -> list[Any]:
        """Process a message of the vehicle; return the payload's messages, which follow each position."""
        kind = message.get_type()
        if message.get_srcComponent() != mavlink.MAV_COMP_ID_AUTOPILOT1:
            return []
        if self.vehicle_id is None and kind == "HEARTBEAT" and message.autopilot != mavlink.MAV_AUTOPILOT_INVALID:
            self.vehicle_id = message.get_srcSystem()
        if message.get_srcSystem() != self.vehicle_id:
            return []
        if kind == "HOME_POSITION" and self._plane is None:
            self._plane = HomePlane(message.latitude / 1e7, message.longitude / 1e7)
            self._hills = Hills(self._terrain, self._plane)
            if self._camera_of is not None:
                self._camera = self._camera_of(self._hills)
        elif kind == "ATTITUDE":
            self._craft.heading_rad, self._craft.roll_rad = message.yaw, message.roll
        elif self._camera is not None and kind == "GIMBAL_DEVICE_SET_ATTITUDE":
            self._camera.on_set_attitude(message)
        elif self._camera is not None and kind == "COMMAND_LONG" and message.param1 == _GIMBAL_INFORMATION:
            return [self._camera.information(round(1000.0 * self._latest_s))]
        elif kind == "GLOBAL_POSITION_INT" and self._plane is not None:
            return self._measure(message, self._plane)
        return []

    def _measure(self, position: Any, plane: HomePlane) -> list[Any]:
        time_s = position.time_boot_ms / 1000.0
        if self._begin_s is None:
            self._begin_s = time_s
        elif time_s < self._latest_s - _STEP_BACK_S:
            self._begin_s += time_s - self._latest_s
        before_s, self._latest_s = self._latest_s, time_s
        since_s = max(0.0, time_s - self._begin_s)
        aircraft_deg = (position.lat / 1e7, position.lon / 1e7)
        aircraft_m = (*plane.east_north_m(*aircraft_deg), position.relative_alt / 1000.0)
        hills, target_m = self._hills, self._hills.standing(self._motion.at(since_s))
        in_sight = hills.sees_target(aircraft_m, target_m)
        # On the ground the payload is tried out on what is about, as in the simulation of our own.
        sight = TargetGeometry.between(aircraft_m, target_m, in_sight or aircraft_m[2] < _ON_GROUND_M)
        craft, camera = self._craft, self._camera
        if camera is not None:
            craft.east_m, craft.north_m, craft.height_m = aircraft_m
            camera.step(since_s, max(time_s - before_s, _STEP_MIN_S), craft, target_m)
        if self.period_s < PERIOD_S and self._measured is not None and since_s - self._measured[0] < PERIOD_S:
            if self.device is not None:
                self.look(self.device, sight, self._measured[1], craft.yaw_rad, craft.roll_rad)
            return []
        measured = self._payload.measure(since_s, position.time_boot_ms, sight, craft.yaw_rad)
        target = target_m, plane.latitude_longitude_deg(*target_m[:2])
        line, laser = (sight.slant_range_m, sight.bearing_rad), (measured.laser_valid, measured.laser_outlier)
        ground = hills.reported(aircraft_m, in_sight)
        self.on_truth(TruthRow(time_s, *target, aircraft_m, aircraft_deg, *line, *laser, *ground))
        self._measured = since_s, measured
        if self.device is not None:
            self.look(self.device, sight, measured, craft.yaw_rad, craft.roll_rad)
            return []
        return measured.messages if camera is None else [camera.attitude(position.time_boot_ms)]


def accompany(
    companion: Companion,
    url: str,
    *,
    key: bytes | None = None,
    straight_to: tuple[str, int] | None = None,
    on_ready: Callable[[int], None] = lambda _vehicle_id: None,
    on_wait: Callable[[str], None] = lambda _reason: None,
    on_turn: Callable[[], None] = lambda: None,
    stopped: Callable[[], bool] = lambda: False,
) -> None:
    """Join the vehicle at ``url`` as component 154 of its system until ``stopped``.

    key: of the vehicle's signing, if it demands that. straight_to: a UDP address that every frame is sent to as well.
    The function waits for a missing or lost vehicle: on_wait then receives the reason once; on_ready is called after
    each connection, on_turn in each turn of the loop. Raises CompanionError for an unusable URL, and if several
    vehicles are received and none is selected.
    """
    scheme, _, address = url.partition("://")
    port = address.rpartition(":")[2]
    if scheme not in _SCHEMES or not (port.isdigit() and 0 < int(port) < 65536):
        raise CompanionError(f"must look like {', '.join(f'{s}://HOST:PORT' for s in _SCHEMES)}, not {url!r}")
    reported = False
    while not stopped():
        try:
            with ExitStack() as stack:
                link = stack.enter_context(closing(_connected(scheme, address)))
                reported = False
                if key is not None:
                    link.setup_signing(key, allow_unsigned_callback=lambda _mav, _message_id: False, link_id=1)
                if straight_to is not None:
                    straight = stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
                    link.mav.set_send_callback(partial(_send_straight, straight, straight_to))
                _converse(companion, link, on_ready, on_turn, stopped)
        except (ConnectionError, TimeoutError) as error:
            if not reported:
                on_wait(f"waiting for a vehicle at {url}: {error.strerror or error}")
            reported = True
            time.sleep(_RETRY_S)
        except OSError as error:
            raise CompanionError(f"cannot reach {url}: {error.strerror or error}") from error


class _TcpLink(mavutil.mavtcp):  # type: ignore[misc]  # pymavlink has no types
    """pymavlink's, but an end of the connection is an error instead of a line on the console."""

    def handle_eof(self) -> None:
        raise ConnectionResetError("the vehicle closed the connection")

    handle_disconnect = handle_eof


def _connected(scheme: str, address: str) -> Any:
    # Otherwise pymavlink begins a new parser at the first frame of version 2, and that one has lost the signing key.
    os.environ["MAVLINK20"] = "1"
    mavutil.set_dialect("all")
    own_id = mavlink.MAV_COMP_ID_GIMBAL
    if scheme == "tcpout":
        return _TcpLink(address, source_component=own_id, retries=1)
    return mavutil.mavlink_connection(f"{scheme}:{address}", source_component=own_id, dialect="all")


def _converse(
    companion: Companion,
    link: Any,
    on_ready: Callable[[int], None],
    on_turn: Callable[[], None],
    stopped: Callable[[], bool],
) -> None:
    wait_s = _WAIT_S if companion.device is None else _DEVICE_WAIT_S
    if companion.vehicle_id is None:
        companion.vehicle_id = _only_vehicle(link, stopped)
    if companion.vehicle_id is None:
        return
    link.mav.srcSystem = companion.vehicle_id
    on_ready(companion.vehicle_id)
    ask_s = heartbeat_s = -math.inf
    while not stopped():
        message = link.recv_match(blocking=True, timeout=wait_s)
        if message is not None and message.get_type() != "BAD_DATA":
            for measurement in companion.handle(message):
                _send(link, measurement)
        on_turn()
        now_s = time.monotonic()
        if now_s >= heartbeat_s:
            heartbeat_s = now_s + _HEARTBEAT_S
            _send(link, SimulatedPayload.heartbeat())
        if now_s >= ask_s:
            ask_s = now_s + _ASK_AGAIN_S
            _ask(companion, link)


def _send(link: Any, message: Any) -> None:
    signing = link.mav.signing
    if signing.sign_outgoing:  # pymavlink counts frames only: a minute behind the clock, they would be too old
        signing.timestamp = max(signing.timestamp, signing_time(time.time()))
    link.mav.send(message)


def _send_straight(udp: socket.socket, address: tuple[str, int], message: Any) -> None:
    with suppress(ConnectionError):  # there is no receiver yet, or no longer
        udp.sendto(message.get_msgbuf(), address)


def _only_vehicle(link: Any, stopped: Callable[[], bool]) -> int | None:
    """Return the system id of the vehicle on the link, once others would have spoken; None when stopped before."""
    received: set[int] = set()
    settled_s, heartbeat_s = math.inf, -math.inf
    while not stopped():
        message = link.recv_match(type="HEARTBEAT", blocking=True, timeout=_WAIT_S)
        now_s = time.monotonic()
        if now_s >= heartbeat_s:  # over udpout a vehicle answers only known senders
            heartbeat_s = now_s + _HEARTBEAT_S
            _send(link, SimulatedPayload.heartbeat())
        if message is not None and message.autopilot != mavlink.MAV_AUTOPILOT_INVALID:
            settled_s = min(settled_s, now_s + _SETTLING_S)
            received.add(message.get_srcSystem())
        if len(received) > 1:
            names = " and ".join(map(str, sorted(received)))
            raise CompanionError(f"leads to several vehicles, systems {names}; name one as ID@URL")
        if now_s >= settled_s:
            return received.pop()
    return None


def _ask(companion: Companion, link: Any) -> None:
    """Request positions and attitudes at the payload's rate, and home until it is known."""
    every_us = mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, companion.period_s * 1e6
    asked = dict.fromkeys(_ASKED, every_us)
    if companion.wants_home:
        asked[mavlink.MAVLINK_MSG_ID_HOME_POSITION] = mavlink.MAV_CMD_REQUEST_MESSAGE, 0
    for message_id, (command, period_us) in asked.items():
        link.mav.command_long_send(companion.vehicle_id, 1, command, 0, message_id, period_us, 0, 0, 0, 0, 0)

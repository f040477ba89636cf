"""A payload read by its own protocol: its measurements arrive as messages of the vehicle's component 154."""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections.abc import AsyncIterator, Callable, Collection, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from pymavlink.dialects.v20 import all as mavlink

from sidelong.app.config import Config, PayloadSection, RouteSection
from sidelong.app.errors import InputError
from sidelong.app.flight.session import Session
from sidelong.app.flight.streams import announcing
from sidelong.app.link.message import Message
from sidelong.app.link.stored import read_mission
from sidelong.app.link.transport import Peer, Transport, opened
from sidelong.app.link.vehicle import LinkError, Vehicle, VehicleTimeline
from sidelong.app.payload.driver import AircraftPose, DriverSettings, Measured
from sidelong.app.payload.registry import MAVLINK, kind_by_name, resolved
from sidelong.app.payload.session import COMPONENT, PayloadSession, PayloadStatus, fields_of, packed
from sidelong.app.records.route_file import read_flight_route
from sidelong.estimators.frames import LocalPlane
from sidelong.mission.core.events import RouteGiven

_FAR_M = 20_000.0  # from the origin of the plane: farther routes are probably wrong coordinates
_ROUTE_WITHIN_S = 120.0  # a slow radio takes a second for each item


def check_route(route: RouteSection, own_ids: Collection[int]) -> None:
    """Raise InputError if the route is to be read from an aircraft of the flight itself, by its system id."""
    if route.system_id in own_ids:
        raise InputError(f"system {route.system_id} is the aircraft itself: give the system id of the target.")


def give_route(
    route: RouteSection,
    session: Session,
    plane: LocalPlane,
    put: Callable[[RouteGiven], object],
    note: Callable[[str], object],
) -> None:
    """Pass on the configured route, as an event of the vehicle's time; the target's mission once it is read.

    note: receives in words why there is none, or that it is far away. Raises InputError if the file cannot be used.
    """

    def pass_on(east_m: Iterable[float], north_m: Iterable[float], lap: bool) -> None:
        way = tuple(east_m), tuple(north_m)
        put(RouteGiven(session.telemetry.now_s, *way, lap, route.tolerance_m, route.speed_m_s, route.direction))
        nearest_m = float(np.hypot(*way).min())
        if nearest_m > _FAR_M:
            note(
                f"the nearest way point of the route is more than {nearest_m // 1000:.0f} km away: check the route, "
                "the order of latitude and longitude, and that they are degrees"
            )

    async def of_mission(system_id: int) -> None:
        note(f"reading the route of the target from system {system_id}")
        try:
            async with asyncio.timeout(_ROUTE_WITHIN_S):
                mission = await read_mission(session.vehicle, system_id)
        except TimeoutError:
            note(f"no route: system {system_id} has not sent its mission within {_ROUTE_WITHIN_S:.0f} s")
            return
        except (LookupError, LinkError) as error:
            note(f"no route: {error}; the flight continues without it")
            return
        east_m, north_m = zip(*(plane.east_north_m(*point) for point in mission.points_deg), strict=True)
        pass_on(east_m, north_m, route.lap or mission.lap)

    if route.file is not None:
        east_m, north_m = read_flight_route(route.file).in_plane(plane)
        pass_on(east_m.tolist(), north_m.tolist(), route.lap)
    if route.system_id is not None:
        session.begin(of_mission(route.system_id))


_TICK_S, _TICK_MIN_S = 0.01, 0.004
_RETRY_S = 1.0
_DELAY_MAX_S = 0.5


@dataclass(eq=False)
class PayloadRunner:
    _url: str
    _session: PayloadSession
    _rate: float  # seconds of the driver's clock per second of this computer's
    _measured: Callable[[Measured, float], object]  # with the time on this computer's monotonic clock
    _report: Callable[[str], object]  # trouble with the connection, one sentence without its full stop
    _begun_s: float = field(default_factory=time.monotonic)
    _transport: Transport | None = None
    _loop: asyncio.AbstractEventLoop = field(default_factory=asyncio.get_running_loop)

    async def run(self) -> None:
        """Open the payload and read it until cancelled. Raises InputError where its port cannot be opened."""
        try:
            self._transport = await self._opened()
            self._transport.start(self._arrived)
            while True:
                self._send(self._session.due(self._driver_s(time.monotonic())))
                await asyncio.sleep(max(_TICK_S / self._rate, _TICK_MIN_S))
        finally:
            if self._transport is not None:
                await asyncio.to_thread(self._transport.close)

    def aircraft(self, pose: AircraftPose) -> None:
        """Send the aircraft's attitude and position to the payload."""
        self._send(self._session.aircraft(pose, self._driver_s(time.monotonic())))

    def point(self, pitch_rad: float, yaw_rad: float) -> None:
        """Point the gimbal; yaw is relative to the aircraft's heading."""
        self._send(self._session.point(pitch_rad, yaw_rad))

    @property
    def pan_limits_rad(self) -> tuple[float, float] | None:
        """Least and greatest yaw off the nose; None while they are unknown, or if there are none."""
        return self._session.pan_limits_rad

    def status(self) -> PayloadStatus:
        return self._session.status(self._driver_s(time.monotonic()))

    async def _opened(self) -> Transport:
        reported = False
        while True:
            try:
                return await asyncio.to_thread(opened, self._url)
            except OSError as error:
                if not reported:
                    reported = True
                    self._report(f"payload at {self._url}: {error.strerror or error}; trying again each second")
                await asyncio.sleep(_RETRY_S)

    def _driver_s(self, monotonic_s: float) -> float:
        return (monotonic_s - self._begun_s) * self._rate

    def _send(self, commands: list[bytes]) -> None:
        if self._transport is not None:
            for command in commands:
                self._transport.send(command)

    def _arrived(self, data: bytes, _peer: Peer) -> bool:
        arrived_s = time.monotonic()
        with contextlib.suppress(RuntimeError):  # the loop has ended
            self._loop.call_soon_threadsafe(self._take, data, arrived_s)
        return True

    def _take(self, data: bytes, arrived_s: float) -> None:
        for measured in self._session.receive(data, self._driver_s(arrived_s)):
            self._measured(measured, self._begun_s + measured.time_s / self._rate)


class PayloadInput:
    """Passes a payload's measurements to the listeners of a vehicle, stamped with the vehicle's time.

    rate: seconds of the vehicle's clock per second of this computer's.
    """

    def __init__(self, vehicle: Vehicle, rate: float, on_frame: Callable[[bytes], object]) -> None:
        self._vehicle, self._rate, self._on_frame = vehicle, rate, on_frame
        self._timeline = VehicleTimeline(rate)
        self._encoder = mavlink.MAVLink(None, vehicle.system_id, COMPONENT)

    def on_message(self, message: Message) -> AircraftPose | None:
        """Update the vehicle's time; return the aircraft's pose, if known, after its position or attitude."""
        if not self._timeline.on_report(message):
            return None
        attitude, position = (self._vehicle.latest.get(name) for name in ("ATTITUDE", "GLOBAL_POSITION_INT"))
        return None if attitude is None or position is None else _pose(attitude.fields, position.fields)

    def measured(self, one: Measured, time_s: float) -> None:
        """Hand on a measurement that was made at ``time_s`` of this computer's monotonic clock."""
        delay_s = 0.0
        if self._rate == 1.0:  # in a simulation the round trip is the computer's load, not the link's
            delay_s = min(0.5 * (self._vehicle.round_trip_s or 0.0), _DELAY_MAX_S)
        vehicle_s = self._timeline.vehicle_s(time_s, delay_s)
        if vehicle_s is None or vehicle_s <= 0.0:
            return
        name, fields = fields_of(one, vehicle_s)
        frame = packed(name, fields, self._encoder)
        if frame is not None:
            self._encoder.seq = (self._encoder.seq + 1) % 256
            self._on_frame(frame)
        self._vehicle.take(Message(name, self._vehicle.system_id, COMPONENT, fields, time.time()))


def _pose(attitude: Mapping[str, Any], position: Mapping[str, Any]) -> AircraftPose:
    place = position["lat"] * 1e-7, position["lon"] * 1e-7, position["alt"] * 1e-3, position["relative_alt"] * 1e-3
    velocity_m_s = position["vx"] * 1e-2, position["vy"] * 1e-2, -position["vz"] * 1e-2
    return AircraftPose(attitude["roll"], attitude["pitch"], attitude["yaw"], *place, *velocity_m_s)


def driver_of(
    payload: PayloadSection, report: Callable[[str], object], simulated_url: str | None = None
) -> tuple[str, str, PayloadSession]:
    """Return name, URL and session of a payload with a driver. Raises InputError for a host that is not known."""
    kind = kind_by_name(payload.kind)
    url = resolved(simulated_url or payload.url or kind.url)
    flips, over_tcp = (payload.flip_yaw, payload.flip_pitch), url.startswith("tcp:")
    driver = kind.make(DriverSettings(payload.range_unit_m, *flips, payload.angles_relative_to, over_tcp))
    name = f"{kind.name} at {url}"
    return name, url, PayloadSession(name, driver, report, payload.range_delay_s, payload.angles_delay_s)


@contextlib.asynccontextmanager
async def payload_input(
    config: Config,
    vehicle: Vehicle,
    report: Callable[[str], object],
    on_frame: Callable[[bytes], object] = lambda _data: None,
    simulated_url: str | None = None,
) -> AsyncIterator[PayloadRunner | None]:
    """Read the configured payload by its driver, or the simulated one; None for one that speaks MAVLink.

    on_frame: receives each measurement as a MAVLink frame. Raises InputError if the payload's host is not known.
    """
    if config.payload.kind == MAVLINK:
        yield None
        return
    rate = 1.0 if simulated_url is None else config.simulation.speed
    reader = PayloadInput(vehicle, rate, on_frame)
    name, url, session = driver_of(config.payload, report, simulated_url)
    runner = PayloadRunner(url, session, rate, reader.measured, report)

    def on_message(message: Message) -> None:
        pose = reader.on_message(message)
        if pose is not None:
            runner.aircraft(pose)

    vehicle.listeners.append(on_message)
    running = asyncio.create_task(announcing(runner.run(), f"payload {name}", report))
    try:
        yield runner
    finally:
        vehicle.listeners.remove(on_message)
        running.cancel()
        await asyncio.gather(running, return_exceptions=True)

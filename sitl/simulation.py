"""The simulation: vehicle, target and payload on one clock that advances only by :meth:`Simulation.advance`."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Hashable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from pymavlink.dialects.v20 import all as mavlink

from sidelong.sitl.arduplane import SimulatedArduPlane
from sidelong.sitl.autopilot import SimulatedAutopilot
from sidelong.sitl.payload.devices import Device, Wired, device_of
from sidelong.sitl.payload.payload import PAYLOAD_MESSAGES, PERIOD_S, Measurement, SimulatedPayload, TargetGeometry
from sidelong.sitl.protocol.radio import PAYLOAD, Datagram, Station
from sidelong.sitl.px4 import SimulatedPx4
from sidelong.sitl.settings import Flavour, Settings, TargetSettings
from sidelong.sitl.world.hills import Hills
from sidelong.sitl.world.motion import MOTIONS, Motion, built_in_motion
from sidelong.sitl.world.track import TrackMotion, read_track
from sidelong.sitl.world.truth import TruthRow

if TYPE_CHECKING:
    from sidelong.sitl.payload.camera import GimbalCamera

STEP_S = 0.02
_OBSERVE_EVERY = round(PERIOD_S / STEP_S)
_HEARTBEAT_EVERY = round(1.0 / STEP_S)
_AIRFIELD_M = 500.0  # the ground around home is flat for takeoff and landing, unless it is lower there
_REBOOT_S = 2.0
_SILENT_S = 60.0  # of the stations' clock: after this silence, a station that was not configured is removed
_EXPIRE_EVERY = round(5.0 / STEP_S)
_WALK_SPEED_M_S = 3.0
_TRACK_SPEED_M_S = 6.0
_PATH_S = 3600.0  # of the target, along which the rendered world is furnished


class Simulation(Wired):
    """Datagrams in by :meth:`receive`, time by :meth:`advance`, datagrams out by :meth:`take`.

    A station is any hashable address; :meth:`connect` adds a station that receives frames before it has sent any.
    ``time_s`` runs from 0; the vehicle's own clock does too until a reboot.
    """

    def __init__(self, settings: Settings) -> None:
        seed = settings.seed if settings.target_seed is None else settings.target_seed
        _, sensor_seed = np.random.SeedSequence(settings.seed).spawn(2)
        self.settings = settings
        self.vehicle: SimulatedAutopilot = (
            SimulatedPx4(settings) if settings.flavour == Flavour.PX4 else SimulatedArduPlane(settings)
        )
        self.motions = target_motions(settings.targets, seed, settings.home_east_m)
        self.looks_at = settings.looks_at
        self.hills = Hills(settings.terrain, self.vehicle.plane)
        self.payload = SimulatedPayload(settings.payload, sensor_seed) if settings.payload is not None else None
        self.camera = None if settings.camera is None else camera_of(settings, seed, self.hills)
        if self.camera is not None:
            self.vehicle.handlers[mavlink.MAV_CMD_DO_GIMBAL_MANAGER_PITCHYAW] = self.camera.on_command
        self._latency_s = 0.0 if settings.payload is None else settings.payload.latency_s
        super().__init__(device_of(settings), round(self._latency_s / STEP_S))
        self._measured: Measurement | None = None
        self.muted: set[str] = set()  # payload messages withheld, by name
        self.lost_s = math.inf  # from then on nothing is received from the vehicle
        self.on_truth: Callable[[TruthRow], None] = lambda _row: None
        self._in_flight: deque[tuple[float, list[Any]]] = deque()
        self._received: list[tuple[Station, Any]] = []
        self._steps = 0
        self._boot_step = 0

    @property
    def time_s(self) -> float:
        return self._steps * STEP_S

    def connect(self, address: Hashable) -> None:
        """Send to an address before it has sent anything."""
        self.vehicle.radio.connect(address, self.vehicle.now_s).expected = True

    def receive(self, address: Hashable, data: bytes) -> None:
        """Process a datagram from a station, known or new."""
        if self._steps < self._boot_step or self.time_s >= self.lost_s:
            return
        station = self.vehicle.radio.connect(address, self.vehicle.now_s)
        for message in station.parser.parse_buffer(data) or ():
            if self.vehicle.receives_once_a_loop:
                self._received.append((station, message))
            else:
                self.vehicle.handle(station, message)

    def take(self) -> list[Datagram]:
        """Return the datagrams to send since the last call."""
        radio = self.vehicle.radio
        taken, radio.outbox = radio.outbox, []
        return taken

    def advance(self, to_s: float) -> None:
        """Make every step that ends by to_s."""
        while self.time_s + STEP_S <= to_s + 1e-9:
            self._step()

    def reboot(self) -> None:
        """Restart the autopilot in flight: two silent seconds, clock at zero, default mode and rates.

        It keeps its missions and parameters, and its arming, as after a watchdog reset.
        """
        self._boot_step = self._steps + round(_REBOOT_S / STEP_S)
        self.vehicle.reboot()

    def mute_payload(self, *kinds: str) -> None:
        """Withhold these payload messages, by name; all of them without a name."""
        self.muted |= set(kinds or PAYLOAD_MESSAGES)

    def pilot_takes_over(self) -> None:
        """Change to another mode, as a pilot by remote control does."""
        self.vehicle.set_mode(self.vehicle.taken_over_mode)

    def _step(self) -> None:
        self._steps += 1
        if self.time_s >= self.lost_s:
            return
        if self._steps % _EXPIRE_EVERY == 0:
            self.vehicle.radio.drop_silent(self.vehicle.now_s - _SILENT_S * self.settings.link_rate)
        since_boot = self._steps - self._boot_step
        vehicle = self.vehicle
        if since_boot <= 0:
            vehicle.coast(STEP_S)
            return
        vehicle.step(since_boot * STEP_S, STEP_S)
        if vehicle.reboot_ordered:
            self.reboot()
            return
        if self._received:
            received, self._received = self._received, []
            for station, message in received:
                vehicle.handle(station, message)
        if self._steps % _OBSERVE_EVERY == 0:
            self._observe()
        if self.camera is not None:
            target_m = self.hills.standing(self.camera.scenery.target_m(self.time_s))
            self.camera.step(self.time_s, STEP_S, vehicle.craft, target_m)
        if self.device is not None:
            self._see(self.device)
        if self._in_flight and self._in_flight[0][0] <= self.time_s:
            self._deliver(self._in_flight.popleft()[1])
        vehicle.stream()

    def _observe(self) -> None:
        vehicle, craft = self.vehicle, self.vehicle.craft
        aircraft_m = (craft.east_m, craft.north_m, craft.height_m)
        target_m = self.hills.standing(self._target_seen())
        ground_m = self.hills.height_m(craft.east_m, craft.north_m)
        is_near = math.hypot(craft.east_m, craft.north_m) < _AIRFIELD_M
        craft.ground_m = min(ground_m, 0.0) if is_near else ground_m
        in_sight = self.hills.sees_target(aircraft_m, target_m)
        # On the ground the payload measures nearby objects, so it always has data.
        clear = in_sight or not craft.flying
        valid = outlier = False
        self._measured = None
        if self.camera is not None:
            messages = [self.camera.attitude(vehicle.boot_ms)]
            if self._steps % _HEARTBEAT_EVERY == 0:
                messages.append(SimulatedPayload.heartbeat())
            self._in_flight.append((self.time_s, [m for m in messages if m.get_type() not in self.muted]))
        elif self.payload is not None:
            sight = self._sight(target_m, clear)
            self._measured = measured = self.payload.measure(self.time_s, vehicle.boot_ms, sight, craft.yaw_rad)
            messages = measured.messages if self.device is None else []
            if self._steps % _HEARTBEAT_EVERY == 0:
                messages.append(self.payload.heartbeat())
            if self.muted:
                messages = [message for message in messages if message.get_type() not in self.muted]
            self._in_flight.append((self.time_s + self._latency_s - 1e-9, messages))
            valid, outlier = measured.laser_valid, measured.laser_outlier
        place_deg = vehicle.plane.latitude_longitude_deg
        places = target_m, place_deg(*target_m[:2]), aircraft_m, place_deg(*aircraft_m[:2])
        ground, name = self.hills.reported(aircraft_m, in_sight), self.settings.targets[self.looks_at].name
        true = TargetGeometry.between(aircraft_m, target_m)
        line = true.slant_range_m, true.bearing_rad
        self.on_truth(TruthRow(vehicle.now_s, *places, *line, valid, outlier, *ground, name))

    def _sight(self, target_m: tuple[float, float, float], clear: bool = True) -> TargetGeometry:
        """Return the line that the gimbal is on, which in gusts is not quite on the target."""
        craft = self.vehicle.craft
        to_m = target_m[0] - craft.east_m, target_m[1] - craft.north_m, target_m[2] - craft.height_m
        return TargetGeometry.between((0.0, 0.0, 0.0), craft.pointed_m(to_m), clear)

    def _see(self, device: Device) -> None:
        craft, measured = self.vehicle.craft, self._measured
        if measured is not None:
            target_m = self.hills.standing(self.motions[self.looks_at].at(self.time_s))
            self.look(device, self._sight(target_m), measured, craft.yaw_rad, craft.roll_rad)

    def _target_seen(self) -> tuple[float, float]:
        """Return where the target is that the payload looks at; turned to a place it takes what is nearest there."""
        if self.camera is not None:
            return self.camera.scenery.target_m(self.time_s)
        places_m = [motion.at(self.time_s) for motion in self.motions]
        roi, self.vehicle.roi = self.vehicle.roi, None
        if roi is not None:
            off_m = [math.dist(place_m, (roi.east_m, roi.north_m)) for place_m in places_m]
            self.looks_at = off_m.index(min(off_m))
        return places_m[self.looks_at]

    def _deliver(self, messages: list[Any]) -> None:
        for message in messages:
            self.vehicle.radio.broadcast(message, PAYLOAD)
            if message.get_type() == "DISTANCE_SENSOR" and isinstance(self.vehicle, SimulatedPx4):
                self.vehicle.take_range(message)


def camera_of(settings: Settings, seed: int, hills: Hills) -> GimbalCamera:
    """Return the camera of a vehicle over a world that is furnished along its target's motion; serve its pictures."""
    from sidelong.sitl.payload.camera import GimbalCamera, VideoServer  # noqa: PLC0415  # PyAV and OpenCV
    from sidelong.sitl.world.picture import Scenery  # noqa: PLC0415

    own, motion = settings.camera, target_motions(settings.targets, seed, settings.home_east_m)[settings.looks_at]
    assert own is not None
    path_m = np.array([motion.at(time_s) for time_s in np.arange(_PATH_S)])
    scenery = Scenery(path_m, hills.height_m, seed, trees=own.trees, lookalikes=own.lookalikes, sees=hills.see)
    camera = GimbalCamera(own, scenery)
    if own.url:
        camera.on_picture = VideoServer(own.url, own).put
    return camera


def target_motions(targets: Sequence[TargetSettings], seed: int, home_east_m: float) -> list[Motion]:
    """Return the targets' motions, drawn separately, in the plane of a home this far east of the first one."""
    shifted = (replace(target, start_m=(target.start_m[0] - home_east_m, target.start_m[1])) for target in targets)
    return [target_motion(target, (seed, number) if number else seed) for number, target in enumerate(shifted)]


def target_motion(settings: TargetSettings, seed: int | Sequence[int]) -> Motion:
    """Return the target's motion. Raises TrackError for a file that is no track."""
    speed_m_s = settings.speed_max_m_s
    if settings.motion in MOTIONS:
        speed_m_s = _WALK_SPEED_M_S if speed_m_s is None else speed_m_s
        target_seed, _ = np.random.SeedSequence(seed).spawn(2)
        rng = np.random.default_rng(target_seed)
        return built_in_motion(settings.motion, settings.start_m, speed_m_s, rng)
    track = read_track(Path(settings.motion))
    skip_s = track.first_motion_s() if settings.skip_s is None else settings.skip_s
    return TrackMotion(track, settings.start_m, _TRACK_SPEED_M_S if speed_m_s is None else speed_m_s, skip_s)

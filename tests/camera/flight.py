"""A flight from pixels alone: the rendered world of :mod:`sidelong.sitl`, the camera, and the core in one loop.

Without a camera in the settings it is the same flight with laser and gimbal.
"""

from __future__ import annotations

import math
import time
from collections import deque
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from sidelong.app.analysis.score import Moment, Score, judge_moments, score
from sidelong.app.assembly import mission_controller_of, prepared
from sidelong.app.autopilots.registry import autopilot_by_mav_autopilot
from sidelong.app.camera.camera import TargetCamera
from sidelong.app.camera.component import status_of
from sidelong.app.camera.view import View
from sidelong.app.config import Config
from sidelong.app.link.message import Message
from sidelong.app.simulation.loop import ClosedLoop
from sidelong.estimators.estimate import TrackQuality
from sidelong.mission.core.events import ControlAcquired
from sidelong.mission.exchange.dialect import Home
from sidelong.sitl.settings import CameraSettings, Flavour, Settings, TargetSettings
from sidelong.sitl.simulation import Simulation
from tests.sitl_vehicle import RATES_HZ, SitlVehicle

CAMERA = 100
_PIPELINE_S = 0.15
_POINT_EVERY_S, _REPORT_EVERY_S, _VIEW_EVERY_S = 0.1, 0.4, 1.0
_DO_GIMBAL_MANAGER_PITCHYAW, _YAW_LOCK = 1000, 16
_ON_CIRCLE_WITHIN_S = 300.0
_CLICK_ABOVE_M, _CLIMBED_SHARE = 40.0, 0.95
_CHI2_95 = 5.991
_JUDGED_EVERY_S = 0.5
_WRONG_M, _CLICK_AGAIN_S = 10.0, 20.0


@dataclass(slots=True)
class Pixels:
    """What was recorded, once a picture, or once a judged position.

    Attributes:
        score: by the truth, None before the end of the flight.
        clicks: how often the operator pointed the gimbal at the target and clicked it again.
    """

    in_picture: list[bool] = field(default_factory=list)
    in_middle: list[bool] = field(default_factory=list)
    off_m: list[float] = field(default_factory=list)  # of what is tracked from the target, nan: lost
    inside: list[bool] = field(default_factory=list)  # of the 95 % ellipse
    score: Score | None = None
    clicks: int = 0
    times_s: list[float] = field(default_factory=list)
    cost_s: list[float] = field(default_factory=list)


def clicked(camera: TargetCamera, view: View, picture: Any, target_m: tuple[float, float]) -> bool:
    """Click the target, if the operator sees it plainly; return whether he does."""
    at, side_px = view.pixel(*target_m), view.scale_px_m(*target_m)
    if at is None:
        return False
    (x_px, y_px), (width, height) = at, view.size_px
    half, x, y = max(round(0.6 * side_px), 2), round(x_px), round(y_px)
    seen = picture[max(y - half, 0) : y, max(x - half, 0) : x + half]
    around = picture[max(y - 4 * half, 0) : y + 2 * half, max(x - 4 * half, 0) : x + 4 * half]
    if not seen.size or np.mean(seen[..., 2] > 1.8 * seen[..., 1]) < 0.7:
        return False
    if np.mean(around[..., 1] > 1.5 * around[..., 2]) > 0.02:  # a tree stands before a part of it, or next to it
        return False
    camera.follow(x_px / width, y_px / height)
    return True


class PixelFlight(ClosedLoop[bytes]):
    """Fly it with :meth:`fly`."""

    camera: TargetCamera | None = None

    def __init__(self, config: Config, settings: Settings, rate_hz: float = 15.0) -> None:
        self.simulation = Simulation(settings)
        super().__init__(SitlVehicle(self.simulation, {**RATES_HZ, 2: 1.0}))
        self.pixels = Pixels()
        self.has_control = self._clicked = False
        self._on_target_s = math.inf
        self._point_s = self._report_s = self._view_s = 0.0
        self._pictures: deque[tuple[float, Any]] = deque()
        self.connect()
        vehicle = self.simulation.vehicle
        home = Home(vehicle.home.latitude_deg, vehicle.home.longitude_deg, vehicle.home.altitude_m)
        home_deg = home.latitude_deg, home.longitude_deg
        controller = prepared(config).controller(self.telemetry.plane, home_deg)
        self.controller = controller
        dialect = autopilot_by_mav_autopilot(vehicle.autopilot_id)
        self.core = mission_controller_of(config, controller, dialect, self.telemetry.plane, home)
        ground = controller.surroundings.ground
        if settings.camera is not None:
            view_rad = math.radians(settings.camera.view_deg)
            self.camera = TargetCamera(view_rad, (1.0, 0.0, 0.0, 0.0), 0.15, ground, self._estimate)
            self.simulation.camera.on_picture = lambda _time_s, image: self._pictures.append((vehicle.now_s, image))
        self.listeners.append(self._follow_events)
        self.requirement, self.height_m = config.requirement.requirement(), config.aircraft.height_m

    def _estimate(self, time_s: float):
        return self.controller.tracker.estimate(time_s)

    def _follow_events(self, event: object, outputs: tuple[object, ...]) -> None:
        if self.camera is not None:
            self.camera.event(event)
        self.has_control |= any(isinstance(output, ControlAcquired) for output in outputs)

    def step(self) -> None:
        """Move the clock by one tick, and let the camera work."""
        super().step()
        if self.core is None or self.camera is None:
            return
        vehicle = self.simulation.vehicle
        now_s = vehicle.now_s
        while self._pictures and self._pictures[0][0] <= now_s - _PIPELINE_S:
            taken_s, picture = self._pictures.popleft()
            self._take(taken_s, picture)
        if now_s >= self._point_s:
            self._point_s = now_s + _POINT_EVERY_S
            wanted = self.camera.pointing(now_s)
            if wanted is not None:
                degrees = [math.degrees(one) for one in wanted]
                fields = {
                    "command": _DO_GIMBAL_MANAGER_PITCHYAW,
                    "param1": degrees[0],
                    "param2": degrees[1],
                    "param3": math.nan,
                    "param4": math.nan,
                    "param5": float(_YAW_LOCK),
                }
                self.transmit(self._packer.frame("COMMAND_LONG", fields, self.simulated.system_id))

    def _take(self, taken_s: float, picture: Any) -> None:
        begun_s = time.perf_counter()
        found = self.camera.picture(picture, taken_s)
        self.pixels.cost_s.append(time.perf_counter() - begun_s)
        if found is None:
            return
        if not self._clicked:
            if self.simulation.vehicle.craft.height_m > _CLICK_ABOVE_M:
                self._clicked = clicked(self.camera, found.view, picture, self._target_m(self.simulation.time_s))
                self._on_target_s = taken_s
                self._judge(taken_s, found)
            return
        if taken_s >= self._view_s:
            self._view_s = taken_s + _VIEW_EVERY_S
            hfov = math.degrees(self.camera.view_rad)
            vfov = math.degrees(2 * math.atan(math.tan(math.radians(hfov / 2)) * picture.shape[0] / picture.shape[1]))
            self._say("CAMERA_FOV_STATUS", {"hfov": hfov, "vfov": vfov})
        if taken_s >= self._report_s:
            self._report_s = taken_s + _REPORT_EVERY_S
            self._say("CAMERA_TRACKING_IMAGE_STATUS", status_of(found) | {"capture_s": taken_s})
        self._judge(taken_s, found)

    def _say(self, name: str, fields: dict) -> None:
        self.on_message(Message(name, self.simulated.system_id, CAMERA, fields, 0.0))

    def _judge(self, taken_s: float, found: Any) -> None:
        pixels, simulation = self.pixels, self.simulation
        boot_s = simulation.time_s - simulation.vehicle.now_s
        target = simulation.camera.scenery.target_m(taken_s + boot_s)
        at = found.view.pixel(*target)
        width, height = found.view.size_px
        inside = at is not None and 0 <= at[0] < width and 0 <= at[1] < height
        pixels.in_picture.append(inside)
        pixels.in_middle.append(inside and abs(at[0] / width - 0.5) < 0.25 and abs(at[1] / height - 0.5) < 0.25)
        off_m = math.nan
        if found.tracked.state == "object":
            ground = found.view.ground(found.tracked.box.x_px, found.tracked.box.y_px)
            off_m = math.dist(ground, target)
        if off_m < _WRONG_M:
            self._on_target_s = taken_s
        elif taken_s > self._on_target_s + _CLICK_AGAIN_S:
            pixels.clicks, self._clicked = pixels.clicks + 1, False
            self.camera.stop()
            simulation.camera.commanded = False
        pixels.off_m.append(off_m)
        pixels.times_s.append(taken_s)
        estimate = self._estimate(taken_s)
        if estimate is not None and estimate.quality is not TrackQuality.LOST:
            off = np.array(estimate.position_m(taken_s)) - target
            pixels.inside.append(bool(off @ np.linalg.solve(estimate.covariance[:2, :2], off) <= _CHI2_95))

    def _target_m(self, time_s: float) -> tuple[float, float]:
        simulation = self.simulation
        if simulation.camera is None:
            return simulation.motions[simulation.looks_at].at(time_s)
        return simulation.camera.scenery.target_m(time_s)

    def _is_watching(self) -> bool:
        """Return whether it has climbed and come within the band, which a takeoff may leave first."""
        craft, wanted = self.simulation.vehicle.craft, self.requirement
        range_m = math.dist((craft.east_m, craft.north_m), self._target_m(self.simulation.time_s))
        has_climbed = craft.height_m > _CLIMBED_SHARE * self.height_m
        return has_climbed and self.controller.estimate is not None and range_m < wanted.range_max_m

    def fly(self, duration_s: float) -> Pixels:
        """Take off, and watch for a time, from when the aircraft is at its height and in the band."""
        self.take_over()
        self.run(_ON_CIRCLE_WITHIN_S, lambda: self.has_control)
        self.run(_ON_CIRCLE_WITHIN_S, self._is_watching)
        for name in ("in_picture", "in_middle", "off_m", "inside", "times_s", "cost_s"):
            getattr(self.pixels, name).clear()
        self.pixels.clicks = 0
        begin_s, moments, before_m = self.simulation.time_s, [], self._target_m(self.simulation.time_s)
        while (time_s := self.simulation.time_s) < begin_s + duration_s:
            craft, at_m = self.simulation.vehicle.craft, self._target_m(time_s)
            velocity_m_s = [(now - before) / _JUDGED_EVERY_S for now, before in zip(at_m, before_m, strict=True)]
            moments.append(Moment(time_s, craft.east_m, craft.north_m, *at_m, *velocity_m_s))
            before_m = at_m
            self.run(_JUDGED_EVERY_S)
        judged = judge_moments(moments, ((-math.inf, self.requirement),))
        self.pixels.score = score(judged, "truth", end_s=self.simulation.time_s)
        return self.pixels


def settings_of(flavour: str, motion: str, seed: int, **camera: Any) -> Settings:
    """Return the simulator's settings of a camera that watches a motion or a track."""
    return Settings(Flavour(flavour), seed=seed, targets=(TargetSettings(motion),), camera=CameraSettings(**camera))

"""The camera of a flight: its video, its place on the link, and the gimbal that it leads."""

from __future__ import annotations

import asyncio
import contextlib
import math
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from pymavlink.dialects.v20 import all as mavlink

from sidelong.app.camera.camera import TargetCamera
from sidelong.app.camera.component import CAMERA_COMPONENT, CameraComponent, Sent
from sidelong.app.camera.video import Picture, VideoFile, VideoSource
from sidelong.app.config import CameraSection
from sidelong.app.link.message import Message
from sidelong.app.link.vehicle import Vehicle, VehicleTimeline
from sidelong.app.link.wire import Packer
from sidelong.estimators.tracking.tracker import Tracker

_WAIT_S = 0.1
_POINT_EVERY_S, _REPORT_EVERY_S = 0.1, 0.4  # a tracker's error lasts for seconds: more reports would say no more
_CLICK_ABOVE_M = 40.0
_MEGABYTE = 1e6

Point = Callable[[float, float], object]
"""Points the gimbal of a payload with a driver: pitch, and yaw relative to the aircraft's heading, rad."""


class CameraRunner:
    """Runs a camera next to a flight, or alone.

    Args:
        settings: The configuration.
        vehicle: That carries it.
        tracker: Estimates the target, and knows the gimbal's mount.
        ground_m: Returns the height of the ground above home at (east, north).
        note: Receives what happens, in words.
        source: The video, instead of the configured one.
        point: Points the gimbal by the payload's own protocol; None: by the gimbal manager.
        clicks: Whether to follow what is in the middle once the aircraft has climbed: for a simulated operator.
        record: Where the video is recorded; None: nowhere.
    """

    def __init__(
        self,
        settings: CameraSection,
        vehicle: Vehicle,
        tracker: Tracker,
        ground_m: Callable[[float, float], float],
        note: Callable[[str], object],
        *,
        source: str | None = None,
        point: Point | None = None,
        clicks: bool = False,
        record: Path | None = None,
    ) -> None:
        self._settings, self._vehicle, self._note = settings, vehicle, note
        self._source, self._point, self._clicks = source or settings.source or "", point, clicks
        view_rad = math.radians(settings.view_deg)
        self.camera = TargetCamera(
            view_rad, tracker.parent_from_mount, settings.lead_s, ground_m, tracker.estimate, settings.tracker
        )
        uri = settings.stream if settings.stream else self._source if "://" in self._source else ""
        self._component = CameraComponent(vehicle.system_id, self.camera, view_rad, uri)
        self._packer = Packer((vehicle.system_id, CAMERA_COMPONENT))
        self._transmit: Callable[[bytes], None] = lambda _frame: None
        self._timeline = VehicleTimeline()
        self._outputs = [VideoFile(settings.stream, settings.rate_hz)] if settings.stream else []
        if record is not None and settings.record_mb:
            self._outputs.append(VideoFile(str(record), settings.rate_hz, settings.record_mb * _MEGABYTE))
        self._height_m, self._heading_rad = 0.0, math.nan
        self._point_s = self._report_s = -math.inf
        self._state = "idle"

    def stepped(self, event: object, _outputs: object) -> None:
        """Take an event of the flight."""
        self.camera.event(event)

    async def run(self) -> None:
        """Run until cancelled."""
        loop = asyncio.get_running_loop()

        def report(text: str) -> None:
            with contextlib.suppress(RuntimeError):  # the loop has ended
                loop.call_soon_threadsafe(self._note, text)

        vehicle, source = self._vehicle, VideoSource(self._source, report)
        vehicle.listeners.append(self._note_message)
        vehicle.bystanders.append(self._commanded)
        try:
            with vehicle.link.serving(vehicle.system_id, CAMERA_COMPONENT) as self._transmit:
                while not source.ended:
                    taken = await asyncio.to_thread(source.next, _WAIT_S)
                    if taken is not None:
                        self._take(*taken)
                    self._work()
            self._note(f"video {self._source} has ended")
        finally:
            vehicle.listeners.remove(self._note_message)
            vehicle.bystanders.remove(self._commanded)
            for output in self._outputs:
                output.close()
            await asyncio.to_thread(source.close)

    # -- in ------------------------------------------------------------------------------------------------

    def _note_message(self, message: Message) -> None:
        if not self._timeline.on_report(message):
            return
        if message.name == "ATTITUDE":
            self._heading_rad = message.fields["yaw"]
        else:
            self._height_m = message.fields["relative_alt"] * 1e-3

    def _commanded(self, message: Message) -> None:
        for sent in self._component.command(message, time.monotonic()):
            self._send(sent)

    def _take(self, picture: Picture, arrived_s: float) -> None:
        self._component.picture_size(picture.shape[1], picture.shape[0])
        taken_s = self._timeline.vehicle_s(arrived_s - self._settings.delay_s)
        if taken_s is None:
            return
        if self._clicks and self._height_m > _CLICK_ABOVE_M:
            self._clicks = False
            self.camera.follow(0.5, 0.5)
            self._note("the simulated operator clicks the target in the middle of the picture")
        pictured = self.camera.picture(picture, taken_s)
        for output in self._outputs:
            with contextlib.suppress(OSError):
                output.put(picture, taken_s)
        if pictured is None:
            return
        state = pictured.tracked.state
        if state != self._state:
            self._state = state
            words = {"object": "follows the object", "lost": "has lost the object: searching", "idle": "is idle"}
            self._note(f"the camera {words[state]}")
        if state != "idle" and taken_s >= self._report_s:
            self._report_s = taken_s + _REPORT_EVERY_S
            fields = self.camera.status() | {"capture_s": taken_s, "camera_device_id": 0}
            self._pass("CAMERA_TRACKING_IMAGE_STATUS", fields)

    def _pass(self, name: str, fields: dict[str, Any]) -> None:
        """Hand the flight a message of the camera's."""
        vehicle = self._vehicle
        vehicle.take(Message(name, vehicle.system_id, CAMERA_COMPONENT, fields, time.time()))

    # -- out -----------------------------------------------------------------------------------------------

    def _work(self) -> None:
        now_s = time.monotonic()
        for name, fields in self._component.due(now_s):
            self._send((name, fields))
            if name == "CAMERA_FOV_STATUS":
                self._pass(name, fields)
        if now_s >= self._point_s:
            vehicle_s = self._timeline.vehicle_s(now_s)
            wanted = None if vehicle_s is None else self.camera.pointing(vehicle_s)
            if wanted is not None:
                self._point_s = now_s + _POINT_EVERY_S
                self._turn(*wanted)

    def _turn(self, pitch_rad: float, yaw_rad: float) -> None:
        if self._point is not None:
            if math.isfinite(self._heading_rad):
                self._point(pitch_rad, math.remainder(yaw_rad - self._heading_rad, math.tau))
            return
        fields = {
            "command": int(mavlink.MAV_CMD_DO_GIMBAL_MANAGER_PITCHYAW),
            "param1": math.degrees(pitch_rad),
            "param2": math.degrees(math.remainder(yaw_rad, math.tau)),
            "param3": math.nan,
            "param4": math.nan,
            "param5": float(mavlink.GIMBAL_MANAGER_FLAGS_YAW_LOCK),
        }
        self._send(("COMMAND_LONG", fields))

    def _send(self, sent: Sent) -> None:
        self._transmit(self._packer.frame(*sent, self._vehicle.system_id))

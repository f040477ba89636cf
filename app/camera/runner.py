"""The camera of a flight: its video, its place on the link, the gimbal that it leads, and the page's picture."""

from __future__ import annotations

import asyncio
import contextlib
import json
import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

from pymavlink.dialects.v20 import all as mavlink

from sidelong.app.camera.camera import Pictured, TargetCamera
from sidelong.app.camera.component import CAMERA_COMPONENT, CameraComponent, Sent, status_of
from sidelong.app.camera.video import Picture, VideoOutput, VideoSource, encoded
from sidelong.app.config import CameraSection
from sidelong.app.link.frames import Packer
from sidelong.app.link.message import Message
from sidelong.app.link.vehicle import Vehicle, VehicleTimeline
from sidelong.app.network import NetworkAddress
from sidelong.app.records.klv import Marked, Sensor, UasMetadata
from sidelong.estimators.frames import LocalPlane
from sidelong.estimators.terrain.ground import Ground
from sidelong.estimators.tracking.tracker import Tracker

_WAIT_S = 0.1
_STAMPS_APART_S = 1e-3
_POINT_EVERY_S, _REPORT_EVERY_S = 0.1, 0.4  # a tracker's error lasts for seconds: more reports would say no more
_CLICK_ABOVE_M = 40.0
_MEGABYTE = 1e6
_ELLIPSE_CORNERS = 32
_CLAIMS = 10  # of the gimbal, with the first commands of a tracking: an operator who claims it later keeps it
_UNCHANGED, _RELEASED = (-1, -1), (-3, -3, -1, -1)  # system and component in first and second control of a gimbal

Point = Callable[[float, float], object]
"""Points the gimbal of a payload with a driver: pitch, and yaw relative to the aircraft's heading, rad."""


Show = Callable[[Callable[[], bytes]], object]
"""Receives a function that returns a picture for the page, as :func:`encoded` returns it."""


@dataclass(frozen=True, slots=True)
class Here:
    """What video metadata needs of a flight: its name, the local plane, and home's altitude above sea level."""

    name: str
    plane: LocalPlane
    home_altitude_m: float


def overlay(pictured: Pictured) -> dict[str, Any]:
    """Return what the page draws on a picture; places in shares of its width and height, None: not in view."""
    view, estimate = pictured.view, pictured.estimate
    marks: dict[str, Any] = {"time_s": round(pictured.time_s, 3), "state": pictured.tracked.state}
    marks["box"] = pictured.edges and [round(edge, 4) for edge in pictured.edges]
    marks["confidence"] = round(pictured.tracked.confidence, 2)
    if estimate is not None:
        middle_m = estimate.position_m(pictured.time_s)
        outline_m = estimate.ellipse_95.outline(_ELLIPSE_CORNERS)
        pixels = [
            view.pixel(middle_m[0] + east_m, middle_m[1] + north_m) for east_m, north_m in ((0.0, 0.0), *outline_m)
        ]
        places = [p and [round(share / side, 4) for share, side in zip(p, view.size_px, strict=True)] for p in pixels]
        marks["estimate"], marks["ellipse"] = places[0], [] if None in places else places[1:]
    return marks


class CameraRunner:
    """Runs a camera next to a flight, or alone.

    Args:
        settings: The configuration.
        vehicle: That carries it.
        tracker: Estimates the target, and knows the gimbal's mount.
        terrain: The ground; None: it is level.
        note: Receives what happens, in words.
        here: For the metadata of the video.
        source: The video, instead of the configured one.
        point: Points the gimbal by the payload's own protocol; None: by the gimbal manager.
        clicks: Whether to follow what is in the middle once the aircraft has climbed: for a simulated operator.
        record: Where the video is recorded, with what was drawn on it next to it as JSON lines; None: nowhere.
        show: Shows the pictures on the page.
    """

    def __init__(
        self,
        settings: CameraSection,
        vehicle: Vehicle,
        tracker: Tracker,
        terrain: Ground | None,
        note: Callable[[str], object],
        here: Here,
        *,
        source: str | None = None,
        point: Point | None = None,
        clicks: bool = False,
        record: Path | None = None,
        show: Show | None = None,
    ) -> None:
        self._settings, self._vehicle, self._note = settings, vehicle, note
        self._source, self._point, self._clicks = source or settings.source or "", point, clicks
        view_rad = math.radians(settings.view_deg)
        self.camera = TargetCamera(
            view_rad, tracker.parent_from_mount, settings.lead_s, terrain, tracker.estimate, settings.tracker
        )
        self._component = CameraComponent(vehicle.system_id, self.camera, view_rad, settings.video_uri)
        self._packer = Packer((vehicle.system_id, CAMERA_COMPONENT))
        self._transmit: Callable[[bytes], None] = lambda _frame: None
        self._timeline = VehicleTimeline(simulated=clicks)  # a simulation's clock pauses with a busy computer
        self._here, self._show = here, show
        self._metadata: UasMetadata | None = None
        self._record = record if settings.record_mb else None
        address = None
        if settings.stream:
            address = NetworkAddress.read(settings.stream, ("udp",)).resolved("camera.stream")
        self._output: VideoOutput | None = None
        if self._record is not None or address is not None:
            budget_bytes = settings.record_mb * _MEGABYTE
            self._output = VideoOutput(settings.rate_hz, self._record, budget_bytes, address)
        self._marks = None if self._record is None else self._record.with_suffix(".jsonl").open("wb")
        self._height_m, self._heading_rad = 0.0, math.nan
        self._point_s = self._report_s = self._stamped_s = -math.inf
        self._state, self._claims = "idle", _CLAIMS
        self._fault: Exception | None = None

    def stepped(self, event: object, _outputs: object) -> None:
        """Pass an event of the flight to the camera; an error in it ends the camera, not the flight."""
        self._isolated(self.camera.event, event)

    def _isolated(self, work: Callable[[Any], object], argument: Any) -> None:
        """Do what the flight or the link calls: an error ends the camera, not them."""
        try:
            work(argument)
        except Exception as error:
            self._fault = self._fault or error

    async def run(self) -> None:
        """Track and report until cancelled."""
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
                    if self._fault is not None:
                        raise self._fault
                    taken = await asyncio.to_thread(source.next, _WAIT_S)
                    if taken is not None:
                        self._take(*taken)
                    self._work()
            self._note(f"video {self._source} has ended")
        finally:
            vehicle.listeners.remove(self._note_message)
            vehicle.bystanders.remove(self._commanded)
            for output in (self._output, self._marks):
                if output is not None:
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
        self._isolated(self._answer, message)

    def _answer(self, message: Message) -> None:
        for sent in self._component.command(message, time.monotonic()):
            self._send(sent)

    def _take(self, picture: Picture, arrived_s: float) -> None:
        self._component.size_px = picture.shape[1], picture.shape[0]
        taken_s = self._timeline.vehicle_s(arrived_s - self._settings.delay_s)
        if taken_s is None:
            return
        if self._clicks and self._height_m > _CLICK_ABOVE_M:
            self._clicks = False
            self.camera.follow(0.5, 0.5)
            self._note("the simulated operator clicks the target in the middle of the picture")
        pictured = self.camera.picture(picture, taken_s)
        marks = {"time_s": round(taken_s, 3), "state": "idle"} if pictured is None else overlay(pictured)
        line = json.dumps(marks, separators=(",", ":"), allow_nan=False).encode() + b"\n"
        if self._show is not None:
            self._show(lambda: encoded(line, picture))
        if self._output is not None:
            with contextlib.suppress(OSError, ValueError):  # a full disk, or values outside the standard's ranges
                self._write(self._output, picture, pictured, taken_s, line)
        if pictured is None:
            return
        state = pictured.tracked.state
        if state != self._state:
            self._state = state
            words = {"object": "follows the object", "lost": "has lost the object: searching", "idle": "is idle"}
            self._note(f"the camera {words[state]}")
        if state != "idle" and taken_s >= self._report_s:
            self._report_s = taken_s + _REPORT_EVERY_S
            self._pass("CAMERA_TRACKING_IMAGE_STATUS", status_of(pictured) | {"capture_s": taken_s})

    def _write(
        self, output: VideoOutput, picture: Picture, pictured: Pictured | None, taken_s: float, line: bytes
    ) -> None:
        """Write a picture to the stream and the record."""
        klv = b""
        # The clocks' offset may step back.
        taken_s = self._stamped_s = max(taken_s, self._stamped_s + _STAMPS_APART_S)
        metadata = self._metadata = self._metadata or self._new_metadata(picture)
        if pictured is not None:
            view, (width, height) = pictured.view, self._component.size_px
            middle_m = view.ground(0.5 * width, 0.5 * height)
            sensor = Sensor(view.ned_from_sight, 0.0 if middle_m is None else view.ground_m(*middle_m))
            marked = None
            if pictured.edges is not None:
                edges_px = tuple(edge * side for edge, side in zip(pictured.edges, 2 * (width, height), strict=True))
                marked = Marked((width, height), edges_px, pictured.tracked.confidence)  # type: ignore[arg-type]
            klv = metadata.packet(taken_s, pictured.position, pictured.attitude, sensor, pictured.estimate, marked)
        output.put(picture, taken_s, metadata.stamp_us(taken_s), klv)
        if self._marks is not None and not output.is_full:
            self._marks.write(line)

    def _new_metadata(self, picture: Picture) -> UasMetadata:
        now_s = self._timeline.vehicle_s(time.monotonic())
        booted = datetime.now(UTC) - timedelta(seconds=now_s or 0.0)
        here, aspect = self._here, picture.shape[0] / picture.shape[1]
        return UasMetadata(here.name, here.plane, booted, here.home_altitude_m, self._settings.view_rad(aspect))

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
            if wanted is None and self._claims < _CLAIMS:
                self._claims = _CLAIMS
                self._command(mavlink.MAV_CMD_DO_GIMBAL_MANAGER_CONFIGURE, *_RELEASED)
            if wanted is not None:
                self._point_s = now_s + _POINT_EVERY_S
                self._turn(*wanted)

    def _turn(self, pitch_rad: float, yaw_rad: float) -> None:
        if self._point is not None:
            if math.isfinite(self._heading_rad):
                self._point(pitch_rad, math.remainder(yaw_rad - self._heading_rad, math.tau))
            return
        if self._claims:
            self._claims -= 1
            own = self._vehicle.system_id, CAMERA_COMPONENT
            self._command(mavlink.MAV_CMD_DO_GIMBAL_MANAGER_CONFIGURE, *own, *_UNCHANGED)
        angles_deg = math.degrees(pitch_rad), math.degrees(math.remainder(yaw_rad, math.tau))
        flags = mavlink.GIMBAL_MANAGER_FLAGS_YAW_LOCK
        self._command(mavlink.MAV_CMD_DO_GIMBAL_MANAGER_PITCHYAW, *angles_deg, math.nan, math.nan, flags)

    def _command(self, command: int, *params: float) -> None:
        numbered = {f"param{number}": float(value) for number, value in enumerate(params, 1)}
        self._send(("COMMAND_LONG", {"command": int(command), **numbered}))

    def _send(self, sent: Sent) -> None:
        self._transmit(self._packer.frame(*sent, self._vehicle.system_id))

"""A gimbal camera without a laser: a gimbal that turns as commanded, and its pictures as a video stream.

The pictures are MPEG-TS with H.264 over UDP. Needs PyAV and OpenCV (the extra ``video``).
"""

from __future__ import annotations

import math
import threading
from collections.abc import Callable
from contextlib import suppress
from fractions import Fraction
from queue import Full, Queue
from typing import Any

import av
from pymavlink.dialects.v20 import all as mavlink

from sidelong.sitl.protocol.commands import ACCEPTED, DENIED, Command
from sidelong.sitl.settings import CameraSettings
from sidelong.sitl.world.airframe import SimulatedAirframe, quaternion
from sidelong.sitl.world.picture import CameraPose, Image, Scenery

_LEAN = 0.05  # of the aircraft's bank, by which a stabilised camera leans in a turn
_PITCH_RAD = (-0.5 * math.pi, math.radians(30.0))
_LOCKED = (
    mavlink.GIMBAL_DEVICE_FLAGS_ROLL_LOCK
    | mavlink.GIMBAL_DEVICE_FLAGS_PITCH_LOCK
    | mavlink.GIMBAL_DEVICE_FLAGS_YAW_LOCK
    | mavlink.GIMBAL_DEVICE_FLAGS_YAW_IN_EARTH_FRAME
)


class GimbalCamera:
    """Turns as commanded, within its rate; until then an operator keeps it on the target by hand."""

    def __init__(self, settings: CameraSettings, scenery: Scenery) -> None:
        self.settings, self.scenery = settings, scenery
        self.on_picture: Callable[[float, Image], object] = lambda _time_s, _picture: None
        self.commanded = False  # by something else than the operator
        self.yaw_rad, self.pitch_rad, self._roll_rad = 0.0, -0.3, 0.0
        self._goal_rad: tuple[float, float] = (self.pitch_rad, self.yaw_rad)
        self._goal_is_of_earth = True
        self._error_rad = (0.0, 0.0)  # of yaw and pitch, by the aircraft's rotation
        self._off_rad, self._slip_rad_s = 0.0, 0.0  # of what is looked at, from the axis
        self._next_s = 0.0

    def on_command(self, command: Command) -> int:
        """Process the angles of MAV_CMD_DO_GIMBAL_MANAGER_PITCHYAW; rates are denied."""
        pitch_rad, yaw_rad = math.radians(command.param(1)), math.radians(command.param(2))
        if not math.isfinite(pitch_rad + yaw_rad):
            return DENIED
        is_of_earth = bool(int(command.number(5)) & mavlink.GIMBAL_MANAGER_FLAGS_YAW_LOCK)
        self.point(pitch_rad, yaw_rad, is_of_earth=is_of_earth)
        return ACCEPTED

    def on_set_attitude(self, message: Any) -> None:
        """Take GIMBAL_DEVICE_SET_ATTITUDE of a gimbal manager; one with rates alone is left."""
        w, x, y, z = message.q
        if math.isfinite(w):
            pitch_rad = math.asin(min(max(2.0 * (w * y - x * z), -1.0), 1.0))
            yaw_rad = math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
            self.point(pitch_rad, yaw_rad, is_of_earth=bool(message.flags & mavlink.GIMBAL_DEVICE_FLAGS_YAW_LOCK))

    def point(self, pitch_rad: float, yaw_rad: float, *, is_of_earth: bool) -> None:
        """Turn there; yaw is clockwise from north, or from the aircraft's nose."""
        self.commanded, self._goal_rad, self._goal_is_of_earth = True, (pitch_rad, yaw_rad), is_of_earth

    def step(self, time_s: float, dt_s: float, craft: SimulatedAirframe, seen_m: tuple[float, float, float]) -> None:
        """Turn for a step, and take a picture if one is due. seen_m: the target (east, north, height)."""
        here_m = craft.east_m, craft.north_m, craft.height_m
        east_m, north_m, up_m = (there - here for there, here in zip(seen_m, here_m, strict=True))
        if not self.commanded:
            self._goal_rad = math.atan2(up_m, math.hypot(east_m, north_m)), math.atan2(east_m, north_m)
        pitch_goal_rad, yaw_goal_rad = self._goal_rad
        if not self._goal_is_of_earth:
            yaw_goal_rad += craft.yaw_rad
        turn_rad_s = self._rate_rad_s(math.remainder(yaw_goal_rad - self.yaw_rad, math.tau))
        self.yaw_rad = math.remainder(self.yaw_rad + turn_rad_s * dt_s, math.tau)
        off_rad = math.remainder(self.yaw_rad - craft.yaw_rad, math.tau)
        limit_rad = math.radians(self.settings.pan_limit_deg)
        if abs(off_rad) > limit_rad:  # at its stop
            self.yaw_rad = math.remainder(craft.yaw_rad + math.copysign(limit_rad, off_rad), math.tau)
        self.pitch_rad += self._rate_rad_s(pitch_goal_rad - self.pitch_rad) * dt_s
        self.pitch_rad = min(max(self.pitch_rad, _PITCH_RAD[0]), _PITCH_RAD[1])
        self._roll_rad, self._error_rad = _LEAN * craft.roll_rad, craft.gimbal_error_rad(self.yaw_rad)
        off_rad = math.remainder(math.atan2(east_m, north_m) - self.yaw_rad, math.tau)
        self._off_rad, self._slip_rad_s = off_rad, (off_rad - self._off_rad) / dt_s
        if time_s >= self._next_s - 1e-9:
            self._next_s = max(self._next_s + 1.0 / self.settings.rate_hz, time_s)
            self.on_picture(time_s, self.picture(time_s, craft))

    def picture(self, time_s: float, craft: SimulatedAirframe) -> Image:
        """Return what the camera sees from the aircraft now."""
        yaw_rad, pitch_rad = self.yaw_rad + self._error_rad[0], self.pitch_rad + self._error_rad[1]
        pose = CameraPose((craft.east_m, craft.north_m, craft.height_m), yaw_rad, pitch_rad, self._roll_rad)
        size = self.settings.width_px, self.settings.height_px
        return self.scenery.picture(time_s, pose, math.radians(self.settings.view_deg), size, self._slip_rad_s)

    def attitude(self, boot_ms: int) -> Any:
        """Return GIMBAL_DEVICE_ATTITUDE_STATUS, relative to north and the horizon."""
        yaw_rad, pitch_rad = self.yaw_rad + self._error_rad[0], self.pitch_rad + self._error_rad[1]
        turned = list(quaternion(self._roll_rad, pitch_rad, yaw_rad))
        return mavlink.MAVLink_gimbal_device_attitude_status_message(
            0, 0, boot_ms, _LOCKED, turned, *(math.nan,) * 3, 0
        )

    def information(self, boot_ms: int) -> Any:
        """Return GIMBAL_DEVICE_INFORMATION, without which a gimbal manager does not command it."""
        names = (b"sidelong", b"simulated gimbal", b"")
        limit_rad = math.radians(self.settings.pan_limit_deg)
        return mavlink.MAVLink_gimbal_device_information_message(
            boot_ms, *names, 0, 0, 0, 0, 0, 0.0, 0.0, *_PITCH_RAD, -limit_rad, limit_rad
        )

    def _rate_rad_s(self, off_rad: float) -> float:
        rate_rad_s, limit_rad_s = off_rad / self.settings.lag_s, math.radians(self.settings.rate_deg_s)
        return min(max(rate_rad_s, -limit_rad_s), limit_rad_s)


class VideoServer:
    """Encodes pictures in a thread of its own and sends them; pictures that come too fast are dropped."""

    def __init__(self, url: str, settings: CameraSettings) -> None:
        self._queue: Queue[tuple[float, Image]] = Queue(maxsize=4)
        self._url, self._settings = url, settings
        threading.Thread(target=self._run, daemon=True).start()

    def put(self, time_s: float, picture: Image) -> None:
        """Queue a picture; drop it if the encoder is behind."""
        with suppress(Full):  # the encoder is behind
            self._queue.put_nowait((time_s, picture))

    def _run(self) -> None:
        settings, url = self._settings, self._url
        with av.open(f"{url}?pkt_size=1316", "w", format="mpegts") as out:
            stream = out.add_stream("libx264", rate=Fraction(settings.rate_hz).limit_denominator(100))
            stream.width, stream.height, stream.pix_fmt = settings.width_px, settings.height_px, "yuv420p"
            stream.options = {"preset": "ultrafast", "tune": "zerolatency", "g": str(round(settings.rate_hz))}
            stream.time_base = stream.codec_context.time_base = Fraction(1, 1000)
            while True:
                time_s, picture = self._queue.get()
                frame = av.VideoFrame.from_ndarray(picture, format="bgr24")
                frame.pts, frame.time_base = round(1000.0 * time_s), Fraction(1, 1000)
                for packet in stream.encode(frame):
                    out.mux(packet)

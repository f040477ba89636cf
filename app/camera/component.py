"""The MAVLink camera that stations see: what it is, where its video is, and the commands that begin to track.

Pure: messages in, messages out. Source: the MAVLink camera protocol v2, https://mavlink.io/en/services/camera.html.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Protocol

from pymavlink.dialects.v20 import all as mavlink

from sidelong.app.link.message import Message

CAMERA_COMPONENT = int(mavlink.MAV_COMP_ID_CAMERA)
_FLAGS = (
    mavlink.CAMERA_CAP_FLAGS_HAS_VIDEO_STREAM
    | mavlink.CAMERA_CAP_FLAGS_HAS_BASIC_ZOOM
    | mavlink.CAMERA_CAP_FLAGS_HAS_TRACKING_POINT
    | mavlink.CAMERA_CAP_FLAGS_HAS_TRACKING_RECTANGLE
)
_HEARTBEAT_S, _VIEW_S = 1.0, 1.0
_REQUESTS = {  # of older stations, by the message that they ask for
    mavlink.MAV_CMD_REQUEST_CAMERA_INFORMATION: mavlink.MAVLINK_MSG_ID_CAMERA_INFORMATION,
    mavlink.MAV_CMD_REQUEST_CAMERA_SETTINGS: mavlink.MAVLINK_MSG_ID_CAMERA_SETTINGS,
    mavlink.MAV_CMD_REQUEST_CAMERA_CAPTURE_STATUS: mavlink.MAVLINK_MSG_ID_CAMERA_CAPTURE_STATUS,
    mavlink.MAV_CMD_REQUEST_STORAGE_INFORMATION: mavlink.MAVLINK_MSG_ID_STORAGE_INFORMATION,
    mavlink.MAV_CMD_REQUEST_VIDEO_STREAM_INFORMATION: mavlink.MAVLINK_MSG_ID_VIDEO_STREAM_INFORMATION,
    mavlink.MAV_CMD_REQUEST_VIDEO_STREAM_STATUS: mavlink.MAVLINK_MSG_ID_VIDEO_STREAM_STATUS,
}
_ACCEPTED, _DENIED, _REJECTED, _UNSUPPORTED = (
    int(result)
    for result in (
        mavlink.MAV_RESULT_ACCEPTED,
        mavlink.MAV_RESULT_DENIED,
        mavlink.MAV_RESULT_TEMPORARILY_REJECTED,
        mavlink.MAV_RESULT_UNSUPPORTED,
    )
)
_PERIOD_MIN_S = 1.0 / 30.0
_ZOOM_MAX = 8.0

Sent = tuple[str, dict[str, Any]]
"""Name and fields of a message of the camera."""


class Tracking(Protocol):
    """What the camera does for its stations; positions are shares of the picture, from its upper left corner."""

    def follow(self, x: float, y: float, width: float = 0.0, height: float = 0.0) -> None: ...

    def stop(self) -> None: ...

    def status(self) -> dict[str, float | int]: ...


@dataclass(slots=True)
class _Shown:
    """What the stations see of the picture: a middle part of it, where it is zoomed."""

    view_rad: float
    size_px: tuple[int, int] = (0, 0)
    zoom: float = 1.0

    @property
    def half_view(self) -> tuple[float, float]:
        """Tangents of half the angles of view, horizontal and vertical."""
        across = math.tan(0.5 * self.view_rad) / self.zoom
        width, height = self.size_px
        return across, across * (height / width if width else 9.0 / 16.0)

    def whole(self, shown: float) -> float:
        """Return the share of the whole picture for one of the shown part."""
        return 0.5 + (shown - 0.5) / self.zoom

    def part(self, share: float) -> float:
        """Return the share of the shown part for one of the whole picture."""
        return 0.5 + (share - 0.5) * self.zoom


class CameraComponent:
    """Answers stations, and reports what is tracked at the rate that one of them requests.

    Args:
        system_id: Of the vehicle that carries it.
        tracking: What does the tracking.
        view_rad: Horizontal field of view, without zoom.
        video_uri: Where stations get the video; "": nowhere.
    """

    def __init__(self, system_id: int, tracking: Tracking, view_rad: float, video_uri: str = "") -> None:
        self._system_id, self._tracking, self._video_uri = system_id, tracking, video_uri
        self._shown = _Shown(view_rad)
        self._heartbeat_s = self._view_s = self._status_s = -math.inf
        self._period_s: dict[tuple[int, int], float] = {}  # of the tracking status, by station

    @property
    def zoom(self) -> float:
        """How many times the picture is enlarged."""
        return self._shown.zoom

    def picture_size(self, width_px: int, height_px: int) -> None:
        """Take the size of the pictures."""
        self._shown.size_px = width_px, height_px

    def due(self, now_s: float) -> list[Sent]:
        """Return what to send now, by a clock of any origin."""
        sent: list[Sent] = []
        if now_s - self._heartbeat_s >= _HEARTBEAT_S:
            self._heartbeat_s = now_s
            sent.append(
                (
                    "HEARTBEAT",
                    {
                        "type": mavlink.MAV_TYPE_CAMERA,
                        "autopilot": mavlink.MAV_AUTOPILOT_INVALID,
                        "base_mode": 0,
                        "custom_mode": 0,
                        "system_status": mavlink.MAV_STATE_ACTIVE,
                        "mavlink_version": 3,
                    },
                )
            )
        if now_s - self._view_s >= _VIEW_S:
            self._view_s = now_s
            sent.append(("CAMERA_FOV_STATUS", self._fov_status(now_s)))
        period_s = min(self._period_s.values(), default=math.inf)
        if now_s - self._status_s >= period_s - 1e-3:
            self._status_s = now_s
            sent.append(("CAMERA_TRACKING_IMAGE_STATUS", self.status()))
        return sent

    def status(self) -> dict[str, Any]:
        """Return the fields of CAMERA_TRACKING_IMAGE_STATUS, in shares of what is shown."""
        status: dict[str, Any] = dict(self._tracking.status())
        places = ("point_x", "point_y", "rec_top_x", "rec_top_y", "rec_bottom_x", "rec_bottom_y")
        return status | {name: self._shown.part(status[name]) for name in places}

    def command(self, message: Message, now_s: float) -> list[Sent]:
        """Take a COMMAND_LONG or COMMAND_INT; return the answers, none where it is for another component."""
        fields = message.fields
        if message.name not in ("COMMAND_LONG", "COMMAND_INT"):
            return []
        if fields["target_system"] not in (0, self._system_id) or fields["target_component"] not in (
            0,
            CAMERA_COMPONENT,
        ):
            return []
        for_all = fields["target_component"] == 0
        command = int(fields["command"])
        result, answers = self._carried_out(command, fields, (message.system_id, message.component_id), now_s)
        if for_all and result == _UNSUPPORTED:
            return []  # another component's
        acknowledgement = {
            "command": command,
            "result": result,
            "progress": 0,
            "result_param2": 0,
            "target_system": message.system_id,
            "target_component": message.component_id,
        }
        return [("COMMAND_ACK", acknowledgement), *answers]

    def _carried_out(
        self, command: int, fields: Mapping[str, Any], station: tuple[int, int], now_s: float
    ) -> tuple[int, list[Sent]]:
        params = [float(fields.get(f"param{number}") or 0.0) for number in range(1, 5)]
        shown = self._shown
        match command:
            case mavlink.MAV_CMD_REQUEST_MESSAGE:
                return self._requested(round(params[0]), now_s)
            case mavlink.MAV_CMD_SET_MESSAGE_INTERVAL:
                return self._interval(round(params[0]), params[1], station), []
            case mavlink.MAV_CMD_CAMERA_TRACK_POINT:
                if not _all_shares(*params[:2]):
                    return _DENIED, []
                return self._follow(shown.whole(params[0]), shown.whole(params[1])), []
            case mavlink.MAV_CMD_CAMERA_TRACK_RECTANGLE:
                left, top, right, bottom = params
                if not (_all_shares(*params) and left < right and top < bottom):
                    return _DENIED, []
                middle = shown.whole(0.5 * (left + right)), shown.whole(0.5 * (top + bottom))
                return self._follow(*middle, (right - left) / shown.zoom, (bottom - top) / shown.zoom), []
            case mavlink.MAV_CMD_CAMERA_STOP_TRACKING:
                self._tracking.stop()
                return _ACCEPTED, []
            case mavlink.MAV_CMD_SET_CAMERA_ZOOM:
                return self._zoomed(round(params[0]), params[1]), [("CAMERA_FOV_STATUS", self._fov_status(now_s))]
            case _ if command in _REQUESTS:
                return self._requested(_REQUESTS[command], now_s)
        return _UNSUPPORTED, []

    def _follow(self, *where: float) -> int:
        if not self._shown.size_px[0]:
            return _REJECTED  # there is no picture yet
        self._tracking.follow(*where)
        return _ACCEPTED

    def _zoomed(self, kind: int, value: float) -> int:
        if kind == mavlink.ZOOM_TYPE_STEP:
            zoom = self._shown.zoom * (1.25 if value > 0.0 else 0.8)
        elif kind == mavlink.ZOOM_TYPE_RANGE:  # 0 to 100 % of the range
            zoom = 1.0 + (_ZOOM_MAX - 1.0) * min(max(value, 0.0), 100.0) / 100.0
        else:
            return _UNSUPPORTED
        self._shown.zoom = min(max(zoom, 1.0), _ZOOM_MAX)
        return _ACCEPTED

    def _interval(self, message_id: int, interval_us: float, station: tuple[int, int]) -> int:
        if message_id != mavlink.MAVLINK_MSG_ID_CAMERA_TRACKING_IMAGE_STATUS:
            return _UNSUPPORTED
        if interval_us < 0.0:
            self._period_s.pop(station, None)
        else:
            self._period_s[station] = max(interval_us * 1e-6, _PERIOD_MIN_S) if interval_us else 0.2
        return _ACCEPTED

    def _requested(self, message_id: int, now_s: float) -> tuple[int, list[Sent]]:
        makers = {
            mavlink.MAVLINK_MSG_ID_CAMERA_INFORMATION: ("CAMERA_INFORMATION", self._information),
            mavlink.MAVLINK_MSG_ID_CAMERA_SETTINGS: ("CAMERA_SETTINGS", self._settings),
            mavlink.MAVLINK_MSG_ID_CAMERA_CAPTURE_STATUS: ("CAMERA_CAPTURE_STATUS", self._capture_status),
            mavlink.MAVLINK_MSG_ID_CAMERA_FOV_STATUS: ("CAMERA_FOV_STATUS", self._fov_status),
            mavlink.MAVLINK_MSG_ID_VIDEO_STREAM_INFORMATION: ("VIDEO_STREAM_INFORMATION", self._stream_information),
            mavlink.MAVLINK_MSG_ID_VIDEO_STREAM_STATUS: ("VIDEO_STREAM_STATUS", self._stream_status),
        }
        if message_id == mavlink.MAVLINK_MSG_ID_CAMERA_TRACKING_IMAGE_STATUS:
            return _ACCEPTED, [("CAMERA_TRACKING_IMAGE_STATUS", self.status())]
        if message_id not in makers:
            return _UNSUPPORTED, []
        name, make = makers[message_id]
        return _ACCEPTED, [(name, make(now_s))]

    # -- messages ------------------------------------------------------------------------------------------

    def _information(self, now_s: float) -> dict[str, Any]:
        width, height = self._shown.size_px
        sensor_mm = 2.0 * self._shown.half_view[0]  # of a focal length of 1 mm: stations use the ratio
        return {
            "time_boot_ms": _milliseconds(now_s),
            "vendor_name": _octets("sidelong"),
            "model_name": _octets("gimbal camera"),
            "firmware_version": 0,
            "focal_length": 1.0,
            "sensor_size_h": sensor_mm,
            "sensor_size_v": 2.0 * self._shown.half_view[1],
            "resolution_h": width,
            "resolution_v": height,
            "lens_id": 0,
            "flags": int(_FLAGS) if self._video_uri else int(_FLAGS & ~mavlink.CAMERA_CAP_FLAGS_HAS_VIDEO_STREAM),
            "cam_definition_version": 0,
            "cam_definition_uri": b"",
        }

    def _settings(self, now_s: float) -> dict[str, Any]:
        zoom = 100.0 * (self._shown.zoom - 1.0) / (_ZOOM_MAX - 1.0)
        return {
            "time_boot_ms": _milliseconds(now_s),
            "mode_id": int(mavlink.CAMERA_MODE_VIDEO),
            "zoomLevel": zoom,
            "focusLevel": math.nan,
        }

    def _capture_status(self, now_s: float) -> dict[str, Any]:
        idle = dict.fromkeys(("image_status", "video_status", "recording_time_ms", "image_count"), 0)
        return {"time_boot_ms": _milliseconds(now_s), **idle, "image_interval": 0.0, "available_capacity": 0.0}

    def _fov_status(self, now_s: float) -> dict[str, Any]:
        across, down = self._shown.half_view
        unknown = dict.fromkeys(("lat_camera", "lon_camera", "alt_camera", "lat_image", "lon_image"), 2**31 - 1)
        return {
            "time_boot_ms": _milliseconds(now_s),
            **unknown,
            "alt_image": 2**31 - 1,
            "q": [math.nan] * 4,
            "hfov": math.degrees(2.0 * math.atan(across)),
            "vfov": math.degrees(2.0 * math.atan(down)),
        }

    def _stream_information(self, _now_s: float) -> dict[str, Any]:
        kind = (
            mavlink.VIDEO_STREAM_TYPE_RTSP
            if self._video_uri.startswith("rtsp:")
            else mavlink.VIDEO_STREAM_TYPE_MPEG_TS
        )
        return {
            "stream_id": 1,
            "count": 1,
            "type": int(kind),
            **self._stream(),
            "name": b"camera",
            "uri": self._video_uri.encode()[:160],
            "encoding": int(mavlink.VIDEO_STREAM_ENCODING_H264),
        }

    def _stream_status(self, _now_s: float) -> dict[str, Any]:
        return {"stream_id": 1, **self._stream()}

    def _stream(self) -> dict[str, Any]:
        width, height = self._shown.size_px
        return {
            "flags": int(mavlink.VIDEO_STREAM_STATUS_FLAGS_RUNNING) if width else 0,
            "framerate": 15.0,
            "resolution_h": width,
            "resolution_v": height,
            "bitrate": 0,
            "rotation": 0,
            "hfov": round(math.degrees(2.0 * math.atan(self._shown.half_view[0]))),
        }


def _all_shares(*values: float) -> bool:
    return all(math.isfinite(value) and 0.0 <= value <= 1.0 for value in values)


def _milliseconds(now_s: float) -> int:
    return max(round(1000.0 * now_s), 0) % 2**32


def _octets(text: str) -> list[int]:
    """Return a name as CAMERA_INFORMATION has it: 32 bytes."""
    return list(text.encode()[:32].ljust(32, b"\0"))

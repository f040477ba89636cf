"""The MAVLink camera that stations see: what it is, where its video is, and the commands that begin to track.

Pure: messages in, messages out. Source: the MAVLink camera protocol v2, https://mavlink.io/en/services/camera.html.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any, Protocol

from pymavlink.dialects.v20 import all as mavlink

from sidelong.app.camera.camera import Edges, Pictured
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
_PERIOD_MIN_S, _PERIOD_DEFAULT_S = 1.0 / 30.0, 0.2
_ZOOM_MAX, _ZOOM_STEP = 8.0, 1.25
# How many parameters of a command have to be numbers; NaN means that one is not used.
_NUMBERS = {
    mavlink.MAV_CMD_REQUEST_MESSAGE: 1,
    mavlink.MAV_CMD_SET_MESSAGE_INTERVAL: 2,
    mavlink.MAV_CMD_SET_CAMERA_ZOOM: 2,
}
_UNKNOWN_PLACE = dict.fromkeys(
    ("lat_camera", "lon_camera", "alt_camera", "lat_image", "lon_image", "alt_image"), 2**31 - 1
)

Sent = tuple[str, dict[str, Any]]
"""Name and fields of a message of the camera."""


class Tracking(Protocol):
    """What the camera does for its stations; positions are shares of the picture, from its upper left corner."""

    @property
    def latest(self) -> Pictured | None: ...

    def follow(self, x: float, y: float, width: float = 0.0, height: float = 0.0) -> None: ...

    def stop(self) -> None: ...


def status_of(latest: Pictured | None, shown: Callable[[float], float] = float) -> dict[str, Any]:
    """Return the fields of CAMERA_TRACKING_IMAGE_STATUS. shown: turns a share of the picture into one of its part."""
    state, edges = ("idle", None) if latest is None else (latest.tracked.state, latest.edges)
    left, top, right, bottom = edges if edges is not None and state == "object" else (math.nan,) * 4
    return {
        "tracking_status": {"idle": 0, "object": 1, "lost": 2}[state],
        "tracking_mode": 0 if state == "idle" else 2,
        "target_data": 0 if state == "idle" else 4,
        "point_x": shown(0.5 * (left + right)),
        "point_y": shown(0.5 * (top + bottom)),
        "radius": math.nan,
        "rec_top_x": shown(left),
        "rec_top_y": shown(top),
        "rec_bottom_x": shown(right),
        "rec_bottom_y": shown(bottom),
    }


class CameraComponent:
    """Answers stations, and reports what is tracked at the rate that one of them requests.

    Args:
        system_id: Of the vehicle that carries it.
        tracking: What does the tracking.
        view_rad: Horizontal field of view, without zoom.
        video_uri: Where stations get the video; "": nowhere.

    Attributes:
        size_px: Width and height of the pictures, 0 before the first one.
        zoom: How many times the picture is enlarged: stations see a middle part of it.
    """

    def __init__(self, system_id: int, tracking: Tracking, view_rad: float, video_uri: str = "") -> None:
        self._system_id, self._tracking, self._video_uri = system_id, tracking, video_uri
        self._view_rad, self.size_px, self.zoom = view_rad, (0, 0), 1.0
        self._heartbeat_s = self._view_s = self._status_s = -math.inf
        self._period_s: dict[tuple[int, int], float] = {}  # of the tracking status, by station

    def due(self, now_s: float) -> list[Sent]:
        """Return what to send now, by a clock of any origin."""
        sent: list[Sent] = []
        if now_s - self._heartbeat_s >= _HEARTBEAT_S:
            self._heartbeat_s = now_s
            kinds = {"type": mavlink.MAV_TYPE_CAMERA, "autopilot": mavlink.MAV_AUTOPILOT_INVALID}
            status = {"system_status": mavlink.MAV_STATE_ACTIVE, "mavlink_version": 3}
            sent.append(("HEARTBEAT", kinds | status))
        if now_s - self._view_s >= _VIEW_S:
            self._view_s = now_s
            sent.append(self._made(mavlink.MAVLINK_MSG_ID_CAMERA_FOV_STATUS, now_s))
        period_s = min(self._period_s.values(), default=math.inf)
        if now_s - self._status_s >= period_s - 1e-3:
            self._status_s = now_s
            sent.append(self._made(mavlink.MAVLINK_MSG_ID_CAMERA_TRACKING_IMAGE_STATUS, now_s))
        return sent

    def command(self, message: Message, now_s: float) -> list[Sent]:
        """Process a COMMAND_LONG or COMMAND_INT; return the answers, none where it is for another component."""
        fields = message.fields
        if message.name not in ("COMMAND_LONG", "COMMAND_INT"):
            return []
        component = fields["target_component"]
        if fields["target_system"] not in (0, self._system_id) or component not in (0, CAMERA_COMPONENT):
            return []
        command, station = int(fields["command"]), (message.system_id, message.component_id)
        result, asked = self._carried_out(command, fields, station)
        if component == 0 and result == _UNSUPPORTED:
            return []  # another component's
        own = {"command": command, "result": result, "target_system": station[0], "target_component": station[1]}
        return [("COMMAND_ACK", own), *((self._made(asked, now_s),) if asked is not None else ())]

    def _carried_out(
        self, command: int, fields: Mapping[str, Any], station: tuple[int, int]
    ) -> tuple[int, int | None]:
        """Return the result, and the number of the message to send with it."""
        params = first, second, *_ = [float(fields.get(f"param{number}") or 0.0) for number in range(1, 5)]
        if not all(map(math.isfinite, params[: _NUMBERS.get(command, 0)])):
            return _DENIED, None
        match command:
            case mavlink.MAV_CMD_REQUEST_MESSAGE:
                return self._requested(round(first))
            case mavlink.MAV_CMD_SET_MESSAGE_INTERVAL:
                return self._interval(round(first), second, station), None
            case mavlink.MAV_CMD_CAMERA_TRACK_POINT:
                return self._follow((first, second, first, second)), None
            case mavlink.MAV_CMD_CAMERA_TRACK_RECTANGLE:
                left, top, right, bottom = params
                return self._follow((left, top, right, bottom)) if left < right and top < bottom else _DENIED, None
            case mavlink.MAV_CMD_CAMERA_STOP_TRACKING:
                self._tracking.stop()
                return _ACCEPTED, None
            case mavlink.MAV_CMD_SET_CAMERA_ZOOM:
                return self._zoomed(round(first), second), mavlink.MAVLINK_MSG_ID_CAMERA_FOV_STATUS
            case _ if command in _REQUESTS:
                return self._requested(_REQUESTS[command])
        return _UNSUPPORTED, None

    def _follow(self, edges: Edges) -> int:
        if not all(math.isfinite(share) and 0.0 <= share <= 1.0 for share in edges):
            return _DENIED
        if not self.size_px[0]:
            return _REJECTED  # there is no picture yet
        left, top, right, bottom = (0.5 + (share - 0.5) / self.zoom for share in edges)
        size = (right - left, bottom - top) if right > left else ()
        self._tracking.follow(0.5 * (left + right), 0.5 * (top + bottom), *size)
        return _ACCEPTED

    def _zoomed(self, kind: int, value: float) -> int:
        if kind == mavlink.ZOOM_TYPE_STEP:
            zoom = self.zoom * (_ZOOM_STEP if value > 0.0 else 1.0 / _ZOOM_STEP)
        elif kind == mavlink.ZOOM_TYPE_RANGE:  # 0 to 100 % of the range
            zoom = 1.0 + (_ZOOM_MAX - 1.0) * min(max(value, 0.0), 100.0) / 100.0
        else:
            return _UNSUPPORTED
        self.zoom = min(max(zoom, 1.0), _ZOOM_MAX)
        return _ACCEPTED

    def _interval(self, message_id: int, interval_us: float, station: tuple[int, int]) -> int:
        if message_id != mavlink.MAVLINK_MSG_ID_CAMERA_TRACKING_IMAGE_STATUS:
            return _UNSUPPORTED
        if interval_us < 0.0:
            self._period_s.pop(station, None)
        else:
            self._period_s[station] = max(interval_us * 1e-6, _PERIOD_MIN_S) if interval_us else _PERIOD_DEFAULT_S
        return _ACCEPTED

    def _requested(self, message_id: int) -> tuple[int, int | None]:
        return (_ACCEPTED, message_id) if message_id in self._messages(0.0) else (_UNSUPPORTED, None)

    def _made(self, message_id: int, now_s: float) -> Sent:
        return mavlink.mavlink_map[message_id].msgname, self._messages(now_s)[message_id]

    def _messages(self, now_s: float) -> dict[int, dict[str, Any]]:
        """Return the fields of each message that can be requested, those of value 0 left out; by its number."""
        width, height = self.size_px
        across = math.tan(0.5 * self._view_rad) / self.zoom
        down = across * (height / width if width else 9.0 / 16.0)
        hfov_deg, vfov_deg = (math.degrees(2.0 * math.atan(half)) for half in (across, down))
        time = {"time_boot_ms": max(round(1000.0 * now_s), 0) % 2**32}
        size = {"resolution_h": width, "resolution_v": height}
        flags = _FLAGS if self._video_uri else _FLAGS & ~mavlink.CAMERA_CAP_FLAGS_HAS_VIDEO_STREAM
        running = int(mavlink.VIDEO_STREAM_STATUS_FLAGS_RUNNING) if width else 0
        stream = {"stream_id": 1, "flags": running, "framerate": 15.0, **size, "hfov": round(hfov_deg)}
        is_rtsp = self._video_uri.startswith("rtsp:")
        return {
            mavlink.MAVLINK_MSG_ID_CAMERA_INFORMATION: {
                **time,
                **size,
                "vendor_name": list(b"sidelong".ljust(32, b"\0")),
                "model_name": list(b"gimbal camera".ljust(32, b"\0")),
                "focal_length": 1.0,  # mm; stations use the ratio of the sensor's size to it
                "sensor_size_h": 2.0 * across,
                "sensor_size_v": 2.0 * down,
                "flags": int(flags),
                "cam_definition_uri": b"",
            },
            mavlink.MAVLINK_MSG_ID_CAMERA_SETTINGS: {
                **time,
                "mode_id": int(mavlink.CAMERA_MODE_VIDEO),
                "zoomLevel": 100.0 * (self.zoom - 1.0) / (_ZOOM_MAX - 1.0),
                "focusLevel": math.nan,
            },
            mavlink.MAVLINK_MSG_ID_CAMERA_CAPTURE_STATUS: time,
            mavlink.MAVLINK_MSG_ID_CAMERA_FOV_STATUS: {
                **time,
                **_UNKNOWN_PLACE,
                "q": [math.nan] * 4,
                "hfov": hfov_deg,
                "vfov": vfov_deg,
            },
            mavlink.MAVLINK_MSG_ID_VIDEO_STREAM_INFORMATION: {
                **stream,
                "count": 1,
                "type": int(mavlink.VIDEO_STREAM_TYPE_RTSP if is_rtsp else mavlink.VIDEO_STREAM_TYPE_MPEG_TS),
                "name": b"camera",
                "uri": self._video_uri.encode()[:160],
                "encoding": int(mavlink.VIDEO_STREAM_ENCODING_H264),
            },
            mavlink.MAVLINK_MSG_ID_VIDEO_STREAM_STATUS: stream,
            mavlink.MAVLINK_MSG_ID_CAMERA_TRACKING_IMAGE_STATUS: status_of(
                self._tracking.latest, lambda share: 0.5 + (share - 0.5) * self.zoom
            ),
        }

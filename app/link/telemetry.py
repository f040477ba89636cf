"""Convert MAVLink messages into events of the control step, with units, frames and time stamps resolved.

All range and gimbal sources pass through: the estimator selects among them, and the control step checks plausibility.
This module only checks the sender: position, wind, GPS and EKF status are accepted from the autopilot alone.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Mapping
from functools import lru_cache, partial
from typing import Any, Literal

from pymavlink.dialects.v20 import all as dialect

from sidelong.app.autopilots.registry import autopilot_by_mav_autopilot
from sidelong.app.link.message import Message
from sidelong.estimators.frames import LocalPlane, wrap_rad
from sidelong.estimators.rotations import from_roll_pitch_yaw, multiply
from sidelong.estimators.sensing import readings
from sidelong.estimators.sensing.clock import VehicleClock
from sidelong.estimators.sensing.pose import AXIS_AHEAD_S, ReadingHistory, gimbal_at
from sidelong.estimators.tracking.sources import SourceSelector, axis_rank
from sidelong.mission.core.events import Event, HomeReported, ModeReported, NavigationReported, WindReported

AUTOPILOT_INVALID = int(dialect.MAV_AUTOPILOT_INVALID)
TYPE_FIXED_WING = int(dialect.MAV_TYPE_FIXED_WING)
ARMED_FLAG = int(dialect.MAV_MODE_FLAG_SAFETY_ARMED)

FAILSAFE = "failsafe"
FAILSAFE_STATES = (5, 6, 8)  # MAV_STATE_CRITICAL, MAV_STATE_EMERGENCY, MAV_STATE_FLIGHT_TERMINATION
RECOVERY_MODES = ("RTL", "QRTL", "LAND", "QLAND", "AUTOLAND", "PRECLAND", "DESCEND", "TERMINATION", "AVOID_ADSB")
"""Modes out of which a flying aircraft is not taken without permission."""


def mode_name(mav_autopilot: int, base_mode: int, custom_mode: int) -> str:
    """Return the mode as the autopilot's own documentation calls it (AUTO, RTL; MISSION, LOITER)."""
    autopilot = autopilot_by_mav_autopilot(mav_autopilot)
    return f"mode {custom_mode}" if autopilot is None else autopilot.mode_name(base_mode, custom_mode)


AUTOPILOT_COMPONENT = 1
_NO_FIX_DEG_E7 = 100_000
_LATITUDE_MAX_E7, _LONGITUDE_MAX_E7 = 900_000_000, 1_800_000_000
# time_boot_ms has 32 bits: it wraps after 49.7 days.
_WRAP_S, _NEAR_WRAP_S = 2**32 * 1e-3, 60.0
_GPS_FIX_3D = 3
_ORIGIN_FIXES, _ORIGIN_NEAR_M = 5, 5_000.0
# EKF_STATUS_FLAGS of ArduPilot and ESTIMATOR_STATUS_FLAGS agree but for the flag of a GPS glitch.
_POSITION_GOOD, _POSITION_HELD, _POSITION_AIDED = 16, 128, 512
_EKF_GLITCH, _ESTIMATOR_GLITCH = 32768, 1024
# MAV_COMP_ID of whatever may track a target: cameras, gimbals, companion computers.
_TRACKERS = frozenset((*range(100, 106), 154, *range(171, 176), *range(191, 198)))

# MAV_SENSOR_ORIENTATION and GIMBAL_DEVICE_FLAGS of the MAVLink common dialect.
_ORIENTATION_CUSTOM = 100
_ROLL_OR_PITCH_LOCK = 4 | 8
_YAW_LOCK, _YAW_IN_VEHICLE_FRAME, _YAW_IN_EARTH_FRAME = 16, 32, 64
_SIGNAL_INVALID = 1
_TRACKING_ACTIVE = 1
_TRACKS_RECTANGLE = 2  # of CAMERA_TRACKING_MODE
_VIEW_MAX_DEG, _SIGHT_AGE_MAX_S = 170.0, 3.0
_TARGET_POSITION = 1  # of TARGET_ABSOLUTE_SENSOR_CAPABILITY_FLAGS
_DELTA_YAW_OFF_RAD = math.radians(30.0)  # what an aircraft turns while the message is on its way, and more

_UNSTAMPED = frozenset(
    {"WIND", "WIND_COV", "GPS_RAW_INT", "EKF_STATUS_REPORT", "ESTIMATOR_STATUS", "RANGEFINDER", "TARGET_ABSOLUTE"}
)
"""Messages without a time of their own: the vehicle's latest is the best known."""
_AUTOPILOT_ALONE = _UNSTAMPED - {"RANGEFINDER", "TARGET_ABSOLUTE"} | {"HEARTBEAT", "GLOBAL_POSITION_INT", "ATTITUDE"}

Fields = Mapping[str, Any]
_source = lru_cache(maxsize=64)(readings.Source)  # the same few speak all the time


class Telemetry:
    """Turns one vehicle's messages into events.

    plane is set by the first position fix, and again while the first few are far apart;
    unusable counts the payload's messages without a reading, by kind ("range", "gimbal"), source and reason;
    system_id by the first autopilot heartbeat, unless given.
    now_s is the vehicle's clock: its latest time stamp, -inf before the first; a single outlying stamp does not
    change it.
    """

    def __init__(self, system_id: int | None = None) -> None:
        self.system_id = system_id
        self.plane: LocalPlane | None = None
        self.unusable: Counter[tuple[str, readings.Source, str]] = Counter()
        self._clock = VehicleClock()
        self._wrapped_s = 0.0
        self._yaw_rad: float | None = None
        self._sight: readings.GimbalReading | None = None
        self._axis_source = SourceSelector(axis_rank)
        self._sights: ReadingHistory[readings.GimbalReading] = ReadingHistory(_SIGHT_AGE_MAX_S)
        self._half_view: dict[int, tuple[float, float]] = {}  # tangents of half the angles, by camera component
        self._near_origin = 0  # consecutive fixes, up to the number that settles the plane
        self._decoders: dict[str, Callable[[Message], Event | None]] = {
            "HEARTBEAT": self._heartbeat,
            "GLOBAL_POSITION_INT": self._position,
            "HOME_POSITION": self._home,
            "ATTITUDE": self._attitude,
            "DISTANCE_SENSOR": self._distance_sensor,
            "RANGEFINDER": self._rangefinder,
            "GIMBAL_DEVICE_ATTITUDE_STATUS": self._gimbal,
            "CAMERA_TRACKING_GEO_STATUS": self._target_fix,
            "CAMERA_FOV_STATUS": self._camera_fov,
            "CAMERA_INFORMATION": self._camera_information,
            "CAMERA_TRACKING_IMAGE_STATUS": self._image_target,
            "TARGET_ABSOLUTE": self._target_absolute,
            "WIND": self._wind,
            "WIND_COV": self._wind_cov,
            "GPS_RAW_INT": self._gps,
            "EKF_STATUS_REPORT": partial(self._ekf, _EKF_GLITCH),
            "ESTIMATOR_STATUS": partial(self._ekf, _ESTIMATOR_GLITCH),
        }

    @property
    def now_s(self) -> float:
        """The vehicle's time, s since its boot; -inf before the first report of it."""
        return self._clock.now_s

    @property
    def wanted(self) -> frozenset[str]:
        """Names of the messages that lead to events."""
        return frozenset(self._decoders)

    def event(self, message: Message) -> Event | None:
        """Return the event of a message; None if there is none (other vehicle, no fix, no signal)."""
        decoder = self._decoders.get(message.name)
        if decoder is None or (self.system_id is not None and message.system_id != self.system_id):
            return None
        if message.name in _AUTOPILOT_ALONE and message.component_id != AUTOPILOT_COMPONENT:
            return None
        return None if message.name in _UNSTAMPED and self.now_s == -math.inf else decoder(message)

    def tick(self, time_s: float) -> None:
        """Move the clock by the stamp of a position that came without a message."""
        self._clock.take(time_s)

    # -- the vehicle ---------------------------------------------------------------------------------------

    def _heartbeat(self, message: Message) -> Event | None:
        fields = message.fields
        if fields["autopilot"] == AUTOPILOT_INVALID:
            return None
        self.system_id = message.system_id
        if self.now_s == -math.inf:
            return None
        base_mode = int(fields["base_mode"])
        mode = mode_name(int(fields["autopilot"]), base_mode, int(fields["custom_mode"]))
        return ModeReported(self.now_s, mode, bool(base_mode & ARMED_FLAG))

    def _position(self, message: Message) -> Event | None:
        fields = message.fields
        if not has_fix(fields):
            return None
        time_s = self._own_seconds(fields["time_boot_ms"])
        latitude_deg, longitude_deg = fields["lat"] * 1e-7, fields["lon"] * 1e-7
        if self.plane is None:
            self.plane = LocalPlane(latitude_deg, longitude_deg)
        east_m, north_m = self.plane.east_north_m(latitude_deg, longitude_deg)
        if self._near_origin < _ORIGIN_FIXES:
            self._near_origin += 1
            if math.hypot(east_m, north_m) > _ORIGIN_NEAR_M:
                self.plane, self._near_origin = LocalPlane(latitude_deg, longitude_deg), 1
                east_m = north_m = 0.0
        return readings.PositionReading(
            time_s,
            east_m,
            north_m,
            fields["relative_alt"] * 1e-3,
            fields["vy"] * 1e-2,
            fields["vx"] * 1e-2,
            -fields["vz"] * 1e-2,
            (fields["alt"] - fields["relative_alt"]) * 1e-3 if "alt" in fields else None,
        )

    def _home(self, message: Message) -> Event | None:
        if self.plane is None or message.component_id != AUTOPILOT_COMPONENT or self.now_s == -math.inf:
            return None
        place_deg = message.fields["latitude"] * 1e-7, message.fields["longitude"] * 1e-7
        return HomeReported(self.now_s, *self.plane.east_north_m(*place_deg))

    def _attitude(self, message: Message) -> Event | None:
        fields = message.fields
        angles = (fields["roll"], fields["pitch"], fields["yaw"])
        if not _finite(*angles):
            return None
        time_s, self._yaw_rad = self._own_seconds(fields["time_boot_ms"]), fields["yaw"]
        return readings.AttitudeReading(time_s, *angles)

    def _own_seconds(self, boot_ms: int) -> float:
        """Return a stamp of the vehicle's own, which moves its clock."""
        time_s = self._seconds(boot_ms)
        self._clock.take(time_s)
        self._wrapped_s = math.floor(self._clock.now_s / _WRAP_S) * _WRAP_S
        return time_s

    def _payload_seconds(self, boot_ms: int) -> float:
        return self._seconds(boot_ms) if boot_ms else 0.0  # 0: the sender does not know the time

    def _seconds(self, boot_ms: int) -> float:
        """Return a stamp in seconds, continued where the 32 bits of milliseconds wrap."""
        now_s, stamp_s = self._clock.now_s, boot_ms * 1e-3
        if abs(self._wrapped_s + stamp_s - now_s) >= _NEAR_WRAP_S:
            for wraps_s in (self._wrapped_s - _WRAP_S, self._wrapped_s + _WRAP_S):
                if wraps_s >= 0.0 and abs(wraps_s + stamp_s - now_s) < _NEAR_WRAP_S:
                    return wraps_s + stamp_s
        return self._wrapped_s + stamp_s

    def _gps(self, message: Message) -> Event | None:
        fix = int(message.fields["fix_type"])
        fault = "" if fix >= _GPS_FIX_3D else f"the GPS has no fix in space (fix type {fix})"
        return NavigationReported(self.now_s, "GPS", fault)

    def _ekf(self, glitch: int, message: Message) -> Event | None:
        flags, fault = int(message.fields["flags"]), ""
        held = flags & _POSITION_HELD and not flags & _POSITION_AIDED  # PX4 holds it at rest on the ground, too
        if flags & glitch:
            fault = "the EKF sees a GPS glitch"
        elif held or not flags & _POSITION_GOOD:
            fault = f"the EKF does not know its position (flags {flags})"
        return NavigationReported(self.now_s, "EKF", fault)

    def _wind(self, message: Message) -> Event | None:
        # ArduPilot reports the direction the wind comes from.
        fields = message.fields
        if not _finite(fields["direction"], fields["speed"]):
            return None
        from_rad = math.radians(fields["direction"])
        speed_m_s = fields["speed"]
        return WindReported(self.now_s, -speed_m_s * math.sin(from_rad), -speed_m_s * math.cos(from_rad))

    def _wind_cov(self, message: Message) -> Event | None:
        fields = message.fields
        if not _finite(fields["wind_x"], fields["wind_y"]):
            return None
        return WindReported(self.now_s, fields["wind_y"], fields["wind_x"])

    # -- the payload ---------------------------------------------------------------------------------------

    def _distance_sensor(self, message: Message) -> Event | None:
        fields = message.fields
        distance_m, orientation = fields["current_distance"] * 1e-2, int(fields["orientation"])
        source = _source(message.name, message.component_id, int(fields["id"]), orientation)
        min_m, max_m = fields["min_distance"] * 1e-2, fields["max_distance"] * 1e-2
        signal = int(fields.get("signal_quality") or 0)  # 0: unknown; absent in MAVLink 1
        if not 0.0 < distance_m < max_m or distance_m < min_m or signal == _SIGNAL_INVALID:
            why = "no echo"  # what is beyond the reach, or has no echo, is often sent as the greatest distance
            if signal != _SIGNAL_INVALID and distance_m > 0.0:
                near = distance_m < min_m
                why = f"nearer than its least range of {min_m:g} m" if near else f"no echo within its {max_m:g} m"
            self.unusable["range", source, why] += 1
            return None
        covariance_cm2 = fields["covariance"]
        quaternion = fields.get("quaternion") if orientation == _ORIENTATION_CUSTOM else None
        return readings.RangeReading(
            time_s=self._payload_seconds(fields["time_boot_ms"]),
            slant_range_m=distance_m,
            source=source,
            sigma_m=math.sqrt(covariance_cm2) * 1e-2 if 0 < covariance_cm2 < 255 else None,
            quality=signal / 100.0 if signal else None,
            min_range_m=min_m,
            max_range_m=max_m,
            sensor_quaternion_wxyz=_quaternion(quaternion),
        )

    def _rangefinder(self, message: Message) -> Event | None:
        distance_m, source = message.fields["distance"], _source(message.name, message.component_id)
        if not _finite(distance_m) or distance_m <= 0.0:
            self.unusable["range", source, "no echo"] += 1
            return None
        return readings.RangeReading(self.now_s, distance_m, source)

    def _gimbal(self, message: Message) -> Event | None:
        fields = message.fields
        quaternion = _quaternion(fields["q"])
        source = _source(message.name, message.component_id, int(fields.get("gimbal_device_id") or 0))
        if quaternion is None:
            self.unusable["gimbal", source, "no orientation"] += 1
            return None
        frame = gimbal_frame(int(fields["flags"]))
        delta_yaw_rad = fields.get("delta_yaw")
        if frame == "vehicle" and delta_yaw_rad and self._is_heading(delta_yaw_rad):
            # The gimbal's own heading, of the moment of the measurement: the aircraft's need not be interpolated.
            quaternion, frame = multiply(from_roll_pitch_yaw(0.0, 0.0, delta_yaw_rad), quaternion), "earth"
        sight = readings.GimbalReading(self._payload_seconds(fields["time_boot_ms"]), quaternion, frame, source)
        if self._axis_source.accepts(source, self.now_s):
            self._sight = sight
            if self._half_view:  # only a camera looks back
                self._sights.add(sight)
        return sight

    def _camera_fov(self, message: Message) -> Event | None:
        angles_deg = message.fields["hfov"], message.fields["vfov"]
        if _finite(*angles_deg) and all(0.0 < angle_deg < _VIEW_MAX_DEG for angle_deg in angles_deg):
            across, down = (math.tan(math.radians(0.5 * angle_deg)) for angle_deg in angles_deg)
            self._half_view[message.component_id] = across, down
        return None

    def _camera_information(self, message: Message) -> Event | None:
        fields = message.fields
        sizes = fields["focal_length"], fields["sensor_size_h"], fields["sensor_size_v"]
        if message.component_id not in self._half_view and _finite(*sizes) and min(sizes) > 0.0:
            focal_mm, across_mm, down_mm = sizes
            self._half_view[message.component_id] = 0.5 * across_mm / focal_mm, 0.5 * down_mm / focal_mm
        return None

    def _image_target(self, message: Message) -> Event | None:
        """Add the target's place in the image to the gimbal's attitude.

        The message has no stamp, so the gimbal's latest attitude is taken as that of the image. A camera of this
        program knows when the image was taken, and adds it as ``capture_s``.
        """
        fields, half_view = message.fields, self._half_view.get(message.component_id)
        known = gimbal_at(self._sights, fields["capture_s"], AXIS_AHEAD_S) if "capture_s" in fields else None
        sight = self._sight if known is None else known[0]
        if fields["tracking_status"] != _TRACKING_ACTIVE or sight is None or half_view is None:
            return None
        if fields["tracking_mode"] == _TRACKS_RECTANGLE:
            x = _mean(fields["rec_top_x"], fields["rec_bottom_x"])
            y = _mean(fields["rec_top_y"], fields["rec_bottom_y"])
        else:
            x, y = fields["point_x"], fields["point_y"]
        stale = sight.time_s and abs(self.now_s - sight.time_s) > _SIGHT_AGE_MAX_S
        if stale or not _finite(x, y) or not (0.0 <= x <= 1.0 and 0.0 <= y <= 1.0):
            return None
        right, down = (2.0 * x - 1.0) * half_view[0], (2.0 * y - 1.0) * half_view[1]
        offset = from_roll_pitch_yaw(0.0, -math.atan2(down, math.hypot(1.0, right)), math.atan(right))
        source = _source(message.name, message.component_id, int(fields.get("camera_device_id") or 0))
        return readings.GimbalReading(sight.time_s, multiply(sight.quaternion_wxyz, offset), sight.frame, source)

    def _is_heading(self, delta_yaw_rad: float) -> bool:
        """Return whether a yaw is near the aircraft's; 0 is what senders that do not know the field send."""
        if not math.isfinite(delta_yaw_rad) or self._yaw_rad is None:
            return False
        return abs(wrap_rad(delta_yaw_rad - self._yaw_rad)) < _DELTA_YAW_OFF_RAD

    def _target_fix(self, message: Message) -> Event | None:
        fields = message.fields
        if message.component_id not in _TRACKERS or fields["tracking_status"] != _TRACKING_ACTIVE:
            return None
        if self.plane is None or not _finite(fields["h_acc"]) or not has_fix(fields):
            return None
        east_m, north_m = self.plane.east_north_m(fields["lat"] * 1e-7, fields["lon"] * 1e-7)
        source = _source(message.name, message.component_id)
        return readings.TargetFixReading(self.now_s, east_m, north_m, fields["h_acc"], source)

    def _target_absolute(self, message: Message) -> Event | None:
        """Take the target's position by another estimator on board, which may use a beacon."""
        fields = message.fields
        if not int(fields["sensor_capabilities"]) & _TARGET_POSITION or self.plane is None or not has_fix(fields):
            return None
        sigmas_m = fields["position_std"][:2]
        if not _finite(*sigmas_m) or max(sigmas_m) <= 0.0:
            return None
        east_m, north_m = self.plane.east_north_m(fields["lat"] * 1e-7, fields["lon"] * 1e-7)
        source = _source(message.name, message.component_id, int(fields["id"]))
        return readings.TargetFixReading(self.now_s, east_m, north_m, max(sigmas_m), source)


def gimbal_frame(flags: int) -> Literal["earth", "vehicle", "body"]:
    """Return what a gimbal's attitude is relative to, by its GIMBAL_DEVICE_FLAGS."""
    if flags & _YAW_IN_EARTH_FRAME or (not flags & _YAW_IN_VEHICLE_FRAME and flags & _YAW_LOCK):
        return "earth"
    return "vehicle" if flags & _ROLL_OR_PITCH_LOCK else "body"


def has_fix(fields: Fields) -> bool:
    """Return whether a position is valid: before its first fix ArduPlane's filter reports positions near (0, 0)."""
    latitude_e7, longitude_e7 = abs(fields["lat"]), abs(fields["lon"])
    on_earth = latitude_e7 <= _LATITUDE_MAX_E7 and longitude_e7 <= _LONGITUDE_MAX_E7
    return bool(on_earth and max(latitude_e7, longitude_e7) > _NO_FIX_DEG_E7)


def _finite(*values: float | None) -> bool:
    for value in values:  # noqa: SIM110  # in half the time of all()
        if value is None or not math.isfinite(value):
            return False
    return True


def _mean(a: float | None, b: float | None) -> float:
    return math.nan if a is None or b is None else 0.5 * (a + b)


def _quaternion(values: Any) -> tuple[float, float, float, float] | None:
    """Return (w, x, y, z), or None where the sender does not know it (NaN, zero)."""
    if values is None or not _finite(*values) or not any(values):
        return None
    w, x, y, z = values
    return (w, x, y, z)

"""ArduPilot's log entries as the MAVLink messages it would send of them, so that one decoder serves every log."""

from __future__ import annotations

import math
from collections import deque
from statistics import median
from typing import Any

from sidelong.app.records.entry import Entry, Made, Translator, global_position
from sidelong.estimators.rotations import from_roll_pitch_yaw

_GPS_EPOCH_S = 315_964_800  # 1980-01-06
_LEAP_S = 18  # GPS is ahead of UTC by this since 2017
_WEEK_S = 604_800
_GPS_FIX_3D = 3
_RANGE_GOOD = 4  # of RFND.Stat
_SIGNAL_UNKNOWN, _SIGNAL_INVALID = 0, 1  # of DISTANCE_SENSOR.signal_quality
_COVARIANCE_UNKNOWN = 255
_ORIENTATION_CUSTOM = 100
_MOUNT_RANGE_ID = 100  # apart from the ids of RFND
_UNIT_RANGES = 50
_DROP_MIN, _HEIGHT_MIN_M = 0.05, 20.0  # below them the ground that the line of sight meets is not known
_LOCKED_YAW_IN_EARTH_FRAME = 4 | 8 | 16 | 64


class ArdupilotMessages(Translator):
    """A position takes its velocity from the first core of the EKF, else from GPS.

    The range of a mount's own rangefinder becomes a DISTANCE_SENSOR of custom orientation. The log repeats it until
    the mount has measured again, and some drivers write decimetres: the unit is that which agrees with the height and
    the pitch of the line of sight.
    """

    def __init__(self) -> None:
        makers = {
            "GPS": self._gps,
            "XKF1": self._ekf,
            "NKF1": self._ekf,
            "POS": self._position,
            "ATT": self._attitude,
            "RFND": self._rangefinder,
            "MNT": self._mount,
            "XKF2": self._wind,
            "NKF2": self._wind,
            "MSG": self._text,
            "VER": self._text,
            "PARM": self._parameter,
        }
        super().__init__(makers)
        self._velocity_ned_m_s: tuple[float, float, float] | None = None
        self._has_ekf = False
        self._height_m = math.nan
        self._mount_ranges: dict[int, float] = {}  # the latest of each mount, as logged
        self._exponents: deque[float] = deque(maxlen=_UNIT_RANGES)  # powers of ten between logged and expected ranges

    def _gps(self, entry: Entry) -> Made:
        fields = entry.fields
        if entry.instance == 0 and fields["Status"] >= _GPS_FIX_3D:
            utc_s = _GPS_EPOCH_S + fields["GWk"] * _WEEK_S + fields["GMS"] * 1e-3 - _LEAP_S
            self._boot_s = utc_s - entry.time_us * 1e-6
            if not self._has_ekf:
                course_rad = math.radians(fields["GCrs"])
                north_m_s, east_m_s = fields["Spd"] * math.cos(course_rad), fields["Spd"] * math.sin(course_rad)
                self._velocity_ned_m_s = north_m_s, east_m_s, fields["VZ"]
        yield from ()

    def _ekf(self, entry: Entry) -> Made:
        if entry.instance == 0:
            self._has_ekf = True
            self._velocity_ned_m_s = entry.fields["VN"], entry.fields["VE"], entry.fields["VD"]
        yield from ()

    def _position(self, entry: Entry) -> Made:
        lat, lng, alt, height = (entry.fields[name] for name in ("Lat", "Lng", "Alt", "RelHomeAlt"))
        self._height_m = height
        if self._velocity_ned_m_s is not None:
            yield from global_position(lat, lng, alt, height, self._velocity_ned_m_s)

    def _attitude(self, entry: Entry) -> Made:
        roll, pitch, yaw = (math.radians(entry.fields[name]) for name in ("Roll", "Pitch", "Yaw"))
        yield "ATTITUDE", {"roll": roll, "pitch": pitch, "yaw": yaw}

    def _rangefinder(self, entry: Entry) -> Made:
        fields = entry.fields
        quality = fields.get("Quality", -1)  # per cent, -1 unknown; in MAVLink 0 is unknown and 1 invalid
        signal = _SIGNAL_UNKNOWN if quality < 0 else max(_SIGNAL_INVALID, quality)
        signal = signal if fields["Stat"] == _RANGE_GOOD else _SIGNAL_INVALID
        yield _range(fields["Dist"], entry.instance, fields["Orient"], signal)

    def _mount(self, entry: Entry) -> Made:
        fields = entry.fields
        roll_rad, pitch_rad, yaw_rad = (math.radians(fields[name]) for name in ("Roll", "Pitch", "YawE"))
        if all(map(math.isfinite, (roll_rad, pitch_rad, yaw_rad))):
            yield (
                "GIMBAL_DEVICE_ATTITUDE_STATUS",
                {
                    "flags": _LOCKED_YAW_IN_EARTH_FRAME,
                    "q": list(from_roll_pitch_yaw(roll_rad, pitch_rad, yaw_rad)),
                    "gimbal_device_id": entry.instance + 1,
                },
            )
        logged = fields.get("Dist", math.nan)
        if math.isfinite(logged) and logged != self._mount_ranges.get(entry.instance):
            self._mount_ranges[entry.instance] = logged
            range_m = logged * self._mount_unit_m(logged, pitch_rad)
            yield _range(range_m, _MOUNT_RANGE_ID + entry.instance, _ORIENTATION_CUSTOM, _SIGNAL_UNKNOWN)

    def _mount_unit_m(self, logged: float, pitch_rad: float) -> float:
        """Return the unit of a mount's ranges: 1, 0.1 or 0.01 m."""
        drop = math.sin(-pitch_rad)
        if logged > 0.0 and drop > _DROP_MIN and self._height_m > _HEIGHT_MIN_M:
            self._exponents.append(math.log10(logged * drop / self._height_m))
        return 10.0 ** -min(max(round(median(self._exponents)), 0), 2) if self._exponents else 1.0

    def _text(self, entry: Entry) -> Made:
        yield "STATUSTEXT", {"text": entry.fields["Message" if entry.name == "MSG" else "FWS"]}

    def _parameter(self, entry: Entry) -> Made:
        yield "PARAM_VALUE", {"param_id": entry.fields["Name"], "param_value": entry.fields["Value"]}

    def _wind(self, entry: Entry) -> Made:
        if entry.instance == 0:
            north_m_s, east_m_s = entry.fields["VWN"], entry.fields["VWE"]
            yield "WIND_COV", {"time_usec": entry.time_us, "wind_x": north_m_s, "wind_y": east_m_s}


def _range(distance_m: float, sensor_id: int, orientation: int, signal: int) -> tuple[str, dict[str, Any]]:
    return (
        "DISTANCE_SENSOR",
        {
            "min_distance": 0.0,
            "max_distance": math.inf,
            "current_distance": 100.0 * distance_m,
            "id": sensor_id,
            "orientation": orientation,
            "covariance": _COVARIANCE_UNKNOWN,
            "signal_quality": signal,
        },
    )

"""PX4's logged topics as the MAVLink messages PX4 would send of them, so that one decoder serves every log."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from sidelong.app.records.entry import Entry, Made, Translator, global_position
from sidelong.app.records.ulog import FIRMWARE, TYPE_PARAMETER
from sidelong.estimators.frames import LocalPlane

_VTOL, _TYPES = 22, {1: 2, 2: 1, 3: 10, 4: 7}  # MAV_TYPE; by vehicle_status.vehicle_type
_GLOBAL_POSITION_SILENCE_US = 1_000_000


class Px4Messages(Translator):
    """A position takes its velocity from the latest vehicle_local_position.

    Where vehicle_global_position is not logged (older PX4), it is made of vehicle_local_position alone. Heights above
    home go by home_position, else by the origin of the local position.
    """

    def __init__(self) -> None:
        makers = {
            "home_position": self._home,
            "vehicle_gps_position": self._gps,
            "vehicle_global_position": self._global_position,
            "vehicle_local_position": self._local_position,
            "vehicle_attitude": self._attitude,
            "distance_sensor": self._distance_sensor,
            "gimbal_device_attitude_status": self._gimbal,
            "wind": self._wind,
            "wind_estimate": self._wind,
            "vehicle_status": self._status,
            TYPE_PARAMETER: self._parameter,
            FIRMWARE: self._firmware,
        }
        super().__init__(makers)
        self._home_altitude_m = math.nan
        self._local: Mapping[str, Any] = {}
        self._global_us: int | None = None  # when the latest global position came, at first when one could have

    def _home(self, entry: Entry) -> Made:
        self._home_altitude_m = entry.fields["alt"]
        yield from ()

    def _gps(self, entry: Entry) -> Made:
        utc_us = entry.fields["time_utc_usec"]
        self._boot_s = (utc_us - entry.time_us) * 1e-6 if utc_us else self._boot_s
        yield from ()

    def _global_position(self, entry: Entry) -> Made:
        self._global_us = entry.time_us
        fields = entry.fields
        yield from self._position(fields["lat"], fields["lon"], fields["alt"])

    def _local_position(self, entry: Entry) -> Made:
        self._local = fields = entry.fields
        if math.isnan(self._home_altitude_m) and fields["z_global"]:
            self._home_altitude_m = fields["ref_alt"]
        if self._global_us is None:
            self._global_us = entry.time_us
        if fields["xy_global"] and entry.time_us - self._global_us > _GLOBAL_POSITION_SILENCE_US:
            plane = LocalPlane(fields["ref_lat"], fields["ref_lon"])
            latitude_deg, longitude_deg = plane.latitude_longitude_deg(fields["y"], fields["x"])
            yield from self._position(latitude_deg, longitude_deg, fields["ref_alt"] - fields["z"])

    def _position(self, latitude_deg: float, longitude_deg: float, altitude_m: float) -> Made:
        velocity_ned_m_s = (self._local.get(name, math.nan) for name in ("vx", "vy", "vz"))
        height_m = altitude_m - self._home_altitude_m
        return global_position(latitude_deg, longitude_deg, altitude_m, height_m, velocity_ned_m_s)

    def _attitude(self, entry: Entry) -> Made:
        w, x, y, z = _quaternion(entry.fields)
        yield (
            "ATTITUDE",
            {
                "roll": math.atan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y)),
                "pitch": math.asin(max(-1.0, min(1.0, 2.0 * (w * y - z * x)))),
                "yaw": math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z)),
            },
        )

    def _distance_sensor(self, entry: Entry) -> Made:
        fields = entry.fields
        quality = fields["signal_quality"]  # -1 unknown, 0 invalid; in MAVLink 0 and 1
        variance_cm2 = 1e4 * fields["variance"]
        if math.isfinite(fields["current_distance"]):
            yield (
                "DISTANCE_SENSOR",
                {
                    "min_distance": 100.0 * fields["min_distance"],
                    "max_distance": 100.0 * fields["max_distance"],
                    "current_distance": 100.0 * fields["current_distance"],
                    "type": fields["type"],
                    "id": entry.instance,
                    "orientation": fields["orientation"],
                    "covariance": variance_cm2 if math.isfinite(variance_cm2) else 255,
                    "quaternion": list(_quaternion(fields)),
                    "signal_quality": 0 if quality < 0 else max(1, quality),
                },
            )

    def _gimbal(self, entry: Entry) -> Made:
        fields = entry.fields
        yield (
            "GIMBAL_DEVICE_ATTITUDE_STATUS",
            {
                "flags": fields["device_flags"],
                "q": list(_quaternion(fields)),
                "gimbal_device_id": fields.get("gimbal_device_id", 0),
            },
        )

    def _status(self, entry: Entry) -> Made:
        fields = entry.fields
        vtol = fields.get("is_vtol") and _VTOL
        kind = vtol or fields.get("system_type") or _TYPES.get(fields.get("vehicle_type", 0))
        if kind:
            yield "PARAM_VALUE", {"param_id": TYPE_PARAMETER, "param_value": kind}

    def _parameter(self, entry: Entry) -> Made:
        yield "PARAM_VALUE", {"param_id": entry.name, "param_value": entry.fields["value"]}

    def _firmware(self, entry: Entry) -> Made:
        yield "STATUSTEXT", {"text": entry.fields["value"]}

    def _wind(self, entry: Entry) -> Made:
        north_m_s, east_m_s = entry.fields["windspeed_north"], entry.fields["windspeed_east"]
        yield "WIND_COV", {"time_usec": entry.time_us, "wind_x": north_m_s, "wind_y": east_m_s}


def _quaternion(fields: Mapping[str, Any]) -> tuple[float, float, float, float]:
    return fields["q[0]"], fields["q[1]"], fields["q[2]"], fields["q[3]"]

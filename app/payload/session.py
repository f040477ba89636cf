"""One payload in use: its loss and return, what it cannot do in words, and its measurements as MAVLink."""

from __future__ import annotations

import math
import statistics
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

from pymavlink.dialects.v20 import all as mavlink

from sidelong.app.link.message import DISTANCE_SENSOR_MAX_CM
from sidelong.app.payload.driver import (
    AircraftPose,
    AnglesMeasured,
    Frame,
    Identity,
    Measured,
    PayloadDriver,
    RangeMeasured,
)
from sidelong.estimators.rotations import from_roll_pitch_yaw, rotate, sight_direction
from sidelong.mission.core.requirement import PAN_LIMIT_MIN_DEG

LOST_AFTER_S = 2.0
"""Without a measurement for this long the payload counts as lost."""

_RESTART_S = 1.0  # of a lost payload
_PAUSE_MAX_S = 0.25  # between two calls: a longer time in which this program was busy is no silence of the payload
_NO_RANGE_AFTER_S = 10.0  # lasers miss for seconds
_RATE_OVER_S = 2.0
_NOT_UNDERSTOOD = "bytes arrive, but nothing of its protocol: check its kind and its baud rate"
_HEIGHT_MIN_M, _DEPRESSION_MIN = 30.0, math.sin(math.radians(5.0))
_RATIOS_KEPT, _RATIOS_NEEDED = 50, 10
_RATIO_MAX = 2.0  # hills, and a target that is not at the height of home, stay below it
_APART_MAX_S = 0.5


@dataclass(frozen=True, slots=True)
class PayloadStatus:
    """Present data and state of a payload; None: not known yet."""

    identity: Identity
    range_hz: float  # over the last 2 s
    angles_hz: float
    round_trip_s: float | None  # shortest recent time between a request and its reply
    damaged: int  # frames refused since the beginning
    range: RangeMeasured | None  # the latest
    angles: AnglesMeasured | None
    missing: tuple[str, ...]  # messages about missing or inconsistent data
    height_ratio: float | None  # height by range and angles over the autopilot's height


class Consistency:
    """Compares slant range times the sine of the depression with the height above home, by the median of 50."""

    def __init__(self) -> None:
        self._ratios: deque[float] = deque(maxlen=_RATIOS_KEPT)

    def add(self, measured: RangeMeasured, angles: AnglesMeasured | None, pose: AircraftPose | None) -> None:
        """Compare a range with the height above home, where angles of the same moment and the pose allow it."""
        if angles is None or pose is None or pose.height_m < _HEIGHT_MIN_M:
            return
        if abs(measured.time_s - angles.time_s) > _APART_MAX_S:
            return
        direction = sight_direction(angles.quaternion_wxyz)
        if angles.frame == "body":
            direction = rotate(from_roll_pitch_yaw(pose.roll_rad, pose.pitch_rad, 0.0), direction)
        if abs(direction[2]) >= _DEPRESSION_MIN:
            self._ratios.append(measured.slant_range_m * direction[2] / pose.height_m)

    @property
    def ratio(self) -> float | None:
        """Height by the payload over height by the autopilot; None while it is not known, as on the ground."""
        return statistics.median(self._ratios) if len(self._ratios) >= _RATIOS_NEEDED else None

    @property
    def fault(self) -> str:
        """What does not agree, and what to set; empty where it agrees or is not known."""
        ratio = self.ratio
        if ratio is None or 1.0 / _RATIO_MAX <= ratio <= _RATIO_MAX:
            return ""
        if ratio < 0.0:
            return "it looks up while the target is below: set payload.flip_pitch = true"
        what = f"range and angles put the target {ratio:.2g} times as far below as the autopilot's height"
        for factor in (10.0, 0.1, 100.0, 0.01):
            if 1.0 / _RATIO_MAX <= ratio / factor <= _RATIO_MAX:
                return f"{what}: set payload.range_unit_m to {1.0 / factor:g} times its present value"
        return f"{what}: check the mount and payload.angles_relative_to"


@dataclass(eq=False)
class PayloadSession:
    """A driver with the supervision of its connection. Times are of the driver's clock."""

    _name: str
    _driver: PayloadDriver
    _report: Callable[[str], object]  # receives one sentence without its full stop
    _range_delay_s: float = 0.0  # age of a range when the payload sends it
    _angles_delay_s: float = 0.0

    def __post_init__(self) -> None:
        self._delays_s = {RangeMeasured: self._range_delay_s, AnglesMeasured: self._angles_delay_s}
        self._called_s: float | None = None
        self._latest_s = self._range_s = self._restarted_s = self._bytes_s = -math.inf
        self._is_lost = self._is_rangeless = False
        self._model = ""
        self._consistency = Consistency()
        self._pose: AircraftPose | None = None
        self._fault = ""
        self._ranges_s: deque[float] = deque()
        self._angles_s: deque[float] = deque()
        self._range: RangeMeasured | None = None
        self._angles: AnglesMeasured | None = None

    def due(self, now_s: float) -> list[bytes]:
        """Return what to send now. To be called every 10 ms or so."""
        if self._called_s is None:
            self._called_s = self._latest_s = self._range_s = self._restarted_s = now_s
        paused_s = max(now_s - self._called_s - _PAUSE_MAX_S, 0.0)
        self._latest_s, self._range_s = self._latest_s + paused_s, self._range_s + paused_s
        self._called_s = now_s
        self._supervise(now_s)
        return list(self._driver.due(now_s))

    def receive(self, data: bytes, now_s: float) -> list[Measured]:
        """Process bytes that arrived at ``now_s``; return the measurements that they complete."""
        self._bytes_s = now_s
        received = self._driver.receive(data, now_s)
        measured = [replace(each, time_s=each.time_s - self._delays_s[type(each)]) for each in received]
        for each in measured:
            if isinstance(each, RangeMeasured):
                self._range, self._range_s = each, now_s
                self._ranges_s.append(now_s)
                self._consistency.add(each, self._angles, self._pose)
            else:
                self._angles = each
                self._angles_s.append(now_s)
        for times_s in (self._ranges_s, self._angles_s):
            while times_s and times_s[0] < now_s - _RATE_OVER_S:
                times_s.popleft()
        if not measured:
            return measured
        if self._is_rangeless and self._range_s == now_s:
            self._is_rangeless = False
            self._report(f"payload {self._name}: ranges again")
        if self._is_lost:
            self._is_lost = self._is_rangeless = False
            self._report(f"payload {self._name}: data again after {now_s - self._latest_s:.0f} s")
            self._range_s = now_s  # its laser may take some seconds
        self._latest_s = now_s
        return measured

    def aircraft(self, pose: AircraftPose, now_s: float) -> list[bytes]:
        """Take the aircraft's pose; return what is to be sent to the payload."""
        self._pose = pose
        return list(self._driver.aircraft(pose, now_s))

    def point(self, pitch_rad: float, yaw_rad: float) -> list[bytes]:
        """Return the commands that point the gimbal; yaw is relative to the aircraft's heading, pitch positive up."""
        return list(self._driver.point(pitch_rad, yaw_rad))

    @property
    def pan_limits_rad(self) -> tuple[float, float] | None:
        """Least and greatest yaw off the nose; None while they are unknown, or if there are none."""
        return self._driver.identity.pan_limits_rad

    def status(self, now_s: float) -> PayloadStatus:
        """Return rates and faults of the last seconds; ``now_s`` is of the driver's clock."""
        range_hz, angles_hz = (
            sum(time_s > now_s - _RATE_OVER_S for time_s in times_s) / _RATE_OVER_S
            for times_s in (self._ranges_s, self._angles_s)
        )
        missing = []
        if not angles_hz and not range_hz:
            silent = "it does not answer: check power, address and wiring"
            missing.append(_NOT_UNDERSTOOD if self._is_not_understood(now_s) else silent)
        elif not angles_hz:
            missing.append("no gimbal angles arrive")
        if self._driver.identity.has_laser is False:
            missing.append(f"the {self._driver.identity.model} has no laser: no range")
        elif angles_hz and not range_hz:
            missing.append("no range arrives: the laser is off, or nothing reflects within its reach")
        if self._consistency.fault:
            missing.append(self._consistency.fault)
        return PayloadStatus(
            identity=self._driver.identity,
            range_hz=range_hz,
            angles_hz=angles_hz,
            round_trip_s=self._driver.round_trip_s,
            damaged=self._driver.damaged,
            range=self._range,
            angles=self._angles,
            missing=tuple(missing),
            height_ratio=self._consistency.ratio,
        )

    def _supervise(self, now_s: float) -> None:
        identity = self._driver.identity
        if identity.model and identity.model != self._model:
            self._model = identity.model
            no_laser = ", which has no laser: the range has to come from elsewhere" * (identity.has_laser is False)
            self._report(f"payload {self._name}: {identity.model}{no_laser}")
            for words in pan_words(identity.pan_limits_rad):
                self._report(f"payload {self._name}: {words}")
        fault = self._consistency.fault
        if fault and fault[:20] != self._fault[:20]:
            self._report(f"payload {self._name}: {fault}")
        self._fault = fault
        silent_s = now_s - self._latest_s
        if silent_s > LOST_AFTER_S:
            if not self._is_lost:
                self._is_lost = True
                silent = f"no data for {silent_s:.0f} s: check its power and its link"
                self._report(f"payload {self._name}: {_NOT_UNDERSTOOD if self._is_not_understood(now_s) else silent}")
            if now_s - self._restarted_s > _RESTART_S:
                self._restarted_s = now_s
                self._driver.restart(now_s)
        elif now_s - self._range_s > _NO_RANGE_AFTER_S and not self._is_rangeless and identity.has_laser is not False:
            self._is_rangeless = True
            self._report(f"payload {self._name}: angles arrive, but no range for {_NO_RANGE_AFTER_S:.0f} s")

    def _is_not_understood(self, now_s: float) -> bool:
        """Return whether bytes arrive that are of another protocol, or at another baud rate."""
        return now_s - self._bytes_s < LOST_AFTER_S and not self._driver.identity.model


_CLOSED_RAD = math.radians(1.0)
_EQUAL_DEG = 2.0


def usable_pan_limit_deg(limits_rad: tuple[float, float] | None) -> float | None:
    """Return the pan limit to each side that figures of eight can be planned for, degrees.

    limits_rad: least and greatest yaw off the nose. None for a gimbal that looks all around, or too little aside.
    """
    if limits_rad is None or _looks_all_around(limits_rad):
        return None
    nearer_deg = float(math.floor(math.degrees(min(-limits_rad[0], limits_rad[1])) + 0.1))
    return None if nearer_deg < PAN_LIMIT_MIN_DEG else nearer_deg


def pan_words(limits_rad: tuple[float, float] | None) -> list[str]:
    """Return what pan limits mean for a watch, one sentence; none if the gimbal looks all around.

    The aircraft turns through 360 degrees in each lap. A target outside the circle is therefore in every direction
    from the nose for the same time, wherever the circle is; only figures of eight avoid that.
    """
    if limits_rad is None or _looks_all_around(limits_rad):
        return []
    least_deg, most_deg = (math.degrees(limit_rad) for limit_rad in limits_rad)
    share = 100.0 - (most_deg - least_deg) / 3.6
    reach = f"the gimbal pans from {least_deg:.0f} to {most_deg:.0f} degrees off the nose"
    lost = f"on a circle it cannot look at the target for {share:.0f} % of each lap"
    instead = "" if usable_pan_limit_deg(limits_rad) is None else "; one aircraft flies figures of eight instead"
    return [f"{reach}: {lost}{instead}"]


def contradiction(configured_deg: float | None, limits_rad: tuple[float, float] | None) -> str:
    """Return that the configured pan limit is wider than the gimbal's, and what to do; empty: it is not."""
    limit_deg = usable_pan_limit_deg(limits_rad)
    if configured_deg is None or limit_deg is None or configured_deg <= limit_deg + _EQUAL_DEG:
        return ""
    return (
        f"aircraft.pan_limit_deg = {configured_deg:g}, but the gimbal pans {limit_deg:g} degrees only; "
        "remove it to plan for that"
    )


def _looks_all_around(limits_rad: tuple[float, float]) -> bool:
    return limits_rad[1] - limits_rad[0] >= math.tau - _CLOSED_RAD


COMPONENT = mavlink.MAV_COMP_ID_GIMBAL
"""The component that a driver's messages come from: 154."""

_LOCKED = mavlink.GIMBAL_DEVICE_FLAGS_ROLL_LOCK | mavlink.GIMBAL_DEVICE_FLAGS_PITCH_LOCK
_FLAGS: dict[Frame, int] = {
    "vehicle": _LOCKED | mavlink.GIMBAL_DEVICE_FLAGS_YAW_IN_VEHICLE_FRAME,
    "body": mavlink.GIMBAL_DEVICE_FLAGS_YAW_IN_VEHICLE_FRAME,
    "earth": _LOCKED | mavlink.GIMBAL_DEVICE_FLAGS_YAW_LOCK | mavlink.GIMBAL_DEVICE_FLAGS_YAW_IN_EARTH_FRAME,
}
_SENSOR_ID = 1
_COVARIANCE_UNKNOWN = 255
_BOOT_MS_WRAP = 1 << 32


def fields_of(measured: Measured, vehicle_s: float) -> tuple[str, dict[str, Any]]:
    """Return name and fields of the message for a measurement, vehicle_s being its time on the vehicle's clock."""
    boot_ms = round(1000.0 * vehicle_s) % _BOOT_MS_WRAP
    if isinstance(measured, AnglesMeasured):
        addressed = {"target_system": 0, "target_component": 0, "time_boot_ms": boot_ms}
        attitude = {"flags": _FLAGS[measured.frame], "q": list(measured.quaternion_wxyz), "failure_flags": 0}
        rates = dict.fromkeys((f"angular_velocity_{axis}" for axis in "xyz"), math.nan)
        return "GIMBAL_DEVICE_ATTITUDE_STATUS", addressed | attitude | rates
    # A field of 16 bits limits what is sent to others, not what is flown by.
    centimetres = 100.0 * measured.slant_range_m
    return "DISTANCE_SENSOR", {
        "time_boot_ms": boot_ms,
        "min_distance": 0,
        "max_distance": max(DISTANCE_SENSOR_MAX_CM, math.floor(centimetres) + 1),
        "current_distance": centimetres,
        "type": mavlink.MAV_DISTANCE_SENSOR_LASER,
        "id": _SENSOR_ID,
        "orientation": mavlink.MAV_SENSOR_ROTATION_CUSTOM,
        "covariance": _COVARIANCE_UNKNOWN,
        "quaternion": [1.0, 0.0, 0.0, 0.0],
        "signal_quality": 0,
    }


def packed(name: str, fields: dict[str, Any], encoder: Any) -> bytes | None:
    """Return the message as bytes; None for a range beyond the 655 m that DISTANCE_SENSOR can carry."""
    if name == "DISTANCE_SENSOR":
        if fields["current_distance"] > DISTANCE_SENSOR_MAX_CM:
            return None
        whole_cm = round(fields["current_distance"])
        fields = fields | {"current_distance": whole_cm, "max_distance": DISTANCE_SENSOR_MAX_CM}
    data: bytes = getattr(mavlink, f"MAVLink_{name.lower()}_message")(**fields).pack(encoder)
    return data

"""One payload in use: notices its loss and return, and reports in words what it cannot do."""

from __future__ import annotations

import math
import statistics
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace

from sidelong.app.payload.driver import AircraftPose, AnglesMeasured, Identity, Measured, PayloadDriver, RangeMeasured
from sidelong.app.payload.pan_limits import pan_words
from sidelong.estimators.rotations import from_roll_pitch_yaw, rotate, sight_direction

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
    """Present data and state of a payload.

    Attributes:
        range_hz: ranges per second over the last 2 s.
        angles_hz: attitudes per second over the last 2 s.
        round_trip_s: shortest recent time between a request and its reply, s; None where it is not known.
        damaged: frames refused since the beginning.
        range: the latest range, None before the first.
        angles: the latest attitude, None before the first.
        missing: messages about missing or inconsistent data; empty without a fault.
        height_ratio: height by range and angles over the autopilot's height; None while it is not known.
    """

    identity: Identity
    range_hz: float
    angles_hz: float
    round_trip_s: float | None
    damaged: int
    range: RangeMeasured | None
    angles: AnglesMeasured | None
    missing: tuple[str, ...]
    height_ratio: float | None


class Consistency:
    """Compares slant range times the sine of the depression with the height above home, by the median of 50."""

    def __init__(self) -> None:
        self._ratios: deque[float] = deque(maxlen=_RATIOS_KEPT)

    def add(self, measured: RangeMeasured, angles: AnglesMeasured | None, pose: AircraftPose | None) -> None:
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


class PayloadSession:
    """A driver with the supervision of its connection. Times are of the driver's clock.

    Args:
        name: how reports call the payload.
        report: receives each report, one sentence without its full stop.
        range_delay_s: age of a range when the payload sends it, s.
        angles_delay_s: the same of the angles, s.
    """

    def __init__(
        self,
        name: str,
        driver: PayloadDriver,
        report: Callable[[str], object],
        range_delay_s: float = 0.0,
        angles_delay_s: float = 0.0,
    ) -> None:
        self._name, self._driver, self._report = name, driver, report
        self._delays_s = {RangeMeasured: range_delay_s, AnglesMeasured: angles_delay_s}
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
        """Take bytes that arrived at ``now_s`` and return the measurements they complete."""
        self._bytes_s = now_s
        measured = [
            replace(one, time_s=one.time_s - self._delays_s[type(one)]) for one in self._driver.receive(data, now_s)
        ]
        for one in measured:
            if isinstance(one, RangeMeasured):
                self._range, self._range_s = one, now_s
                self._ranges_s.append(now_s)
                self._consistency.add(one, self._angles, self._pose)
            else:
                self._angles = one
                self._angles_s.append(now_s)
        for times_s in (self._ranges_s, self._angles_s):
            while times_s and times_s[0] < now_s - _RATE_OVER_S:
                times_s.popleft()
        if measured:
            self._returned(now_s)
            self._latest_s = now_s
        return measured

    def aircraft(self, pose: AircraftPose, now_s: float) -> list[bytes]:
        self._pose = pose
        return list(self._driver.aircraft(pose, now_s))

    def point(self, pitch_rad: float, yaw_rad: float) -> list[bytes]:
        return list(self._driver.point(pitch_rad, yaw_rad))

    @property
    def pan_limits_rad(self) -> tuple[float, float] | None:
        """Least and greatest yaw off the nose; None while they are unknown, or if there are none."""
        return self._driver.identity.pan_limits_rad

    def status(self, now_s: float) -> PayloadStatus:
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
            self._driver.identity,
            range_hz,
            angles_hz,
            self._driver.round_trip_s,
            self._driver.damaged,
            self._range,
            self._angles,
            tuple(missing),
            self._consistency.ratio,
        )

    def _supervise(self, now_s: float) -> None:
        identity = self._driver.identity
        if identity.model and identity.model != self._model:
            self._model = identity.model
            no_laser = ", which has no laser: the range has to come from elsewhere"
            no_laser = no_laser if identity.has_laser is False else ""
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

    def _returned(self, now_s: float) -> None:
        if self._is_rangeless and self._range_s == now_s:
            self._is_rangeless = False
            self._report(f"payload {self._name}: ranges again")
        if self._is_lost:
            self._is_lost = self._is_rangeless = False
            self._report(f"payload {self._name}: data again after {now_s - self._latest_s:.0f} s")
            self._range_s = now_s  # its laser may take some seconds

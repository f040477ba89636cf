"""The interface of a payload driver: bytes in, measurements out, commands out; no socket and no clock.

Times are seconds on the driver's clock. Any steady clock serves; its caller converts to the vehicle's clock.

Angles follow MAVLink: roll right wing down, pitch up and yaw to the right are positive, radians.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal, Protocol

from sidelong.estimators.rotations import Quaternion

Frame = Literal["vehicle", "body", "earth"]
"""What gimbal angles are relative to; the same words as in :class:`estimators.sensing.readings.GimbalReading`."""


@dataclass(frozen=True, slots=True)
class RangeMeasured:
    """A laser range.

    Attributes:
        time_s: best estimate of the time of measurement, s on the driver's clock.
    """

    time_s: float
    slant_range_m: float


@dataclass(frozen=True, slots=True)
class AnglesMeasured:
    """The attitude of the gimbal.

    Attributes:
        time_s: best estimate of the time of measurement, s on the driver's clock.
        quaternion_wxyz: rotation from the sight frame (forward, right, down) to ``frame``.
    """

    time_s: float
    quaternion_wxyz: Quaternion
    frame: Frame


Measured = RangeMeasured | AnglesMeasured


@dataclass(frozen=True, slots=True)
class DriverSettings:
    """Settings that concern every protocol.

    Attributes:
        range_unit_m: unit of the range that the payload sends, m; None: the unit of its manual.
        flip_yaw: whether the payload's yaw is positive opposite to the direction in its manual.
        flip_pitch: the same of its pitch.
        relative_to: reference of the payload's angles; None: the reference of its manual or its mode.
        over_tcp: whether the bytes go over TCP, for which some protocols have another frame.
    """

    range_unit_m: float | None = None
    flip_yaw: bool = False
    flip_pitch: bool = False
    relative_to: Frame | None = None
    over_tcp: bool = False


@dataclass(frozen=True, slots=True)
class AircraftPose:
    """The aircraft's attitude and position, which some gimbals want to know.

    Attributes:
        roll_rad: right wing down.
        pitch_rad: nose up.
        yaw_rad: heading, clockwise from north.
        latitude_deg: WGS-84.
        longitude_deg: WGS-84.
        altitude_m: above mean sea level.
        height_m: above home.
        velocity_north_m_s: over the ground.
        velocity_east_m_s: over the ground.
        velocity_up_m_s: climb rate.
    """

    roll_rad: float
    pitch_rad: float
    yaw_rad: float
    latitude_deg: float
    longitude_deg: float
    altitude_m: float
    height_m: float
    velocity_north_m_s: float
    velocity_east_m_s: float
    velocity_up_m_s: float


@dataclass(slots=True)
class Identity:
    """What the payload reports of itself.

    Attributes:
        model: name of the model, "" while it is unknown.
        firmware: version in words, "" while it is unknown.
        has_laser: None while it is unknown.
        pan_limits_rad: least and greatest yaw off the nose; None while they are unknown, or if there are none.
    """

    model: str = ""
    firmware: str = ""
    has_laser: bool | None = None
    pan_limits_rad: tuple[float, float] | None = None


class PayloadDriver(Protocol):
    """One connection's protocol state."""

    identity: Identity

    @property
    def damaged(self) -> int:
        """Number of byte sequences that began like a frame and were none."""

    @property
    def round_trip_s(self) -> float | None:
        """Shortest recent time between a request and its reply, s; None before the first reply."""

    def restart(self, now_s: float) -> None:
        """Forget the connection's state: identification, streams and laser are requested again."""

    def due(self, now_s: float) -> Sequence[bytes]:
        """Return the requests to send now. To be called every 10 ms or so."""

    def receive(self, data: bytes, now_s: float) -> list[Measured]:
        """Take bytes that arrived at ``now_s`` and return the measurements they complete."""

    def aircraft(self, pose: AircraftPose, now_s: float) -> Sequence[bytes]:
        """Return the aircraft data to send to the gimbal; call it after each new attitude."""

    def point(self, pitch_rad: float, yaw_rad: float) -> Sequence[bytes]:
        """Return the commands that point the gimbal; yaw is relative to the aircraft's heading."""


@dataclass(frozen=True, slots=True)
class PayloadKind:
    """A protocol.

    Attributes:
        name: the value of ``payload.kind``.
        about: what it covers, in a few words.
        url: where its devices are found as delivered.
        make: returns a driver for one connection.
    """

    name: str
    about: str
    url: str
    make: Callable[[DriverSettings], PayloadDriver]

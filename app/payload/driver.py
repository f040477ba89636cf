"""A payload driver: bytes in, measurements out, commands out; no socket and no clock.

Times are seconds on the driver's clock. Any steady clock serves; its caller converts to the vehicle's clock.

Angles follow MAVLink: roll right wing down, pitch up and yaw to the right are positive, radians.
"""

from __future__ import annotations

from abc import abstractmethod
from collections import deque
from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, Protocol

from sidelong.app.link.framing import Framer
from sidelong.estimators.rotations import Quaternion

Frame = Literal["vehicle", "body", "earth"]
"""What gimbal angles are relative to; the same words as in :class:`estimators.sensing.readings.GimbalReading`."""


@dataclass(frozen=True, slots=True)
class RangeMeasured:
    time_s: float  # best estimate of the time of measurement, on the driver's clock
    slant_range_m: float


@dataclass(frozen=True, slots=True)
class AnglesMeasured:
    time_s: float  # as of a range
    quaternion_wxyz: Quaternion  # rotation of the gimbal from the sight frame (forward, right, down) to ``frame``
    frame: Frame


Measured = RangeMeasured | AnglesMeasured


@dataclass(frozen=True, slots=True)
class DriverSettings:
    """Settings that concern every protocol; None: as in the payload's manual."""

    range_unit_m: float | None = None  # of the range that the payload sends
    flip_yaw: bool = False  # whether it is positive opposite to the direction in the manual
    flip_pitch: bool = False
    relative_to: Frame | None = None  # of the payload's angles
    over_tcp: bool = False  # some protocols have another frame there


@dataclass(frozen=True, slots=True)
class AircraftPose:
    """The aircraft's attitude and position, which some gimbals want to know; velocities over the ground."""

    roll_rad: float
    pitch_rad: float
    yaw_rad: float  # heading, clockwise from north
    latitude_deg: float
    longitude_deg: float
    altitude_m: float  # above mean sea level
    height_m: float  # above home
    velocity_north_m_s: float
    velocity_east_m_s: float
    velocity_up_m_s: float


@dataclass(slots=True)
class Identity:
    """What the payload reports of itself; "" or None while it is unknown."""

    model: str = ""
    firmware: str = ""
    has_laser: bool | None = None
    pan_limits_rad: tuple[float, float] | None = None  # least and greatest yaw off the nose; None also if unlimited


class PayloadDriver(Protocol):
    """One connection's protocol state."""

    identity: Identity

    @property
    def damaged(self) -> int: ...  # number of byte sequences that began like a frame and were none
    @property
    def round_trip_s(self) -> float | None: ...  # shortest recent time between a request and its reply

    def restart(self, now_s: float) -> None:
        """Forget the connection's state: identification, streams and laser are requested again."""

    def due(self, now_s: float) -> Sequence[bytes]:
        """Return the requests to send now. To be called every 10 ms or so."""

    def receive(self, data: bytes, now_s: float) -> list[Measured]:
        """Process bytes that arrived at ``now_s``; return the measurements that they complete."""

    def aircraft(self, pose: AircraftPose, now_s: float) -> Sequence[bytes]:
        """Return the aircraft data to send to the gimbal; call it after each new attitude."""

    def point(self, pitch_rad: float, yaw_rad: float) -> Sequence[bytes]:
        """Return the commands that point the gimbal; yaw is relative to the aircraft's heading."""


@dataclass(frozen=True, slots=True)
class PayloadKind:
    """A protocol, for one value of ``payload.kind``."""

    name: str
    about: str
    url: str  # where its devices are found as delivered
    make: Callable[[DriverSettings], PayloadDriver]


_REPLIES_KEPT = 20
_GIVEN_UP_S, _GIVEN_UP_FIRST_S = 0.3, 1.0


class Period:
    def __init__(self, period_s: float) -> None:
        self._period_s = period_s
        self._next_s = float("-inf")

    def is_due(self, now_s: float) -> bool:
        """Return whether it is due, and begin the next period if it is. No missed period is made up for."""
        if now_s < self._next_s:
            return False
        late_s = now_s - self._next_s
        self._next_s = (now_s if late_s > self._period_s else self._next_s) + self._period_s
        return True

    def restart(self) -> None:
        """Be due at once."""
        self._next_s = float("-inf")


class RoundTrips:
    """Requests that wait for a reply, one of each kind, and the shortest time of the latest replies.

    Replies do not name their request. So nothing is requested again before its reply has come or is given up, and a
    measurement that comes without a request counts as delayed by half of the shortest time.
    """

    def __init__(self) -> None:
        self._sent_s: dict[Hashable, float] = {}
        self._latest_s: deque[float] = deque(maxlen=_REPLIES_KEPT)

    @property
    def shortest_s(self) -> float | None:
        """The shortest of the latest round trips, s; None before the first."""
        return min(self._latest_s, default=None)

    def sent(self, kind: Hashable, now_s: float) -> None:
        """Note that a request of a kind has been sent."""
        self._sent_s[kind] = now_s

    def awaits(self, kind: Hashable, now_s: float) -> bool:
        """Return whether a request of a kind waits for its reply."""
        shortest_s = self.shortest_s
        given_up_s = _GIVEN_UP_FIRST_S if shortest_s is None else max(_GIVEN_UP_S, 3.0 * shortest_s)
        return now_s - self._sent_s.get(kind, float("-inf")) < given_up_s

    def measured_s(self, kind: Hashable, now_s: float) -> float:
        """Return when a message that came now was written: halfway to its request, if it answers one."""
        awaited = self.awaits(kind, now_s)
        sent_s = self._sent_s.pop(kind, now_s)
        if not awaited:
            return now_s - 0.5 * (self.shortest_s or 0.0)
        self._latest_s.append(now_s - sent_s)
        return 0.5 * (sent_s + now_s)

    def clear(self) -> None:
        self._sent_s.clear()


class FramedDriver(PayloadDriver):
    """State of one connection: frames, timers, round trips, and the settings of every protocol.

    Args:
        periods_s: periods of what is sent repeatedly, by name.
        yaw_sign: 1 where yaw is positive to the right by the manual, else -1; the same of pitch, upwards.
    """

    def __init__(
        self,
        settings: DriverSettings,
        framer: Framer,
        periods_s: Mapping[str, float],
        range_unit_m: float = 1.0,
        yaw_sign: float = 1.0,
        pitch_sign: float = 1.0,
    ) -> None:
        self.identity = Identity()
        self._settings = settings
        self._framer = framer
        self._trips = RoundTrips()
        self._follows = False  # the aircraft's yaw: set with the first command where a gimbal has such a mode
        self._due = {name: Period(period_s) for name, period_s in periods_s.items()}
        self._range_unit_m = settings.range_unit_m or range_unit_m
        self._yaw_sign = -yaw_sign if settings.flip_yaw else yaw_sign
        self._pitch_sign = -pitch_sign if settings.flip_pitch else pitch_sign

    @property
    def damaged(self) -> int:
        return self._framer.damaged

    @property
    def round_trip_s(self) -> float | None:
        return self._trips.shortest_s

    def restart(self, now_s: float) -> None:
        self._framer.clear()
        self._trips.clear()
        self._follows = False
        self.identity = Identity()
        for period in self._due.values():
            period.restart()

    def receive(self, data: bytes, now_s: float) -> list[Measured]:
        return [one for frame in self._framer.feed(data) for one in self._measured(frame, now_s) if one is not None]

    def aircraft(self, pose: AircraftPose, now_s: float) -> Sequence[bytes]:
        """Return nothing: most gimbals have sensors of their own."""
        return ()

    @abstractmethod
    def _measured(self, frame: bytes, now_s: float) -> Sequence[Measured | None]:
        """Return the measurements of a frame."""

    def _attitude(self, time_s: float, quaternion: Quaternion, frame: Frame = "vehicle") -> AnglesMeasured:
        """Return an attitude relative to ``frame``, unless the settings name another reference."""
        return AnglesMeasured(time_s, quaternion, self._settings.relative_to or frame)

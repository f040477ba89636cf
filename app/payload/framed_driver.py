"""What the drivers have in common: frames, timers, round trips, and the settings of every protocol."""

from __future__ import annotations

from abc import abstractmethod
from collections import deque
from collections.abc import Hashable, Mapping, Sequence

from sidelong.app.link.framing import Framer
from sidelong.app.payload.driver import (
    AircraftPose,
    AnglesMeasured,
    DriverSettings,
    Frame,
    Identity,
    Measured,
    PayloadDriver,
)
from sidelong.estimators.rotations import Quaternion

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
        self._sent_s[kind] = now_s

    def awaits(self, kind: Hashable, now_s: float) -> bool:
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
    """State of one connection.

    Args:
        periods_s: periods of what is sent repeatedly, by name.
        range_unit_m: unit of the range by the manual, m.
        yaw_sign: 1 where yaw is positive to the right by the manual, else -1.
        pitch_sign: 1 where pitch is positive upwards by the manual, else -1.
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

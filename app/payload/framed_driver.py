"""What the drivers have in common: frames, timers, round trips, and the settings of every protocol."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping, Sequence

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
from sidelong.app.payload.requests import Period, RoundTrips
from sidelong.estimators.rotations import Quaternion


class FramedDriver(PayloadDriver):
    """State of one connection.

    Args:
        settings: settings that concern every protocol.
        framer: splits the received bytes into frames.
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

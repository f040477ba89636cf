"""Where the aircraft was, and how it was turned, at any time of the last seconds.

Source: piecewise cubic Hermite interpolation, de Boor, *A Practical Guide to Splines*, chapter IV.
"""

from __future__ import annotations

import math
from bisect import bisect_right, insort
from dataclasses import replace
from operator import attrgetter
from typing import Generic, TypeVar

from sidelong.estimators.frames import wrap_rad
from sidelong.estimators.rotations import interpolated
from sidelong.estimators.sensing.readings import AttitudeReading, GimbalReading, PositionReading, Reading

T = TypeVar("T", bound=Reading)
_time_s = attrgetter("time_s")


class ReadingHistory(Generic[T]):
    """Readings of one kind in the order of their times (vehicle's clock), of the last ``span_s`` seconds at least.

    A second reading of the same time is a duplicate and is dropped.
    """

    def __init__(self, span_s: float) -> None:
        self._span_s, self.newest_s = span_s, -math.inf
        self._items: list[T] = []

    def __len__(self) -> int:
        return len(self._items)

    def add(self, item: T) -> bool:
        """Store a reading in the order of the times; return False for a duplicate."""
        items = self._items
        if item.time_s > self.newest_s:
            items.append(item)
            self.newest_s = item.time_s
        else:
            at = bisect_right(items, item.time_s, key=_time_s)
            if at > 0 and items[at - 1].time_s == item.time_s:
                return False
            insort(items, item, key=_time_s)
        # Cut rarely and much: the cost of a cut is spread over many readings.
        if items[0].time_s < self.newest_s - 2 * self._span_s and len(items) > 64:
            del items[: bisect_right(items, self.newest_s - self._span_s, key=_time_s)]
        return True

    def around(self, time_s: float) -> tuple[T, T] | None:
        """Return the readings before and after a time, twice one of that time; None outside the readings."""
        items = self._items
        if time_s == self.newest_s:  # as where all devices measure at once
            return items[-1], items[-1]
        at = bisect_right(items, time_s, key=_time_s)
        if at == 0:
            return None
        before = items[at - 1]
        if before.time_s == time_s:
            return before, before
        return None if at == len(items) else (before, items[at])

    def since(self, time_s: float) -> list[T]:
        """Return the readings from a time on."""
        return self._items[bisect_right(self._items, time_s, key=_time_s) :]

    def newest(self) -> T | None:
        """Return the latest item, None while there is none."""
        return self._items[-1] if self._items else None


class PoseHistory:
    """Positions and attitudes as they come; interpolated ones at the times that are asked for."""

    _SPAN_S = 12.0
    _EXTRAPOLATION_MAX_S = 0.3
    _GAP_MAX_S = 3.0  # between two readings: across more, the aircraft's motion is unknown

    def __init__(self) -> None:
        self.positions: ReadingHistory[PositionReading] = ReadingHistory(self._SPAN_S)
        self.attitudes: ReadingHistory[AttitudeReading] = ReadingHistory(self._SPAN_S)

    def position_at(self, time_s: float) -> PositionReading | None:
        """Return the aircraft's position at a time; None outside the readings and in a long gap.

        Follows the cubic through two positions and their velocities: at 1 Hz and 0.5 g of turn it stays within 0.1 m
        where a straight line errs by 0.6 m. After the last reading, its velocity is held for 0.3 s.
        """
        pair = self.positions.around(time_s)
        if pair is None:
            return self._position_after_the_last(time_s)
        a, b = pair
        step_s = b.time_s - a.time_s
        if step_s <= 0.0:
            return a
        if step_s > self._GAP_MAX_S:
            return None
        u = (time_s - a.time_s) / step_s
        # Hermite's cubic: weights of the two positions, then of the two velocities.
        weight_b = u * u * (3 - 2 * u)
        weight_a = 1 - weight_b
        slope_a, slope_b = u * (1 - u) * (1 - u) * step_s, u * u * (u - 1) * step_s
        return PositionReading(
            time_s,
            weight_a * a.east_m + weight_b * b.east_m + slope_a * a.velocity_east_m_s + slope_b * b.velocity_east_m_s,
            weight_a * a.north_m
            + weight_b * b.north_m
            + slope_a * a.velocity_north_m_s
            + slope_b * b.velocity_north_m_s,
            weight_a * a.height_m + weight_b * b.height_m + slope_a * a.velocity_up_m_s + slope_b * b.velocity_up_m_s,
            a.velocity_east_m_s + u * (b.velocity_east_m_s - a.velocity_east_m_s),
            a.velocity_north_m_s + u * (b.velocity_north_m_s - a.velocity_north_m_s),
            a.velocity_up_m_s + u * (b.velocity_up_m_s - a.velocity_up_m_s),
        )

    def _position_after_the_last(self, time_s: float) -> PositionReading | None:
        last = self.positions.newest()
        if last is None or not 0.0 <= time_s - last.time_s <= self._EXTRAPOLATION_MAX_S:
            return None
        ahead_s = time_s - last.time_s
        return replace(
            last,
            time_s=time_s,
            east_m=last.east_m + last.velocity_east_m_s * ahead_s,
            north_m=last.north_m + last.velocity_north_m_s * ahead_s,
            height_m=last.height_m + last.velocity_up_m_s * ahead_s,
        )

    def attitude_at(self, time_s: float) -> AttitudeReading | None:
        """Return the attitude at a time, interpolated linearly; None outside the readings and in a long gap."""
        pair = self.attitudes.around(time_s)
        if pair is None:
            return None
        a, b = pair
        if b.time_s <= a.time_s:
            return a
        if b.time_s - a.time_s > self._GAP_MAX_S:
            return None
        u = (time_s - a.time_s) / (b.time_s - a.time_s)
        return AttitudeReading(
            time_s,
            a.roll_rad + u * wrap_rad(b.roll_rad - a.roll_rad),
            a.pitch_rad + u * (b.pitch_rad - a.pitch_rad),
            wrap_rad(a.yaw_rad + u * wrap_rad(b.yaw_rad - a.yaw_rad)),
        )


_GIMBAL_GAP_MAX_S = 1.0  # between two attitudes of a gimbal: across more, it may have turned anywhere
AXIS_AHEAD_S = 0.4  # for a picture that is newer than the gimbal's last attitude
_TURN_S = 0.3  # a rate over less than this is that of the stamps' errors


def gimbal_at(
    gimbals: ReadingHistory[GimbalReading], time_s: float, ahead_s: float = 0.0
) -> tuple[GimbalReading, float] | None:
    """Return the gimbal's attitude, and the time between its readings; None outside, in gaps, between devices.

    ahead_s: for how long after the newest reading it turns on at its last rate.
    """
    pair, newest = gimbals.around(time_s), gimbals.newest()
    if pair is None and newest is not None and 0.0 < time_s - newest.time_s <= ahead_s:
        before = gimbals.around(newest.time_s - _TURN_S)
        pair = None if before is None else (before[0], newest)
    if pair is None:
        return None
    a, b = pair
    gap_s = b.time_s - a.time_s
    if gap_s == 0.0:
        return a, 0.0
    other = a.source is not b.source and a.source != b.source  # nearly always the same object
    if gap_s > _GIMBAL_GAP_MAX_S or other or a.frame != b.frame:
        return None
    quaternion = interpolated(a.quaternion_wxyz, b.quaternion_wxyz, (time_s - a.time_s) / gap_s)
    return GimbalReading(time_s, quaternion, a.frame, a.source), gap_s

"""Which items lie behind an aircraft, so that it is never sent back to one. Source: docs/retries.md#1-messages."""

from __future__ import annotations

import math

import numpy as np

from sidelong.estimators.frames import LocalPlane
from sidelong.mission.core.path import Path
from sidelong.mission.core.plan import AircraftState
from sidelong.mission.exchange.layout import MissionLayout
from sidelong.mission.upload.mission_item import MissionItem

_NEAR_M = 100.0  # off its line, an aircraft passes a waypoint at such a distance
SWITCH_M = 15.0  # so far before a waypoint the next one may be flown to


def first_ahead(layout: MissionLayout, path: Path, plane: LocalPlane, flown_m: float) -> int:
    """Return the first item that is ahead on a path.

    Args:
        layout: The items on board.
        path: The path.
        plane: The local plane of the mission.
        flown_m: Distance flown along the path, m.

    Returns:
        Number of the item, at most that of the circle.
    """
    for seq in range(layout.first, layout.end - 1):
        east_m, north_m = place_of(layout.items[seq], plane)
        nearest = int(np.argmin(np.hypot(path.east_m - east_m, path.north_m - north_m)))
        if path.arc_m[nearest] > flown_m + SWITCH_M:
            return seq
    return layout.end - 1


def flown_after(
    layout: MissionLayout, seq: int | None, aircraft: AircraftState | None, plane: LocalPlane, duration_s: float
) -> int:
    """Return the item that will be flown after ``duration_s``: a waypoint may be passed until then.

    Args:
        layout: The items on board.
        seq: Number of the item flown now; None if unknown.
        aircraft: State of the aircraft; None if unknown: no waypoint is passed.
        plane: The local plane of the mission.
        duration_s: How far to look ahead, s.
    """
    index = min(max(seq if seq is not None else layout.first, layout.first), layout.end - 1)
    if aircraft is None or index == layout.end - 1:
        return index
    east_m, north_m = place_of(layout.items[index], plane)
    off_m = math.hypot(east_m - aircraft.east_m, north_m - aircraft.north_m)
    return index + (off_m < SWITCH_M + aircraft.ground_speed_m_s * duration_s)


def is_skipped(layout: MissionLayout, seq: int, aircraft: AircraftState, plane: LocalPlane, flown_m: float) -> bool:
    """Return whether ``seq`` is flown although the aircraft cannot have passed the waypoint before it.

    Args:
        layout: The line that is flown.
        seq: Item that is flown now.
        aircraft: Where the aircraft is.
        plane: Local plane.
        flown_m: How far it may have flown since it passed that waypoint.
    """
    if seq - 1 not in layout or seq not in layout:
        return False
    east_m, north_m = place_of(layout.items[seq - 1], plane)
    return math.hypot(east_m - aircraft.east_m, north_m - aircraft.north_m) > _NEAR_M + flown_m


def place_of(item: MissionItem, plane: LocalPlane) -> tuple[float, float]:
    """Return where an item lies (east, north), m."""
    return plane.east_north_m(item.x * 1e-7, item.y * 1e-7)

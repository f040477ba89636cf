"""A plan as mission items: circles are LOITER_UNLIM, transitions are waypoints.

::

    [waypoints of the transition ...] [new circle]

Setting the first of them current at the departure flies the transition; the circle at its end never completes, so it
needs no one again, and an upload behind it moves nothing.

Source: NAV_LOITER_UNLIM and NAV_WAYPOINT, <https://mavlink.io/en/messages/common.html#MAV_CMD_NAV_LOITER_UNLIM>.
"""

from __future__ import annotations

import numpy as np

from sidelong.estimators.frames import LocalPlane
from sidelong.mission.core.circle import Circle
from sidelong.mission.core.path import Path
from sidelong.mission.core.plan import HeightProfile, Plan
from sidelong.mission.upload.line_tracking import LineTracking
from sidelong.mission.upload.mission_item import MissionItem, e7
from sidelong.mission.upload.waypoints import lay_out

# MAV_CMD and MAV_FRAME of common.xml.
NAV_WAYPOINT, NAV_LOITER_UNLIM = 16, 17
FRAME_GLOBAL, FRAME_GLOBAL_RELATIVE_ALT = 0, 3

_PRECISE_M = 4.0  # deviation of a precise plan; chords of gentle curves turn the course by 10 degrees at 15 m


def circle_item(circle: Circle, plane: LocalPlane, height_m: float) -> MissionItem:
    """Return an unlimited loiter; param3 is the radius, negative counter-clockwise.

    Args:
        circle: The circle.
        plane: The local plane of the mission.
        height_m: Height above home, m.
    """
    signed_m = circle.radius_m if circle.clockwise else -circle.radius_m
    x, y = e7(plane.latitude_longitude_deg(circle.east_m, circle.north_m))
    return MissionItem(NAV_LOITER_UNLIM, FRAME_GLOBAL_RELATIVE_ALT, 0.0, 0.0, signed_m, 0.0, x, y, height_m)


def plan_items(
    plan: Plan, plane: LocalPlane, height_m: float, tolerance_m: float, tracking: LineTracking | None = None
) -> tuple[MissionItem, ...]:
    """Return the mission items of a plan: the waypoints of its transition, as few as possible, and its circle.

    param2 of a waypoint is its acceptance radius.

    Args:
        plan: The plan.
        plane: The local plane of the mission.
        height_m: Height above home of a plan without heights, m.
        tolerance_m: Greatest deviation of the flown path from the transition, m.
        tracking: How the autopilot flies along waypoints; None: ArduPlane's defaults at 15 m/s.

    Raises:
        UnflyableError: The flown path would leave the transition by more than ``tolerance_m``.
    """
    circle = circle_item(plan.circle, plane, plan.circle_height_m(height_m))
    if plan.transition is None:
        return (circle,)
    tracking, wanted_m = tracking or LineTracking(), _PRECISE_M if plan.precise else tolerance_m
    waypoints = (
        MissionItem(
            NAV_WAYPOINT,
            FRAME_GLOBAL_RELATIVE_ALT,
            0.0,
            float(round(tracking.switch_m)),
            0.0,
            0.0,
            *e7(plane.latitude_longitude_deg(east_m, north_m)),
            _height_nearby_m(plan.transition, plan.heights, east_m, north_m, height_m),
        )
        for east_m, north_m in lay_out(plan.transition, plan.circle, tracking, tolerance_m, wanted_m)
    )
    return (*waypoints, circle)


def _height_nearby_m(
    line: Path, heights: HeightProfile | None, east_m: float, north_m: float, height_m: float
) -> float:
    """Return the height where a line passes a waypoint."""
    if heights is None:
        return height_m
    nearest = int(np.argmin(np.hypot(line.east_m - east_m, line.north_m - north_m)))
    return heights.at_m(float(line.arc_m[nearest]))

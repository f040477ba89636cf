"""Plans that lead away from a circle that crosses another one. Source: docs/how-to/several-aircraft.md."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from sidelong.estimators.estimate import TargetEstimate
from sidelong.mission.core.circle import Circle
from sidelong.mission.core.path import Path
from sidelong.mission.core.plan import AircraftState, Plan
from sidelong.mission.core.requirement import Aircraft, Requirement
from sidelong.mission.geometry.approach import least_range_m, turn_straight_turn

_BEARINGS, _RINGS = 24, 3
_ABEAM = 0.5  # cosine of the angle from abeam of the target within which a circle is on a side


def escapes(
    start: AircraftState, target: TargetEstimate | None, present: Circle, airframe: Aircraft, requirement: Requirement
) -> Iterator[Plan]:
    """Yield plans to other circles, the nearest on the required side first.

    With a target the circles lie in the range band about it, and no path comes nearer to it than range_min_m.

    Args:
        start: The aircraft at the departure.
        target: The estimate of the target; None while there is none: circles about the present one are returned.
        present: The circle that is flown.
        airframe: Gives the radius and the airspeed.
        requirement: Gives band and side.
    """

    def keeps_range(path: Path) -> bool:
        return target is None or least_range_m(path, target, airframe.airspeed_m_s) >= requirement.range_min_m

    for circle in _circles(target, present, airframe, requirement):
        paths = (turn_straight_turn(start, circle, turn * airframe.radius_m) for turn in (1.0, -1.0))
        clear = [path for path in paths if path is not None and keeps_range(path)]
        if clear:
            yield Plan(circle, min(clear, key=lambda path: path.length_m), start.time_s)


def _circles(
    target: TargetEstimate | None, present: Circle, airframe: Aircraft, requirement: Requirement
) -> list[Circle]:
    radius_m = airframe.radius_m
    if target is None:
        middle_m, rings_m = (present.east_m, present.north_m), np.array([4.0, 6.0, 8.0]) * radius_m
        side_rad = 0.0
    else:
        middle_m = target.east_m, target.north_m
        limits_m = requirement.range_min_m + radius_m, requirement.range_max_m - radius_m
        rings_m = np.linspace(*limits_m, _RINGS + 2)[1:-1]  # the target moves: not at the limits themselves
        side_rad = target.course_rad + requirement.side.normal_turn_rad

    def rank(circle: Circle) -> tuple[bool, float]:
        bearing_rad = math.atan2(circle.east_m - middle_m[0], circle.north_m - middle_m[1])
        off_side = target is not None and math.cos(bearing_rad - side_rad) < _ABEAM
        return off_side, math.hypot(circle.east_m - present.east_m, circle.north_m - present.north_m)

    bearings_rad = np.arange(_BEARINGS) * 2.0 * math.pi / _BEARINGS
    circles = [
        Circle(
            middle_m[0] + ring_m * math.sin(bearing_rad),
            middle_m[1] + ring_m * math.cos(bearing_rad),
            radius_m,
            present.clockwise if target is None else requirement.side.clockwise,
        )
        for ring_m in rings_m.tolist()
        for bearing_rad in bearings_rad.tolist()
    ]
    return sorted(circles, key=rank)

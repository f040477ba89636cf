r"""A plan as mission items, and as a .plan file: circles are LOITER_UNLIM, transitions are waypoints.

::

    [waypoints of the transition ...] [new circle]

Setting the first of them current at the departure flies the transition; the circle at its end never completes, so it
needs no one again, and an upload behind it moves nothing.

As few waypoints are used as keep the flown line within a tolerance of the planned one. A vehicle that tracks straight
lines flies outside of a curve, so the waypoints lie inside of it::

        flown .--------.         The offset e at which the tracking model flies the planned
           .'  o------o  '.      curvature follows from its law. The line of these offsets is simplified as far as
          /   /        \   \     it goes; then the waypoints are shifted square to the line until the model's flight
             o waypoints o       of them keeps the tolerance, or the next finer line is tried.

Source: NAV_LOITER_UNLIM and NAV_WAYPOINT, <https://mavlink.io/en/messages/common.html#MAV_CMD_NAV_LOITER_UNLIM>;
docs/explanation/exchange.md; Douglas and Peucker, "Algorithms for the reduction of the number of points required to
represent a digitized line or its caricature", Cartographica 10(2), 1973;
<https://docs.qgroundcontrol.com/master/en/qgc-dev-guide/file_formats/plan.html>.
"""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from shapely import LineString

from sidelong.estimators.frames import LocalPlane
from sidelong.mission.core.circle import Circle
from sidelong.mission.core.path import FloatArray, Path
from sidelong.mission.core.plan import AircraftState, Plan
from sidelong.mission.geometry.line_kernel import LinePoint
from sidelong.mission.geometry.progress import path_times_s
from sidelong.mission.upload.fences import Outline
from sidelong.mission.upload.line_tracking import LineTracking, Point
from sidelong.mission.upload.line_tracking_kernel import nearest_on
from sidelong.mission.upload.mission_item import MissionItem, e7

_SIMPLIFICATIONS_M = (60.0, 40.0, 27.0, 18.0, 12.0, 8.0, 5.0, 3.0)
_HOPEFUL_M = 60.0  # where the model flies farther off, shifting the waypoints does not help
_SHIFTS = 4
_PROBE_M = 3.0
_SHIFT_MAX_M = 20.0
_STIFFNESS = 0.05  # how much a metre of shift counts against a metre of deviation, squared
_GRID_M = 10.0
_WINDOW_M = 80.0  # the nearest point of the plan is looked for so far before and after the planned one
_REACHED_SHARE = 0.8  # of the acceptance radius
_SETTLING_M = 100.0  # of the new circle: the deviation counts there too


class UnflyableError(ValueError):
    """No few waypoints make the autopilot fly the transition closely enough."""


def lay_out(
    transition: Path, circle: Circle, tracking: LineTracking, tolerance_m: float, wanted_m: float = math.inf
) -> tuple[Point, ...]:
    """Return the fewest waypoints (east, north) found that lead along a transition to a circle within a tolerance.

    wanted_m: deviation to be kept where waypoints can be found for it.

    Raises:
        UnflyableError: The flown path would leave the transition by more than ``tolerance_m``.
    """
    problem, wanted_m = _Problem(transition, circle, tracking), min(wanted_m, tolerance_m)
    best, count = np.empty((0, 2)), 0  # straight to the circle
    least_m, reference = problem.deviations_m(best)[1], problem.reference()
    for simplification_m in _SIMPLIFICATIONS_M:
        if least_m <= wanted_m:
            break
        waypoints = np.array(reference.simplify(simplification_m, preserve_topology=False).coords)
        if len(waypoints) == count:
            continue
        count = len(waypoints)
        waypoints, deviation_m = _shifted(problem, waypoints, wanted_m)
        if deviation_m < least_m:
            best, least_m = waypoints, deviation_m
    if least_m > tolerance_m:
        raise UnflyableError(
            f"the autopilot would fly {least_m:.0f} m off the transition; tolerance_m is {tolerance_m:.0f}"
        )
    return tuple((float(east_m), float(north_m)) for east_m, north_m in best)


def first_to_fly(
    transition: Path,
    circle: Circle,
    tracking: LineTracking,
    waypoints: Sequence[Point],
    aircraft: AircraftState,
    tolerance_m: float,
) -> int:
    """Return which waypoint an aircraft flies to first, so that it does not turn back to one next to it.

    It may depart next to the start of the transition, and pass the first waypoint too far off to reach it. The first
    one is taken that the model flies to within the tolerance and the distance from the start, else the one with the
    least deviation; len(waypoints): the circle. The model has to do so with a smaller acceptance radius too: the
    aircraft may pass a waypoint farther off than predicted.
    """
    start = LinePoint(aircraft.east_m, aircraft.north_m, aircraft.course_rad, aircraft.curvature_per_m)
    stricter = replace(tracking, switch_s=_REACHED_SHARE * tracking.switch_s)
    problems = [_Problem(transition, circle, model, start) for model in (tracking, stricter)]
    places = np.array(waypoints, float).reshape(-1, 2)
    apart_m = math.hypot(start.east_m - transition.east_m[0], start.north_m - transition.north_m[0])
    deviations_m = []
    for first in range(len(places) + 1):
        deviations_m.append(max(problem.deviations_m(places[first:])[1] for problem in problems))
        if deviations_m[-1] <= tolerance_m + apart_m:
            return first
    return int(np.argmin(deviations_m))


class _Problem:
    """A planned line, and the model's flight of waypoints along it from ``start``, by default the line's."""

    def __init__(
        self, transition: Path, circle: Circle, tracking: LineTracking, start: LinePoint | None = None
    ) -> None:
        rows = transition.east_m, transition.north_m, transition.course_rad, transition.curvature_per_m
        self._start = start or LinePoint(*(float(row[0]) for row in rows))
        self._circle, self._tracking, self._length_m = circle, tracking, transition.length_m
        self._line = _continued(transition, circle, _SETTLING_M + tracking.switch_m)
        self._times_s = path_times_s(self._line, tracking.airspeed_m_s, tracking.wind)
        self._grid_m = np.arange(0.0, transition.length_m + _SETTLING_M, _GRID_M)

    def reference(self) -> LineString:
        """Return the line that the model tracks where it flies the planned one, as far as waypoints lie on it."""
        line, tracking = self._line, self._tracking
        offset_m = _offsets_m(line, tracking)
        # The last waypoint is where the switch to the circle comes at the transition's end.
        first_m, last_m = tracking.first_m, self._length_m + tracking.switch_m
        between = (line.arc_m >= first_m) & (line.arc_m <= max(last_m, first_m + 2.0 * _GRID_M))
        east_m = line.east_m + offset_m * np.cos(line.course_rad)
        north_m = line.north_m - offset_m * np.sin(line.course_rad)
        return LineString(np.column_stack((east_m, north_m))[between])

    def deviations_m(self, waypoints: FloatArray) -> tuple[FloatArray, float]:
        """Return how far right of the line the model flies, on a grid along it, and the greatest of all."""
        line = self._line
        flown = self._tracking.fly(self._start, waypoints, self._circle, float(self._times_s[-1]))
        planned_m = np.interp(flown[:, 0], self._times_s, line.arc_m)
        nearest, apart_m = nearest_on(flown, planned_m, line.arc_m, line.east_m, line.north_m, _WINDOW_M)
        course_rad = line.course_rad[nearest]
        east_m, north_m = flown[:, 1] - line.east_m[nearest], flown[:, 2] - line.north_m[nearest]
        right_m = east_m * np.cos(course_rad) - north_m * np.sin(course_rad)
        return np.interp(self._grid_m, line.arc_m[nearest], right_m), float(apart_m.max())

    def normals(self, waypoints: FloatArray) -> FloatArray:
        """Return the unit vectors to the right of the line at the points of it nearest to the waypoints."""
        apart_m = np.hypot(waypoints[:, 0, None] - self._line.east_m, waypoints[:, 1, None] - self._line.north_m)
        course_rad = self._line.course_rad[np.argmin(apart_m, axis=1)]
        return np.column_stack((np.cos(course_rad), -np.sin(course_rad)))


def _shifted(problem: _Problem, waypoints: FloatArray, tolerance_m: float) -> tuple[FloatArray, float]:
    """Shift the waypoints square to the line by Gauss-Newton steps, weighted to where the deviation is greatest.

    Returns them, and how far the model flies from the planned line at most, m.
    """
    right_m, worst_m = problem.deviations_m(waypoints)
    normals = problem.normals(waypoints)
    for _ in range(_SHIFTS):
        if worst_m <= tolerance_m or worst_m > _HOPEFUL_M:
            break
        effects = np.empty((right_m.size, len(waypoints)))
        for index, normal in enumerate(normals):
            probed = waypoints.copy()
            probed[index] += _PROBE_M * normal
            effects[:, index] = (problem.deviations_m(probed)[0] - right_m) / _PROBE_M
        weights = 0.1 + np.abs(right_m) / np.max(np.abs(right_m))
        normal_matrix = (effects.T * weights) @ effects + _STIFFNESS * np.eye(len(waypoints))
        shifts_m = -np.linalg.solve(normal_matrix, effects.T @ (weights * right_m))
        shifts_m = np.clip(shifts_m, -_SHIFT_MAX_M, _SHIFT_MAX_M)
        for share in (1.0, 0.5, 0.25):
            tried = waypoints + share * shifts_m[:, None] * normals
            tried_right_m, tried_worst_m = problem.deviations_m(tried)
            if tried_worst_m < worst_m:
                break
        else:
            break
        waypoints, right_m, worst_m = tried, tried_right_m, tried_worst_m
    return waypoints, worst_m


def _offsets_m(line: Path, tracking: LineTracking) -> FloatArray:
    """Return how far right of ``line`` the tracked line must lie for the curvature to be flown.

    A leg begins ``switch_m`` before its waypoint, so at arc s the vehicle tracks the tangent at s + switch. The law
    wants an angle of asin(curvature / g) between its course and the direction it steers for; the tangent's own
    direction supplies part of it, the distance from it over l the rest. The slant of the offset line counts too,
    which makes the offset follow with a length of l - switch. The roll follows the law with a lag.
    """
    speed_m_s, ahead_m = tracking.airspeed_m_s, tracking.switch_m
    gain_per_m, look_ahead_m = tracking.gain_per_m(speed_m_s), tracking.look_ahead_m(speed_m_s)

    def at(arc_m: FloatArray, values: FloatArray) -> FloatArray:
        return np.interp(arc_m, line.arc_m, values)

    behind_m = np.maximum(line.arc_m - ahead_m, 0.0)
    lagged_per_m = at(behind_m + tracking.roll_lag_s * speed_m_s, line.curvature_per_m)
    wanted_rad = np.arcsin(np.clip(lagged_per_m / gain_per_m, -0.95, 0.95))
    tangent_rad = line.course_rad - at(behind_m, line.course_rad)
    tangent_m = (line.east_m - at(behind_m, line.east_m)) * np.cos(line.course_rad) - (
        line.north_m - at(behind_m, line.north_m)
    ) * np.sin(line.course_rad)
    steady_m = look_ahead_m * (wanted_rad - tangent_rad) - tangent_m
    following_m = max(look_ahead_m - ahead_m, 0.25 * look_ahead_m)
    offset_m = float(np.interp(ahead_m, line.arc_m, steady_m))
    offsets_m = []
    for arc_m, before_m, wanted_m in zip(line.arc_m, np.append(0.0, line.arc_m), steady_m, strict=False):
        if arc_m > ahead_m:
            offset_m += (wanted_m - offset_m) * (1.0 - math.exp(-(arc_m - before_m) / following_m))
        offsets_m.append(offset_m)
    return np.array(offsets_m)


def _continued(transition: Path, circle: Circle, length_m: float) -> Path:
    on_m = np.linspace(0.0, length_m, math.ceil(length_m / 2.0) + 1)[1:]
    course_rad = transition.course_rad[-1] + circle.curvature_per_m * on_m
    places_m = np.array([circle.position_at_course(float(course)) for course in course_rad])
    return Path(
        np.concatenate((transition.arc_m, transition.length_m + on_m)),
        np.concatenate((transition.east_m, places_m[:, 0])),
        np.concatenate((transition.north_m, places_m[:, 1])),
        np.concatenate((transition.course_rad, course_rad)),
        np.concatenate((transition.curvature_per_m, np.full(on_m.size, circle.curvature_per_m))),
    )


# MAV_CMD and MAV_FRAME of common.xml.
NAV_WAYPOINT, NAV_LOITER_UNLIM = 16, 17
FRAME_GLOBAL, FRAME_GLOBAL_RELATIVE_ALT = 0, 3

_PRECISE_M = 4.0  # deviation of a precise plan; chords of gentle curves turn the course by 10 degrees at 15 m


def circle_item(circle: Circle, plane: LocalPlane, height_m: float) -> MissionItem:
    """Return an unlimited loiter at a height above home; param3 is the radius, negative counter-clockwise."""
    signed_m = circle.radius_m if circle.clockwise else -circle.radius_m
    x, y = e7(plane.latitude_longitude_deg(circle.east_m, circle.north_m))
    return MissionItem(NAV_LOITER_UNLIM, FRAME_GLOBAL_RELATIVE_ALT, 0.0, 0.0, signed_m, 0.0, x, y, height_m)


def plan_items(
    plan: Plan, plane: LocalPlane, height_m: float, tolerance_m: float, tracking: LineTracking | None = None
) -> tuple[MissionItem, ...]:
    """Return the mission items of a plan: the waypoints of its transition, as few as possible, and its circle.

    param2 of a waypoint is its acceptance radius. height_m: above home, of a plan without heights. tracking: how the
    autopilot flies along waypoints; None: ArduPlane's defaults at 15 m/s.

    Raises:
        UnflyableError: The flown path would leave the transition by more than ``tolerance_m``.
    """
    circle = circle_item(plan.circle, plane, plan.circle_height_m(height_m))
    if plan.transition is None:
        return (circle,)
    tracking, wanted_m = tracking or LineTracking(), _PRECISE_M if plan.precise else tolerance_m
    line, items, params = plan.transition, [], (0.0, float(round(tracking.switch_m)), 0.0, 0.0)
    for east_m, north_m in lay_out(line, plan.circle, tracking, tolerance_m, wanted_m):
        if plan.heights is not None:
            nearest = int(np.argmin(np.hypot(line.east_m - east_m, line.north_m - north_m)))
            height_m = plan.heights.at_m(float(line.arc_m[nearest]))
        place = e7(plane.latitude_longitude_deg(east_m, north_m))
        items.append(MissionItem(NAV_WAYPOINT, FRAME_GLOBAL_RELATIVE_ALT, *params, *place, height_m))
    return (*items, circle)


@dataclass(frozen=True, slots=True)
class MissionLayout:
    """The vehicle's mission: ``items`` with the present line at [first, end). ``head`` items stay in front.

    An upload may be cut anywhere, and ArduPlane stores items as they arrive. So the items of the present line keep
    their places in every upload, and the new line goes where it cannot be reached from there: the present line ends
    in a circle that never completes. Wherever the upload is cut, the vehicle flies on as before::

        [head] [present line ...circle] [new line ...circle]      after it, or
        [head] [new line ...circle] [present line ...circle]      before it, if it fits into the room there

    What is left over between and behind them is never reached.

    min_items: it is kept that long, so that a new line finds places to be written to without a new list.
    """

    items: tuple[MissionItem, ...]
    head: int
    first: int
    end: int
    min_items: int = 0

    def __contains__(self, seq: int) -> bool:
        """Return whether an item belongs to the present path."""
        return self.first <= seq < self.end

    def line(self) -> tuple[MissionItem, ...]:
        """Return the items of the present line."""
        return self.items[self.first : self.end]

    def since(self, index: int) -> MissionLayout:
        """Return the same mission with the items before an index flown: their places are free for a new path."""
        return replace(self, first=index) if index in self else self

    def with_line(self, line: Sequence[MissionItem]) -> MissionLayout:
        """Return the mission with the present path in place and another path, its first item, as the next one."""
        fits = len(line) <= self.first - self.head
        first = self.head if fits else self.end
        end = first + len(line)
        kept = max(self.end, self.min_items)
        return replace(self, items=(*self.items[:first], *line, *self.items[end:kept]), first=first, end=end)

    def filled(self) -> MissionLayout:
        """Return the mission with the circle that the present line ends in repeated until it has ``min_items``."""
        missing = self.min_items - len(self.items)
        return replace(self, items=(*self.items, *(self.items[self.end - 1 : self.end] * missing)))


_ALTITUDE_MODE_RELATIVE, _ALTITUDE_MODE_ABSOLUTE = 1, 2
_FIXED_WING = 1  # MAV_TYPE


def plan_file(
    items: Sequence[MissionItem],
    plane: LocalPlane,
    home_altitude_m: float,
    airspeed_m_s: float,
    mav_autopilot: int,
    keep_in: Sequence[Outline] = (),
    keep_out: Sequence[Outline] = (),
) -> str:
    """Return the text of a QGroundControl .plan file, version 1, with home at the plane's origin.

    items have no home item: the file has a field of its own for it, and whatever loads it for ArduPilot puts home at
    0. home_altitude_m: above mean sea level. keep_in, keep_out: outlines (east, north) of fences.
    """
    document = {
        "fileType": "Plan",
        "version": 1,
        "groundStation": "sidelong",
        "mission": {
            "version": 2,
            "firmwareType": mav_autopilot,
            "vehicleType": _FIXED_WING,
            "cruiseSpeed": airspeed_m_s,
            "hoverSpeed": airspeed_m_s,
            "globalPlanAltitudeMode": _ALTITUDE_MODE_RELATIVE,
            "plannedHomePosition": [plane.origin_latitude_deg, plane.origin_longitude_deg, home_altitude_m],
            "items": [_simple_item(number, item) for number, item in enumerate(items, 1)],
        },
        "geoFence": {
            "version": 2,
            "circles": [],
            "polygons": [
                *(_polygon(outline, plane, inclusion=True) for outline in keep_in),
                *(_polygon(outline, plane, inclusion=False) for outline in keep_out),
            ],
        },
        "rallyPoints": {"version": 2, "points": []},
    }
    return json.dumps(document, indent=4, allow_nan=False) + "\n"


def _simple_item(number: int, item: MissionItem) -> dict[str, Any]:
    params = (item.param1, item.param2, item.param3, item.param4)
    return {
        "type": "SimpleItem",
        "doJumpId": number,
        "command": item.command,
        "frame": item.frame,
        "autoContinue": bool(item.autocontinue),
        "params": [*(None if math.isnan(param) else param for param in params), *item.latitude_longitude_deg, item.z],
        "Altitude": item.z,
        "AltitudeMode": _ALTITUDE_MODE_ABSOLUTE if item.frame == FRAME_GLOBAL else _ALTITUDE_MODE_RELATIVE,
        "AMSLAltAboveTerrain": None,
    }


def _polygon(outline: Outline, plane: LocalPlane, inclusion: bool) -> dict[str, Any]:
    """Return the polygon, its corners clockwise as the format has them."""
    following = (*outline[1:], outline[0])
    twice_area_m2 = sum(e0 * n1 - e1 * n0 for (e0, n0), (e1, n1) in zip(outline, following, strict=True))
    clockwise = outline[::-1] if twice_area_m2 > 0.0 else outline
    return {
        "version": 1,
        "inclusion": inclusion,
        "polygon": [list(plane.latitude_longitude_deg(*corner)) for corner in clockwise],
    }

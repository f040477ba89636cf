"""The data sent to the page, as JSON: metres in the plane, radians clockwise from north, seconds; unknown: null."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import asdict, fields

import numpy as np
from pydantic import BaseModel

from sidelong.app.analysis.score import GAP_MAX_S
from sidelong.app.config import AircraftSection, Config, RequirementSection
from sidelong.app.view.history import Json
from sidelong.estimators.frames import LocalPlane
from sidelong.estimators.terrain.ground import Ground
from sidelong.mission.control.present import Present, VehicleStatus
from sidelong.mission.core.fleet import Neighbour
from sidelong.mission.core.path import Path
from sidelong.mission.core.plan import Plan
from sidelong.mission.core.requirement import Requirement
from sidelong.mission.geometry.line_kernel import line_at
from sidelong.mission.geometry.progress import line_of, nearest_arc_m
from sidelong.mission.route.route import Route, RouteProgress
from sidelong.mission.viewpoint.watch_course import side_words


def _limits(section: type[BaseModel], name: str) -> list[float]:
    limits = section.model_fields[name].metadata
    return [next(getattr(limit, key) for limit in limits if hasattr(limit, key)) for key in ("ge", "le")]


_LIMITS = {name: _limits(AircraftSection, name) for name in ("radius_m", "height_m")} | {
    name: _limits(RequirementSection, name) for name in ("range_min_m", "range_max_m")
}

_UNSENT = ("alarms", "silent_s")
_LINE_POINTS, _ROUTE_POINTS = 60, 500
_AHEAD_S = np.linspace(0.0, 60.0, 13)  # how far the page draws the expected path of the target
_AHEAD_POINTS = 41  # of the ground ahead
_ON_TRANSITION = 1.2  # a transition is shown for this share of the time it takes


def setting(
    config: Config,
    plane: LocalPlane | None,
    name: str,
    requirement: Requirement | None = None,
    routes: Iterable[Route] = (),
) -> Json:
    """Return what changes on request only; fences are included once the plane is known."""
    requirement = requirement or config.requirement.requirement()

    def outlines(polygons: list[list[tuple[float, float]]]) -> list[list[list[float]]]:
        if plane is None:
            return []
        return [[_rounded(*plane.east_north_m(*corner)) for corner in polygon] for polygon in polygons]

    sector = requirement.sector
    return {
        "band_m": [requirement.range_min_m, requirement.range_max_m],
        "sector_rad": None if sector is None else [sector.from_rad, sector.to_rad],
        "either_side": requirement.either_side,
        "limits": _LIMITS,
        "bank_max_rad": math.radians(config.aircraft.bank_max_deg),
        "keep_in": outlines(config.fences.keep_in),
        "keep_out": outlines(config.fences.keep_out),
        "rally": outlines([config.fences.rally])[0] if plane is not None else [],
        "name": name,
        "display": config.display.model_dump(),
        "routes": [[_rounded(*point) for point in route.outline_m(_ROUTE_POINTS).tolist()] for route in routes],
        "origin": None if plane is None else _origin(plane),
    }


def _origin(plane: LocalPlane) -> Json:
    """Return what turns a point of the map into degrees, to a metre within some kilometres: for the cursor only."""
    latitude_deg, longitude_deg = plane.origin_latitude_deg, plane.origin_longitude_deg
    east_m, _ = plane.east_north_m(latitude_deg, longitude_deg + 0.01)
    _, north_m = plane.east_north_m(latitude_deg + 0.01, longitude_deg)
    return {
        "latitude_deg": latitude_deg,
        "longitude_deg": longitude_deg,
        "east_m_per_deg": round(east_m * 100.0, 2),
        "north_m_per_deg": round(north_m * 100.0, 2),
    }


def _inputs(snapshot: Present) -> list[str]:
    """Return the inputs that are not ok and have no alarm, which states its own age."""
    alarms = snapshot.vehicle.alarms if snapshot.vehicle else ()
    keys = {alarm.key for alarm in alarms}
    return [] if "target" in keys else [one for one in snapshot.impaired_inputs if one.split()[0] not in keys]


def _vehicle(vehicle: VehicleStatus) -> Json:
    status = {field.name: getattr(vehicle, field.name) for field in fields(vehicle) if field.name not in _UNSENT}
    return status | {name: _number(status[name], 0) for name in ("endurance_s", "home_s")}


def _other(other: Neighbour, time_s: float) -> Json:
    """Return a foreign aircraft where it is by now, as the map draws aircraft."""
    state = other.state
    gone_m = state.ground_speed_m_s * (time_s - state.time_s)
    at_m = state.east_m + gone_m * math.sin(state.course_rad), state.north_m + gone_m * math.cos(state.course_rad)
    flown = {"course_rad": round(state.course_rad, 4), "height_m": _number(other.height_m, 0)}
    return {"name": other.name, "aircraft": {"at_m": _rounded(*at_m), **flown}}


class WatchShares:
    """The shares of the time so far in band and on side: from the first moment in the band, as a flight is judged.

    They start again when sidelong gets control of the aircraft; None before.
    """

    def __init__(self) -> None:
        self._begin(in_control=False)

    def _begin(self, *, in_control: bool) -> None:
        self.in_band: float | None = None
        self.on_side: float | None = None
        self._total_s = self._in_band_s = self._side_known_s = self._on_side_s = 0.0
        self._last: Present | None = None
        self._controlled = in_control

    def note(self, now: Present) -> None:
        """Process a state; it counts until the next one, as unknown for what is beyond ``GAP_MAX_S``."""
        if now.phase.in_control and not self._controlled:
            self._begin(in_control=True)
        if self._last is None and not now.in_band:
            return
        before, self._last = self._last or now, now
        step_s = max(now.time_s - before.time_s, 0.0)
        sure_s = min(step_s, GAP_MAX_S)
        self._total_s += step_s
        self._in_band_s += sure_s * bool(before.in_band)
        if before.is_side_known:
            self._side_known_s += step_s
            self._on_side_s += sure_s * bool(before.on_side)
        self.in_band = self._in_band_s / self._total_s if self._total_s > 0.0 else None
        self.on_side = self._on_side_s / self._side_known_s if self._side_known_s > 0.0 else None


class StateEncoder:
    """Turns snapshots into states; remembers the shares of time, and lines already thinned."""

    def __init__(self, airspeed_m_s: float, height_m: float) -> None:
        self._airspeed_m_s, self._height_m = airspeed_m_s, height_m
        self.plane: LocalPlane | None = None  # set once it is known: positions are then sent in degrees too
        self.ground: Ground | None = None  # the same: the ground ahead is then sent
        self._shares = WatchShares()
        self._thinned: dict[int, tuple[Path, list[list[float]]]] = {}

    def state(self, snapshot: Present, silent_s: float, name: str = "") -> Json:
        """Return the state; silent_s: time since the last message of the vehicle; name: '' for a single aircraft."""
        time_s, vehicle = snapshot.time_s, snapshot.vehicle
        self._shares.note(snapshot)
        return {
            "name": name,
            "time_s": _number(time_s, 2),
            "phase": snapshot.phase,
            "mode": snapshot.mode,
            "side": snapshot.side,
            "aircraft": self._aircraft(snapshot),
            "target": self._target(snapshot),
            "present": self._plan(snapshot.plan, time_s, flown=True),
            "proposed": self._plan(snapshot.decision.plan if snapshot.decision else None, time_s, flown=False),
            "coming": self._plan(snapshot.coming, time_s, flown=False),
            "reason": snapshot.decision.reason if snapshot.decision is not None else "",
            "wind_m_s": _rounded(snapshot.wind.east_m_s, snapshot.wind.north_m_s),
            "nis": _number(snapshot.nis, 2),
            "range_age_s": _number(time_s - snapshot.range_s, 2),
            "gimbal_age_s": _number(time_s - snapshot.gimbal_s, 2),
            "link_age_s": round(silent_s, 2),
            "connected": snapshot.connected,
            "sightings": snapshot.sightings,
            "rejected": snapshot.rejected,
            "moves": snapshot.moves,
            "uploads": snapshot.uploads,
            "upload_failures": snapshot.upload_failures,
            "latency_s": _number(snapshot.latency_s, 2),
            "asked": self._asked(snapshot),
            "ahead": self._ahead(snapshot),
            "waypoints": [_rounded(*one) for one in snapshot.waypoints_m],
            "vehicle": None if vehicle is None else _vehicle(vehicle),
            "alarms": [{"aircraft": name, **asdict(alarm)} for alarm in (vehicle.alarms if vehicle else ())],
            "over": snapshot.over,
            "unknown": snapshot.unknown,
            "inputs": _inputs(snapshot),
            "route": None if snapshot.route is None else _route(snapshot.route),
            "traffic": [_other(one, time_s) for one in snapshot.traffic],
            "share_in_band": _number(self._shares.in_band, 3),
            "share_on_side": _number(self._shares.on_side, 3),
        }

    def _asked(self, snapshot: Present) -> Json:
        requirement = snapshot.requirement
        return {
            "radius_m": snapshot.airframe.radius_m,
            "height_m": self._height_m if snapshot.height_asked_m is None else snapshot.height_asked_m,
            "range_min_m": requirement.range_min_m,
            "range_max_m": requirement.range_max_m,
            "side": side_words(requirement),
        }

    def _ahead(self, snapshot: Present) -> Json | None:
        """Return the ground and the planned heights from the aircraft to the end of the next lap, m above home."""
        here, plan = snapshot.aircraft, snapshot.coming or snapshot.plan
        if self.ground is None or here is None or plan is None:
            return None
        at_m = nearest_arc_m(plan, here)
        length_m = max(plan.transition_m - at_m, 0.0) + math.tau * plan.circle.radius_m
        arcs_m, found = at_m + np.linspace(0.0, length_m, _AHEAD_POINTS), np.empty((3, _AHEAD_POINTS))
        line_at(*line_of(plan), arcs_m, here.east_m, here.north_m, found)
        ground_m = self.ground.heights_at_m(found[0], found[1])
        one_height_m = self._height_m if snapshot.height_asked_m is None else snapshot.height_asked_m
        heights_m = [one_height_m if plan.heights is None else plan.heights.at_m(arc_m) for arc_m in arcs_m.tolist()]
        return {
            "length_m": round(length_m),
            "ground_m": [_number(one, 0) for one in ground_m.tolist()],
            "height_m": [_number(one, 0) for one in heights_m],
        }

    def _aircraft(self, snapshot: Present) -> Json | None:
        aircraft, attitude = snapshot.aircraft, snapshot.attitude
        if aircraft is None:
            return None
        return {
            "at_m": _rounded(aircraft.east_m, aircraft.north_m),
            "at_deg": self._degrees(aircraft.east_m, aircraft.north_m),
            "course_rad": round(aircraft.course_rad, 4),
            "ground_speed_m_s": round(aircraft.ground_speed_m_s, 2),
            "bank_rad": None if attitude is None else round(attitude.roll_rad, 4),
            "pitch_rad": None if attitude is None else round(attitude.pitch_rad, 4),
            "height_m": _number(snapshot.height_m, 1),
        }

    def _target(self, snapshot: Present) -> Json | None:
        estimate, aircraft = snapshot.estimate, snapshot.aircraft
        if estimate is None or aircraft is None:
            return None
        at_m = estimate.position_m(snapshot.time_s)
        ellipse = estimate.ellipse_95
        return {
            "at_m": _rounded(*at_m),
            "at_deg": self._degrees(*at_m),
            "velocity_m_s": _rounded(estimate.velocity_east_m_s, estimate.velocity_north_m_s),
            "course_rad": _number(snapshot.present_course_rad, 4),
            "watch_course_rad": _number(snapshot.watch_course_rad, 4),
            "ellipse": [
                round(ellipse.semi_major_m, 2),
                round(ellipse.semi_minor_m, 2),
                round(ellipse.orientation_rad, 4),
            ],
            "quality": estimate.quality,
            "why": estimate.reason,
            "unseen_s": _number(snapshot.time_s - estimate.last_sighting_s, 1),
            "stands": snapshot.stands,
            "range_m": _number(snapshot.range_m, 1),
            "angle_rad": _number(snapshot.angle_rad, 4),
            "in_band": snapshot.in_band,
            "on_side": snapshot.on_side,
        }

    def _degrees(self, east_m: float, north_m: float) -> list[float] | None:
        """Return [latitude, longitude], to a decimetre."""
        if self.plane is None:
            return None
        return [round(degrees, 6) for degrees in self.plane.latitude_longitude_deg(east_m, north_m)]

    def _plan(self, plan: Plan | None, time_s: float, *, flown: bool) -> Json | None:
        if plan is None:
            return None
        circle = plan.circle
        line: list[list[float]] = []
        if plan.transition is not None:
            done_s = plan.departure_s + _ON_TRANSITION * plan.transition.length_m / self._airspeed_m_s
            line = self._line(plan.transition) if not flown or time_s < done_s else []
        return {
            "circle": [*_rounded(circle.east_m, circle.north_m), round(circle.radius_m, 1)],
            "clockwise": circle.clockwise,
            "line": line,
            "in_s": None if flown else _number(plan.departure_s - time_s, 1),
        }

    def _line(self, path: Path) -> list[list[float]]:
        kept = self._thinned.get(id(path))
        if kept is not None:
            return kept[1]
        every = max(1, len(path.arc_m) // _LINE_POINTS)
        line = [
            _rounded(e, n) for e, n in zip(path.east_m[::every].tolist(), path.north_m[::every].tolist(), strict=True)
        ]
        line.append(_rounded(float(path.east_m[-1]), float(path.north_m[-1])))
        while len(self._thinned) > 3:
            del self._thinned[next(iter(self._thinned))]
        self._thinned[id(path)] = (path, line)  # keeps the path, so that its id stays its own
        return line


def _route(progress: RouteProgress) -> Json:
    ahead = progress.places_m(_AHEAD_S).tolist() if progress.on_route else []
    return {
        "on": progress.on_route,
        "of_use": progress.of_use,
        "along_m": _number(progress.along_m, 0),
        "length_m": _number(progress.route.length_m, 0),
        "to_end_s": _number(progress.to_end_s, 0),
        "ahead": [_rounded(*point) for point in ahead],
    }


def _number(value: float | None, digits: int) -> float | None:
    return round(value, digits) if value is not None and math.isfinite(value) else None


def _rounded(east_m: float, north_m: float) -> list[float]:
    return [round(east_m, 1), round(north_m, 1)]

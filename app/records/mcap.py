"""A flight as an MCAP file, for Foxglove and PlotJuggler: poses, sightings, estimates, circles, plans.

Messages are JSON: places by Foxglove's own schemas, for its map and 3D panels, and the numbers in topics of their
own, for plots. Frame ``plane``: x east, y north, z up from home; ``aircraft``: forward, left, up. ``LAYOUT`` shows it
all.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable
from dataclasses import asdict
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

from sidelong.app.errors import missing_package
from sidelong.app.records.export import ROUTE_POINTS, ring
from sidelong.app.records.sensing import Sensing
from sidelong.estimators.estimate import TargetEstimate
from sidelong.estimators.frames import LocalPlane, wrap_rad
from sidelong.estimators.rotations import from_roll_pitch_yaw
from sidelong.estimators.sensing.readings import PositionReading
from sidelong.estimators.sensing.sighting import Sighting, SightingOutcome
from sidelong.estimators.tracking.tracker import Tracker
from sidelong.mission.core.circle import Circle
from sidelong.mission.core.events import (
    Announce,
    ControlAcquired,
    Event,
    HealthChanged,
    PlanStatus,
    RouteGiven,
    StepOutput,
    UploadPlan,
)
from sidelong.mission.core.plan import Plan
from sidelong.mission.route.route import RouteFollower, follower_of

_UNSTAMPED = frozenset({"foxglove.GeoJSON", "foxglove.SceneUpdate"})


def mcap_writer_class() -> Any:
    """Return the writer of the package mcap, an optional extra. Raises InputError when it is not installed."""
    try:
        from mcap.writer import Writer  # noqa: PLC0415
    except ImportError as error:
        raise missing_package("MCAP", "mcap") from error
    return Writer


class McapWriter:
    """Replaces ``path``. Raises InputError without the package mcap, OSError for a file that cannot be written."""

    def __init__(self, path: Path) -> None:
        writer = mcap_writer_class()
        self._file = path.open("wb")
        self._writer = writer(self._file)
        self._writer.start()
        self._channels: dict[str, int] = {}

    def write(self, topic: str, schema: str, time_ns: int, values: dict[str, Any]) -> None:
        """Add a message, with its time in it (ns since 1970) where the schema has one."""
        message = _without_nan(values if schema in _UNSTAMPED else {"timestamp": stamp(time_ns), **values})
        if topic not in self._channels:
            described = json.dumps(_schema(message)).encode()
            schema_id = self._writer.register_schema(schema, "jsonschema", described)
            self._channels[topic] = self._writer.register_channel(topic, "json", schema_id)
        data = json.dumps(message, separators=(",", ":")).encode()
        self._writer.add_message(self._channels[topic], time_ns, data, time_ns)

    def close(self) -> None:
        self._writer.finish()
        self._file.close()


def stamp(time_ns: int) -> dict[str, int]:
    """Return a time, ns, as Foxglove's seconds and nanoseconds."""
    return dict(zip(("sec", "nsec"), divmod(time_ns, 10**9), strict=True))


def _schema(value: Any) -> dict[str, Any]:
    if isinstance(value, dict):
        return {"type": "object", "properties": {name: _schema(item) for name, item in value.items()}}
    if isinstance(value, list):
        return {"type": "array", "items": _schema(value[0]) if value else {}}
    kinds = ((bool, "boolean"), (str, "string"), (int, "integer"))
    return {"type": next((name for kind, name in kinds if isinstance(value, kind)), "number")}


def _without_nan(value: Any) -> Any:
    if isinstance(value, dict):
        return {name: _without_nan(item) for name, item in value.items()}
    return None if isinstance(value, float) and math.isnan(value) else value


LAYOUT = Path(__file__).parent / "foxglove_layout.json"

# Of foxglove.LocationFix. The covariance of a target is that of the filter over the ground; up it is a guess.
_COVARIANCE_UNKNOWN, _COVARIANCE_APPROXIMATED = 0, 1
_LEVEL_INFO = 2  # of foxglove.Log
_HEIGHT_SIGMA_M = 10.0
_HEIGHT_WEIGHT = 0.05  # of a new sighting in the target's height
_ELLIPSE_CORNERS = 36
_EPOCH = datetime.fromtimestamp(0, UTC)
Place = tuple[float, float, float]
"""East, north and height above home, m."""

_LINE_STRIP = 0
_FOREVER = {"sec": 0, "nsec": 0}
_SHAPES = ("arrows", "cubes", "spheres", "cylinders", "lines", "triangles", "texts", "models")
_NO_ROTATION = {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}
_COLOURS = {
    "target": (0.85, 0.15, 0.10, 1.0),
    "ellipse": (0.85, 0.15, 0.10, 1.0),
    "sight": (0.95, 0.75, 0.10, 0.8),
    "circle": (0.10, 0.55, 0.90, 1.0),
    "route": (0.95, 0.80, 0.20, 0.6),
    "plan": (0.55, 0.35, 0.85, 1.0),
}
_BALL_M = 4.0


class McapLog:
    """Takes a flight's events and commands in order and writes them to ``out``, with the estimates of ``tracker``.

    booted: when the vehicle's clock was zero; None: times count from 1970. home_altitude_m: above the sea; None:
    altitudes are those above home. name: of the aircraft, in its topics and frame, where several are in one file.
    """

    def __init__(
        self,
        out: McapWriter,
        plane: LocalPlane,
        tracker: Tracker,
        booted: datetime | None = None,
        home_altitude_m: float | None = None,
        name: str = "",
    ) -> None:
        self._out, self._frame = out, name or "aircraft"
        self._prefix = f"/{name}" if name else ""
        self._boot_ns = ((booted or _EPOCH) - _EPOCH) // timedelta(microseconds=1) * 1000
        self._plane, self._sensing = plane, Sensing(tracker)
        self._home_altitude_m = home_altitude_m or 0.0
        self._aircraft: Place = (0.0, 0.0, 0.0)
        self._target_height_m = 0.0
        self._plans: dict[int, Plan] = {}
        self._follower: RouteFollower | None = None

    def event(self, event: Event) -> None:
        """Feed an event; positions, estimates, circles and sightings are written."""
        admitted, outcomes = self._sensing.take(event)
        self._sightings(outcomes)
        match admitted:
            case PositionReading():
                self._position(admitted)
                estimate = self._sensing.tracker.estimate(admitted.time_s)
                if estimate is not None:
                    self._target(estimate)
            case RouteGiven():
                self._follower = follower_of(admitted)
                if self._follower is not None:
                    outline = self._follower.route.outline_m(ROUTE_POINTS).tolist()
                    self._line("route", admitted.time_s, outline, height_m=0.0)
            case ControlAcquired():
                self._circle(admitted.time_s, admitted.circle)
            case PlanStatus(stage="departed") if admitted.number in self._plans:
                self._circle(admitted.time_s, self._plans[admitted.number].circle)

    def command(self, command: StepOutput) -> None:
        """Feed an output of the step just fed; plans, announcements and health are written."""
        match command:
            case UploadPlan():
                self._plans[command.number] = command.plan
                self._plan(command)
            case Announce():
                logged = {"level": _LEVEL_INFO, "message": command.text, "name": command.kind, "file": "", "line": 0}
                self._write("/announcements", "foxglove.Log", command.time_s, logged)
            case HealthChanged():
                health = _fields(command, "input", "state", "text")
                health["previous_state_lasted_s"] = command.lasted_s
                self._write("/health", "sidelong.Health", command.time_s, health)

    def _position(self, p: PositionReading) -> None:
        attitude = self._sensing.attitude
        angles = (attitude.roll_rad, attitude.pitch_rad, attitude.yaw_rad) if attitude else (0.0, 0.0, 0.0)
        self._aircraft = (p.east_m, p.north_m, p.height_m)
        place, rotation = {"x": p.east_m, "y": p.north_m, "z": p.height_m}, _plane_from_body(*angles)
        frames = {"parent_frame_id": "plane", "child_frame_id": self._frame}
        self._write("/tf", "foxglove.FrameTransform", p.time_s, frames | {"translation": place, "rotation": rotation})
        pose = {"position": place, "orientation": rotation}
        self._write("/aircraft", "foxglove.PoseInFrame", p.time_s, {"frame_id": "plane", "pose": pose})
        self._fix("/aircraft/fix", p.time_s, self._aircraft, None)
        numbers = _fields(p, "height_m", "velocity_east_m_s", "velocity_north_m_s", "velocity_up_m_s")
        numbers |= zip(("roll_deg", "pitch_deg", "yaw_deg"), map(math.degrees, angles), strict=True)
        self._write("/aircraft/numbers", "sidelong.Aircraft", p.time_s, numbers)

    def _sightings(self, outcomes: Iterable[SightingOutcome]) -> None:
        for outcome in outcomes:
            seen = outcome.sighting
            numbers = _fields(seen, "east_m", "north_m") | _fields(outcome, "accepted", "nis", "reason")
            if isinstance(seen, Sighting):
                numbers["slant_range_m"] = seen.slant_range_m
                numbers["bearing_deg"] = math.degrees(seen.bearing_rad)
                numbers["depression_deg"] = math.degrees(seen.depression_rad)
                place = seen.east_m, seen.north_m, seen.height_m
                self._scene(seen.time_s, line("sight", [self._aircraft, place]))
                if outcome.accepted:
                    self._target_height_m += _HEIGHT_WEIGHT * (seen.height_m - self._target_height_m)
            self._write("/sighting", "sidelong.Sighting", seen.time_s, numbers)

    def _target(self, estimate: TargetEstimate) -> None:
        self._progress(estimate)
        covariance = estimate.covariance.tolist()
        numbers = _fields(estimate, "east_m", "north_m", "velocity_east_m_s", "velocity_north_m_s")
        numbers |= {"covariance": estimate.covariance.ravel().tolist(), "quality": estimate.quality.value}
        self._write("/target", "sidelong.Target", estimate.time_s, numbers)
        place = estimate.east_m, estimate.north_m, self._target_height_m
        (ee, en, *_), (ne, nn, *_) = covariance[:2]
        self._fix("/target/fix", estimate.time_s, place, [ee, en, 0.0, ne, nn, 0.0, 0.0, 0.0, _HEIGHT_SIGMA_M**2])
        ellipse = estimate.ellipse_95
        outline = ellipse.outline(_ELLIPSE_CORNERS)
        edge = [(place[0] + east_m, place[1] + north_m, place[2]) for east_m, north_m in outline]
        self._scene(estimate.time_s, ball("target", place), line("ellipse", edge))
        east_m, north_m = self._aircraft[0] - place[0], self._aircraft[1] - place[1]
        watch = {
            "range_m": math.hypot(east_m, north_m),
            "sigma_m": ellipse.semi_major_m,
            "target_speed_m_s": estimate.speed_m_s,
            "bearing_from_course_deg": math.degrees(wrap_rad(math.atan2(east_m, north_m) - estimate.course_rad)),
        }
        self._write("/watch", "sidelong.Watch", estimate.time_s, watch)

    def _progress(self, estimate: TargetEstimate) -> None:
        progress = None if self._follower is None else self._follower.update(estimate)
        if progress is not None:
            numbers = _fields(progress, "on_route", "of_use", "probability", "along_m", "speed_m_s", "to_end_s")
            numbers["length_m"] = progress.route.length_m
            self._write("/route", "sidelong.Route", estimate.time_s, numbers)

    def _fix(self, topic: str, time_s: float, place: Place, covariance: list[float] | None) -> None:
        latitude_deg, longitude_deg = self._plane.latitude_longitude_deg(*place[:2])
        fix = {
            "frame_id": "plane",
            "latitude": latitude_deg,
            "longitude": longitude_deg,
            "altitude": self._home_altitude_m + place[2],
            "position_covariance": covariance or [0.0] * 9,
            "position_covariance_type": _COVARIANCE_APPROXIMATED if covariance else _COVARIANCE_UNKNOWN,
        }
        self._write(topic, "foxglove.LocationFix", time_s, fix)

    def _circle(self, time_s: float, circle: Circle) -> None:
        self._write("/circle", "sidelong.Circle", time_s, asdict(circle))
        self._line("circle", time_s, ring(circle))

    def _plan(self, prepared: UploadPlan) -> None:
        plan = prepared.plan
        numbers = _fields(prepared, "number", "reason") | {"departure_s": plan.departure_s}
        numbers |= {"length_m": plan.transition_m, "circle": asdict(plan.circle)}
        self._write("/plan", "sidelong.Plan", prepared.time_s, numbers)
        way = list(zip(plan.transition.east_m, plan.transition.north_m, strict=True)) if plan.transition else []
        self._line("plan", prepared.time_s, [*way, *ring(plan.circle)])

    def _line(
        self, name: str, time_s: float, corners: list[tuple[float, float]], height_m: float | None = None
    ) -> None:
        """Draw a line on the map, and in the scene at a height; by default at the aircraft's present one."""
        places = [self._plane.latitude_longitude_deg(*map(float, corner))[::-1] for corner in corners]
        feature = {"type": "Feature", "properties": {}, "geometry": {"type": "LineString", "coordinates": places}}
        geojson = {"geojson": json.dumps({"type": "FeatureCollection", "features": [feature]})}
        self._write(f"/{name}/map", "foxglove.GeoJSON", time_s, geojson)
        up_m = self._aircraft[2] if height_m is None else height_m
        self._scene(time_s, line(name, ((*corner, up_m) for corner in corners)))

    def _scene(self, time_s: float, *entities: dict[str, object]) -> None:
        stamped = [{"timestamp": stamp(self._nanoseconds(time_s)), **entity} for entity in entities]
        self._write("/scene", "foxglove.SceneUpdate", time_s, {"deletions": [], "entities": stamped})

    def _write(self, topic: str, schema: str, time_s: float, values: dict[str, Any]) -> None:
        self._out.write(self._prefix + topic, schema, self._nanoseconds(time_s), values)

    def _nanoseconds(self, time_s: float) -> int:
        return self._boot_ns + round(time_s * 1e9)


def _fields(source: object, *names: str) -> dict[str, Any]:
    return {name: getattr(source, name) for name in names}


def _plane_from_body(roll_rad: float, pitch_rad: float, yaw_rad: float) -> dict[str, float]:
    """Return the attitude of forward-left-up in east-north-up: up and left turn the signs of yaw and pitch."""
    return dict(zip("wxyz", from_roll_pitch_yaw(roll_rad, -pitch_rad, math.pi / 2 - yaw_rad), strict=True))


def line(name: str, places: Iterable[Place]) -> dict[str, Any]:
    """Return the entity ``name`` as a line through the places, in the frame ``plane``."""
    drawn = {"type": _LINE_STRIP, "thickness": 1.0 if name == "sight" else 3.0, "scale_invariant": True}
    placed = {"pose": _pose((0.0, 0.0, 0.0)), "points": [_xyz(place) for place in places]}
    return _entity(name, lines=[drawn | placed | {"color": _colour(name), "colors": [], "indices": []}])


def ball(name: str, place: Place) -> dict[str, Any]:
    """Return the entity ``name`` as a sphere at a place, in the frame ``plane``."""
    sphere = {"pose": _pose(place), "size": _xyz((_BALL_M, _BALL_M, _BALL_M)), "color": _colour(name)}
    return _entity(name, spheres=[sphere])


def _entity(name: str, **shapes: list[dict[str, Any]]) -> dict[str, Any]:
    about = {"frame_id": "plane", "id": name, "lifetime": _FOREVER, "frame_locked": True, "metadata": []}
    return about | {shape: shapes.get(shape, []) for shape in _SHAPES}


def _pose(place: Place) -> dict[str, Any]:
    return {"position": _xyz(place), "orientation": _NO_ROTATION}


def _xyz(place: Place) -> dict[str, float]:
    return dict(zip("xyz", map(float, place), strict=True))


def _colour(name: str) -> dict[str, float]:
    return dict(zip("rgba", _COLOURS[name], strict=True))

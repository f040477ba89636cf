"""A flight as an MCAP file, for Foxglove and PlotJuggler: poses, sightings, estimates, circles, plans.

Messages are JSON. Places go by Foxglove's own schemas, which its map and 3D panels show as they come; the numbers
behind them have topics of their own, for plots. The frame ``plane`` is x east, y north, z up from home.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterable
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

from app.errors import InputError
from app.records.appender import Appender
from app.records.track import ring
from estimators.estimate import TargetEstimate
from estimators.frames import LocalPlane
from estimators.readings import AttitudeReading, GimbalReading, PositionReading, RangeReading, TargetFixReading
from estimators.rotations import from_roll_pitch_yaw
from estimators.sighting import Sighting, SightingOutcome
from estimators.tracker import Tracker
from mission.control.plausibility import Plausibility
from mission.core.circle import Circle
from mission.core.events import Announce, Command, ControlAcquired, Event, PlanStatus, UploadPlan
from mission.core.plan import Plan

_CHUNK_BYTES = 32 << 10
_COVARIANCE_KNOWN = 3  # of foxglove.LocationFix
_LEVEL_INFO = 2  # of foxglove.Log
_EPOCH = datetime.fromtimestamp(0, UTC)


class McapLog:
    """Takes a run's events and commands in order, live or from its journal, and writes them to ``path``.

    The estimates are those of ``tracker``, which is fed with the readings. booted is when the vehicle's clock was
    zero; without it times count from 1970. on_trouble and OSError: as :class:`Appender`. Raises InputError when the
    package mcap is not installed.
    """

    def __init__(
        self,
        path: Path,
        plane: LocalPlane,
        tracker: Tracker,
        on_trouble: Callable[[str], None],
        booted: datetime | None = None,
    ) -> None:
        self._out = _Messages(path, on_trouble, booted or _EPOCH)
        self._plane, self._tracker = plane, tracker
        self._door = Plausibility()
        self._attitude: AttitudeReading | None = None
        self._plans: dict[int, Plan] = {}

    def event(self, event: Event) -> None:
        """Take an event."""
        admitted, _ = self._door.admit(event)
        match admitted:
            case AttitudeReading() | RangeReading() | GimbalReading() | TargetFixReading():
                self._attitude = admitted if isinstance(admitted, AttitudeReading) else self._attitude
                self._sightings(self._tracker.add(admitted))
            case PositionReading():
                if self._door.place_is_known:
                    self._sightings(self._tracker.add(admitted))
                self._aircraft(admitted)
                estimate = self._tracker.estimate(admitted.time_s)
                if estimate is not None:
                    self._target(estimate)
            case ControlAcquired():
                self._circle(admitted.time_s, admitted.circle)
            case PlanStatus(stage="departed") if admitted.number in self._plans:
                self._circle(admitted.time_s, self._plans[admitted.number].circle)

    def command(self, command: Command) -> None:
        """Take a command."""
        match command:
            case UploadPlan():
                self._plans[command.number] = command.plan
                self._plan(command)
            case Announce():
                said = {"level": _LEVEL_INFO, "name": command.kind, "message": command.text}
                self._out.write("/said", "foxglove.Log", command.time_s, said)

    def close(self) -> None:
        """Write the index and what is left."""
        self._out.close()

    def _aircraft(self, p: PositionReading) -> None:
        attitude = self._attitude
        angles = (attitude.roll_rad, attitude.pitch_rad, attitude.yaw_rad) if attitude else (0.0, 0.0, 0.0)
        pose = {
            "position": {"x": p.east_m, "y": p.north_m, "z": p.height_m},
            "orientation": _plane_from_body(*angles),
        }
        self._out.write("/aircraft", "foxglove.PoseInFrame", p.time_s, {"frame_id": "plane", "pose": pose})
        self._fix("/aircraft/fix", p.time_s, p.east_m, p.north_m, p.height_m, [0.0] * 9)
        numbers = {
            "height_m": p.height_m,
            "velocity_east_m_s": p.velocity_east_m_s,
            "velocity_north_m_s": p.velocity_north_m_s,
            "velocity_up_m_s": p.velocity_up_m_s,
            **dict(zip(("roll_deg", "pitch_deg", "yaw_deg"), map(math.degrees, angles), strict=True)),
        }
        self._out.write("/aircraft/numbers", "sidelong.Aircraft", p.time_s, numbers)

    def _sightings(self, outcomes: Iterable[SightingOutcome]) -> None:
        for outcome in outcomes:
            seen = outcome.sighting
            numbers = {
                "east_m": seen.east_m,
                "north_m": seen.north_m,
                "accepted": outcome.accepted,
                "nis": outcome.nis,
                "reason": outcome.reason,
            }
            if isinstance(seen, Sighting):
                numbers["slant_range_m"] = seen.slant_range_m
                numbers["bearing_deg"] = math.degrees(seen.bearing_rad)
                numbers["depression_deg"] = math.degrees(seen.depression_rad)
            self._out.write("/sighting", "sidelong.Sighting", seen.time_s, numbers)

    def _target(self, estimate: TargetEstimate) -> None:
        covariance = estimate.covariance.tolist()
        numbers = {
            "east_m": estimate.east_m,
            "north_m": estimate.north_m,
            "velocity_east_m_s": estimate.velocity_east_m_s,
            "velocity_north_m_s": estimate.velocity_north_m_s,
            "covariance": [value for row in covariance for value in row],
            "quality": estimate.quality.value,
        }
        self._out.write("/target", "sidelong.Target", estimate.time_s, numbers)
        (ee, en, *_), (ne, nn, *_) = covariance[:2]
        east_north_up = [ee, en, 0.0, ne, nn, 0.0, 0.0, 0.0, 0.0]
        self._fix("/target/fix", estimate.time_s, estimate.east_m, estimate.north_m, 0.0, east_north_up)

    def _fix(
        self, topic: str, time_s: float, east_m: float, north_m: float, height_m: float, covariance: list[float]
    ) -> None:
        latitude_deg, longitude_deg = self._plane.latitude_longitude_deg(east_m, north_m)
        fix = {
            "frame_id": "plane",
            "latitude": latitude_deg,
            "longitude": longitude_deg,
            "altitude": height_m,
            "position_covariance": covariance,
            "position_covariance_type": _COVARIANCE_KNOWN,
        }
        self._out.write(topic, "foxglove.LocationFix", time_s, fix)

    def _circle(self, time_s: float, circle: Circle) -> None:
        self._out.write("/circle", "sidelong.Circle", time_s, _circle_numbers(circle))
        self._line("/circle/map", time_s, ring(circle))

    def _plan(self, prepared: UploadPlan) -> None:
        plan = prepared.plan
        numbers = {
            "number": prepared.number,
            "departure_s": plan.departure_s,
            "reason": prepared.reason,
            "length_m": plan.transition.length_m if plan.transition else 0.0,
            "circle": _circle_numbers(plan.circle),
        }
        self._out.write("/plan", "sidelong.Plan", prepared.time_s, numbers)
        way = list(zip(plan.transition.east_m, plan.transition.north_m, strict=True)) if plan.transition else []
        self._line("/plan/map", prepared.time_s, [*way, *ring(plan.circle)])

    def _line(self, topic: str, time_s: float, corners: Iterable[tuple[float, float]]) -> None:
        places = [
            self._plane.latitude_longitude_deg(float(east_m), float(north_m))[::-1] for east_m, north_m in corners
        ]
        feature = {"type": "Feature", "properties": {}, "geometry": {"type": "LineString", "coordinates": places}}
        geojson = {"geojson": json.dumps({"type": "FeatureCollection", "features": [feature]})}
        self._out.write(topic, "foxglove.GeoJSON", time_s, geojson)


class _Messages:
    """JSON messages into an MCAP file; each topic's schema is told by its first message."""

    def __init__(self, path: Path, on_trouble: Callable[[str], None], booted: datetime) -> None:
        try:
            from mcap.writer import CompressionType, Writer  # noqa: PLC0415  # an optional extra
        except ImportError as error:
            raise InputError("MCAP needs the package mcap; install it with: pip install 'sidelong[mcap]'.") from error
        self._boot_ns = (booted - _EPOCH) // timedelta(microseconds=1) * 1000
        self._stream = _Stream(path, on_trouble)
        self._writer = Writer(self._stream, chunk_size=_CHUNK_BYTES, compression=CompressionType.NONE)  # type: ignore[arg-type]  # it needs no more of a file
        self._writer.start()
        self._channels: dict[str, int] = {}

    def write(self, topic: str, schema: str, time_s: float, values: dict[str, Any]) -> None:
        time_ns = self._boot_ns + round(time_s * 1e9)
        sec, nsec = divmod(time_ns, 10**9)
        message = _without_nan({"timestamp": {"sec": sec, "nsec": nsec}, **values})
        if topic not in self._channels:
            described = json.dumps(_schema(message)).encode()
            schema_id = self._writer.register_schema(schema, "jsonschema", described)
            self._channels[topic] = self._writer.register_channel(topic, "json", schema_id)
        data = json.dumps(message, separators=(",", ":")).encode()
        self._writer.add_message(self._channels[topic], time_ns, data, time_ns)

    def close(self) -> None:
        self._writer.finish()  # type: ignore[no-untyped-call]  # the one method without annotations
        self._stream.close()


class _Stream(Appender):
    """As much of a file as the MCAP writer needs."""

    _position = 0

    def write(self, data: bytes) -> None:
        self._position += len(data)
        self.append(bytes(data))

    def tell(self) -> int:
        return self._position


def _schema(value: Any) -> dict[str, Any]:
    """Return the JSON schema of a message like this one."""
    match value:
        case dict():
            properties = {name: _schema(item) for name, item in value.items()}
            return {"type": "object", "properties": properties}
        case list():
            return {"type": "array", "items": _schema(value[0])}
        case bool():
            return {"type": "boolean"}
        case str():
            return {"type": "string"}
        case int():
            return {"type": "integer"}
        case _:
            return {"type": "number"}


def _without_nan(value: Any) -> Any:
    if isinstance(value, dict):
        return {name: _without_nan(item) for name, item in value.items()}
    return None if isinstance(value, float) and math.isnan(value) else value


def _circle_numbers(circle: Circle) -> dict[str, Any]:
    return {
        "east_m": circle.east_m,
        "north_m": circle.north_m,
        "radius_m": circle.radius_m,
        "clockwise": circle.clockwise,
    }


def _plane_from_body(roll_rad: float, pitch_rad: float, yaw_rad: float) -> dict[str, float]:
    """Return the attitude of forward-left-up in east-north-up: up and left turn the signs of yaw and pitch."""
    return dict(zip("wxyz", from_roll_pitch_yaw(roll_rad, -pitch_rad, math.pi / 2 - yaw_rad), strict=True))

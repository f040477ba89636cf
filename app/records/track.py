"""What of a flight can be handed to other programs."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta
from typing import NamedTuple

from sidelong.estimators.estimate import TargetEstimate
from sidelong.estimators.frames import LocalPlane
from sidelong.estimators.sensing.readings import PositionReading
from sidelong.mission.core.circle import Circle
from sidelong.mission.route.route import Route
from sidelong.mission.upload.fences import Outline
from sidelong.mission.upload.mission_item import MissionItem

_RING_CORNERS = 72
ROUTE_POINTS = 2000  # of a route in a file


@dataclass(frozen=True, slots=True)
class Mission:
    """Items without a home item, the fences (outlines in the plane), and the MAV_AUTOPILOT."""

    items: Sequence[MissionItem]
    airspeed_m_s: float
    mav_autopilot: int
    keep_in: Sequence[Outline] = ()
    keep_out: Sequence[Outline] = ()


class TrackPoint(NamedTuple):
    """Where something was at a time. height_m: above sea level or, if home's altitude is unknown, above home.

    It is empty for a target, which is on the ground.
    """

    time_s: float
    latitude_deg: float
    longitude_deg: float
    height_m: tuple[float, ...]


class PositionTrack(NamedTuple):
    """A line that was travelled; kind: "aircraft" or "target"."""

    kind: str
    name: str
    places: list[TrackPoint]


@dataclass(frozen=True, slots=True)
class FlownTrack:
    """Tracks in order of time, in ``plane``.

    circles: (since, circle) as they were flown. booted is when the vehicle's clock was zero, home_altitude_m is
    above sea level; None where unknown. label: the aircraft's name, where there are several; targets: of each one
    the target's name, where there are several of these. route: expected of the target.
    """

    name: str
    plane: LocalPlane
    aircraft: Sequence[PositionReading]
    estimates: Sequence[TargetEstimate] = ()
    circles: Sequence[tuple[float, Circle]] = ()
    mission: Mission | None = None
    booted: datetime | None = None
    home_altitude_m: float | None = None
    label: str = ""
    targets: Sequence[str] = ()
    route: Route | None = None

    def named(self, what: str) -> str:
        return f"{self.label} {what}" if self.label else what

    def of_targets(self) -> dict[str, list[TargetEstimate]]:
        """Return the estimates by what they are of: "target" or its name."""
        found: dict[str, list[TargetEstimate]] = {}
        for estimate, name in zip(self.estimates, self.targets or [""] * len(self.estimates), strict=True):
            found.setdefault(name or "target", []).append(estimate)
        return found

    def tracks(self) -> Iterator[PositionTrack]:
        """Yield the aircraft's track, then those of the targets that were seen."""
        base_m = self.home_altitude_m or 0.0
        flown = [
            TrackPoint(one.time_s, *self.degrees(one.east_m, one.north_m), (round(base_m + one.height_m, 3),))
            for one in self.aircraft
        ]
        yield PositionTrack("aircraft", self.named("aircraft"), flown)
        for name, estimates in self.of_targets().items():
            places = [TrackPoint(one.time_s, *self.degrees(one.east_m, one.north_m), ()) for one in estimates]
            yield PositionTrack("target", self.named(name), places)

    def at(self, time_s: float) -> datetime | None:
        """Return the time of day at a time of the vehicle's clock."""
        return None if self.booted is None else self.booted + timedelta(seconds=time_s)

    def utc(self, time_s: float) -> str | None:
        """Return a time of the vehicle's clock as ISO 8601 in UTC, to the millisecond."""
        moment = self.at(time_s)
        return None if moment is None else moment.replace(tzinfo=None).isoformat(timespec="milliseconds") + "Z"

    def degrees(self, east_m: float, north_m: float) -> tuple[float, float]:
        """Return (latitude, longitude), rounded to the millimetre."""
        latitude_deg, longitude_deg = self.plane.latitude_longitude_deg(east_m, north_m)
        return round(latitude_deg, 8), round(longitude_deg, 8)


def ring(circle: Circle) -> list[tuple[float, float]]:
    """Return (east, north) of the corners of a polygon for a circle, in the order it is flown, closed."""
    turn = 1.0 if circle.clockwise else -1.0
    corners = [circle.position_at_course(turn * math.tau * corner / _RING_CORNERS) for corner in range(_RING_CORNERS)]
    return [*corners, corners[0]]

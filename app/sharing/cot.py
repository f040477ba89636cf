"""Cursor on target (CoT) output: XML events once a second for the target, for the aircraft and for where it looks.

The schema defines ``ce`` as a 1-sigma error where it stands for an error. sidelong sends the long axis of the
estimate's ellipse. It sends no events for a lost track: the last event then becomes stale automatically.
"""

from __future__ import annotations

import math
import socket
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from uuid import NAMESPACE_DNS, uuid5
from xml.etree import ElementTree

from sidelong.app.sharing.senders import Sender
from sidelong.estimators.ellipse import confidence_ellipse
from sidelong.estimators.estimate import TargetEstimate, TrackQuality
from sidelong.estimators.frames import LocalPlane
from sidelong.mission.control.present import Present
from sidelong.mission.core.plan import AircraftState
from sidelong.mission.route.progress import RouteProgress, describe
from sidelong.mission.route.route import Route

_MACHINE_FUSED, _MACHINE_GPS = "m-f", "m-g"
_UNKNOWN = "9999999.0"
_ONE_SIGMA = 1.0 - math.exp(-0.5)  # the share of a two-dimensional Gaussian within one sigma
_SEND_EVERY_S = 1.0
PLAIN_CALLSIGN = "target"
_STALE_AFTER, _ROUTE_STALE_AFTER = timedelta(seconds=10.0), timedelta(seconds=180.0)
_DRAWN_LINE = "u-d-f"
_ROUTE_EVERY_S, _ROUTE_POINTS = 60.0, 40
_SENSOR_POINT = "b-m-p-s-p-i"


@dataclass(frozen=True, slots=True)
class CotNames:
    """How target and aircraft are to be shown: types of the CoT schema, call signs, and the team of the aircraft.

    A target of a fleet is called by its name there, unless it has been given another call sign.

    Attributes:
        view_deg: Horizontal and vertical field of view of the aircraft's sensor; None: not sent.
        video: Address of its video; '': there is none.
    """

    type: str = "a-n-G"
    callsign: str = PLAIN_CALLSIGN
    own_type: str = "a-f-A-C-F"
    own_callsign: str = "sidelong"
    team: str = "Cyan"
    view_deg: tuple[float, float] | None = None
    video: str = ""


def lasting_uid(callsign: str) -> str:
    """Return the same uid at each start on this computer: the map keeps one symbol for one call sign."""
    return f"sidelong-{uuid5(NAMESPACE_DNS, f'{socket.gethostname()}/{callsign}').hex[:8]}"


def target_event(
    estimate: TargetEstimate,
    plane: LocalPlane,
    time_s: float,
    now: datetime,
    uid: str,
    names: CotNames = CotNames(),
    route: RouteProgress | None = None,
) -> bytes:
    """Return the event for the target at ``time_s`` of the vehicle's clock, which is ``now`` by the wall's."""
    event = _event(uid, names.type, _MACHINE_FUSED, now)
    error_m = confidence_ellipse(estimate.covariance[:2, :2], _ONE_SIGMA).semi_major_m
    _point(event, plane, estimate.position_m(time_s), ce=f"{error_m:.1f}")
    detail = _detail(event, names.callsign, estimate.course_rad, estimate.speed_m_s)
    remarks = ElementTree.SubElement(detail, "remarks")
    remarks.text = f"sidelong: track {estimate.quality}, within {estimate.ellipse_95.semi_major_m:.1f} m with 95 %"
    if route is not None:
        remarks.text += f"; {describe(route)}"
    return _encoded(event)


def aircraft_event(
    aircraft: AircraftState,
    plane: LocalPlane,
    now: datetime,
    uid: str,
    height_above_ellipsoid_m: float | None,
    names: CotNames = CotNames(),
    looks_m: tuple[float, float, float] | None = None,
) -> bytes:
    """Return the event for the aircraft.

    Args:
        looks_m: How far east, north and below of it the place is at which its sensor looks.
    """
    event = _event(uid, names.own_type, _MACHINE_GPS, now)
    hae = _UNKNOWN if height_above_ellipsoid_m is None else f"{height_above_ellipsoid_m:.1f}"
    _point(event, plane, (aircraft.east_m, aircraft.north_m), hae=hae)
    detail = _detail(event, names.own_callsign, aircraft.course_rad, aircraft.ground_speed_m_s)
    ElementTree.SubElement(detail, "__group", name=names.team, role="Team Member")
    if names.video:
        ElementTree.SubElement(detail, "__video", url=names.video)
    if looks_m is not None and names.view_deg is not None:
        east_m, north_m, down_m = looks_m
        away_m = math.hypot(east_m, north_m)
        numbers = {
            "azimuth": math.degrees(math.atan2(east_m, north_m)) % 360.0,
            "elevation": -math.degrees(math.atan2(down_m, away_m)),
            "range": math.hypot(away_m, down_m),
            "fov": names.view_deg[0],
            "vfov": names.view_deg[1],
            "roll": 0.0,
        }
        texts = {name: f"{number:.1f}" for name, number in numbers.items()}
        ElementTree.SubElement(detail, "sensor", texts, model="sidelong", type="r", version="0.6")
    return _encoded(event)


def sensor_point_event(
    place_m: tuple[float, float], plane: LocalPlane, now: datetime, uid: str, names: CotNames = CotNames()
) -> bytes:
    """Return the sensor's point of interest, linked to the aircraft with that uid."""
    event = _event(f"{uid}.SPI", _SENSOR_POINT, _MACHINE_FUSED, now)
    _point(event, plane, place_m)
    detail = ElementTree.SubElement(event, "detail")
    ElementTree.SubElement(detail, "contact", callsign=f"{names.own_callsign}.SPI")
    ElementTree.SubElement(detail, "link", uid=uid, type=names.own_type, relation="p-p")
    return _encoded(event)


def route_event(route: Route, plane: LocalPlane, now: datetime, uid: str, callsign: str) -> bytes:
    """Return the route of the target as a drawn line."""
    outline = route.outline_m(_ROUTE_POINTS)
    event = _event(uid, _DRAWN_LINE, _MACHINE_FUSED, now, _ROUTE_STALE_AFTER)
    _point(event, plane, (float(outline[0, 0]), float(outline[0, 1])))
    detail = ElementTree.SubElement(event, "detail")
    for place in outline.tolist():
        latitude_deg, longitude_deg = plane.latitude_longitude_deg(*place)
        ElementTree.SubElement(detail, "link", point=f"{latitude_deg:.6f},{longitude_deg:.6f}")
    ElementTree.SubElement(detail, "contact", callsign=callsign)
    return _encoded(event)


def _event(uid: str, kind: str, how: str, now: datetime, lasts: timedelta = _STALE_AFTER) -> ElementTree.Element:
    at, stale = _utc(now), _utc(now + lasts)
    return ElementTree.Element("event", version="2.0", uid=uid, type=kind, how=how, time=at, start=at, stale=stale)


def _point(
    event: ElementTree.Element,
    plane: LocalPlane,
    place_m: tuple[float, float],
    ce: str = _UNKNOWN,
    hae: str = _UNKNOWN,
) -> None:
    latitude_deg, longitude_deg = plane.latitude_longitude_deg(*place_m)
    place = {"lat": f"{latitude_deg:.7f}", "lon": f"{longitude_deg:.7f}"}
    ElementTree.SubElement(event, "point", place, hae=hae, ce=ce, le=_UNKNOWN)


def _detail(event: ElementTree.Element, callsign: str, course_rad: float, speed_m_s: float) -> ElementTree.Element:
    detail = ElementTree.SubElement(event, "detail")
    ElementTree.SubElement(detail, "contact", callsign=callsign)
    course = f"{math.degrees(course_rad) % 360.0:.1f}"
    ElementTree.SubElement(detail, "track", course=course, speed=f"{speed_m_s:.2f}")
    return detail


def _encoded(event: ElementTree.Element) -> bytes:
    text: bytes = ElementTree.tostring(event, encoding="utf-8", xml_declaration=True)
    return text + b"\n"


def _utc(at: datetime) -> str:
    return at.astimezone(UTC).strftime("%Y-%m-%dT%H:%M:%S.%fZ")


class CotOutput:
    """An ``Observer`` that sends both by ``sender``. height_m returns the aircraft's ellipsoidal height if known."""

    def __init__(
        self,
        sender: Sender,
        plane: LocalPlane,
        names: CotNames = CotNames(),
        height_m: Callable[[], float | None] = lambda: None,
    ) -> None:
        self._sender, self._plane, self._names, self._height_m = sender, plane, names, height_m
        self._own_uid = f"{lasting_uid(names.own_callsign)}-{names.own_callsign}"
        self._next_s = self._route_s = -math.inf

    def show(self, snapshot: Present) -> None:
        """Send the available positions if the next event is due."""
        estimate, now_s = snapshot.estimate, time.monotonic()
        if now_s < self._next_s or snapshot.aircraft is None:
            return
        self._next_s, now = now_s + _SEND_EVERY_S, datetime.now(UTC)
        names, own, from_m = self._names, snapshot.aircraft, snapshot.from_target_m
        is_seen = estimate is not None and from_m is not None and estimate.quality is not TrackQuality.LOST
        looks_m = (-from_m[0], -from_m[1], snapshot.height_m) if from_m is not None and is_seen else None
        self._sender.send(aircraft_event(own, self._plane, now, self._own_uid, self._height_m(), names, looks_m))
        if estimate is not None and is_seen:
            place_m = estimate.position_m(snapshot.time_s)
            self._sender.send(sensor_point_event(place_m, self._plane, now, self._own_uid, names))
            if snapshot.target and names.callsign == PLAIN_CALLSIGN:
                names = replace(names, callsign=snapshot.target)
            uid = f"{lasting_uid(names.callsign)}-target"
            route = snapshot.route
            self._sender.send(target_event(estimate, self._plane, snapshot.time_s, now, uid, names, route))
            if route is not None and now_s >= self._route_s + _ROUTE_EVERY_S:
                self._route_s = now_s
                name = f"route of {names.callsign}"
                self._sender.send(route_event(route.route, self._plane, now, f"{uid}-route", name))

    def stop(self) -> None:
        self._sender.stop()

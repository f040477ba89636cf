"""The estimate for other displays, as cursor on target (CoT): one small XML event a second over UDP.

A neutral ground track. ``ce`` is what the schema wants where it stands for an error: one sigma, here along the long
axis of the estimate's ellipse. Nothing is sent of a lost track: the last event then goes stale by itself.
"""

from __future__ import annotations

import contextlib
import math
import re
import socket
import time
from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from types import TracebackType
from uuid import uuid4
from xml.etree import ElementTree

from app.errors import InputError
from estimators.ellipse import confidence_ellipse
from estimators.estimate import TargetEstimate, TrackQuality
from estimators.frames import LocalPlane
from mission.control.controller import Snapshot
from mission.core.events import Announce

_NEUTRAL_GROUND = "a-n-G"
_MACHINE_FUSED = "m-f"
_UNKNOWN = "9999999.0"
_ONE_SIGMA = 1.0 - math.exp(-0.5)  # so much of a two-dimensional Gaussian lies within one sigma
_SEND_EVERY_S = 1.0
_STALE_AFTER = timedelta(seconds=10.0)
_ADDRESS = re.compile(r"udp://([^:/]+):(\d{1,5})")


def cot_event(estimate: TargetEstimate, plane: LocalPlane, time_s: float, now: datetime, uid: str) -> bytes:
    """Return the event for the target at ``time_s`` of the vehicle's clock, which is ``now`` by the wall's."""
    latitude_deg, longitude_deg = plane.latitude_longitude_deg(*estimate.position_m(time_s))
    position = estimate.covariance[:2, :2]
    event = ElementTree.Element(
        "event",
        version="2.0",
        uid=uid,
        type=_NEUTRAL_GROUND,
        how=_MACHINE_FUSED,
        time=_utc(now),
        start=_utc(now),
        stale=_utc(now + _STALE_AFTER),
    )
    ElementTree.SubElement(
        event,
        "point",
        lat=f"{latitude_deg:.7f}",
        lon=f"{longitude_deg:.7f}",
        hae=_UNKNOWN,
        ce=f"{confidence_ellipse(position, _ONE_SIGMA).semi_major_m:.1f}",
        le=_UNKNOWN,
    )
    detail = ElementTree.SubElement(event, "detail")
    ElementTree.SubElement(detail, "contact", callsign="target")
    ElementTree.SubElement(
        detail,
        "track",
        course=f"{math.degrees(estimate.course_rad) % 360.0:.1f}",
        speed=f"{estimate.speed_m_s:.2f}",
    )
    remarks = ElementTree.SubElement(detail, "remarks")
    within_m = confidence_ellipse(position).semi_major_m
    remarks.text = f"sidelong: track {estimate.quality}, within {within_m:.1f} m with 95 %"
    text: bytes = ElementTree.tostring(event, encoding="utf-8", xml_declaration=True)
    return text


def _utc(at: datetime) -> str:
    return at.astimezone(UTC).strftime("%Y-%m-%dT%H:%M:%S.%fZ")


class CotOutput:
    """A ``Display`` that sends the estimate to ``udp://HOST:PORT``. Use as ``with``.

    Never waits: what the network does not take is lost. Raises InputError for an address it cannot use.
    """

    def __init__(
        self, address: str, plane: LocalPlane, now: Callable[[], datetime] = lambda: datetime.now(UTC)
    ) -> None:
        match = _ADDRESS.fullmatch(address)
        if match is None or not 0 < int(match[2]) < 65536:
            raise InputError(f"--cot {address!r} is no address; give one like udp://239.2.3.1:6969.")
        try:
            self._to = (socket.gethostbyname(match[1]), int(match[2]))
        except OSError as error:
            raise InputError(f"--cot {address!r}: the host {match[1]} is not known.") from error
        self._plane, self._now = plane, now
        self._uid = f"sidelong-{uuid4().hex[:8]}"
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        self._next_s = -math.inf

    def __enter__(self) -> CotOutput:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._socket.close()

    def say(self, announcement: Announce) -> None:
        pass

    def show(self, snapshot: Snapshot) -> None:
        """Send the estimate if it is time to."""
        estimate, now_s = snapshot.estimate, time.monotonic()
        if now_s < self._next_s or estimate is None or estimate.quality is TrackQuality.LOST:
            return
        self._next_s = now_s + _SEND_EVERY_S
        event = cot_event(estimate, self._plane, snapshot.time_s, self._now(), self._uid)
        with contextlib.suppress(OSError):
            self._socket.sendto(event, self._to)

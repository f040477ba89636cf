"""The estimate as cursor on target, read back by a library that is not ours."""

from __future__ import annotations

import math
import socket
from dataclasses import replace
from datetime import UTC, datetime

import numpy as np
import pytest

from app.errors import InputError
from app.flight.cot import CotOutput, cot_event
from estimators.estimate import TargetEstimate, TrackQuality
from estimators.frames import LocalPlane

takproto = pytest.importorskip("takproto", reason="takproto is not installed (the dev extra has it)")

PLANE = LocalPlane(47.4, 8.5)
NOW = datetime(2026, 11, 21, 12, 0, 0, tzinfo=UTC)
COVARIANCE = np.diag([16.0, 9.0, 0.1, 0.1])
ESTIMATE = TargetEstimate(200.0, 300.0, -400.0, -2.0, 0.0, COVARIANCE, TrackQuality.GOOD, 200.0)


def parsed(event: bytes):
    return takproto.parse_proto(bytearray(takproto.xml2proto(event))).cotEvent


def test_the_event_says_where_the_target_is_now_and_how_well_that_is_known():
    event = parsed(cot_event(ESTIMATE, PLANE, 205.0, NOW, "sidelong-1"))
    assert PLANE.east_north_m(event.lat, event.lon) == pytest.approx((290.0, -400.0), abs=0.02)
    assert event.ce == pytest.approx(4.0, abs=0.05)  # one sigma along the long axis
    assert event.hae == event.le == 9999999.0
    assert event.detail.track.speed == pytest.approx(2.0)
    assert event.detail.track.course == pytest.approx(270.0)
    assert event.detail.contact.callsign == "target"


def test_the_type_is_neutral_and_the_event_goes_stale():
    event = parsed(cot_event(ESTIMATE, PLANE, 200.0, NOW, "sidelong-1"))
    assert (event.type, event.how, event.uid) == ("a-n-G", "m-f", "sidelong-1")
    assert event.sendTime == event.startTime == NOW.timestamp() * 1000
    assert event.staleTime - event.sendTime == 10_000


@pytest.fixture
def receiver():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as receiver:
        receiver.bind(("127.0.0.1", 0))
        receiver.settimeout(10.0)
        yield receiver


@pytest.fixture
def snapshot(flight):
    for _, _, controller in flight(5.0):
        last = controller
    return last.snapshot()


def address_of(receiver: socket.socket) -> str:
    return f"udp://127.0.0.1:{receiver.getsockname()[1]}"


def waiting(receiver: socket.socket) -> list[bytes]:
    receiver.setblocking(False)
    got = []
    try:
        while True:
            got.append(receiver.recv(65536))
    except BlockingIOError:
        return got


def test_it_is_sent_once_a_second_at_most(receiver, snapshot):
    with CotOutput(address_of(receiver), PLANE) as output:
        for _ in range(20):
            output.show(snapshot)
    event = parsed(receiver.recv(65536))
    assert waiting(receiver) == []
    estimate = snapshot.estimate
    at_m = PLANE.east_north_m(event.lat, event.lon)
    assert math.dist(at_m, (estimate.east_m, estimate.north_m)) < 10.0
    assert event.uid.startswith("sidelong-")


@pytest.mark.parametrize("lost", [True, False])
def test_a_lost_or_unseen_target_is_not_sent(receiver, snapshot, lost):
    estimate = replace(snapshot.estimate, quality=TrackQuality.LOST) if lost else None
    with CotOutput(address_of(receiver), PLANE) as output:
        output.show(replace(snapshot, estimate=estimate))
    assert waiting(receiver) == []


def test_nobody_listening_does_no_harm(receiver, snapshot):
    address = address_of(receiver)
    receiver.close()
    with CotOutput(address, PLANE) as output:
        output.show(snapshot)


@pytest.mark.parametrize("address", ["239.2.3.1:6969", "tcp://127.0.0.1:1", "udp://host", "udp://127.0.0.1:70000"])
def test_a_bad_address_is_told(address):
    with pytest.raises(InputError, match="--cot"):
        CotOutput(address, PLANE)

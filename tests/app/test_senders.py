"""One vehicle or two with the same system id, reported before anything is armed."""

from __future__ import annotations

import itertools

import pytest
from pymavlink.dialects.v20 import common as mavlink

from sidelong.app.flight.session import SenderCheck, VehicleInputs
from sidelong.app.link.vehicle import VehicleMessages
from tests.messages import Sender, heartbeat, position


@pytest.fixture
def vehicle() -> VehicleMessages:
    return VehicleMessages(1, (255, 190))


@pytest.fixture
def senders(vehicle) -> SenderCheck:
    check = SenderCheck()
    check.judge(VehicleInputs(vehicle))
    return check


def frames(first: int, component: int = 1, system: int = 1, version: int = 2):
    sender = Sender(component, system, first)
    for number in itertools.count(first):
        attitude = mavlink.MAVLink_attitude_message(number, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
        yield sender(attitude, force_mavlink1=version == 1).data


@pytest.mark.parametrize("version", [1, 2])
@pytest.mark.parametrize("burst", [1, 6])
def test_frame_numbers_that_take_turns_are_two(senders, version, burst):
    one, other = frames(3, version=version), frames(120, version=version)
    for _ in range(200 // burst):
        for sender in (one, other):
            for frame in itertools.islice(sender, burst):
                senders.frame(frame)
    assert "frame numbers take turns; give one of them another system id" in senders.two_vehicles


def test_lost_frames_and_other_components_are_none(senders):
    one, gimbal, other = frames(3), frames(90, component=154), frames(200, system=2)
    for number in range(600):
        frame = next(one)
        if number % 3:
            senders.frame(frame)
        senders.frame(next(gimbal))
        senders.frame(next(other))
    senders.frame(b"")
    senders.frame(b"\xfd\x00")
    assert senders.two_vehicles is None


def test_clocks_that_take_turns_are_two(senders, vehicle):
    for time_ms in range(100_000, 103_000, 100):
        vehicle.take(position(time_ms))
        vehicle.take(position(time_ms + 400_000))
    assert "its clocks take turns, 400 s apart" in senders.two_vehicles


def test_places_that_take_turns_are_two(senders, vehicle):
    for time_ms in range(100_000, 105_000, 100):
        vehicle.take(position(time_ms))
        vehicle.take(position(time_ms + 30, 474_010_000))
    assert "its positions take turns, 111 m apart" in senders.two_vehicles


def test_heartbeats_of_two_kinds_are_two(senders, vehicle):
    for kind in (1, 2, 1):
        vehicle.take(heartbeat(type=kind))
    assert "different kinds" in senders.two_vehicles


def test_a_vehicle_alone_is_one(senders, vehicle):
    for time_ms in range(100_000, 130_000, 100):
        vehicle.take(position(time_ms))
        vehicle.take(heartbeat())
    assert senders.two_vehicles is None

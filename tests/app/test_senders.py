"""One vehicle or two with the same system id, told before anything is armed."""

from __future__ import annotations

import itertools

import pytest
from pymavlink.dialects.v20 import common as mavlink

from sidelong.app.link.message import Message
from sidelong.app.link.senders import SenderCheck


@pytest.fixture
def senders() -> SenderCheck:
    check = SenderCheck()
    check.system_id = 1
    return check


def frames(first: int, component: int = 1, system: int = 1, version: int = 2):
    mav = mavlink.MAVLink(None, srcSystem=system, srcComponent=component)
    for number in itertools.count(first):
        mav.seq = number % 256
        message = mavlink.MAVLink_attitude_message(number, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
        yield message.pack(mav, force_mavlink1=version == 1)


def told(name: str, **fields) -> Message:
    return Message(name, 1, 1, fields, 0.0)


def position(time_ms: int, lat: int = 474_000_000) -> Message:
    fields = {"lon": 85_000_000, "relative_alt": 0, "vx": 0, "vy": 0, "vz": 0}
    return told("GLOBAL_POSITION_INT", time_boot_ms=time_ms, lat=lat, **fields)


@pytest.mark.parametrize("version", [1, 2])
@pytest.mark.parametrize("burst", [1, 6])
def test_frame_numbers_that_take_turns_are_two(senders, version, burst):
    one, other = frames(3, version=version), frames(120, version=version)
    for _ in range(200 // burst):
        for sender in (one, other):
            for frame in itertools.islice(sender, burst):
                senders.frame(frame)
    assert "frame numbers take turns; give one of them another system id" in senders.two


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
    assert senders.two is None


def test_clocks_that_take_turns_are_two(senders):
    for time_ms in range(100_000, 103_000, 100):
        senders.message(position(time_ms))
        senders.message(position(time_ms + 400_000))
    assert "its clocks take turns, 400 s apart" in senders.two


def test_places_that_take_turns_are_two(senders):
    for time_ms in range(100_000, 105_000, 100):
        senders.message(position(time_ms))
        senders.message(position(time_ms + 30, 474_010_000))
    assert "its positions take turns, 111 m apart" in senders.two


def test_heartbeats_of_two_kinds_are_two(senders):
    for kind in (1, 2, 1):
        senders.message(told("HEARTBEAT", autopilot=3, type=kind, base_mode=81, custom_mode=0))
    assert "different kinds" in senders.two


def test_a_vehicle_alone_is_one(senders):
    for time_ms in range(100_000, 130_000, 100):
        senders.message(position(time_ms))
        senders.message(told("HEARTBEAT", autopilot=3, type=1, base_mode=81, custom_mode=0))
    assert senders.two is None

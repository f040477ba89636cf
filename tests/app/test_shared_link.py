"""One transport for several users: all receive, each sends, the last one closes."""

from __future__ import annotations

import time

import pytest
from pymavlink.dialects.v20 import all as mavlink

from sidelong.app.link.frames import Frame
from sidelong.app.link.raw_links import RawLinks
from sidelong.app.link.signing import LinkSigning, Refusal, key_in_use, make_key, signing_time
from sidelong.app.link.transport import sharing_opener
from sidelong.sitl.protocol.radio import read_key as sitl_key
from sidelong.sitl.settings import Settings
from sidelong.sitl.simulation import Simulation

A, B, C = "udpin://127.0.0.1:1", "udpin://127.0.0.1:2", "udpin://127.0.0.1:3"


class Wire:
    def __init__(self, url):
        self.url, self.sent, self.closed, self.starts, self.receive = url, [], 0, 0, None

    def start(self, receive):
        self.receive, self.starts = receive, self.starts + 1

    def send(self, data):
        self.sent.append(data)

    def close(self):
        self.closed += 1


@pytest.fixture
def opened():
    """Return the opener of three links, of which the first two share one URL, and the transports that it opens."""
    wires: dict[str, Wire] = {}

    def open_one(url):
        assert url not in wires, "opened twice"
        wires[url] = Wire(url)
        return wires[url]

    return sharing_opener([(A, C), (A,), (B,)], open_one), wires


def test_a_url_of_one_link_is_its_own(opened):
    opener, wires = opened
    assert opener(B) is wires[B]
    assert opener(C) is wires[C]


def test_all_users_receive_and_send(opened):
    opener, wires = opened
    received = {"one": [], "other": []}
    one, other = opener(A), opener(A)
    one.start(lambda data, peer: received["one"].append(data) or False)
    other.start(lambda data, peer: received["other"].append(data) or True)
    assert wires[A].starts == 1
    assert wires[A].receive(b"frame", None) is True  # it is enough that one of them knows the peer
    assert received == {"one": [b"frame"], "other": [b"frame"]}
    one.send(b"1")
    other.send(b"2")
    assert wires[A].sent == [b"1", b"2"]


def test_the_last_user_closes_it(opened):
    opener, wires = opened
    one, other = opener(A), opener(A)
    received = []
    one.start(lambda data, peer: received.append(data) or True)
    one.close()
    one.close()
    one.send(b"too late")
    assert (wires[A].closed, wires[A].sent) == (0, [])
    wires[A].receive(b"frame", None)
    assert received == []
    other.close()
    assert wires[A].closed == 1


def test_two_vehicles_that_demand_signing_share_a_link(opened, tmp_path):
    opener, wires = opened
    path, own = tmp_path / "fleet.key", (245, 190)
    make_key(path)
    vehicles = [
        Simulation(Settings(system_id=k, signing_key=sitl_key(path), boot_unix_s=time.time())) for k in (1, 2)
    ]
    received: list[list[bytes]] = [[], []]
    with key_in_use(path, signing_time(time.time()), pytest.fail) as key:
        links = [RawLinks([(A, opener(A))], own, key.apart()) for _ in vehicles]
        for one, frames in zip(links, received, strict=True):
            one.start(frames.append)
        brought = []

        def run(seconds: float) -> None:
            for _ in range(round(10 * seconds)):
                for vehicle in vehicles:
                    vehicle.advance(vehicle.time_s + 0.1)
                    for _, data in vehicle.take():
                        brought.append(data)
                        wires[A].receive(data, ("vehicle", 1))
                sent, wires[A].sent = wires[A].sent, []
                for data in sent:
                    for vehicle in vehicles:  # each receives what is for the other
                        vehicle.receive(0, data)

        for vehicle in vehicles:
            vehicle.connect(0)
        run(30.0)
        plain = mavlink.MAVLink(None, *own)
        for system_id, one in enumerate(links, 1):
            arm = mavlink.MAVLink_command_long_message(
                system_id, 1, mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 0, 1, 0, 0, 0, 0, 0, 0
            )
            one.send(bytes(arm.pack(plain)))
        run(1.0)
        assert all(vehicle.vehicle.armed for vehicle in vehicles)
        for one, frames in zip(links, received, strict=True):
            assert one.reports()[0].refused == {}
            assert {Frame(data).system_id for data in frames} == {1, 2}
        count = len(received[0])
        for data in brought[-50:]:
            assert wires[A].receive(data, ("vehicle", 1)) is False  # received before, by both
        assert len(received[0]) == len(received[1]) == count
        for one in links:
            one.close()
    with key_in_use(path, signing_time(time.time()), pytest.fail) as key:
        again, now = LinkSigning(key.key, key.times, 0, own), signing_time(time.time())
        assert {again.refusal(Frame(data), now) for data in brought[-50:]} == {Refusal.OLD}

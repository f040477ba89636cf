"""Signed links to the simulated vehicle, without sockets: what is let in, by both sides, and anything not.

HOSTILE_FRAMES=100000 python -m pytest tests/app/test_raw_links.py -s -k hostile   sends this many of each kind.
"""

from __future__ import annotations

import contextlib
import os
import time
from collections import Counter
from types import SimpleNamespace

import pytest
from pymavlink.dialects.v20 import all as mavlink

from sidelong.app.link.frames import Frame, FrameSplitter
from sidelong.app.link.raw_links import UNREAD, RawLinks
from sidelong.app.link.signing import Refusal, key_in_use, make_key, signing_time
from sidelong.sitl.protocol.radio import read_key as sitl_key
from sidelong.sitl.settings import Flavour, Settings
from sidelong.sitl.simulation import Simulation

HOSTILE = int(os.environ.get("HOSTILE_FRAMES", "300"))
OURS = (245, 190)
STEP_S = 0.1


class Wire:
    """A transport in memory; ``bring`` is the other side's sending."""

    def __init__(self) -> None:
        self.sent: list[bytes] = []

    def start(self, receive) -> None:
        self._receive = receive

    def bring(self, data: bytes) -> bool:
        return self._receive(data, ("vehicle", 1))

    def send(self, data: bytes) -> None:
        self.sent.append(data)

    def close(self) -> None:
        pass


class Linked:
    """A vehicle that demands signing, circling, and one or two links to it."""

    def __init__(self, tmp_path, flavour: Flavour, links: int, seed: int = 1) -> None:
        path = tmp_path / f"{flavour}.key"
        if not path.exists():
            make_key(path)
        self.simulation = Simulation(
            Settings(flavour=flavour, seed=seed, signing_key=sitl_key(path), boot_unix_s=time.time())
        )
        self.wires = [Wire() for _ in range(links)]
        self.delivered: list[bytes] = []
        self.troubles: list[str] = []
        self._held = key_in_use(path, signing_time(time.time()), pytest.fail)
        self.links = RawLinks(
            [(f"link{index}", wire) for index, wire in enumerate(self.wires)],
            *(OURS, self._held.__enter__()),
            on_trouble=self.troubles.append,
        )
        self.links.start(lambda data: self.delivered.extend(frame.data for frame in FrameSplitter().split(data)))
        self.brought: list[list[bytes]] = [[] for _ in range(links)]
        for index in range(links):
            self.simulation.connect(index)
        self._plain = mavlink.MAVLink(None, *OURS)

    def close(self) -> None:
        self.links.close()
        self._held.__exit__(None, None, None)

    def run(self, seconds: float, cut: frozenset[int] = frozenset()) -> None:
        for _ in range(round(seconds / STEP_S)):
            self.simulation.advance(self.simulation.time_s + STEP_S)
            for index, data in self.simulation.take():
                if index in range(len(self.wires)) and index not in cut:
                    self.brought[index].append(data)
                    self.wires[index].bring(data)
            for index, wire in enumerate(self.wires):
                sent, wire.sent = wire.sent, []
                for data in () if index in cut else sent:
                    self.simulation.receive(index, data)
        self.links.flush()

    def command(self, command: int, *params: float) -> int | None:
        """Send a command, and return its result."""
        before = len(self.delivered)
        padded = (*params, *(0.0,) * 7)[:7]
        message = mavlink.MAVLink_command_long_message(1, 1, command, 0, *padded)
        self.links.send(bytes(message.pack(self._plain)))
        self.run(0.5)
        acks = [m for m in self.received(before) if m.get_type() == "COMMAND_ACK" and m.command == command]
        return acks[-1].result if acks else None

    def received(self, since: int = 0):
        parser = mavlink.MAVLink(None)
        return [message for data in self.delivered[since:] for message in parser.parse_buffer(data) or ()]


@pytest.fixture
def linked(tmp_path):
    made = []

    def make(flavour=Flavour.ARDUPLANE, links=1, **options):
        made.append(Linked(tmp_path, flavour, links, **options))
        return made[-1]

    yield make
    for one in made:
        one.close()


def unsigned(frames):
    return [Frame(data).renumbered(Frame(data).sequence, signed=False) for data in frames]


def wrongly_signed(frames):
    signer = mavlink.MAVLink(None)
    signer.signing.secret_key, signer.signing.timestamp = bytes(32), signing_time(time.time() + 10.0)

    class Buffer:
        pass

    made = []
    for data in frames:
        buffer = Buffer()
        buffer._msgbuf = bytearray(Frame(data).renumbered(Frame(data).sequence, signed=True))
        mavlink.MAVLink_message.sign_packet(buffer, signer)
        made.append(bytes(buffer._msgbuf))
    return made


def repeated(frames, count):
    return (frames * (count // len(frames) + 1))[:count]


@pytest.mark.parametrize("flavour", list(Flavour))
def test_a_vehicle_that_demands_signing_obeys_and_is_received(linked, flavour):
    flight = linked(flavour)
    flight.run(30.0)
    assert flight.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1) == mavlink.MAV_RESULT_ACCEPTED
    assert flight.simulation.vehicle.armed
    (report,) = flight.links.reports()
    assert report.signed
    assert report.refused == {}
    assert report.measured.loss == 0.0
    assert flight.delivered == [data for data in flight.brought[0] if Frame(data).message_id not in UNREAD]


@pytest.mark.parametrize("flavour", list(Flavour))
def test_no_hostile_frame_reaches_the_core(linked, flavour):
    flight = linked(flavour, links=2)
    flight.run(20.0)
    own, other = ([data for data in brought if Frame(data).system_id == 1] for brought in flight.brought)
    assert len(own) > 100
    kinds = {
        Refusal.UNSIGNED: unsigned(repeated(own, HOSTILE)),
        Refusal.WRONG_KEY: wrongly_signed(repeated(own, HOSTILE)),
        Refusal.OLD: repeated(own, HOSTILE),
    }
    before = len(flight.delivered)
    for frames in kinds.values():
        for data in frames:
            assert not flight.wires[0].bring(data)
    assert len(flight.delivered) == before
    # Another link's: fresh, genuine, taken off the second link before it arrives there.
    flight.simulation.advance(flight.simulation.time_s + 5.0)
    taken = [data for index, data in flight.simulation.take() if index == 1 and Frame(data).system_id == 1]
    for data in repeated(taken, HOSTILE):
        assert not flight.wires[0].bring(data)
    assert len(flight.delivered) == before
    first, second = flight.links.reports()
    assert first.refused == {str(kind): HOSTILE for kind in (*kinds, Refusal.OTHER_LINK)}
    assert second.refused == {}
    assert other
    announced = Counter(text.rpartition(", ")[2] for text in flight.troubles)
    assert set(announced) == set(first.refused)  # each kind is reported, and not each frame
    assert max(announced.values()) <= 4
    flight.run(1.0)
    assert len(flight.delivered) > before


@pytest.mark.parametrize("flavour", list(Flavour))
def test_no_hostile_frame_disturbs_the_vehicle(linked, flavour):
    attacked = linked(flavour)
    attacked.run(30.0)
    vehicle = attacked.simulation.vehicle
    disarm = mavlink.MAVLink_command_long_message(1, 1, mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 0, 0, 21196, *(0,) * 5)
    plain = bytes(disarm.pack(mavlink.MAVLink(None, *OURS)))
    assert attacked.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1) == mavlink.MAV_RESULT_ACCEPTED
    attacked.links.send(plain)
    (signed,) = (data for data in attacked.wires[0].sent if Frame(data).message_id == disarm.id)
    attacked.wires[0].sent.clear()
    attacked.simulation.receive(0, signed)  # which is obeyed once
    attacked.run(1.0)
    assert not vehicle.armed
    assert attacked.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1) == mavlink.MAV_RESULT_ACCEPTED
    for frames in ([signed], unsigned([signed]), wrongly_signed([signed])):
        for data in repeated(frames, HOSTILE):
            attacked.simulation.receive(0, data)
            attacked.simulation.receive("stranger", data)
    attacked.run(1.0)
    assert vehicle.armed
    assert attacked.command(mavlink.MAV_CMD_REQUEST_MESSAGE, 148) == mavlink.MAV_RESULT_ACCEPTED


def test_a_radio_s_own_status_needs_no_signature_and_goes_no_further(linked):
    flight = linked()
    status = mavlink.MAVLink_radio_status_message(181, 174, 100, 40, 41, 0, 0)
    frame = bytes(status.pack(mavlink.MAVLink(None, 51, 68)))
    flight.run(2.0)
    before = len(flight.delivered)
    flight.wires[0].bring(frame)
    assert len(flight.delivered) == before
    (report,) = flight.links.reports()
    assert (report.measured.rssi, report.measured.remote_rssi) == (181, 174)
    assert report.refused == {}
    flight.simulation.receive(0, frame)
    flight.run(0.5)
    assert flight.command(mavlink.MAV_CMD_REQUEST_MESSAGE, 148) == mavlink.MAV_RESULT_ACCEPTED


@pytest.mark.parametrize("flavour", list(Flavour))
def test_px4_receives_heartbeats_of_those_without_the_key_and_obeys_none(linked, flavour):
    one = linked(flavour)
    one.run(0.5)
    vehicle, station = one.simulation.vehicle, mavlink.MAVLink(None, 255, 190)
    for message in (
        mavlink.MAVLink_heartbeat_message(mavlink.MAV_TYPE_GCS, mavlink.MAV_AUTOPILOT_INVALID, 0, 0, 4, 3),
        mavlink.MAVLink_command_long_message(1, 1, mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 0, 1, 21196, 0, 0, 0, 0, 0),
    ):
        one.simulation.receive(0, bytes(message.pack(station)))
    one.run(0.5)
    assert (vehicle.gcs_received_s is not None) is (flavour is Flavour.PX4)
    answer = mavlink.MAVLINK_MSG_ID_COMMAND_ACK
    assert not [data for data in one.brought[0] if Frame(data).message_id == answer]


def test_a_vehicle_that_signs_is_noticed_on_a_link_without_a_key():
    signing, wire, troubles = mavlink.MAVLink(None, 1, 1), Wire(), []
    signing.signing.secret_key, signing.signing.sign_outgoing = bytes(32), True
    with contextlib.closing(RawLinks([("link", wire)], OURS, None, on_trouble=troubles.append)) as links:
        links.start(lambda _data: None)
        for _ in range(2):
            assert wire.bring(bytes(mavlink.MAVLink_heartbeat_message(1, 3, 0, 0, 4, 3).pack(signing)))
    assert troubles == ["the vehicle signs its messages: without link.signing_key_file it may reject ours"]


def test_a_link_is_of_mavlink_1_until_a_frame_of_mavlink_2_arrives():
    wire, vehicle, found = Wire(), mavlink.MAVLink(None, 1, 1), []
    heartbeat = mavlink.MAVLink_heartbeat_message(1, 3, 0, 0, 4, 3)
    with contextlib.closing(RawLinks([("link", wire)], OURS, None)) as links:
        links.start(lambda _data: None)
        found.append(links.reports()[0].only_mavlink_1)
        for is_v1 in (True, True, False, True):
            wire.bring(bytes(heartbeat.pack(vehicle, force_mavlink1=is_v1)))
            found.append(links.reports()[0].only_mavlink_1)
    assert found == [False, True, True, False, False]


def test_a_listening_link_speaks_to_those_who_have_the_key(linked):
    flight = linked()
    flight.run(5.0)
    (frame, *_), wire = flight.brought[0], flight.wires[0]
    assert not wire.bring(unsigned([frame])[0])
    assert not wire.bring(frame)  # a replay, once something fresh has been received
    flight.simulation.advance(flight.simulation.time_s + 1.0)
    assert all(wire.bring(data) for _, data in flight.simulation.take())


def test_frames_are_found_in_any_pieces_between_garbage():
    sender = mavlink.MAVLink(None, 1, 1)
    frames = []
    for number in range(200):
        sender.seq = number
        frames.append(bytes(mavlink.MAVLink_attitude_message(number, *(0.1,) * 6).pack(sender)))
    stream = b"".join(frame + b"\xfd\x00\x01\xfe\x55"[: number % 6] for number, frame in enumerate(frames))
    stream += bytes(300)  # what looks like the beginning of a frame is waited for that long
    for size in (1, 7, 64, len(stream)):
        splitter = FrameSplitter()
        found = [f.data for at in range(0, len(stream), size) for f in splitter.split(stream[at : at + size])]
        assert found == frames


def test_what_comes_often_is_passed_on_with_others(monkeypatch):
    clock = SimpleNamespace(monotonic=lambda: 0.0, monotonic_ns=time.monotonic_ns, time=time.time)  # stands still
    monkeypatch.setattr("sidelong.app.link.raw_links.time", clock)
    wire, passed, vehicle = Wire(), [], mavlink.MAVLink(None, 1, 1)
    attitude = bytes(mavlink.MAVLink_attitude_message(0, *(0.0,) * 6).pack(vehicle))
    heartbeat = bytes(mavlink.MAVLink_heartbeat_message(1, 3, 0, 0, 4, 3).pack(vehicle))
    links = RawLinks([("link", wire)], OURS, None)
    links.start(passed.append)
    try:
        wire.bring(attitude)
        assert passed == []
        wire.bring(heartbeat)
        assert passed.pop() == attitude + heartbeat
        for _ in range(8):  # as in a simulation that runs fast
            wire.bring(attitude)
        assert passed.pop() == 8 * attitude
        assert passed == []
    finally:
        links.close()


def test_a_sender_that_floods_a_link_is_not_decoded_and_keeps_no_other_out(monkeypatch):
    wire, delivered, now_s, split = Wire(), [], [100.0], []
    monkeypatch.setattr("sidelong.app.link.raw_links.time.monotonic", lambda: now_s[0])
    real = FrameSplitter.split
    monkeypatch.setattr(FrameSplitter, "split", lambda self, data: split.append(len(data)) or real(self, data))
    links = RawLinks([("link", wire)], OURS, None)
    links.start(delivered.append)
    try:
        for data in (b"\xfd\x00" * 2000, bytes(100_000)):
            stranger = lambda data=data: wire._receive(data, ("stranger", len(data)))  # noqa: E731
            split.clear()
            for _ in range(1000):
                stranger()
            assert sum(split) < 4_200_000, "more was decoded than one sender may send"
            now_s[0] += 10.0
            split.clear()
            stranger()
            assert split == [len(data)]  # later it is received again
        beat = mavlink.MAVLink_heartbeat_message(1, 3, 0, 0, 0, 3).pack(mavlink.MAVLink(None, 1, 1))
        assert wire.bring(bytes(beat))
        links.flush()
        assert b"".join(delivered) == bytes(beat)
    finally:
        links.close()

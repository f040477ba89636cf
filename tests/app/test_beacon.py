"""A beacon that the target carries, and the estimate for other autopilots' follow modes, in frames of pymavlink."""

from __future__ import annotations

import asyncio
import math
import socket
from datetime import UTC, datetime, timedelta
from functools import reduce
from operator import xor

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from sidelong.app.errors import InputError
from sidelong.app.network import NetworkAddress
from sidelong.app.sharing import beacon as beacon_module
from sidelong.app.sharing.beacon import BeaconInput, decode
from sidelong.app.sharing.outputs import CotNames, DatagramSender, FollowTargetOutput, NmeaOutput, target_event
from sidelong.estimators.estimate import TargetEstimate, TrackQuality
from sidelong.estimators.frames import LocalPlane
from sidelong.estimators.sensing.readings import TargetFixReading

PLANE = LocalPlane(47.4, 8.5)
NOW = datetime(2026, 11, 21, 12, 0, 0, tzinfo=UTC)
ESTIMATE = TargetEstimate(200.0, 300.0, -400.0, -2.0, 1.0, np.diag([16.0, 9.0, 0.1, 0.1]), TrackQuality.GOOD, 200.0)


def follow_target(
    east_m: float, north_m: float, system_id: int = 30, sigma_m: float = 3.0, announced: int = 3
) -> bytes:
    latitude_deg, longitude_deg = PLANE.latitude_longitude_deg(east_m, north_m)
    place = round(latitude_deg * 1e7), round(longitude_deg * 1e7), 480.0
    rest = [0.0] * 3, [0.0] * 3, [1.0, 0.0, 0.0, 0.0], [0.0] * 3, [sigma_m, 0.0, 0.0], 0
    message = mavlink.MAVLink_follow_target_message(1000, announced, *place, *rest)
    return bytes(message.pack(mavlink.MAVLink(None, srcSystem=system_id)))


def cot(east_m: float, north_m: float, callsign: str = "ranger 7", at: datetime = NOW) -> bytes:
    moved = TargetEstimate(0.0, east_m, north_m, 0.0, 0.0, ESTIMATE.covariance, TrackQuality.GOOD, 0.0)
    return target_event(moved, PLANE, 0.0, at, f"ANDROID-{callsign}", CotNames(callsign=callsign))


class Input:
    """A beacon's input with what it has put and reported; the vehicle's clock is at 500 s."""

    def __init__(self, name: str | None = None) -> None:
        self.time_s = 0.0
        self.put: list[TargetFixReading] = []
        self.announced: list[str] = []
        self.beacon = BeaconInput(
            PLANE, name, 5.0, lambda: 500.0, self.put.append, self.announced.append, lambda: NOW, lambda: self.time_s
        )

    def on_message(self, *datagrams: bytes) -> None:
        for datagram in datagrams:
            self.beacon.datagram_received(datagram, None)


def test_follow_target_becomes_a_fix_of_its_own_accuracy():
    received = Input()
    received.on_message(follow_target(100.0, -50.0))
    (fix,) = received.put
    assert (fix.east_m, fix.north_m) == pytest.approx((100.0, -50.0), abs=0.02)
    assert (fix.time_s, fix.sigma_m, fix.source.message) == (500.0, 3.0, "FOLLOW_TARGET")
    received.on_message(follow_target(100.0, -50.0, sigma_m=0.0))
    assert received.put[-1].sigma_m == 5.0  # as configured: it does not report


def test_cursor_on_target_becomes_a_fix_of_the_time_it_reports():
    received = Input("ranger 7")
    received.on_message(cot(100.0, -50.0, at=NOW - timedelta(seconds=0.5)), cot(0.0, 0.0, callsign="another station"))
    (fix,) = received.put
    assert (fix.east_m, fix.north_m) == pytest.approx((100.0, -50.0), abs=0.02)
    assert (fix.time_s, fix.source.message) == (499.5, "COT")
    assert fix.sigma_m == pytest.approx(4.0, abs=0.1)


def event(kind: str, uid: str, how: str = "m-g", at: datetime = NOW) -> bytes:
    return (
        f'<?xml version="1.0" encoding="UTF-8"?><event version="2.0" uid="{uid}" type="{kind}" how="{how}" '
        f'time="{at.isoformat()}"><point lat="47.4" lon="8.5" ce="4.9"/>'
        '<detail><contact callsign="WALKER"/></detail></event>'
    ).encode()


def test_chat_pings_drawings_and_marks_are_no_other_beacon():
    received = Input()
    phone = event("a-f-G-U-C", "ANDROID-1")
    received.on_message(phone, event("b-t-f", "GeoChat.ANDROID-1"), event("t-x-c-t", "ANDROID-1-ping"))
    received.on_message(event("u-d-f", "line"), event("b-m-r", "route"), event("a-h-G", "mark", "h-e"), phone)
    assert [fix.source.message for fix in received.put] == ["COT", "COT"]
    assert received.announced == ["the beacon WALKER reports the target's position"]


def test_beacon_that_is_the_only_one_left_is_used_again():
    received = Input()
    received.on_message(follow_target(0.0, 0.0, 30), follow_target(900.0, 0.0, 31))
    received.time_s = 10.0
    received.on_message(follow_target(0.0, 0.0, 30))
    assert len(received.put) == 1
    received.time_s = 16.0  # the other one has been silent for more than 15 s
    received.on_message(follow_target(0.0, 0.0, 30))
    assert len(received.put) == 2
    assert received.announced[-1] == "only the beacon 30 is still received: it is used"
    received.on_message(follow_target(900.0, 0.0, 31))
    assert sum("several beacons" in text for text in received.announced) == 2


def nmea(body: str) -> bytes:
    return f"${body}*{reduce(xor, body.encode()):02X}\r\n".encode()


def global_position(latitude_deg: float, longitude_deg: float) -> bytes:
    place = round(latitude_deg * 1e7), round(longitude_deg * 1e7)
    message = mavlink.MAVLink_global_position_int_message(1000, *place, 400_000, 0, 0, 0, 0, 0)
    return bytes(message.pack(mavlink.MAVLink(None, srcSystem=7)))


def tak_protobuf() -> bytes:
    takproto = pytest.importorskip("takproto", reason="takproto is not installed (the dev extra has it)")
    text = event("a-f-G-U-C", "ANDROID-1").replace(b"+00:00", b".000000Z")
    return bytes(takproto.xml2proto(text, takproto.TAKProtoVer.MESH))


@pytest.mark.parametrize(
    ("datagram", "message"),
    [
        (lambda: nmea("GNRMC,120000.00,A,4724.000,N,00830.000,E,2.1,10.0,211126,,,A"), "NMEA"),
        (lambda: nmea("GPGGA,120000,4724.000,N,00830.000,E,1,08,1.1,430.0,M,,M,,"), "NMEA"),
        (lambda: global_position(47.4, 8.5), "GLOBAL_POSITION_INT"),
        (tak_protobuf, "COT"),
        (lambda: b"\xbf\x00\xbf" + event("a-f-G-U-C", "ANDROID-1"), "COT"),
    ],
)
def test_other_forms_of_a_position_are_read(datagram, message):
    received = Input()
    received.beacon.datagram_received(datagram(), ("192.0.2.7", 4000))
    (fix,) = received.put
    assert (fix.east_m, fix.north_m) == pytest.approx((0.0, 0.0), abs=0.02)
    assert fix.source.message == message


@pytest.mark.parametrize(
    "datagram",
    [
        nmea("GNRMC,120000.00,V,,,,,,,211126,,,N"),
        nmea("GPGGA,120000,4724.000,N,00830.000,E,0,00,,,M,,M,,"),
        nmea("GNRMC,120000.00,A,4724.000,N,00830.000,E,,,211126,,,A").replace(b"47", b"48"),
        bytes(mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 0, 3).pack(mavlink.MAVLink(None))),
        b"{'lat': 47.4}",
    ],
)
def test_datagrams_without_a_position_are_announced_once(datagram):
    received = Input()
    received.on_message(*[datagram] * 30)
    assert received.put == []
    (text,) = received.announced
    assert "none with a position that is read: let it send FOLLOW_TARGET, GLOBAL_POSITION_INT" in text


def test_more_than_a_beacon_sends_is_dropped_before_it_is_decoded(monkeypatch):
    decoded = []
    monkeypatch.setattr(beacon_module, "decode", lambda data, *_: decoded.append(len(data)) or [])
    received = Input()
    for second in range(10):
        received.time_s = float(second)
        for _ in range(50):  # 400 kB in each second of two senders, 40 of them
            received.beacon.datagram_received(bytes(8000), ("192.0.2.7", 4000))
            received.beacon.datagram_received(bytes(8000), ("192.0.2.8", 4000))
        for sender in range(40):
            received.beacon.datagram_received(bytes(8000), (f"192.0.2.{100 + sender}", 4000))
    assert 10 * 32 << 10 < sum(decoded) < 11 * 64 << 10
    assert len(received.announced) == 2  # the other one: none of them is read
    assert "more than 32 KiB/s of one sender, or datagrams of more than 8 KiB" in received.announced[0]
    received.time_s = 20.0
    received.beacon.datagram_received(bytes(100), ("192.0.2.7", 4000))
    assert decoded[-1] == 100


@pytest.mark.parametrize("encoding", ["utf-16", "utf-32", "utf-7"])
def test_entities_are_not_expanded_in_any_encoding(encoding):
    bomb = (
        "<!DOCTYPE a [<!ENTITY b '"
        + "c" * 100
        + "'>"
        + "".join(
            f"<!ENTITY b{k} '{'&b' + (str(k - 1) if k else '') + ';'}{'&b' + (str(k - 1) if k else '') + ';'}'>"
            for k in range(20)
        )
    )
    text = f"<?xml version='1.0' encoding='{encoding}'?>{bomb}]><event uid='&b19;'/>"
    assert decode(text.encode(encoding), NOW) == []
    assert decode(text.encode(), NOW) == []


def test_a_multicast_group_is_joined(free_port):
    async def run() -> TargetFixReading:
        got: asyncio.Queue[TargetFixReading] = asyncio.Queue()
        beacon, port = BeaconInput(PLANE, None, 5.0, lambda: 500.0, got.put_nowait, lambda _: None), free_port()
        await beacon.listen(NetworkAddress("udp", "239.2.3.1", port))
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
            sender.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, socket.inet_aton("127.0.0.1"))
            sender.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_TTL, 0)
            sender.sendto(follow_target(100.0, -50.0), ("239.2.3.1", port))
        fix = await asyncio.wait_for(got.get(), 20.0)
        beacon.stop()
        return fix

    assert asyncio.run(run()).east_m == pytest.approx(100.0, abs=0.02)


def test_a_group_that_cannot_be_joined_is_refused(free_port, monkeypatch):
    monkeypatch.setattr(socket, "if_nameindex", lambda: [(9999, "none")])
    beacon = BeaconInput(PLANE, None, 5.0, lambda: 500.0, print, print)
    with pytest.raises(InputError, match=r"239\.2\.3\.1:\d+ cannot be listened to \(No such device\)"):
        asyncio.run(beacon.listen(NetworkAddress("udp", "239.2.3.1", free_port())))


def test_two_beacons_without_a_name_are_both_left():
    received = Input()
    received.on_message(follow_target(0.0, 0.0, 30), follow_target(900.0, 0.0, 31), follow_target(0.0, 0.0, 30))
    assert len(received.put) == 1
    assert any("several beacons" in text for text in received.announced)
    named = Input("31")
    named.on_message(follow_target(0.0, 0.0, 30), follow_target(900.0, 0.0, 31))
    assert [round(fix.east_m) for fix in named.put] == [900]


def test_what_is_late_or_no_place_is_left():
    received = Input()
    received.on_message(cot(0.0, 0.0, at=NOW - timedelta(hours=1)), cot(0.0, 0.0, at=NOW + timedelta(seconds=30)))
    received.on_message(follow_target(0.0, 0.0, announced=2))
    assert received.put == []
    assert len(received.announced) == 1


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"<",
        b"<event/>",
        b"<event uid='a' time='x'><point lat='1' lon='2' ce='3'/></event>",
        b"<event uid='a' time='2026-11-21T12:00:00Z'><point lat='nan' lon='2' ce='3'/></event>",
        b"<!DOCTYPE a [<!ENTITY b 'c'>]><event/>",
        bytes(range(256)) * 8,
        follow_target(0.0, 0.0)[:-1],
    ],
)
def test_nonsense_is_passed_over(data):
    received = Input()
    received.on_message(data, data[::-1])
    assert received.put == []


def test_random_bytes_lead_to_nothing():
    rng = np.random.default_rng(3)
    base = [follow_target(0.0, 0.0), cot(0.0, 0.0)]
    for _ in range(2000):
        damaged = bytearray(base[int(rng.integers(2))])
        for at in rng.integers(len(damaged), size=3):
            damaged[at] = int(rng.integers(256))
        for one in decode(bytes(damaged), NOW):
            assert isinstance(one.latitude_deg, float)


def test_it_listens_by_udp(free_port):
    async def run() -> list[TargetFixReading]:
        got: asyncio.Queue[TargetFixReading] = asyncio.Queue()
        beacon = BeaconInput(PLANE, None, 5.0, lambda: 500.0, got.put_nowait, lambda _: None)
        port = free_port()
        await beacon.listen(NetworkAddress("udp", "127.0.0.1", port))
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
            sender.sendto(follow_target(100.0, -50.0), ("127.0.0.1", port))
        fix = await asyncio.wait_for(got.get(), 20.0)
        with pytest.raises(InputError, match="cannot be listened to"):
            await BeaconInput(PLANE, None, 5.0, lambda: 0.0, got.put_nowait, print).listen(
                NetworkAddress("udp", "127.0.0.1", port)
            )
        beacon.stop()
        return [fix]

    assert asyncio.run(run())[0].east_m == pytest.approx(100.0, abs=0.02)


# -- for other autopilots ----------------------------------------------------------------------------------------


def sender_to(receiver: socket.socket) -> DatagramSender:
    return DatagramSender(NetworkAddress("udp", *receiver.getsockname()), "test")


def over_hills(east_m: float, north_m: float) -> float:
    return 488.0 + round(0.1 * east_m - 0.2 * north_m)


def test_follow_target_is_what_pymavlink_reads(receiver, snapshot):
    output = FollowTargetOutput(sender_to(receiver), PLANE, over_hills, 240)
    output.show(snapshot)
    parser = mavlink.MAVLink(None)
    heartbeat, announced = (parser.parse_buffer(receiver.recv(4096))[0] for _ in range(2))
    assert (heartbeat.type, announced.get_srcSystem()) == (mavlink.MAV_TYPE_ONBOARD_CONTROLLER, 240)
    estimate = snapshot.estimate
    at_m = PLANE.east_north_m(announced.lat * 1e-7, announced.lon * 1e-7)
    assert math.dist(at_m, estimate.position_m(snapshot.time_s)) < 0.05
    assert announced.vel[:2] == pytest.approx([estimate.velocity_north_m_s, estimate.velocity_east_m_s], abs=1e-5)
    assert (announced.alt, announced.est_capabilities) == (over_hills(*estimate.position_m(snapshot.time_s)), 3)
    output.stop()


def test_nmea_is_what_a_gps_library_reads(receiver, snapshot):
    pynmeagps = pytest.importorskip("pynmeagps", reason="pynmeagps is not installed (the dev extra has it)")
    output = NmeaOutput(sender_to(receiver), PLANE, over_hills, lambda: NOW)
    output.show(snapshot)
    rmc, gga = (pynmeagps.NMEAReader.parse(line + b"\r\n") for line in receiver.recv(4096).splitlines())
    estimate = snapshot.estimate
    for sentence in (rmc, gga):
        at_m = PLANE.east_north_m(sentence.lat, sentence.lon)
        assert math.dist(at_m, estimate.position_m(snapshot.time_s)) < 0.05
        assert sentence.time == NOW.time()
    assert rmc.spd == pytest.approx(estimate.speed_m_s / 0.514444, abs=0.01)
    assert rmc.cog == pytest.approx(math.degrees(estimate.course_rad) % 360.0, abs=0.01)
    assert (rmc.date, gga.alt, gga.quality) == (NOW.date(), over_hills(*estimate.position_m(snapshot.time_s)), 1)
    output.stop()

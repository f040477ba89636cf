"""The estimate as cursor on target, read back by a library that is not ours."""

from __future__ import annotations

import asyncio
import contextlib
import math
import socket
import ssl
import subprocess
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from sidelong.app.config import load_config
from sidelong.app.errors import InputError
from sidelong.app.network import NetworkAddress
from sidelong.app.sharing.outputs import (
    CotNames,
    CotOutput,
    DatagramSender,
    StreamSender,
    aircraft_event,
    lasting_uid,
    target_event,
    tls_context,
)
from sidelong.estimators.estimate import TargetEstimate, TrackQuality
from sidelong.estimators.frames import LocalPlane
from sidelong.mission.route.route import RouteProgress, route_of

takproto = pytest.importorskip("takproto", reason="takproto is not installed (the dev extra has it)")

PLANE = LocalPlane(47.4, 8.5)
NOW = datetime(2026, 11, 21, 12, 0, 0, tzinfo=UTC)
COVARIANCE = np.diag([16.0, 9.0, 0.1, 0.1])
ESTIMATE = TargetEstimate(200.0, 300.0, -400.0, -2.0, 0.0, COVARIANCE, TrackQuality.GOOD, 200.0)


def parsed(event: bytes):
    return takproto.parse_proto(bytearray(takproto.xml2proto(event))).cotEvent


def test_the_event_reports_where_the_target_is_now_and_how_well_that_is_known():
    event = parsed(target_event(ESTIMATE, PLANE, 205.0, NOW, "sidelong-1"))
    assert PLANE.east_north_m(event.lat, event.lon) == pytest.approx((290.0, -400.0), abs=0.02)
    assert event.ce == pytest.approx(4.0, abs=0.05)  # one sigma along the long axis
    assert event.hae == event.le == 9999999.0
    assert event.detail.track.speed == pytest.approx(2.0)
    assert event.detail.track.course == pytest.approx(270.0)
    assert event.detail.contact.callsign == "target"


def test_the_type_is_neutral_and_the_event_goes_stale():
    event = parsed(target_event(ESTIMATE, PLANE, 200.0, NOW, "sidelong-1"))
    assert (event.type, event.how, event.uid) == ("a-n-G", "m-f", "sidelong-1")
    assert event.sendTime == event.startTime == NOW.timestamp() * 1000
    assert event.staleTime - event.sendTime == 10_000


def output_to(receiver: socket.socket, **names) -> CotOutput:
    return CotOutput(
        DatagramSender(NetworkAddress("udp", *receiver.getsockname()), "sharing.cot"), PLANE, CotNames(**names)
    )


def waiting(receiver: socket.socket) -> list[bytes]:
    receiver.setblocking(False)
    got = []
    try:
        while True:
            got.append(receiver.recv(65536))
    except BlockingIOError:
        return got


def test_target_and_aircraft_are_sent_once_a_second_at_most(receiver, snapshot):
    output = output_to(receiver)
    for _ in range(20):
        output.show(snapshot)
    own, _, event = (parsed(receiver.recv(65536)) for _ in range(3))
    assert waiting(receiver) == []
    estimate, aircraft = snapshot.estimate, snapshot.aircraft
    at_m = PLANE.east_north_m(event.lat, event.lon)
    assert math.dist(at_m, (estimate.east_m, estimate.north_m)) < 10.0
    assert PLANE.east_north_m(own.lat, own.lon) == pytest.approx((aircraft.east_m, aircraft.north_m), abs=0.02)
    assert (own.uid, event.uid) == (f"{lasting_uid('sidelong')}-sidelong", f"{lasting_uid('target')}-target")
    output.stop()


def test_the_sensor_its_point_and_its_video_are_sent_with_the_aircraft(receiver, snapshot):
    output = output_to(receiver, view_deg=(20.0, 11.3), video="udp://192.0.2.1:5600")
    output.show(snapshot)
    own, point, target = (ElementTree.fromstring(event) for event in waiting(receiver))
    sensor = own.find("detail/sensor")
    assert (sensor.get("fov"), sensor.get("vfov")) == ("20.0", "11.3")
    assert own.find("detail/__video").get("url") == "udp://192.0.2.1:5600"
    azimuth_rad, depression_rad = (math.radians(float(sensor.get(name))) for name in ("azimuth", "elevation"))
    away_m = float(sensor.get("range")) * math.cos(depression_rad)
    place_m = snapshot.estimate.position_m(snapshot.time_s)
    looks_m = (
        snapshot.aircraft.east_m + away_m * math.sin(azimuth_rad),
        snapshot.aircraft.north_m + away_m * math.cos(azimuth_rad),
    )
    assert math.dist(looks_m, place_m) < 15.0
    assert (point.get("type"), point.get("uid")) == ("b-m-p-s-p-i", f"{own.get('uid')}.SPI")
    assert point.find("point").get("lat") == target.find("point").get("lat")
    assert point.find("detail/link").get("uid") == own.get("uid")
    output.stop()


def test_an_unseen_target_is_sent_as_it_is_predicted_and_one_never_seen_is_not(receiver, snapshot):
    covariance = np.diag([150.0**2, 150.0**2, 1.0, 1.0])
    lost = replace(snapshot.estimate, quality=TrackQuality.LOST, covariance=covariance)
    output = output_to(receiver)
    output.show(replace(snapshot, estimate=lost))
    *_, target = waiting(receiver)
    assert float(ElementTree.fromstring(target).find("point").get("ce")) == pytest.approx(150.0)
    assert "track lost, within 367.2 m with 95 %" in parsed(target).detail.xmlDetail
    output.stop()
    output = output_to(receiver)
    output.show(replace(snapshot, estimate=None))
    (only,) = waiting(receiver)
    assert parsed(only).uid.endswith("-sidelong")
    output.stop()


def test_no_one_listening_does_no_harm(receiver, snapshot):
    output = output_to(receiver)
    receiver.close()
    output.show(snapshot)
    output.stop()


def test_the_route_is_sent_as_a_line_and_the_progress_with_the_target(receiver, snapshot):
    route = route_of(np.array([0.0, 0.0, 400.0]), np.array([0.0, 300.0, 300.0]))
    progress = RouteProgress(route, True, 120.0, 4.0, 0.9, 145.0)
    output = output_to(receiver)
    output.show(replace(snapshot, route=progress))
    _, _, target, line = waiting(receiver)
    assert "120 of 700 m along the route, 145 s to its end" in parsed(target).detail.xmlDetail
    drawn = ElementTree.fromstring(line)
    corners = [tuple(map(float, one.attrib["point"].split(","))) for one in drawn.iter("link")]
    assert parsed(line).type == "u-d-f"
    assert PLANE.east_north_m(*corners[0]) == pytest.approx((0.0, 0.0), abs=0.2)
    assert PLANE.east_north_m(*corners[-1]) == pytest.approx((400.0, 300.0), abs=0.2)
    output.stop()


def test_types_call_signs_and_team_are_those_asked_for(snapshot):
    names = CotNames("a-u-G-U", "cow 3", "a-f-A-M-F-Q", "uav 1", "Magenta")
    target = parsed(target_event(ESTIMATE, PLANE, 200.0, NOW, "sidelong-1", names))
    assert (target.type, target.detail.contact.callsign) == ("a-u-G-U", "cow 3")
    own = parsed(aircraft_event(snapshot.aircraft, PLANE, NOW, "sidelong-1-aircraft", 540.0, names))
    assert (own.type, own.detail.contact.callsign, own.hae) == ("a-f-A-M-F-Q", "uav 1", 540.0)
    assert (own.detail.group.name, own.detail.group.role) == ("Magenta", "Team Member")
    assert own.detail.track.speed == pytest.approx(snapshot.aircraft.ground_speed_m_s, abs=0.01)


@pytest.mark.parametrize("address", ["239.2.3.1:6969", "ssl://127.0.0.1:1", "udp://host", "udp://127.0.0.1:70000"])
def test_a_bad_address_is_reported_with_the_configuration(address):
    with pytest.raises(InputError, match=r"sharing\.cot: .*give one like"):
        load_config(None, {"sharing": {"cot": address}})


# -- TCP and TLS, against real servers on the loopback ---------------------------------------------------------


def openssl(*words: str, cwd: Path) -> None:
    subprocess.run(["openssl", *words], cwd=cwd, check=True, capture_output=True, timeout=30)


@pytest.fixture(scope="module")
def certificates(tmp_path_factory) -> Path:
    """Make an authority with a server's and a client's certificate, and a stranger's."""
    folder = tmp_path_factory.mktemp("certificates")
    curve = ("-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-nodes", "-days", "2")
    for name in ("authority", "stranger"):
        openssl(
            "req",
            "-x509",
            *curve,
            "-keyout",
            f"{name}.key",
            "-out",
            f"{name}.pem",
            "-subj",
            f"/CN={name}",
            cwd=folder,
        )
    for name in ("takserver", "client"):
        openssl("req", *curve, "-keyout", f"{name}.key", "-out", f"{name}.csr", "-subj", f"/CN={name}", cwd=folder)
        (folder / "names").write_text(f"subjectAltName=DNS:{name}\n")
        signed = ("-CA", "authority.pem", "-CAkey", "authority.key", "-CAcreateserial", "-extfile", "names")
        openssl("x509", "-req", "-in", f"{name}.csr", *signed, "-days", "2", "-out", f"{name}.pem", cwd=folder)
    return folder


class Server:
    """Keeps what comes, and reports something to whoever connects, as a TAK server does."""

    def __init__(self) -> None:
        self.got, self.connections = b"", 0
        self.enough, self.left = asyncio.Event(), asyncio.Event()

    async def __call__(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.connections += 1
        writer.write(b"<event/>" * 1000)
        with contextlib.suppress(OSError):
            while data := await reader.read(65536):
                self.got += data
                if self.got.count(b"</event>") >= 3:
                    self.enough.set()
        writer.close()
        self.left.set()


async def announced_to(server: Server, snapshot, tls_server=None, **sender) -> list[str]:
    """Show a snapshot to whoever is connected to the server; return what was reported."""
    announced: list[str] = []
    settled = asyncio.Event()

    def announce(text: str) -> None:
        announced.append(text)
        settled.set()

    listening = await asyncio.start_server(server, "127.0.0.1", 0, ssl=tls_server)
    async with listening:
        port = listening.sockets[0].getsockname()[1]
        scheme = "tcp" if tls_server is None else "tls"
        connection = StreamSender(
            NetworkAddress(scheme, "127.0.0.1", port), sender.get("tls"), sender.get("server_name"), announce
        )
        output = CotOutput(connection, PLANE)
        await asyncio.wait_for(settled.wait(), 20.0)
        output.show(snapshot)
        if announced[0].startswith("sending"):
            await asyncio.wait_for(server.enough.wait(), 20.0)
        output.stop()
        if server.got:
            await asyncio.wait_for(server.left.wait(), 20.0)
    return announced


def server_context(certificates: Path) -> ssl.SSLContext:
    context = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH, cafile=certificates / "authority.pem")
    context.load_cert_chain(certificates / "takserver.pem", certificates / "takserver.key")
    context.verify_mode = ssl.CERT_REQUIRED
    context.verify_flags &= ~ssl.VERIFY_X509_STRICT  # these certificates do not report their use, as many do not
    return context


def test_it_goes_by_tcp(snapshot):
    server = Server()
    assert [text.split(":")[0] for text in asyncio.run(announced_to(server, snapshot))] == ["sending to tcp"]
    events = [b"<?xml" + event for event in server.got.split(b"<?xml")[1:]]
    assert [parsed(event).type for event in events] == ["a-f-A-C-F", "b-m-p-s-p-i", "a-n-G"]


def test_it_goes_by_tls_with_a_certificate_of_its_own(snapshot, certificates):
    server = Server()
    tls = tls_context(
        certificates / "client.pem", certificates / "client.key", certificates / "authority.pem", "sharing.cot"
    )
    announced = asyncio.run(
        announced_to(server, snapshot, server_context(certificates), tls=tls, server_name="takserver")
    )
    assert announced[0].startswith("sending to tls://127.0.0.1:")
    assert server.got.count(b"</event>") == 3


@pytest.mark.parametrize(("authority", "server_name"), [("stranger", "takserver"), ("authority", "elsewhere")])
def test_a_server_that_is_not_the_one_is_reported_nothing(snapshot, certificates, authority, server_name):
    server = Server()
    tls = tls_context(
        certificates / "client.pem", certificates / "client.key", certificates / f"{authority}.pem", "sharing.cot"
    )
    announced = asyncio.run(
        announced_to(server, snapshot, server_context(certificates), tls=tls, server_name=server_name)
    )
    assert "cannot be reached" in announced[0]
    assert server.got == b""


def test_files_that_do_not_serve_are_named(certificates, tmp_path):
    (tmp_path / "nothing.pem").write_text("nothing")
    with pytest.raises(InputError, match=r"sharing\.cot: .*nothing\.pem holds no certificates"):
        tls_context(None, None, tmp_path / "nothing.pem", "sharing.cot")
    with pytest.raises(InputError, match=r"client\.pem and its key cannot be used"):
        tls_context(certificates / "client.pem", certificates / "stranger.key", None, "sharing.cot")
    with pytest.raises(InputError, match="without its certificate"):
        tls_context(None, certificates / "client.key", None, "sharing.cot")

"""A TAK server between two flights with the camera and a second client: what that one receives of them.

``SIDELONG_TAK=PROGRAM python -m pytest tests/bench/test_tak.py -s``. PROGRAM is ``taky`` (0.10, of PyPI, in an
environment of its own), or HOST:PORT of another server that takes plain TCP. TAK_S: length of each flight, s.
"""

from __future__ import annotations

import contextlib
import os
import re
import socket
import subprocess
import sys
import threading
from collections.abc import Iterator
from datetime import UTC, datetime, timedelta
from pathlib import Path
from xml.etree import ElementTree

import pytest

from tests.bench.size import size

SERVER, FLIGHT_S = os.environ.get("SIDELONG_TAK", ""), size(40, 20, "TAK_S")
_STREAM = "udp://127.0.0.1:5617"
_CONFIG = "[taky]\nbind_ip = 127.0.0.1\nroot_dir = .\n[cot_server]\nport = {}\n[ssl]\nenabled = false\n"
_EVENT = re.compile(rb"<event .*?</event>", re.DOTALL)
_AIRCRAFT, _TARGET, _SENSOR_POINT = "a-f-A-C-F", "a-n-G", "b-m-p-s-p-i"


@contextlib.contextmanager
def served(folder: Path, port: int) -> Iterator[tuple[str, int]]:
    """Yield the address of the server, which is started if it is a program."""
    host, colon, number = SERVER.rpartition(":")
    if colon:
        yield host, int(number)
        return
    (folder / "taky.conf").write_text(_CONFIG.format(port))
    with subprocess.Popen([SERVER, "-l", "error", "-c", "taky.conf"], cwd=folder) as server:
        try:
            yield "127.0.0.1", port
        finally:
            server.terminate()


def connected(address: tuple[str, int]) -> socket.socket:
    """Return a connection to a server that may just be starting."""
    for _ in range(100):
        with contextlib.suppress(ConnectionRefusedError):
            return socket.create_connection(address)
        threading.Event().wait(0.1)
    pytest.fail(f"no server at {address}")


def gathered(taken: socket.socket, onward: socket.socket | None = None) -> bytearray:
    """Return what arrives, from now on; it is also sent onward."""
    got = bytearray()

    def gather() -> None:
        with contextlib.suppress(OSError):  # closed
            while data := taken.recv(65536):
                got.extend(data)
                if onward is not None:
                    onward.sendall(data)

    threading.Thread(target=gather, daemon=True).start()
    return got


def events(got: bytearray) -> list[ElementTree.Element]:
    """Return the events, their places to 0.1 m: a server may round them."""
    found = [ElementTree.fromstring(text) for text in _EVENT.findall(bytes(got))]
    for place in (event.find("point") for event in found):
        place.attrib.update({name: f"{float(place.attrib[name]):.6f}" for name in ("lat", "lon")})
    return found


@pytest.mark.skipif(not SERVER, reason="SIDELONG_TAK names no TAK server")
def test_another_client_of_a_tak_server_sees_sensor_video_and_lasting_symbols(tmp_path, free_port):
    now, uids = datetime.now(UTC), []
    at, stale = (f"{when:%Y-%m-%dT%H:%M:%S}.000Z" for when in (now, now + timedelta(hours=1)))
    times = f'time="{at}" start="{at}" stale="{stale}"'
    point = '<point lat="47.4" lon="8.5" hae="0" ce="9999999" le="9999999"/>'
    detail = '<detail><contact callsign="observer" endpoint="*:-1:stcp"/><__group name="Cyan" role="HQ"/></detail>'
    own = f'<event version="2.0" uid="observer" type="a-f-G-U-C" how="m-g" {times}>{point}{detail}</event>'
    with served(tmp_path, free_port()) as address, socket.create_server(("127.0.0.1", 0)) as relay:
        relay.settimeout(300.0)
        client = connected(address)
        client.sendall(own.encode())
        received = gathered(client)
        for flight in range(2):
            begun = len(received)
            options = {"--payload": "video://", "--duration": FLIGHT_S, "--out": tmp_path / str(flight)}
            to = "tcp://{}:{}".format(*relay.getsockname())
            launch = [sys.executable, "-m", "sidelong", "launch", "--no-view", "--set", f"sharing.cot={to}"]
            launch += ["--set", f"camera.stream={_STREAM}", *(str(word) for pair in options.items() for word in pair)]
            with subprocess.Popen(launch, stdout=subprocess.DEVNULL) as flying, relay.accept()[0] as sender:
                sent = gathered(sender, connected(address))
                assert flying.wait(600) == 0
            known = {ElementTree.tostring(event) for event in events(sent)}
            ours = [event for event in events(received[begun:]) if event.get("uid", "").startswith("sidelong")]
            changed = [event for event in ours if ElementTree.tostring(event) not in known]
            kinds = {kind: [event for event in ours if event.get("type") == kind] for kind in (_AIRCRAFT, _TARGET)}
            points = [event for event in ours if event.get("type") == _SENSOR_POINT]
            sensors = [event.find("detail/sensor") for event in kinds[_AIRCRAFT]]
            print(f"\nsent {len(known)}, received {len(ours)}, {len(changed)} of them changed;", end=" ")
            print({kind: len(found) for kind, found in kinds.items()}, len(points), "sensor points", end="")
            assert len(ours) >= 0.9 * len(known) > FLIGHT_S
            assert not changed
            assert {event.find("detail/__video").get("url") for event in kinds[_AIRCRAFT]} == {_STREAM}
            looking = [sensor.attrib for sensor in sensors if sensor is not None]
            assert len(looking) >= 0.5 * FLIGHT_S
            assert all({"azimuth", "elevation", "range", "fov", "vfov"} <= set(one) for one in looking)
            assert all(float(one["fov"]) == pytest.approx(12.0) for one in looking)
            assert {event.find("detail/link").get("uid") for event in points} == {kinds[_AIRCRAFT][0].get("uid")}
            uids.append({event.get("uid") for event in ours})
    assert uids[0] == uids[1]
    assert len(uids[0]) == 3

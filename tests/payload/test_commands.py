"""The command line with a simulated payload on loopback."""

from __future__ import annotations

import contextlib
import json
import socket
import subprocess
from collections.abc import Iterator

import pytest
from pymavlink.dialects.v20 import common as mavlink

from sidelong.sitl.payload.devices import DEVICES
from tests.command_line import SIDELONG, sidelong


@contextlib.contextmanager
def simulated(kind: str, port: int, vehicle_port: int) -> Iterator[None]:
    """Run a simulated vehicle whose payload listens at a port."""
    options = ("--set", f"device={kind}@127.0.0.1:{port}", "--to", f"127.0.0.1:{vehicle_port}", "--while-input")
    with subprocess.Popen(
        [str(SIDELONG), "sitl", *options], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as process:
        try:
            assert process.stdout is not None
            assert process.stdout.readline().startswith("ready")
            yield
        finally:
            process.kill()


@pytest.mark.udp
@pytest.mark.parametrize("kind", DEVICES)
def test_driver_alone_publishes_mavlink_of_component_154(kind, free_port, tmp_path):
    port, vehicle_port = free_port(), free_port()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as udp, simulated(kind, port, vehicle_port):
        udp.bind(("127.0.0.1", 0))
        udp.settimeout(60.0)
        to = f"udpout:127.0.0.1:{udp.getsockname()[1]}"
        done = sidelong(
            "payload", f"{kind}://127.0.0.1:{port}", "--to", to, "--duration", 2, "--json", tmp_path / "payload.json"
        )
        assert done.returncode == 0, done.stderr
        parser, received = mavlink.MAVLink(None), {}
        udp.setblocking(False)
        with contextlib.suppress(BlockingIOError):
            while True:
                for message in parser.parse_buffer(udp.recv(4096)) or ():
                    received[message.get_type()] = message
    assert received.keys() >= {"HEARTBEAT", "DISTANCE_SENSOR", "GIMBAL_DEVICE_ATTITUDE_STATUS"}
    assert {message.get_srcComponent() for message in received.values()} == {154}
    status = json.loads((tmp_path / "payload.json").read_text())
    assert received["DISTANCE_SENSOR"].current_distance == pytest.approx(100.0 * status["range_m"], abs=500.0)
    assert received["DISTANCE_SENSOR"].orientation == 100
    assert status["missing"] == []


@pytest.mark.udp
def test_payload_that_does_not_answer_fails(free_port):
    done = sidelong("payload", f"siyi://127.0.0.1:{free_port()}", "--duration", 0.5)
    assert done.returncode == 1
    assert "siyi: it does not answer: check power, address and wiring" in done.stderr


def test_payload_without_a_driver_is_refused():
    done = sidelong("payload", "mavlink")
    assert done.returncode == 2
    assert "siyi://" in done.stderr


def test_wrong_destination_is_refused():
    done = sidelong("payload", "siyi://127.0.0.1", "--to", "udp:14550")
    assert done.returncode == 2
    assert "udpout:HOST:PORT" in done.stderr


def test_simulated_vehicle_with_a_real_payload_is_refused():
    done = sidelong("launch", "--payload", "siyi://127.0.0.1")
    assert done.returncode == 2
    assert "siyi://" in done.stderr
    assert "Traceback" not in done.stderr

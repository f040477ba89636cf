"""Telemetry packed by pymavlink, so that what is read in these tests was not written by our own code."""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence

import pytest
from pymavlink.dialects.v20 import ardupilotmega as dialect

START_US = 1_700_000_000_000_000
STEP_US = 10_000


class Sender:
    """Packs messages as system 1. ``i`` numbers them, so that each frame differs from the others by its content."""

    def __init__(self, *, version: int = 2, signed: bool = False, component: int = 1) -> None:
        self._version = version
        self._mav = dialect.MAVLink(None, srcSystem=1, srcComponent=component)
        if signed:
            self._mav.signing.secret_key = bytes(32)
            self._mav.signing.sign_outgoing = True

    def frame(self, message: dialect.MAVLink_message) -> bytes:
        packed = bytes(message.pack(self._mav, force_mavlink1=self._version == 1))
        self._mav.seq = (self._mav.seq + 1) % 256
        return packed

    def heartbeat(self) -> bytes:
        return self.frame(dialect.MAVLink_heartbeat_message(1, 3, 81, 10, 4, 3))

    def attitude(self, i: int) -> bytes:
        return self.frame(dialect.MAVLink_attitude_message(i, 0.1, -0.2, 0.01 * i, 0.0, 0.0, 0.0))

    def position(self, i: int) -> bytes:
        return self.frame(
            dialect.MAVLink_global_position_int_message(i, 473977418, 85455940, 600_000, 112_000 + i, 15, -3, 1, 9000)
        )

    def range(self, i: int) -> bytes:
        quaternion = [0.5, 0.5, -0.5, 0.5]
        return self.frame(
            dialect.MAVLink_distance_sensor_message(i, 20, 60_000, 20_000 + i, 0, 1, 100, 4, 0.1, 0.2, quaternion, 90)
        )

    def text(self, text: str) -> bytes:
        return self.frame(dialect.MAVLink_statustext_message(6, text.encode()))

    def tunnel(self, content: bytes) -> bytes:
        payload = content.ljust(128, b"\0")
        return self.frame(dialect.MAVLink_tunnel_message(0, 0, 0, len(content), payload))

    def mixture(self, count: int) -> list[bytes]:
        """Return ``count`` frames as a vehicle sends them: of several kinds, numbered from 1."""
        makers: Sequence[Callable[[int], bytes]] = (
            self.attitude,
            self.range,
            lambda i: self.text(f"number {i}"),
            self.position,
            self.attitude,
            lambda _: self.heartbeat(),
        )
        return [makers[i % len(makers)](i) for i in range(1, count + 1)]


@pytest.fixture
def sender() -> type[Sender]:
    return Sender


@pytest.fixture
def stamped() -> Callable[[Sequence[bytes]], list[bytes]]:
    """Return a function that puts a stamp before each frame, 10 ms apart."""
    return lambda frames: [struct.pack(">Q", START_US + STEP_US * i) + frame for i, frame in enumerate(frames)]

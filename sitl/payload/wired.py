"""What a device is connected to, and the network port that it speaks at."""

from __future__ import annotations

import contextlib
import socket
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Sequence

from sidelong.sitl.payload.devices import OVER_TCP, Device, DeviceView
from sidelong.sitl.payload.payload import Measurement, TargetGeometry

_LEAN = 0.05  # of the aircraft's bank, by which a stabilised camera leans in a turn


class Wired(ABC):
    """What the port of a device is connected to: a simulation or a companion, which looks at the target for it.

    latency_looks: how many looks ago the laser's present range was measured.
    """

    def __init__(self, device: Device | None, latency_looks: int) -> None:
        self.device = device
        self.unplugged = False  # the device neither receives nor answers
        self._seen: DeviceView | None = None
        self._streamed: list[bytes] = []
        self._slants_m: deque[float] = deque(maxlen=latency_looks + 1)  # true ones

    @property
    @abstractmethod
    def time_s(self) -> float:
        """The device's clock."""

    def receive_device(self, data: bytes) -> list[bytes]:
        """Take bytes at the device's port and return its answers."""
        if self.device is None or self._seen is None or self.unplugged:
            return []
        return self.device.receive(data, self.time_s, self._seen)

    def take_device(self) -> list[bytes]:
        streamed, self._streamed = self._streamed, []
        return [] if self.unplugged else streamed

    def look(
        self, device: Device, sight: TargetGeometry, latest: Measurement, heading_rad: float, roll_rad: float
    ) -> None:
        """Let the device look along the sight, with the errors of the latest measurement."""
        self._slants_m.append(sight.slant_range_m)
        self._seen = DeviceView(
            None if latest.range_m is None else self._slants_m[0] + latest.range_error_m,
            sight.bearing_rad + latest.bearing_error_rad - heading_rad,
            sight.elevation_rad + latest.elevation_error_rad,
            _LEAN * roll_rad,
        )
        self._streamed += device.stream(self.time_s, self._seen)


Address = tuple[str, int]

_DATAGRAM_MAX = 4096


class DevicePort:
    """The port of a device: by UDP it answers its latest client and streams to it, by TCP it serves only that one."""

    def __init__(self, wired: Wired, address: Address, over_tcp: bool) -> None:
        self._wired = wired
        self._peer: Address | None = None
        self._client: socket.socket | None = None  # by TCP
        self._over_tcp = over_tcp
        if over_tcp:
            self._socket = socket.create_server(address)
        else:
            self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
            self._socket.bind(address)
        self._socket.setblocking(False)

    @property
    def sockets(self) -> list[socket.socket]:
        """Those that may become readable."""
        return [self._socket] if self._client is None else [self._socket, self._client]

    def send(self) -> None:
        self._send(self._wired.take_device())

    def receive(self) -> None:
        with contextlib.suppress(BlockingIOError):
            if self._over_tcp:
                self._receive_tcp()
            while not self._over_tcp:
                with contextlib.suppress(ConnectionError):  # the client has gone
                    data, self._peer = self._socket.recvfrom(_DATAGRAM_MAX)
                    self._send(self._wired.receive_device(data))

    def _receive_tcp(self) -> None:
        with contextlib.suppress(BlockingIOError):
            client, _ = self._socket.accept()
            self._drop()
            client.setblocking(False)
            client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self._client = client
        if self._client is not None:
            data = b""
            with contextlib.suppress(ConnectionError):
                data = self._client.recv(_DATAGRAM_MAX)
            if data:
                self._send(self._wired.receive_device(data))
            else:
                self._drop()

    def close(self) -> None:
        self._drop()
        self._socket.close()

    def _send(self, frames: Sequence[bytes]) -> None:
        with contextlib.suppress(BlockingIOError, ConnectionError):
            if self._client is not None:
                self._client.sendall(b"".join(frames))
        for frame in frames:
            with contextlib.suppress(BlockingIOError, ConnectionError):
                if self._peer is not None:
                    self._socket.sendto(frame, self._peer)

    def _drop(self) -> None:
        if self._client is not None:
            self._client.close()
            self._client = None


def device_port(kind: str, wired: Wired, address: Address) -> DevicePort:
    return DevicePort(wired, address, kind.partition("@")[0] in OVER_TCP)

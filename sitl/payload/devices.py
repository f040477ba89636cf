"""The simulated payloads by the names of their protocols, and the network ports that they speak at."""

from __future__ import annotations

import contextlib
import socket
from collections.abc import Callable, Sequence

import numpy as np

from sidelong.sitl.payload.device import Device, Wired
from sidelong.sitl.payload.gremsy import SimulatedGremsy
from sidelong.sitl.payload.siyi import SimulatedSiyi
from sidelong.sitl.payload.topotek import SimulatedTopotek
from sidelong.sitl.payload.viewpro import SimulatedViewpro
from sidelong.sitl.settings import Quirks, Settings

OVER_TCP = ("viewpro",)
"""Those that listen for a TCP connection; the others take datagrams."""

DEVICES: dict[str, Callable[[Quirks, np.random.Generator], Device]] = {
    "siyi": SimulatedSiyi,
    "viewpro": SimulatedViewpro,
    "gremsy": SimulatedGremsy,
    "topotek": SimulatedTopotek,
}


def device_of(settings: Settings) -> Device | None:
    """Return the device of a vehicle, None where its payload has no port of its own."""
    if not settings.device:
        return None
    kind = settings.device.partition("@")[0]
    return DEVICES[kind](settings.quirks, np.random.default_rng(settings.seed))


Address = tuple[str, int]

_DATAGRAM_MAX = 4096


class _UdpPort:
    """Answers its client, and streams to the latest one."""

    def __init__(self, wired: Wired, address: Address) -> None:
        self._wired = wired
        self._peer: Address | None = None
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind(address)
        self.socket.setblocking(False)

    @property
    def sockets(self) -> tuple[socket.socket, ...]:
        """Those that may become readable."""
        return (self.socket,)

    def send(self) -> None:
        self._send(self._wired.take_device())

    def receive(self) -> None:
        while True:
            try:
                data, self._peer = self.socket.recvfrom(_DATAGRAM_MAX)
            except BlockingIOError:
                return
            except ConnectionError:
                continue  # the client has gone
            self._send(self._wired.receive_device(data))

    def close(self) -> None:
        self.socket.close()

    def _send(self, frames: Sequence[bytes]) -> None:
        for frame in frames:
            if self._peer is not None:
                with contextlib.suppress(BlockingIOError, ConnectionError):
                    self.socket.sendto(frame, self._peer)


class _TcpPort:
    """Serves one client at a time, the latest."""

    def __init__(self, wired: Wired, address: Address) -> None:
        self._wired = wired
        self._server = socket.create_server(address)
        self._server.setblocking(False)
        self._client: socket.socket | None = None

    @property
    def sockets(self) -> tuple[socket.socket, ...]:
        """Those that may become readable."""
        return (self._server,) if self._client is None else (self._server, self._client)

    def send(self) -> None:
        self._send(self._wired.take_device())

    def receive(self) -> None:
        with contextlib.suppress(BlockingIOError):
            client, _ = self._server.accept()
            self._drop()
            client.setblocking(False)
            client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self._client = client
        if self._client is None:
            return
        with contextlib.suppress(BlockingIOError):
            try:
                data = self._client.recv(_DATAGRAM_MAX)
            except ConnectionError:
                data = b""
            if data:
                self._send(self._wired.receive_device(data))
            else:
                self._drop()

    def close(self) -> None:
        self._drop()
        self._server.close()

    def _send(self, frames: Sequence[bytes]) -> None:
        if self._client is not None:
            with contextlib.suppress(BlockingIOError, ConnectionError):
                self._client.sendall(b"".join(frames))

    def _drop(self) -> None:
        if self._client is not None:
            self._client.close()
            self._client = None


DevicePort = _UdpPort | _TcpPort


def device_port(kind: str, wired: Wired, address: Address) -> DevicePort:
    """Return an open port for a device of this kind."""
    return _TcpPort(wired, address) if kind.partition("@")[0] in OVER_TCP else _UdpPort(wired, address)

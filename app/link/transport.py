"""Bytes in and out of one link: UDP, TCP or a serial line, each served by its own thread.

A lost link reconnects automatically: a TCP connection is made again, an unplugged serial device is opened again.
Sending never blocks: data that does not fit into the buffer is dropped, as on a radio link.
"""

from __future__ import annotations

import contextlib
import os
import select
import socket
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Protocol

import serial

_READ_BYTES = 4096
_WAKE_S = 0.2
_GATHER_S, _DATAGRAMS_MAX = 0.004, 64  # what an autopilot sends at a time then wakes the thread once
_RETRY_S = 1.0
_SILENT_S = 10.0  # after this silence, a UDP peer is no longer sent to, unless it is the only one
_PEERS_MAX = 8
_UNSENT_MAX_BYTES = 1 << 16

Peer = tuple[str, int] | None
Receive = Callable[[bytes, Peer], bool]
"""Takes bytes and their sender; returns whether they confirm the sender as a peer."""


class Transport(Protocol):
    """One link's bytes."""

    def start(self, receive: Receive) -> None:
        """Begin to receive, in a thread. ``receive`` is called from there."""
        ...

    def send(self, data: bytes) -> None:
        """Send to whoever is at the other end, from any thread; what cannot be sent now is lost."""
        ...

    def close(self) -> None:
        """End it; safe to call more than once."""
        ...


def opened(url: str) -> Transport:
    """Return the transport of a URL that ``checked_url`` has passed. Raises OSError when it cannot be opened."""
    scheme, _, rest = url.partition("://")
    host, _, last = rest.rpartition(":")
    if scheme.startswith("serial"):
        return SerialTransport(host, int(last), scheme == "serial_flowcontrol")
    address = (host, int(last))
    if scheme.startswith("udp"):
        return UdpTransport(address, listening=scheme == "udpin")
    return TcpListener(address) if scheme == "tcpin" else TcpTransport(address)


class _Threaded(ABC):
    def __init__(self) -> None:
        self._closing = threading.Event()
        self._thread: threading.Thread | None = None

    def start(self, receive: Receive) -> None:
        self._thread = threading.Thread(target=self._run, args=(receive,), name="link", daemon=True)
        self._thread.start()

    def close(self) -> None:
        self._closing.set()
        if self._thread is not None and self._thread is not threading.current_thread():
            self._thread.join(5.0)

    @abstractmethod
    def _run(self, receive: Receive) -> None: ...


class UdpTransport(_Threaded):
    """UDP datagrams. A listening socket sends only to confirmed peers."""

    def __init__(self, address: tuple[str, int], listening: bool) -> None:
        super().__init__()
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            if listening:
                self._socket.bind(address)
            else:
                self._socket.connect(address)  # the kernel then drops datagrams from other addresses
        except OSError:
            self._socket.close()
            raise
        self._socket.setblocking(False)
        self._listening = listening
        self._peers: dict[tuple[str, int], float] = {}

    def send(self, data: bytes) -> None:
        with contextlib.suppress(OSError):
            if not self._listening:
                self._socket.send(data)
                return
        for peer in list(self._peers):
            with contextlib.suppress(OSError):
                self._socket.sendto(data, peer)

    def close(self) -> None:
        super().close()
        self._socket.close()

    def _run(self, receive: Receive) -> None:
        while not self._closing.is_set():
            if not select.select([self._socket], [], [], _WAKE_S)[0]:
                continue
            time.sleep(_GATHER_S)
            for _ in range(_DATAGRAMS_MAX):
                try:
                    data, peer = self._socket.recvfrom(65536)
                except OSError:  # there is no more, or the other end is not there (yet)
                    break
                if receive(data, peer) and self._listening:
                    self._received(peer, time.monotonic())

    def _received(self, peer: tuple[str, int], now_s: float) -> None:
        peers = {one: received_s for one, received_s in self._peers.items() if now_s - received_s < _SILENT_S} | {
            peer: now_s
        }
        while len(peers) > _PEERS_MAX:
            del peers[min(peers, key=lambda one: peers[one])]
        self._peers = peers


class _StreamTransport(_Threaded):
    """A stream of bytes on a file descriptor that may go and come again."""

    def __init__(self) -> None:
        super().__init__()
        self._lock = threading.Lock()
        self._stream: socket.socket | serial.Serial | None = None
        self._unsent = b""

    @abstractmethod
    def _connected(self) -> socket.socket | serial.Serial | None:
        """Return the next connection, not blocking, or None where there is none now. Raises OSError."""

    def send(self, data: bytes) -> None:
        with self._lock:
            if self._stream is not None and len(self._unsent) + len(data) <= _UNSENT_MAX_BYTES:
                self._unsent += data  # whole or not at all: half a frame would cost the next one, too
                self._flush()

    def close(self) -> None:
        super().close()
        self._drop()

    def _flush(self) -> None:
        if self._stream is not None and self._unsent:
            with contextlib.suppress(OSError):  # a broken connection is found by reading
                self._unsent = self._unsent[os.write(self._stream.fileno(), self._unsent) :]

    def _drop(self) -> None:
        with self._lock:
            stream, self._stream, self._unsent = self._stream, None, b""
        if stream is not None:
            with contextlib.suppress(OSError):
                stream.close()

    def _run(self, receive: Receive) -> None:
        while not self._closing.is_set():
            if self._stream is None:
                try:
                    self._stream = self._connected()
                except OSError:
                    self._closing.wait(_RETRY_S)
                continue
            try:
                self._served(self._stream.fileno(), receive)
            except OSError:  # gone: a device unplugged, a connection reset
                self._drop()
                self._closing.wait(_RETRY_S)

    def _served(self, descriptor: int, receive: Receive) -> None:
        wants_write = [descriptor] if self._unsent else []
        readable, writable, _ = select.select([descriptor], wants_write, [], _WAKE_S)
        if writable:
            with self._lock:
                self._flush()
        if readable:
            data = os.read(descriptor, _READ_BYTES)
            if not data:
                raise ConnectionResetError
            receive(data, None)


class TcpTransport(_StreamTransport):
    """A TCP connection to a server. The first one has to succeed: OSError otherwise."""

    def __init__(self, address: tuple[str, int]) -> None:
        super().__init__()
        self._address = address
        self._stream = self._connected()

    def _connected(self) -> socket.socket:
        connection = socket.create_connection(self._address, timeout=2.0)
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        connection.setblocking(False)
        return connection


class TcpListener(_StreamTransport):
    """A TCP server for one client at a time."""

    def __init__(self, address: tuple[str, int]) -> None:
        super().__init__()
        self._server = socket.create_server(address)
        self._server.settimeout(_WAKE_S)

    def _connected(self) -> socket.socket | None:
        try:
            connection, _ = self._server.accept()
        except TimeoutError:
            return None
        connection.setblocking(False)
        return connection

    def close(self) -> None:
        super().close()
        self._server.close()


class SerialTransport(_StreamTransport):
    """A serial device. It has to be there at first: OSError otherwise."""

    def __init__(self, device: str, baud: int, flow_control: bool) -> None:
        super().__init__()
        self._device, self._baud, self._flow_control = device, baud, flow_control
        self._stream = self._connected()

    def _connected(self) -> serial.Serial:
        try:
            return serial.Serial(self._device, self._baud, timeout=0, write_timeout=0, rtscts=self._flow_control)
        except ValueError as error:
            raise OSError(22, f"{self._baud} baud is no rate of {self._device}") from error

"""Bytes in and out of one link: UDP, TCP or a serial line, each served by its own thread.

A lost link reconnects automatically: a TCP connection is made again, an unplugged serial device is opened again.
Sending never blocks: data that does not fit into the buffer is dropped, as on a radio link.
"""

from __future__ import annotations

import contextlib
import os
import re
import select
import socket
import threading
import time
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Protocol, TypeAlias

import serial

from sidelong.app.errors import InputError
from sidelong.app.network import NetworkAddress

_READ_BYTES = 4096
_WAKE_S = 0.2
_GATHER_S, _DATAGRAMS_MAX = 0.004, 64  # what an autopilot sends at a time then wakes the thread once
_RETRY_S = 1.0
_SILENT_S = 10.0  # after this silence, a UDP peer is no longer sent to, unless it is the only one
_PEERS_MAX = 8
_UNSENT_MAX_BYTES = 1 << 16

_Stream: TypeAlias = socket.socket | serial.Serial
Peer = tuple[str, int] | None
Receive = Callable[[bytes, Peer], bool]
"""Takes bytes and their sender; returns whether they confirm the sender as a peer."""


class Transport(Protocol):
    def start(self, receive: Receive) -> None: ...  # begin to receive, in a thread; ``receive`` is called from there
    def send(self, data: bytes) -> None: ...  # from any thread; what cannot be sent now is lost
    def close(self) -> None: ...  # safe to call more than once


def opened(url: str) -> Transport:
    """Return the transport of a URL that ``checked_url`` has passed. Raises OSError when it cannot be opened."""
    scheme, _, rest = url.partition("://")
    host, _, last = rest.rpartition(":")
    address = (host, int(last))
    if scheme.startswith("udp"):
        return UdpTransport(address, listening=scheme == "udpin")
    if scheme == "tcpin":
        return TcpServerTransport(address)
    if scheme.startswith("serial"):
        return _StreamTransport(partial(_serial_opened, *address, scheme == "serial_flowcontrol"))
    return _StreamTransport(partial(_tcp_connected, address))


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
        peers = {known: since_s for known, since_s in self._peers.items() if now_s - since_s < _SILENT_S}
        peers[peer] = now_s
        while len(peers) > _PEERS_MAX:
            del peers[min(peers, key=peers.__getitem__)]
        self._peers = peers


@dataclass(slots=True)
class _Client:
    """A connection to a ``TcpServerTransport``; received_s: when it last sent what confirms it as a peer, or came."""

    connection: socket.socket
    peer: tuple[str, int]
    received_s: float
    confirmed: bool = False
    unsent: bytes = b""


class TcpServerTransport(_Threaded):
    """A TCP port. It goes on listening while clients are connected, and sends to confirmed peers only.

    A client that is not confirmed makes room for the next one, first of the host that has the most.
    """

    def __init__(self, address: tuple[str, int]) -> None:
        super().__init__()
        self._lock = threading.Lock()
        self._server = socket.create_server(address)
        self._server.setblocking(False)
        self._clients: dict[int, _Client] = {}

    def send(self, data: bytes) -> None:
        with self._lock:
            for client in self._clients.values():
                if client.confirmed and len(client.unsent) + len(data) <= _UNSENT_MAX_BYTES:
                    client.unsent += data
                    _flush(client)

    def close(self) -> None:
        super().close()
        with self._lock:
            for client in self._clients.values():
                client.connection.close()
            self._clients.clear()
        self._server.close()

    def _run(self, receive: Receive) -> None:
        while not self._closing.is_set():
            with self._lock:
                unsent = [number for number, client in self._clients.items() if client.unsent]
            readable, writable, _ = select.select([self._server.fileno(), *self._clients], unsent, [], _WAKE_S)
            if self._server.fileno() in readable:
                self._accept(time.monotonic())
            for number in readable:
                if number in self._clients:
                    self._read(number, receive)
            with self._lock:
                for number in writable:
                    if number in self._clients:
                        _flush(self._clients[number])
            now_s = time.monotonic()
            for number, client in list(self._clients.items()):
                if not client.confirmed and now_s - client.received_s > _SILENT_S:
                    self._drop(number)

    def _read(self, number: int, receive: Receive) -> None:
        client = self._clients[number]
        try:
            data = client.connection.recv(_READ_BYTES)
        except BlockingIOError:
            return
        except OSError:
            data = b""
        if not data:
            self._drop(number)
        elif receive(data, client.peer):
            client.confirmed, client.received_s = True, time.monotonic()

    def _accept(self, now_s: float) -> None:
        try:
            connection, peer = self._server.accept()
        except OSError:  # it has gone again, or this process has no descriptor left
            return
        connection.setblocking(False)
        if len(self._clients) >= _PEERS_MAX:
            hosts = Counter(client.peer[0] for client in self._clients.values())
            idle = [
                (-hosts[client.peer[0]], client.received_s, number)
                for number, client in self._clients.items()
                if not client.confirmed or now_s - client.received_s > _SILENT_S
            ]
            if not idle:
                connection.close()
                return
            self._drop(min(idle)[2])
        with self._lock:
            self._clients[connection.fileno()] = _Client(connection, peer, now_s)

    def _drop(self, number: int) -> None:
        with self._lock:
            self._clients.pop(number).connection.close()


def _flush(client: _Client) -> None:
    with contextlib.suppress(OSError):  # a broken connection is found by reading
        client.unsent = client.unsent[client.connection.send(client.unsent) :]


class _StreamTransport(_Threaded):
    """A stream of bytes on a file descriptor that may go and come again.

    connect: returns the next connection, not blocking; may raise OSError.
    """

    def __init__(self, connect: Callable[[], _Stream]) -> None:
        super().__init__()
        self._lock, self._unsent = threading.Lock(), b""
        self._connect = connect
        self._stream: _Stream | None = connect()

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
                    self._stream = self._connect()
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


def _tcp_connected(address: tuple[str, int]) -> socket.socket:
    connection = socket.create_connection(address, timeout=2.0)
    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    connection.setblocking(False)
    return connection


def _serial_opened(device: str, baud: int, flow_control: bool) -> serial.Serial:
    try:
        return serial.Serial(device, baud, timeout=0, write_timeout=0, rtscts=flow_control)
    except ValueError as error:
        raise OSError(22, f"{baud} baud is no rate of {device}") from error


class _Shared:
    """A transport and its users, each with what it receives by; None: it has not started."""

    def __init__(self, transport: Transport) -> None:
        self.transport = transport
        self.lock = threading.Lock()
        self.users: dict[_User, Receive | None] = {}
        self.started = False

    def received(self, data: bytes, peer: Peer) -> bool:
        with self.lock:
            receivers = [receive for receive in self.users.values() if receive is not None]
        shown = [receive(data, peer) for receive in receivers]  # each of them must receive it
        return any(shown)


class _User:
    """The transport as one of its users has it; it is closed when the last of them is."""

    def __init__(self, shared: _Shared) -> None:
        self._shared = shared
        shared.users[self] = None

    def start(self, receive: Receive) -> None:
        shared = self._shared
        with shared.lock:
            if self not in shared.users:
                return
            shared.users[self] = receive
            begins, shared.started = not shared.started, True
        if begins:
            shared.transport.start(shared.received)

    def send(self, data: bytes) -> None:
        if self in self._shared.users:
            self._shared.transport.send(data)

    def close(self) -> None:
        users = self._shared.users
        with self._shared.lock:
            last = [*users] == [self]
            users.pop(self, None)
        if last:
            self._shared.transport.close()


def sharing_opener(links: Sequence[Sequence[str]], opened: Callable[[str], Transport]) -> Callable[[str], Transport]:
    """Return what opens a URL; those that several of ``links`` have are opened once, for all of them."""
    every = [url for urls in links for url in urls]
    shared: dict[str, _Shared] = {}

    def opener(url: str) -> Transport:
        if every.count(url) == 1:
            return opened(url)
        if url not in shared:
            shared[url] = _Shared(opened(url))
        return _User(shared[url])

    return opener


_SCHEMES = ("udpin", "udpout", "tcpout", "tcpin")
_SERIAL_URL = re.compile(r"serial(?:_flowcontrol)?://(/[^:]+):\d+")


def checked_form(url: str) -> NetworkAddress | None:
    """Return the address in a URL, None for a serial line. Raises InputError for another form; nothing is opened."""
    if _SERIAL_URL.fullmatch(url):
        return None
    try:
        return NetworkAddress.read(url, _SCHEMES, ["serial:///dev/NAME:BAUD"])
    except ValueError as error:
        raise InputError(f"{error}.") from error


def checked_url(url: str) -> str:
    """Return the URL with its host in numbers.

    Raises InputError for what cannot be opened, a device that is not there, or a port in use.
    """
    address = checked_form(url)
    if address is None:
        device = url.partition("://")[2].rpartition(":")[0]
        if not Path(device).exists():
            raise InputError(f"{url!r}: there is no device {device}; plug it in, or name another.")
        return url
    host, port = address.resolved(repr(url))
    if address.scheme.endswith("in"):
        _probe_port(url, address.scheme, host, port)
    return f"{address.scheme}://{host}:{port}"


def _probe_port(url: str, scheme: str, address: str, port: int) -> None:
    # A second process may bind a UDP port and silently steal the traffic of the first: check first.
    kind = socket.SOCK_DGRAM if scheme == "udpin" else socket.SOCK_STREAM
    with socket.socket(socket.AF_INET, kind) as probe:
        try:
            probe.bind((address, port))
        except OSError as error:
            raise InputError(
                f"{url!r}: port {port} cannot be opened ({error.strerror}); "
                "end the program that uses it (a ground station?) or give another port."
            ) from error

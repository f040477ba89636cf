"""Bytes over UDP, TCP and a serial line, both ways, and links that go and come again."""

from __future__ import annotations

import contextlib
import os
import pty
import queue
import socket
import tty

import pytest

from sidelong.app.link.transport import opened

PATIENCE_S = 20.0


class Ear:
    """What a transport received; reports yes to those who send ``friend``."""

    def __init__(self) -> None:
        self.received: queue.Queue = queue.Queue()

    def __call__(self, data, _peer):
        self.received.put(data)
        return data.startswith(b"friend")

    def next(self):
        return self.received.get(timeout=PATIENCE_S)


@pytest.fixture
def listening():
    made = []

    def start(url):
        transport, ear = opened(url), Ear()
        made.append(transport)
        transport.start(ear)
        return transport, ear

    yield start
    for transport in made:
        transport.close()
        transport.close()
        transport.send(b"after the end")


def udp_socket():
    mine = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    mine.bind(("127.0.0.1", 0))
    mine.settimeout(PATIENCE_S)
    return mine


def test_udp_in_speaks_to_friends_only(listening, free_port):
    port = free_port()
    transport, ear = listening(f"udpin://127.0.0.1:{port}")
    with udp_socket() as friend, udp_socket() as stranger:
        stranger.sendto(b"stranger", ("127.0.0.1", port))
        assert ear.next() == b"stranger"
        for number in range(2):  # it is known as a friend once the next datagram is read
            friend.sendto(b"friend %d" % number, ("127.0.0.1", port))
            assert ear.next() == b"friend %d" % number
        transport.send(b"answer")
        assert friend.recv(100) == b"answer"
        stranger.setblocking(False)
        with pytest.raises(BlockingIOError):
            stranger.recv(100)


def test_udp_out_receives_no_one_else(listening):
    with udp_socket() as peer, udp_socket() as stranger:
        transport, ear = listening(f"udpout://127.0.0.1:{peer.getsockname()[1]}")
        transport.send(b"hello")
        data, address = peer.recvfrom(100)
        assert data == b"hello"
        stranger.sendto(b"stranger", address)
        peer.sendto(b"friend", address)
        assert ear.next() == b"friend"


def test_tcp_out_connects_again(listening):
    with socket.create_server(("127.0.0.1", 0)) as server:
        server.settimeout(PATIENCE_S)
        transport, ear = listening(f"tcpout://127.0.0.1:{server.getsockname()[1]}")
        for number in range(2):
            connection, _ = server.accept()
            with connection:
                connection.settimeout(PATIENCE_S)
                connection.sendall(b"from the vehicle %d" % number)
                assert ear.next() == b"from the vehicle %d" % number
                transport.send(b"to the vehicle")
                assert connection.recv(100) == b"to the vehicle"


def tcp_client(port):
    return socket.create_connection(("127.0.0.1", port), timeout=PATIENCE_S)


def test_tcp_in_takes_the_next_client(listening, free_port):
    port = free_port()
    transport, ear = listening(f"tcpin://127.0.0.1:{port}")
    for _ in range(2):
        with tcp_client(port) as client:
            for _ in range(2):  # it is known as a friend once the next bytes are read
                client.sendall(b"friend")
                assert ear.next() == b"friend"
            transport.send(b"answer")
            assert client.recv(100) == b"answer"


def test_strangers_who_connect_first_do_not_shut_the_vehicle_out_of_tcp_in(listening, free_port):
    port = free_port()
    transport, ear = listening(f"tcpin://127.0.0.1:{port}")
    strangers = [tcp_client(port) for _ in range(30)]
    with tcp_client(port) as vehicle:
        for _ in range(2):
            vehicle.sendall(b"friend")
            assert ear.next() == b"friend"
        later = [tcp_client(port) for _ in range(30)]
        later[-1].sendall(b"stranger")
        assert ear.next() == b"stranger"
        transport.send(b"answer")
        assert vehicle.recv(100) == b"answer"
    for stranger in (*strangers, *later):
        stranger.setblocking(False)
        with contextlib.suppress(BlockingIOError, ConnectionResetError):
            assert stranger.recv(100) == b""
        stranger.close()


def test_a_peer_that_reads_nothing_does_not_hold_up_the_sender(listening):
    with socket.create_server(("127.0.0.1", 0)) as server:
        transport, ear = listening(f"tcpout://127.0.0.1:{server.getsockname()[1]}")
        connection, _ = server.accept()
        with connection:
            for _ in range(20_000):
                transport.send(bytes(1000))
            connection.sendall(b"friend")
            assert ear.next() == b"friend"


def test_a_serial_line(listening):
    ours, theirs = pty.openpty()
    tty.setraw(ours)
    device = os.ttyname(theirs)
    transport, ear = listening(f"serial://{device}:57600")
    os.write(ours, b"from the vehicle")
    assert ear.next() == b"from the vehicle"
    transport.send(b"to the vehicle")
    assert os.read(ours, 100) == b"to the vehicle"
    os.close(theirs)
    os.close(ours)


@pytest.mark.parametrize("url", ["serial:///dev/none:57600", "tcpout://127.0.0.1:1", "udpin://192.0.2.1:14550"])
def test_what_cannot_be_opened_is_an_oserror(url):
    with pytest.raises(OSError):
        opened(url)

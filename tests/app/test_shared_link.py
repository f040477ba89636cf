"""One transport for several users: all hear, each sends, the last one closes."""

from __future__ import annotations

import pytest

from app.link.shared import sharing_opener

A, B, C = "udpin://127.0.0.1:1", "udpin://127.0.0.1:2", "udpin://127.0.0.1:3"


class Wire:
    def __init__(self, url):
        self.url, self.sent, self.closed, self.starts, self.receive = url, [], 0, 0, None

    def start(self, receive):
        self.receive, self.starts = receive, self.starts + 1

    def send(self, data):
        self.sent.append(data)

    def close(self):
        self.closed += 1


@pytest.fixture
def opened():
    """Return the opener of three links, of which the first two share one URL, and the transports that it opens."""
    wires: dict[str, Wire] = {}

    def open_one(url):
        assert url not in wires, "opened twice"
        wires[url] = Wire(url)
        return wires[url]

    return sharing_opener([(A, C), (A,), (B,)], open_one), wires


def test_a_url_of_one_link_is_its_own(opened):
    opener, wires = opened
    assert opener(B) is wires[B]
    assert opener(C) is wires[C]


def test_all_users_hear_and_send(opened):
    opener, wires = opened
    heard = {"one": [], "other": []}
    one, other = opener(A), opener(A)
    one.start(lambda data, peer: heard["one"].append(data) or False)
    other.start(lambda data, peer: heard["other"].append(data) or True)
    assert wires[A].starts == 1
    assert wires[A].receive(b"frame", None) is True  # it is enough that one of them knows the peer
    assert heard == {"one": [b"frame"], "other": [b"frame"]}
    one.send(b"1")
    other.send(b"2")
    assert wires[A].sent == [b"1", b"2"]


def test_the_last_user_closes_it(opened):
    opener, wires = opened
    one, other = opener(A), opener(A)
    heard = []
    one.start(lambda data, peer: heard.append(data) or True)
    one.close()
    one.close()
    one.send(b"too late")
    assert (wires[A].closed, wires[A].sent) == (0, [])
    wires[A].receive(b"frame", None)
    assert heard == []
    other.close()
    assert wires[A].closed == 1

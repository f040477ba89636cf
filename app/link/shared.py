"""One transport for the links of several vehicles: each receives all data, and all send on it."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence

from sidelong.app.link.transport import Peer, Receive, Transport


class SharedTransport:
    """Hands out ``user`` after ``user``; the transport is closed when the last of them is."""

    def __init__(self, transport: Transport) -> None:
        self._transport = transport
        self._lock = threading.Lock()
        self._receivers: dict[Transport, Receive] = {}
        self._users = 0
        self._started = False

    def user(self) -> Transport:
        """Return the transport as one of its users has it."""
        self._users += 1
        return _User(self)

    def send(self, data: bytes) -> None:
        """Send for one of the users."""
        self._transport.send(data)

    def join(self, user: Transport, receive: Receive) -> None:
        """Add a user, which receives data from now on."""
        with self._lock:
            self._receivers[user] = receive
            begins, self._started = not self._started, True
        if begins:
            self._transport.start(self._received)

    def leave(self, user: Transport) -> None:
        """Remove a user; close the transport after the last one."""
        with self._lock:
            self._receivers.pop(user, None)
            self._users -= 1
            last = self._users == 0
        if last:
            self._transport.close()

    def _received(self, data: bytes, peer: Peer) -> bool:
        with self._lock:
            receivers = list(self._receivers.values())
        shown = [receive(data, peer) for receive in receivers]  # each of them must receive it
        return any(shown)


class _User:
    def __init__(self, shared: SharedTransport) -> None:
        self._shared: SharedTransport | None = shared

    def start(self, receive: Receive) -> None:
        if self._shared is not None:
            self._shared.join(self, receive)

    def send(self, data: bytes) -> None:
        if self._shared is not None:
            self._shared.send(data)

    def close(self) -> None:
        shared, self._shared = self._shared, None
        if shared is not None:
            shared.leave(self)


def sharing_opener(links: Sequence[Sequence[str]], opened: Callable[[str], Transport]) -> Callable[[str], Transport]:
    """Return what opens a URL; those that several of ``links`` have are opened once, for all of them."""
    every = [url for urls in links for url in urls]
    shared: dict[str, SharedTransport] = {}

    def opener(url: str) -> Transport:
        if every.count(url) == 1:
            return opened(url)
        if url not in shared:
            shared[url] = SharedTransport(opened(url))
        return shared[url].user()

    return opener

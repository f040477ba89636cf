"""One transport for the links of several vehicles: each receives all data, and all send on it."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence

from sidelong.app.link.transport import Peer, Receive, Transport


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

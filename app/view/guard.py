"""Limits on the connections to the page: how many in all and per client, and how long a request may take.

A connection counts from the moment it is accepted, before any TLS handshake.
"""

from __future__ import annotations

import asyncio
import socket
from collections import Counter
from typing import Any, ClassVar, Self

from starlette.types import ASGIApp, Receive, Scope, Send

_CONNECTIONS_MAX, _OF_ONE_CLIENT_MAX = 100, 24
_REQUEST_WITHIN_S = 10.0


class _Connection(socket.socket):
    """An accepted connection. It is counted until it is closed, and shut down unless a request comes in time."""

    count: ClassVar[Counter[str]] = Counter()  # of the open connections, by client address
    by_peer: ClassVar[dict[tuple[str, int], _Connection]] = {}
    peer: tuple[str, int]
    _deadline: asyncio.TimerHandle | None = None

    @classmethod
    def counted(cls, accepted: socket.socket, peer: tuple[str, int]) -> Self:
        """Take over an accepted socket."""
        self = cls(accepted.family, accepted.type, accepted.proto, fileno=accepted.detach())
        self.peer = peer
        cls.by_peer[peer] = self
        cls.count[peer[0]] += 1
        self.await_request()
        return self

    def await_request(self) -> None:
        """Shut the connection down unless ``request_came`` is called in time."""
        self.request_came()
        self._deadline = asyncio.get_running_loop().call_later(_REQUEST_WITHIN_S, self._expire)

    def request_came(self) -> None:
        if self._deadline is not None:
            self._deadline.cancel()
            self._deadline = None

    def _expire(self) -> None:
        try:
            self.shutdown(socket.SHUT_RDWR)  # the event loop reads the end, and closes it
        except OSError:
            self.close()  # it was never connected, or is gone

    def close(self) -> None:
        self.request_came()
        if self.by_peer.pop(self.peer, None) is not None:
            self.count[self.peer[0]] -= 1
            if not self.count[self.peer[0]]:
                del self.count[self.peer[0]]
        super().close()


class Listener(socket.socket):
    """A listening socket that drops connections beyond the limits."""

    def accept(self) -> tuple[socket.socket, Any]:
        """Return the next connection that is within the limits. Raises BlockingIOError if there is none."""
        while True:
            accepted, peer = super().accept()
            count = _Connection.count
            if count.total() < _CONNECTIONS_MAX and count[peer[0]] < _OF_ONE_CLIENT_MAX:
                return _Connection.counted(accepted, peer), peer
            accepted.close()


def timed(app: ASGIApp) -> ASGIApp:
    """Return an application that reports to its ``Listener`` when a request has arrived and was answered."""

    async def reporting(scope: Scope, receive: Receive, send: Send) -> None:
        connection = _Connection.by_peer.get(tuple(scope.get("client") or ()))
        if connection is not None:
            connection.request_came()
        try:
            await app(scope, receive, send)
        finally:
            if connection is not None and _Connection.by_peer.get(connection.peer) is connection:
                connection.await_request()  # the next one

    return reporting

"""Connections to the page: so many in all and from one address, and each request within a time."""

from __future__ import annotations

import asyncio
from collections import Counter
from typing import Any, ClassVar

from uvicorn.protocols.http.h11_impl import H11Protocol

_CONNECTIONS_MAX, _OF_ONE_CLIENT_MAX = 100, 24
_REQUEST_WITHIN_S = 10.0


class GuardedProtocol(H11Protocol):
    """uvicorn's, but one that takes no more connections than it can bear, and none that sends its request slowly."""

    _clients: ClassVar[Counter[str]] = Counter()

    def __init__(self, *args: Any, **options: Any) -> None:
        super().__init__(*args, **options)
        self._deadline: asyncio.TimerHandle | None = None
        self._name = ""

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]  # as uvicorn has it
        super().connection_made(transport)
        name = self.client[0] if self.client is not None else "?"
        if self._clients.total() >= _CONNECTIONS_MAX or self._clients[name] >= _OF_ONE_CLIENT_MAX:
            transport.abort()
            return
        self._name = name
        self._clients[name] += 1
        self._wait()

    def connection_lost(self, exc: Exception | None) -> None:
        self._stop_waiting()
        if self._name:
            self._clients[self._name] -= 1
            if not self._clients[self._name]:
                del self._clients[self._name]
            self._name = ""
        super().connection_lost(exc)

    def handle_events(self) -> None:
        before = self.cycle
        super().handle_events()
        if self.cycle is not before:
            self._stop_waiting()

    def on_response_complete(self) -> None:
        self._wait()
        super().on_response_complete()

    def _wait(self) -> None:
        self._stop_waiting()
        self._deadline = self.loop.call_later(_REQUEST_WITHIN_S, self.transport.abort)

    def _stop_waiting(self) -> None:
        if self._deadline is not None:
            self._deadline.cancel()
            self._deadline = None

"""The page's server: static files, the states that each browser asks for one by one, and the button presses.

A browser asks for what is newer than what it has, and its request waits until there is something. So a slow line
drops states and never queues them. A page knows how old the shown state is at most: as old as the program's last
message was when it was sent, and the time that the exchange took. Other sites cannot reach this server: not by
another host name (Host), from another origin (Origin, Sec-Fetch-Site) or in a frame.

This module is imported by the server's process alone and must stay quick to load: nothing of mission or estimators.
"""

from __future__ import annotations

import asyncio
import ipaddress
import json
import re
import secrets
import socket
import sys
import time
from collections import Counter
from collections.abc import Callable, Sequence
from functools import partial
from importlib.resources import files
from pathlib import Path
from typing import Any, ClassVar, Self

import uvicorn
from starlette.applications import Starlette
from starlette.datastructures import MutableHeaders
from starlette.middleware import Middleware
from starlette.middleware.gzip import GZipMiddleware
from starlette.requests import Request
from starlette.responses import JSONResponse, PlainTextResponse, RedirectResponse, Response
from starlette.routing import Route
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from sidelong.app.network import Allowances
from sidelong.app.view.address import LOOPBACK
from sidelong.app.view.background import Background, is_tile, media_type, readable_tile
from sidelong.app.view.history import FrameHistory, Json

_CONNECTIONS_MAX, _CONNECTIONS_OF_ONE_MAX = 100, 24
_REQUEST_WITHIN_S = 10.0


class _Connection(socket.socket):
    """An accepted connection. It is counted until it is closed, and shut down unless a request comes in time."""

    count: ClassVar[Counter[str]] = Counter()  # of the open connections, by client address
    by_peer: ClassVar[dict[tuple[str, int], _Connection]] = {}
    peer: tuple[str, int]
    _deadline: asyncio.TimerHandle | None = None

    @classmethod
    def counted(cls, accepted: socket.socket, peer: tuple[str, int]) -> Self:
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
            if count.total() < _CONNECTIONS_MAX and count[peer[0]] < _CONNECTIONS_OF_ONE_MAX:
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


_SESSIONS_MAX = 100


class Access:
    """The sessions. host: the address that is served at; tokens: what was printed, '' on loopback."""

    def __init__(self, host: str, operator_token: str, viewer_token: str) -> None:
        self.local = host in LOOPBACK
        self._host = host
        self._tokens = {"operator": operator_token, "viewer": viewer_token}
        self._sessions: dict[str, str] = {}  # the roles
        self._operator = ""

    def knows_host(self, name: str) -> bool:
        """Return whether a Host header matches the served address, to reject requests by another host name."""
        name = name.rpartition(":")[0] if name.rpartition(":")[2].isdigit() else name
        if self.local:
            return name in LOOPBACK
        if name == self._host:
            return True
        try:
            ipaddress.ip_address(name.strip("[]"))
        except ValueError:
            return False
        return True

    def entered(self, token: str) -> str | None:
        """Return a new session for a token, None for a wrong one. The operator's takes the buttons over."""
        given = token.encode()
        for role, right in self._tokens.items():
            if right and secrets.compare_digest(given, right.encode()):
                session = secrets.token_urlsafe(16)
                self._sessions[session] = role
                while len(self._sessions) > _SESSIONS_MAX:
                    oldest = next(one for one in self._sessions if one != self._operator)
                    del self._sessions[oldest]
                if role == "operator":
                    self._operator = session
                return session
        return None

    def sees(self, session: str) -> bool:
        """Whether a session may see the page."""
        return self.local or session in self._sessions

    def refusal(self, session: str) -> str | None:
        """Return why a session may not press buttons; None if it may."""
        if self.local or (session and session == self._operator):
            return None
        if self._sessions.get(session) == "operator":
            return "another client has the buttons now; open the operator's address again to take them over"
        return "this page is for watching only"

    def who(self, client: str) -> str:
        """Return how the page names a client to others."""
        return f"operator at {'this machine' if self.local else client}"


_COOKIE = "sidelong"
_MEDIA = {"html": "text/html", "css": "text/css", "js": "text/javascript"}
_HEADERS = {
    "Content-Security-Policy": (
        "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; img-src 'self' data:; "
        "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    ),
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cache-Control": "no-store",
    "X-Frame-Options": "DENY",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cross-Origin-Opener-Policy": "same-origin",
}
_BODY_MAX_BYTES, _BODY_WITHIN_S = 1024, 5.0
_PAGES_MAX, _OF_ONE_CLIENT_MAX = 50, 16  # waiting requests; fewer than a client has connections
_WAITS_S = 5.0  # for news, before it is answered that there is none
_ACTIONS: dict[str, set[str | None]] = {
    "hold": {None},
    "resume": {None},
    "end": {None},
    "confirm": {None},
    "side": {"left", "right"},
}
_NUMBERS, _NUMBER_MAX, _WORDS_MAX = ("radius_m", "range_min_m", "range_max_m", "height_m"), 1e5, 20  # of a change
_ALARM = re.compile("[a-z]{1,20}")
_OF_SERVICE = frozenset({"watch", "release"})  # buttons of a service's page


_LINE_MAX_BYTES = 1 << 22


class Server:
    """The application: passes messages of the flight to all pages; ``press`` receives their button presses."""

    def __init__(
        self,
        access: Access,
        press: Callable[[Json], None],
        under: Background | None = None,
        replay: bool = False,
        fleet: Sequence[str] = (),
        service: bool = False,
    ) -> None:
        self._access, self._press = access, press
        self._known = replay_button_of if replay else partial(button_of, fleet=frozenset(fleet), service=service)
        self._under, self._tiles = under, under.opened() if under is not None else None
        self._shade: Path | None = None
        self._camera: Path | None = None
        self._history = FrameHistory(aircraft=max(len(fleet), 1))
        self._news = asyncio.Event()  # set when there is some; another one for each message
        self._waiting: Counter[str] = Counter()  # requests for news, by client
        self._requests = Allowances(burst=300.0, rate_s=50.0)
        self._often = Allowances(burst=2000.0, rate_s=300.0)  # states, and the map's pictures
        self._guesses = Allowances(burst=10.0, rate_s=0.2)
        self._presses = Allowances(burst=20.0, rate_s=5.0)
        self._files = {one.name: one.read_bytes() for one in (files("sidelong.app.view") / "page").iterdir()}
        packed = [Middleware(GZipMiddleware, compresslevel=5)]  # pictures and tiles are compressed already
        routes = [
            Route("/", self._index, middleware=packed),
            Route("/state", self._state, middleware=packed),
            Route("/press", self._pressed, methods=["POST"]),
            Route("/map/{zoom:int}/{column:int}/{row:int}", self._tile),
            Route("/map", self._picture),
            Route("/shade", self._picture),
            Route("/picture", self._filmed),
            Route("/{name}", self._file, middleware=packed),
        ]
        self.app = timed(self._guarded(Starlette(routes=routes)))

    def publish(self, update: Json) -> None:
        """Keep an update for pages that come later, and wake those that wait."""
        if "shade" in update:
            self._shade = Path(update.pop("shade"))
        if "picture" in update:
            self._camera = Path(update.pop("picture"))
        self._history.add(update)
        self._news.set()
        self._news = asyncio.Event()

    def close(self) -> None:
        self.publish({"over": True})

    # -- requests ------------------------------------------------------------------------------------------

    def _guarded(self, inner: ASGIApp) -> ASGIApp:

        async def app(scope: Scope, receive: Receive, send: Send) -> None:
            async def with_headers(message: Message) -> None:
                if message["type"] == "http.response.start":
                    given = MutableHeaders(scope=message)
                    for name, value in _HEADERS.items():
                        given.setdefault(name, value)
                await send(message)

            answer: ASGIApp = self._unwanted(Request(scope)) or inner
            await answer(scope, receive, with_headers)

        return app

    def _unwanted(self, request: Request) -> Response | None:
        often = request.url.path.startswith(("/map", "/shade", "/state", "/picture"))
        allowances = self._often if often else self._requests
        if not allowances.used(_client(request), time.monotonic()):
            return PlainTextResponse("too many requests", 429)
        if not self._access.knows_host(request.headers.get("host", "")):
            return PlainTextResponse("this page is served at the address that was printed only", 403)
        if request.headers.get("sec-fetch-site", "none") == "cross-site" and request.url.path != "/":
            return PlainTextResponse("another site asks for this", 403)
        return None if request.url.path == "/" else self._refused(request)

    def _refused(self, request: Request) -> Response | None:
        if self._access.sees(request.cookies.get(_COOKIE, "")):
            return None
        return PlainTextResponse("open the page with the address that was printed: it carries the token", 403)

    async def _index(self, request: Request) -> Response:
        given = request.query_params.get("token")
        if given is not None and not self._access.local:
            if not self._guesses.used(_client(request), time.monotonic()):
                return PlainTextResponse("too many tokens tried; wait 5 s", 429)
            session = self._access.entered(given)
            if session is not None:
                entered = RedirectResponse("/", 303)  # the token does not stay in the address
                secure = request.url.scheme == "https"
                entered.set_cookie(_COOKIE, session, httponly=True, samesite="strict", secure=secure)
                return entered
        return self._refused(request) or await self._file(request)

    async def _file(self, request: Request) -> Response:
        name = request.path_params.get("name", "index.html")
        if name not in self._files:
            return PlainTextResponse("not found", 404)
        return Response(self._files[name], media_type=_MEDIA[name.rpartition(".")[2]])

    async def _tile(self, request: Request) -> Response:
        at = tuple(request.path_params[name] for name in ("zoom", "column", "row"))
        return _shown(readable_tile(self._tiles, *at) if self._tiles is not None and is_tile(*at) else None)

    async def _picture(self, request: Request) -> Response:
        under = self._under.path if self._under and not self._tiles else None
        return _shown(_content(self._shade if request.url.path == "/shade" else under))

    async def _filmed(self, _request: Request) -> Response:
        data = _content(self._camera)
        if data is None:
            return PlainTextResponse("no camera", 404)
        return Response(data, media_type="application/octet-stream")

    async def _state(self, request: Request) -> Response:
        """Answer with what is newer than the page has, as soon as there is something."""
        client, have, since_s = _client(request), request.query_params.get("have", ""), time.monotonic()
        if have == self._history.cursor:
            if self._waiting.total() >= _PAGES_MAX or self._waiting[client] >= _OF_ONE_CLIENT_MAX:
                return PlainTextResponse("too many live maps are open; close one and load this page again", 503)
            self._waiting[client] += 1
            try:
                await asyncio.wait_for(self._news.wait(), _WAITS_S)
            except TimeoutError:
                pass
            finally:
                self._waiting -= Counter({client: 1})  # drops those at zero
        answer = self._history.since(have) | {"held_s": round(time.monotonic() - since_s, 3)}
        return JSONResponse(answer)

    async def _pressed(self, request: Request) -> Response:
        # A page of another origin can neither send this content type unasked nor leave out or forge its Origin.
        own_origin = f"{request.url.scheme}://{request.headers.get('host', '')}"
        if request.headers.get("origin") != own_origin or request.headers.get("content-type") != "application/json":
            return PlainTextResponse("buttons are taken from the page itself only", 403)
        not_allowed = self._access.refusal(request.cookies.get(_COOKIE, ""))
        if not_allowed is not None:
            return PlainTextResponse(not_allowed, 403)
        body = await _body(request)
        if body is None:
            return PlainTextResponse("that is no button: too long, or too slow", 413)
        if not self._presses.used(_client(request), time.monotonic()):
            return PlainTextResponse("too many buttons at once; wait", 429)
        try:
            button = self._known(json.loads(body))
        except (ValueError, TypeError, KeyError, AttributeError, RecursionError):
            return PlainTextResponse("no such button", 400)
        self._press({**button, "who": self._access.who(_client(request))})
        return JSONResponse({"passed on": button["action"]}, 202)


def _content(path: Path | None) -> bytes | None:
    """Return a picture's bytes; None if there is no picture, or it can no longer be read."""
    try:
        return path.read_bytes() if path is not None else None
    except OSError:
        return None


def _shown(data: bytes | None) -> Response:
    if data is None:
        return PlainTextResponse("not on this map", 404)
    return Response(data, media_type=media_type(data), headers={"Cache-Control": "private, max-age=3600"})


def button_of(press: Json, fleet: frozenset[str] = frozenset(), *, service: bool = False) -> Json:
    """Return the known part of a request from a flight's page; service: whether watches are begun and released there.

    Raises ValueError, TypeError, KeyError or AttributeError: the page of this flight has no such button.
    """
    action = press["action"]
    if service and action in _OF_SERVICE:
        return {"action": action}
    if action == "relieve":
        name = press["name"]
        if name not in fleet:
            raise ValueError(f"{name!r} is not an aircraft of this flight")
        return {"action": action, "name": name}
    if action == "track":
        return {"action": action, "where": _shares(press["where"])}
    if action == "acknowledge":
        alarm, aircraft = press["alarm"], press["aircraft"]
        if not _ALARM.fullmatch(alarm) or aircraft not in {"", *fleet}:
            raise ValueError
        return {"action": action, "alarm": alarm, "aircraft": aircraft}
    if action != "change":
        side = press.get("side")
        if side not in _ACTIONS[action]:
            raise ValueError
        return {"action": action, "side": side}
    values = press["values"]
    if not values or not all(_fits(key, value) for key, value in values.items()):
        raise ValueError
    return {"action": action, "values": values}


def _fits(key: str, value: object) -> bool:
    if key == "side":
        return isinstance(value, str) and len(value) <= _WORDS_MAX
    return key in _NUMBERS and isinstance(value, int | float) and value is not True and 0.0 < value < _NUMBER_MAX


def _shares(where: list[float]) -> list[float]:
    """Return a point or a rectangle of a picture, or nothing. Raises ValueError, TypeError."""
    if len(where) not in (0, 2, 4) or not all(type(share) in (int, float) and 0 <= share <= 1 for share in where):
        raise ValueError
    return where


def replay_button_of(press: Json) -> Json:
    """Return a press on a replay's page if it is valid; none of them commands a flight. Raises as above."""
    action, value = press["action"], press.get("value")
    is_number = isinstance(value, int | float) and not isinstance(value, bool) and -1e9 < value < 1e9
    if action not in {"play", "pause", "seek", "speed", "step"} or is_number != (action not in {"play", "pause"}):
        raise ValueError
    return {"action": action, "value": value}


def _client(request: Request) -> str:
    return request.client.host if request.client is not None else "?"


async def _body(request: Request) -> bytes | None:
    """Return a request's body; None where it is too long or does not come."""
    body = b""
    try:
        async with asyncio.timeout(_BODY_WITHIN_S):
            async for part in request.stream():
                body += part
                if len(body) > _BODY_MAX_BYTES:
                    return None
    except TimeoutError:
        return None
    return body


def _listening(host: str, port: int) -> Listener:
    listener = Listener(socket.AF_INET, socket.SOCK_STREAM)
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        listener.bind((host, port))
        listener.listen()  # from here on a browser may come: it waits until the server runs
    except OSError as error:
        sys.exit(f"port {port} cannot be opened ({error.strerror})")
    return listener


async def _serve() -> None:
    """Serve the page: states come in on standard input, until that ends; buttons go out on standard output.

    The first line in are the options, the first line out {"port"}.
    """
    reader = asyncio.StreamReader(_LINE_MAX_BYTES)
    await asyncio.get_running_loop().connect_read_pipe(lambda: asyncio.StreamReaderProtocol(reader), sys.stdin)
    options = json.loads(await reader.readline())
    listener = _listening(options["host"], options["port"])

    def press(pressed: Json) -> None:
        print(json.dumps(pressed), flush=True)

    under = options["map"] and Background(Path(options["map"]["path"]), zooms=options["map"]["zooms"])
    access = Access(options["host"], options["operator_token"], options["viewer_token"])
    server = Server(access, press, under, options["replay"], options["fleet"], options["service"])
    configured = uvicorn.Config(
        server.app,
        http="h11",
        ws="none",
        lifespan="off",
        log_level="error",
        access_log=False,
        server_header=False,
        proxy_headers=False,  # the client address is that of the connection
        timeout_keep_alive=30,  # a page on a stalled line comes again on the connection that it has
        timeout_graceful_shutdown=1,
        ssl_certfile=options["cert"],
        ssl_keyfile=options["key"],
    )
    try:
        configured.load()
    except (OSError, ValueError) as error:  # ssl.SSLError is an OSError
        sys.exit(f"the certificate or its key cannot be used ({error})")
    runner = uvicorn.Server(configured)
    serving = asyncio.create_task(runner.serve(sockets=[listener]))
    print(json.dumps({"port": listener.getsockname()[1]}), flush=True)
    while (line := await reader.readline()).endswith(b"\n"):  # a cut line is the end, too
        server.publish(json.loads(line))
    server.close()
    runner.should_exit = True
    await serving


if __name__ == "__main__":
    asyncio.run(_serve())

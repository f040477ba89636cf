"""The page's server: static files, a stream of states to each browser, and the buttons back.

Access: from loopback, to loopback names only, so that no foreign page can reach it by a name of its own; anything
else needs the token, given once in the address and kept as a cookie. Buttons are taken from the page itself only.

This module is imported by the server's process alone and must stay quick to load: nothing of mission or estimators.
"""

from __future__ import annotations

import asyncio
import json
import secrets
from collections import deque
from collections.abc import AsyncIterator, Callable
from importlib.resources import files
from typing import Any
from urllib.parse import urlsplit

from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import JSONResponse, PlainTextResponse, RedirectResponse, Response, StreamingResponse
from starlette.routing import Route

from app.view.address import LOOPBACK

Json = dict[str, Any]

_COOKIE = "sidelong"
_MEDIA = {
    "index.html": "text/html",
    "page.css": "text/css",
    "page.js": "text/javascript",
    "map.js": "text/javascript",
    "plots.js": "text/javascript",
}
_HEADERS = {
    "Content-Security-Policy": (
        "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; img-src 'self' data:; "
        "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    ),
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cache-Control": "no-store",
}
_TRAIL_KEPT, _SERIES_KEPT, _WORDS_KEPT = 2400, 2400, 500  # 20 minutes of trail
_UNSENT_MAX = 50  # states; a browser that is further behind is made to begin anew
_ACTIONS: dict[str, set[str | None]] = {"hold": {None}, "resume": {None}, "end": {None}, "side": {"left", "right"}}
_SERIES = ("nis", "range_age_s", "gimbal_age_s", "link_age_s")


class History:
    """What a page that opens late has to be told."""

    def __init__(self) -> None:
        self.setting: Json = {}
        self.state: Json | None = None
        self.start_s: float | None = None
        self.trail: deque[list[float]] = deque(maxlen=_TRAIL_KEPT)
        self.said: deque[list[Any]] = deque(maxlen=_WORDS_KEPT)
        self.series: deque[Json] = deque(maxlen=_SERIES_KEPT)

    def add(self, told: Json) -> None:
        self.setting = told.get("setting", self.setting)
        self.start_s = told["start_s"]
        self.trail.extend(told["trail"])
        self.said.extend(told["said"])
        state = told.get("state")
        if state is not None:
            self.state = state
            self.series.append(_sample(state))

    def told(self) -> Json:
        """Return all of it as one message."""
        return {
            "setting": self.setting,
            "start_s": self.start_s,
            "trail": list(self.trail),
            "said": list(self.said),
            "series": list(self.series),
            **({"state": self.state} if self.state is not None else {}),
        }


def _sample(state: Json) -> Json:
    """Return what the plots draw of a state."""
    target, aircraft = state["target"] or {}, state["aircraft"] or {}
    return {
        "time_s": state["time_s"],
        "target_m": target.get("at_m"),
        "range_m": target.get("range_m"),
        "angle_rad": target.get("angle_rad"),
        "bank_rad": aircraft.get("bank_rad"),
        **{key: state[key] for key in _SERIES},
    }


class Server:
    """The application. ``tell`` passes a message of the flight on to all pages; ``press`` gets their buttons."""

    def __init__(self, host: str, token: str, press: Callable[[Json], None]) -> None:
        self._token, self._press = token, press
        self._loopback = host in LOOPBACK
        self._history = History()
        self._pages: set[asyncio.Queue[bytes | None]] = set()
        folder = files("app.view") / "page"
        self._files = {name: (folder / name).read_bytes() for name in _MEDIA}
        self.app = Starlette(
            routes=[
                Route("/", self._index),
                Route("/events", self._events),
                Route("/press", self._pressed, methods=["POST"]),
                Route("/{name}", self._file),
            ]
        )

    def tell(self, told: Json) -> None:
        """Pass a message on to every page."""
        self._history.add(told)
        event = _event(told | ({"series": [_sample(told["state"])]} if "state" in told else {}))
        for page in list(self._pages):
            try:
                page.put_nowait(event)
            except asyncio.QueueFull:
                self._pages.discard(page)
                while not page.empty():
                    page.get_nowait()
                page.put_nowait(None)

    def close(self) -> None:
        """End every page's stream."""
        self.tell({"start_s": self._history.start_s, "trail": [], "said": [], "over": True})
        for page in self._pages:
            page.put_nowait(None)

    # -- requests ------------------------------------------------------------------------------------------

    def _refused(self, request: Request) -> Response | None:
        host = request.headers.get("host", "")
        if self._loopback:
            if host.partition(":")[0] not in LOOPBACK:
                return PlainTextResponse("this page is served to this machine only", 403)
        elif not secrets.compare_digest(request.cookies.get(_COOKIE, "").encode(), self._token.encode()):
            return PlainTextResponse("open the page with the address that was printed: it carries the token", 403)
        return None

    async def _index(self, request: Request) -> Response:
        given = request.query_params.get("token")
        if given is not None and not self._loopback and secrets.compare_digest(given.encode(), self._token.encode()):
            entered = RedirectResponse("/", 303, headers=_HEADERS)  # the token does not stay in the address
            entered.set_cookie(_COOKIE, self._token, httponly=True, samesite="strict")
            return entered
        return self._refused(request) or self._static("index.html")

    async def _file(self, request: Request) -> Response:
        name = request.path_params["name"]
        return self._refused(request) or (
            self._static(name) if name in _MEDIA else PlainTextResponse("not found", 404)
        )

    def _static(self, name: str) -> Response:
        return Response(self._files[name], media_type=_MEDIA[name], headers=_HEADERS)

    async def _events(self, request: Request) -> Response:
        return self._refused(request) or StreamingResponse(
            self._stream(), media_type="text/event-stream", headers=_HEADERS
        )

    async def _stream(self) -> AsyncIterator[bytes]:
        page: asyncio.Queue[bytes | None] = asyncio.Queue(_UNSENT_MAX)
        self._pages.add(page)
        try:
            yield _event(self._history.told() | {"anew": True})
            while (event := await page.get()) is not None:
                yield event
        finally:
            self._pages.discard(page)

    async def _pressed(self, request: Request) -> Response:
        refused = self._refused(request)
        if refused is not None:
            return refused
        # A page of another origin can neither send this content type unasked nor leave out or forge its Origin.
        origin, host = request.headers.get("origin", ""), request.headers.get("host", "")
        if urlsplit(origin).netloc != host or request.headers.get("content-type") != "application/json":
            return PlainTextResponse("buttons are taken from the page itself only", 403)
        try:
            press = json.loads(await request.body())
            action, side = press["action"], press.get("side")
            known = side in _ACTIONS[action]
        except (ValueError, TypeError, KeyError, AttributeError):
            known = False
        if not known:
            return PlainTextResponse("no such button", 400)
        self._press({"action": action, "side": side})
        return JSONResponse({"passed on": action}, 202)


def _event(told: Json) -> bytes:
    return b"data: " + json.dumps(told, separators=(",", ":")).encode() + b"\n\n"

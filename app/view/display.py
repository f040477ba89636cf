"""A ``Display`` that feeds the page in the browser, in addition to the terminal, and passes on its button presses."""

from __future__ import annotations

import asyncio
import contextlib
import json
import math
import os
import tempfile
import time
import webbrowser
from collections import deque
from collections.abc import AsyncIterator, Callable, Iterator, Sequence
from pathlib import Path
from typing import TypeVar

from sidelong.app.config import Config
from sidelong.app.flight.loop import FlightDisplay, Wish
from sidelong.app.view.address import PageAddress
from sidelong.app.view.process import Feed, page_line, start_page, under_flight
from sidelong.app.view.shading import Shading
from sidelong.app.view.state import Json, StateEncoder, setting
from sidelong.estimators.frames import LocalPlane
from sidelong.mission.control.present import Present
from sidelong.mission.core.events import AlarmReported, Announce, MissionChange, OperatorRequest
from sidelong.mission.core.requirement import Side
from sidelong.mission.route.route import Route

_SEND_EVERY_S = 0.125
_TRAIL_STEP_S = 0.5  # of the vehicle's time
_UNSENT_MAX = 2000  # trail points and words kept while the page takes none


T = TypeVar("T")
View = TypeVar("View", bound="ViewDisplay")


class ShownAircraft:
    """A ``FlightDisplay`` of one aircraft around another, which shows it on the page too.

    Attributes:
        name: In a fleet; '' where there is one aircraft only.
        encoder: Turns its snapshots into states.
        snapshot: The latest one.
        start_s: When watching began, on the clock of its vehicle; None: not taken over yet, and times mean nothing.
    """

    def __init__(self, inner: FlightDisplay, config: Config, page: ViewDisplay, name: str = "") -> None:
        self._inner, self._page, self.name = inner, page, name
        self.encoder = StateEncoder(config.aircraft.airspeed_m_s, config.aircraft.height_m)
        self.snapshot: Present | None = None
        self.start_s: float | None = None
        self._received_at_s = time.monotonic()
        self._trail_s = -math.inf

    def begin(self, plane: LocalPlane, request: Callable[[Wish], None]) -> None:
        self._inner.begin(plane, request)
        self.encoder.plane = plane

    def engage(self, start_s: float, duration_s: float | None) -> None:
        self._inner.engage(start_s, duration_s)
        self.start_s = start_s

    def note(self, text: str) -> None:
        self._inner.note(text)
        self._page.received(self, None, "note", text)

    def say(self, announcement: Announce) -> None:
        self._inner.say(announcement)
        time_s = None if self.start_s is None else announcement.time_s
        self._page.received(self, time_s, announcement.kind, announcement.text)

    def show(self, snapshot: Present) -> None:
        self._inner.show(snapshot)
        self._page.isolated("the page's state", self._observe, snapshot)

    def _observe(self, snapshot: Present) -> None:
        if self.snapshot is None or snapshot.time_s != self.snapshot.time_s:
            self._received_at_s = time.monotonic()
        self.snapshot, aircraft = snapshot, snapshot.aircraft
        if aircraft is not None and aircraft.time_s >= self._trail_s + _TRAIL_STEP_S:
            self._trail_s = aircraft.time_s
            point = [round(value, 1) for value in (aircraft.time_s, aircraft.east_m, aircraft.north_m)]
            self._page.trail.append([*point, self.name])
        self._page.pump_if_due()

    def state(self, snapshot: Present) -> Json:
        """Return the state for the page."""
        silent_s = time.monotonic() - self._received_at_s
        return self.encoder.state(snapshot, silent_s, self.name)


class ViewDisplay(ShownAircraft):
    """The page, with its first aircraft. Use as ``with``; ``url`` and ``viewer_url`` are then its addresses.

    Whatever the page's process does, every call returns at once and raises nothing: the page gets what fits.

    Args:
        name: What the page calls the vehicle; by default its links.
        fleet: The names of the aircraft that may be relieved; empty for a flight of one aircraft.
    """

    def __init__(
        self,
        inner: FlightDisplay,
        config: Config,
        address: PageAddress,
        name: str = "",
        fleet: Sequence[str] = (),
    ) -> None:
        super().__init__(inner, config, self, *fleet[:1])
        self.url = self.viewer_url = ""
        self._fleet = tuple(fleet)
        self._config, self.address = config, address
        self._name = name or ", ".join(config.link.connections) or f"simulated {config.simulation.autopilot}"
        self._shown: list[ShownAircraft] = [self]
        self._feed: Feed | None = None
        self.trail: deque[list[object]] = deque(maxlen=_UNSENT_MAX)
        self._announced: deque[list[object]] = deque(maxlen=_UNSENT_MAX)
        self._setting: Json | None = None
        self._requirement = config.requirement.requirement()
        self._routes: dict[str, Route] = {}  # by the target's name
        self._shading: Shading | None = None
        self._sent_at_s = -math.inf
        self._request: Callable[[Wish], None] | None = None
        self._faults: set[tuple[str, type[Exception]]] = set()  # those already reported

    # -- life ----------------------------------------------------------------------------------------------

    def __enter__(self) -> ViewDisplay:
        """Start the server and wait for it. Raises InputError when it does not come up (port in use)."""
        self._feed, self.url, self.viewer_url = start_page(self.address, fleet=self._fleet)
        self._setting = self._set()
        self.pump()
        return self

    def __exit__(self, *_: object) -> None:
        if self._feed is not None:
            self.pump()
            self._feed.close()
            self._feed = None
        if self._shading is not None:
            self._shading.close()

    async def keep_fresh(self) -> None:
        """Keep sending the state to the page while there are no events, until cancelled."""
        while True:
            await asyncio.sleep(_SEND_EVERY_S)
            self.pump_if_due()

    # -- from the flight -----------------------------------------------------------------------------------

    def begin(self, plane: LocalPlane, request: Callable[[Wish], None]) -> None:
        super().begin(plane, request)
        self._request = request
        self._setting = self._set()
        if self._config.terrain.folder is not None and self._shading is None:
            self._shading = Shading(self._config, plane)

    def note(self, text: str) -> None:
        super().note(text)
        self.pump()

    def received(self, aircraft: ShownAircraft, time_s: float | None, kind: str, text: str) -> None:
        """Add a message of an aircraft to the log of the page. time_s: by its vehicle's clock."""
        self._announced.append([time_s, kind, text])

    # -- to and from the page ------------------------------------------------------------------------------

    def pump_if_due(self) -> None:
        """Send the state to the page if it is due."""
        if time.monotonic() - self._sent_at_s >= _SEND_EVERY_S:
            self.pump()

    def pump(self) -> None:
        """Send the state to the page and take the buttons that were pressed. Never raises: the flight goes on."""
        feed, self._sent_at_s = self._feed, time.monotonic()
        if feed is None or not feed.alive:
            return
        for line in feed.lines():
            self.isolated("a request from the page", lambda line: self._pressed(json.loads(line)), line)
        self.isolated("the page's state", self._send, feed)

    def _send(self, feed: Feed) -> None:
        if feed.send(page_line(self._update())):
            self.trail.clear()
            self._announced.clear()
            self._setting = None
        elif not feed.alive:
            self._inner.note("the page has stopped; the flight goes on without it")

    def isolated(self, what: str, work: Callable[[T], object], argument: T) -> None:
        """Do what is for the page alone; an error in it is reported once and never reaches the control loop."""
        try:
            work(argument)
        except Exception as error:
            if (what, type(error)) not in self._faults:
                self._faults.add((what, type(error)))
                fault = f"{what} caused an internal error ({type(error).__name__}: {error})"
                self._inner.note(f"{fault}; the flight continues")

    def _set(self) -> Json:
        base = setting(self._config, self.encoder.plane, self._name, self._requirement, self._routes.values())
        return base | under_flight(self.address, self._shading)

    def _renew_setting(self) -> None:
        """Send the setting again if the requirement or the route of a target has changed."""
        snapshots = [one.snapshot for one in self._shown if one.snapshot is not None]
        routes = {one.target: one.route.route for one in snapshots if one.route is not None}
        requirement = self._requirement if self.snapshot is None else self.snapshot.requirement
        if (requirement, routes) != (self._requirement, self._routes):
            self._requirement, self._routes = requirement, routes
            self._setting = self._set()

    def _update(self) -> Json:
        self._renew_setting()
        update: Json = {
            "start_s": self.start_s,
            "trail": list(self.trail),
            "announcements": list(self._announced),
        }
        if self._shading is not None and self._shading.is_new():
            update["shade"], self._setting = str(self._shading.file), self._set()
        if self._setting is not None:
            update["setting"] = self._setting
        return update | self._states()

    def _states(self) -> Json:
        """Return the part of an update that says how the flight stands."""
        return {} if self.snapshot is None else {"state": self.state(self.snapshot)}

    def _answer(self, text: str) -> None:
        """Answer a request of the page, on the terminal too."""
        self._inner.note(text)
        self._announced.append([None, "operator", text])

    def _pressed(self, press: Json) -> None:
        if self._request is None or self.snapshot is None or not math.isfinite(self.snapshot.time_s):
            self._answer(f"{press['action']} refused: nothing is flown yet")
            return
        self.note(f"{press['action']} by {press['who']}")
        time_s, who = self.snapshot.time_s, press["who"]
        if press["action"] == "acknowledge":
            self._request(AlarmReported(time_s, press["alarm"], "acknowledged", who=who))
            return
        if press["action"] == "change":
            # JSON's whole numbers arrive as int: functions compiled for floats would be compiled again for them.
            given: Json = press["values"]
            values: Json = {key: value if key == "side" else float(value) for key, value in given.items()}
            self._request(MissionChange(time_s, **values, who=who))
            return
        side = Side(press["side"]) if press["side"] is not None else None
        self._request(OperatorRequest(time_s, press["action"], side, who))


@contextlib.contextmanager
def _shown_address(view: ViewDisplay, announce: Callable[[str], object]) -> Iterator[None]:
    """Announce the page's address; what is announced may be logged, so tokens go into a file of its owner alone."""
    page, _, token = view.url.partition("?")
    if not token:
        announce(f"live map: {page}")
        yield
        return
    folder = os.environ.get("RUNTIME_DIRECTORY", "").split(":")[0] or os.environ.get("XDG_RUNTIME_DIR")
    descriptor, name = tempfile.mkstemp(".txt", "sidelong-map-", folder if folder and Path(folder).is_dir() else None)
    try:
        with os.fdopen(descriptor, "w", encoding="ascii") as file:
            file.write(f"operator: {view.url}\nto watch only: {view.viewer_url}\n")
        announce(f"live map: {page}, by the addresses in {name}, which you alone can read")
        if view.address.cert is None:
            announce("the map goes over the network unencrypted: --view-cert and --view-key encrypt it")
        yield
    finally:
        Path(name).unlink(missing_ok=True)


@contextlib.asynccontextmanager
async def served(view: View, announce: Callable[[str], object]) -> AsyncIterator[View]:
    """Serve a page inside the context; the callback receives its address."""
    with view, _shown_address(view, announce):
        opening = (
            asyncio.create_task(asyncio.to_thread(webbrowser.open, view.url)) if view.address.opens_browser else None
        )
        fresh = asyncio.create_task(view.keep_fresh())
        try:
            yield view
        finally:
            fresh.cancel()
            if opening is not None:
                opening.cancel()

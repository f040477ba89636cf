"""The page in the browser, fed with one or several aircraft alongside other displays, and its button presses."""

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
from collections.abc import AsyncIterator, Callable, Iterable, Iterator, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import Literal, Protocol, TypeVar

from sidelong.app.config import Config
from sidelong.app.flight.loop import FlightDisplay, TrackRequest, Wish
from sidelong.app.process import program
from sidelong.app.view.address import PageAddress
from sidelong.app.view.history import Json
from sidelong.app.view.process import Feed, page_line, start_page, under_flight
from sidelong.app.view.shading import PictureFile, Shading
from sidelong.app.view.state import StateEncoder, setting
from sidelong.estimators.frames import LocalPlane
from sidelong.estimators.terrain.ground import Ground
from sidelong.mission.control.present import Present
from sidelong.mission.core.events import AlarmReported, Announce, MissionChange, OperatorRequest
from sidelong.mission.core.requirement import Side
from sidelong.mission.route.route import Route

_SEND_EVERY_S = 0.125
_TRAIL_STEP_S = 0.5  # of the vehicle's time
_UNSENT_MAX = 2000  # trail points and words kept while the page takes none
_LAST_WITHIN_S = 1.0

T = TypeVar("T")


class FleetRequests(Protocol):
    """What a person may ask of the whole fleet; each returns why not, '' where it is passed on."""

    def watch_from(self, side: Side, who: str) -> str: ...

    def relieve(self, name: str, who: str) -> str: ...


class ShownAircraft:
    """A ``FlightDisplay`` of one aircraft around another, which shows it on the page too.

    start_s: When watching began, on the clock of its vehicle; None: not taken over yet, and times mean nothing.
    """

    def __init__(self, inner: FlightDisplay, config: Config, page: ViewDisplay, name: str) -> None:
        self._page, self.name, self._config = page, name, config
        self.adopt(inner)

    def adopt(self, inner: FlightDisplay) -> None:
        """Begin again with another flight, which ``inner`` displays as well."""
        self._inner = inner
        aircraft = self._config.aircraft
        self.encoder = StateEncoder(aircraft.airspeed_m_s, aircraft.height_m)
        self.snapshot: Present | None = None
        self.start_s: float | None = None
        self._received_at_s = time.monotonic()
        self._trail_s = -math.inf
        self._request: Callable[[Wish], None] | None = None

    def begin(self, plane: LocalPlane, request: Callable[[Wish], None], config: Config | None = None) -> None:
        self._inner.begin(plane, request, config)
        self.encoder.plane, self._request = plane, request
        self._page.comes_to("taking over")

    def let_go(self) -> None:
        """Pass on no further wish: the flight has ended. Its last state stays."""
        self._request = None

    def show_picture(self, picture: Callable[[], bytes]) -> None:
        """Put a picture of the payload's camera on the page; an error of it is announced."""
        self._page.isolated("the camera's picture", partial(self._page.put_picture, self), picture)

    def watching_began(self, start_s: float, duration_s: float | None) -> None:
        self._inner.watching_began(start_s, duration_s)
        self.start_s = start_s
        self._page.comes_to("flying")

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

    @property
    def is_flown(self) -> bool:
        """Whether requests to it are possible: it is controlled and its time is known."""
        return self._request is not None and self.snapshot is not None and math.isfinite(self.snapshot.time_s)

    def ask(self, wish: Wish) -> None:
        """Pass a person's wish on to the aircraft, at its own time."""
        if self.is_flown and self._request is not None and self.snapshot is not None:
            self._request(replace(wish, time_s=self.snapshot.time_s))

    def state(self, snapshot: Present) -> Json:
        """Return a snapshot as the page takes it."""
        self.encoder.ground = self._page.ground
        return self.encoder.state(snapshot, time.monotonic() - self._received_at_s, self.name)


class ViewDisplay(ShownAircraft):
    """The page, with its first aircraft. Use as ``with``; ``url`` and ``viewer_url`` are then its addresses.

    Whatever the page's process does, every call returns at once and raises nothing: the page gets what fits.

    Args:
        displays: Another display of each aircraft, by its name; '' where there is one aircraft only.
        sides: The required side of each target of a fleet.
        is_service: Watches are begun and released on the page, by ``service``, which returns whether, and a text.
    """

    requests: FleetRequests
    service: Callable[[Literal["watch", "release"], str], tuple[bool, str]]

    def __init__(
        self,
        displays: Mapping[str, FlightDisplay],
        configs: Mapping[str, Config],
        address: PageAddress,
        sides: Mapping[str, Side] = MappingProxyType({}),
        is_service: bool = False,
    ) -> None:
        first, *others = configs
        config = configs[first]
        self._is_service, self._restarts = is_service, False
        self._stage: Json = {"name": "preparing", "text": ""}
        self._announced: deque[list[object]] = deque(maxlen=_UNSENT_MAX)
        self.trail: deque[list[object]] = deque(maxlen=_UNSENT_MAX)
        super().__init__(displays[first], config, self, first)
        self.url = self.viewer_url = ""
        self.address = address
        several = ", ".join(configs) or ", ".join(config.link.connections)
        self._title = several or f"simulated {config.simulation.autopilot}"
        self._shown: dict[str, ShownAircraft] = {first: self}
        self._shown |= {name: ShownAircraft(displays[name], configs[name], self, name) for name in others}
        self._fleet = tuple(filter(None, configs))
        self._feed: Feed | None = None
        self._setting: Json | None = None
        self._requirement = config.requirement.requirement()
        self._wanted, self._sides = self._requirement.side, dict(sides)
        self._routes: dict[str, Route] = {}  # by the target's name
        self._shading: Shading | None = None
        self._pictures: PictureFile | None = None
        self._filmed: ShownAircraft = self
        self._sent_at_s = -math.inf
        self._faults: set[tuple[str, type[Exception]]] = set()  # those already reported

    def of(self, name: str) -> ShownAircraft:
        """Return the display of one aircraft of a fleet, by its name."""
        return self._shown[name]

    @property
    def ground(self) -> Ground | None:
        """The elevation data, once they are read."""
        return None if self._shading is None else self._shading.ground

    # -- life ----------------------------------------------------------------------------------------------

    def __enter__(self) -> ViewDisplay:
        """Start the server and wait for it. Raises InputError when it does not come up (port in use)."""
        self._feed, self.url, self.viewer_url = start_page(self.address, fleet=self._fleet, service=self._is_service)
        self._setting = self._set()
        self.pump()
        return self

    def __exit__(self, *_: object) -> None:
        if self._feed is not None:
            self._drain(self._feed)  # so that the end is sent whole
            self.pump()
            self._drain(self._feed)
            self._feed.close()
            self._feed = None
        for pictures in (self._shading, self._pictures):
            if pictures is not None:
                pictures.close()

    @property
    def is_served(self) -> bool:
        """Whether the page's process is alive."""
        return self._feed is not None and self._feed.alive

    @staticmethod
    def _drain(feed: Feed) -> None:
        until_s = time.monotonic() + _LAST_WITHIN_S
        while feed.alive and not feed.ready and time.monotonic() < until_s:
            time.sleep(0.01)

    async def keep_fresh(self) -> None:
        """Keep sending the state to the page while there are no events, until cancelled."""
        while True:
            await asyncio.sleep(_SEND_EVERY_S)
            self.pump_if_due()

    # -- before, between and after flights -------------------------------------------------------------------

    def show_stage(self, name: str, text: str = "", **more: object) -> None:
        """Show where the program stands when nothing is flown.

        Args:
            name: preparing, taking over, flying, ended; of a service also waiting, ready and fault.
            more: checks (name, ready, text), summary (name, text), next (commands).
        """
        if self._stage != (stage := {"name": name, "text": text, **more}):
            self._stage = stage
            self.pump()

    def comes_to(self, name: str) -> None:
        """Show the stage ``name``, taking over or flying; nothing changes once an aircraft flies."""
        if self._stage["name"] != "flying":
            self.show_stage(name)

    def show_end(self, rows: Iterable[tuple[str, ...]], folder: Path) -> None:
        """Put summary and next commands on the page."""
        commands = f"{program()} report {folder}", f"{program()} replay {folder} --view"
        self.show_stage(
            "ended", summary=[(name, " · ".join(filter(None, values))) for name, *values in rows], next=commands
        )

    def adopt(self, inner: FlightDisplay) -> None:
        super().adopt(inner)
        self.trail.clear()
        self._restarts = True

    # -- from the flight -----------------------------------------------------------------------------------

    def begin(self, plane: LocalPlane, request: Callable[[Wish], None], config: Config | None = None) -> None:
        super().begin(plane, request, config)
        self._config = config or self._config
        self._setting = self._set()
        if self._config.terrain.folder is not None and self._shading is None:
            self._shading = Shading(self._config, plane)

    def note(self, text: str) -> None:
        super().note(text)
        self.pump()

    def received(self, aircraft: ShownAircraft, time_s: float | None, kind: str, text: str) -> None:
        """Add a message to the log, at a time of the vehicle's clock; several aircraft share that of the first."""
        if time_s is not None and aircraft is not self:
            time_s = None if self.snapshot is None or self.start_s is None else self.snapshot.time_s
        self._announced.append([time_s, kind, f"{aircraft.name}: {text}" if aircraft.name else text])
        if self._stage["name"] in ("preparing", "taking over"):
            self.show_stage(self._stage["name"], text)

    def put_picture(self, aircraft: ShownAircraft, picture: Callable[[], bytes]) -> None:
        """Let the page show a picture of an aircraft's camera; it takes those of one aircraft."""
        if not self.is_served:
            return
        if self._pictures is None:
            self._pictures, self._filmed = PictureFile(), aircraft
            self._setting = self._set()
        if aircraft is self._filmed:
            self._pictures.put(picture)

    # -- to and from the page ------------------------------------------------------------------------------

    def pump_if_due(self) -> None:
        """Send what has gathered, unless it was sent just before."""
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
            self._setting, self._restarts = None, False
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
        base = setting(self._config, self.encoder.plane, self._title, self._requirement, self._routes.values())
        base |= under_flight(self.address, self._shading, self._pictures)
        return base | {"fleet": list(self._fleet)} if self._fleet else base

    def _renew_setting(self) -> None:
        snapshots = [one.snapshot for one in self._shown.values() if one.snapshot is not None]
        routes = {one.target: one.route.route for one in snapshots if one.route is not None}
        requirement = self._requirement if self.snapshot is None else self.snapshot.requirement
        if (requirement, routes) != (self._requirement, self._routes):
            self._requirement, self._routes = requirement, routes
            self._setting = self._set()

    def _update(self) -> Json:
        self._renew_setting()
        update: Json = {
            "made_s": time.monotonic(),
            "stage": self._stage | {"service": self._is_service},
            "start_s": self.start_s,
            "trail": list(self.trail),
            "announcements": list(self._announced),
        }
        if self._shading is not None and self._shading.is_new():
            update["shade"], self._setting = str(self._shading.file), self._set()
        if self._setting is not None:
            update["setting"] = self._setting
            if self._pictures is not None:
                update["picture"] = str(self._pictures.file)
        if self._restarts:
            update["restart"] = True
        states = [self._state_of(one, one.snapshot) for one in self._shown.values() if one.snapshot is not None]
        if self._fleet:
            return update | {"fleet": states}
        return update | {"state": states[0]} if states else update

    def _state_of(self, one: ShownAircraft, snapshot: Present) -> Json:
        """Return the state of an aircraft; in a fleet with the required side, and the side of its role."""
        state = one.state(snapshot)
        if not self._fleet:
            return state
        if len(self._sides) > 1 and state["target"] is not None:
            state["target"]["name"] = snapshot.target
        if snapshot.requirement.sector is None and not snapshot.requirement.either_side:
            state["asked"]["side"] = snapshot.side
        return state | {"start_s": one.start_s, "wanted": self._sides.get(snapshot.target, self._wanted)}

    def _answer(self, text: str) -> None:
        self._inner.note(text)
        self._announced.append([None, "operator", text])

    def _pressed(self, press: Json) -> None:
        action, who = press["action"], press["who"]
        if action == "relieve":
            name = press["name"]
            refused = self.requests.relieve(name, who) if name in self._fleet else "there is no such aircraft"
            self._answer(f"relieving {name} refused: {refused}" if refused else f"relieve {name} by {who}")
            return
        if action in ("watch", "release"):
            accepted, text = self.service(action, who)
            self._announced.append([None, "operator" if accepted else "refused", f"{action}: {text}"])
            return
        asked = self._filmed if action == "track" else self._shown.get(press.get("aircraft", ""), self)
        if self._is_service and action == "end":  # also a watch that is only beginning, or that is to be the next one
            self._pressed(press | {"action": "release"})
            return
        if not asked.is_flown:
            self._answer(f"{action} refused: nothing is flown yet")
            return
        self._inner.note(f"{action} by {who}")
        if action == "track":
            asked.ask(TrackRequest(0.0, tuple(map(float, press["where"])), who))
        elif action == "acknowledge":
            asked.ask(AlarmReported(0.0, press["alarm"], "acknowledged", who=who))
        elif action == "change":
            # JSON's whole numbers arrive as int: functions compiled for floats would be compiled again for them.
            given: Json = press["values"]
            values: Json = {key: value if key == "side" else float(value) for key, value in given.items()}
            self.ask_all(MissionChange(0.0, **values, who=who))
        else:
            side = Side(press["side"]) if press["side"] is not None else None
            self.ask_all(OperatorRequest(0.0, action, side, who))

    def ask_all(self, wish: OperatorRequest | MissionChange) -> None:
        """Pass a wish on to all; in a fleet the side is the coordinator's to give, and the heights are layers."""
        if not self._fleet:
            self.ask(wish)
            return
        if isinstance(wish, MissionChange):
            if wish.height_m is not None:
                self._answer("refused: the heights of a fleet are layers, which are not changed in flight")
                return
            if wish.side is not None:
                self._answer("refused: change the side of a fleet alone, without other values")
                return
        elif wish.action == "side" and wish.side is not None:
            refused = self.requests.watch_from(wish.side, wish.who)
            if not refused:
                self._wanted, self._sides = wish.side, dict.fromkeys(self._sides, wish.side)
            self._answer(f"refused: {refused}" if refused else f"watching from the {wish.side}")
            return
        for one in self._shown.values():
            if one.is_flown:
                one.ask(wish)
            else:
                self._answer(f"{one.name}: refused: it is not flown yet")


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
async def served(view: ViewDisplay, announce: Callable[[str], object]) -> AsyncIterator[ViewDisplay]:
    """Serve a page inside the context; the callback receives its address."""
    with view, _shown_address(view, announce):
        if view.address.opens_browser:  # at once: the event loop may compile for a minute next
            asyncio.get_running_loop().run_in_executor(None, webbrowser.open, view.url)
        fresh = asyncio.create_task(view.keep_fresh())
        try:
            yield view
        finally:
            fresh.cancel()

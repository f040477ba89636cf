"""The live map of a fleet: a row for each aircraft, one of them in detail; the buttons apply to all of them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Protocol

from sidelong.app.config import Config
from sidelong.app.fleet.panel import AircraftDisplay, FleetPanel
from sidelong.app.flight.display import FlightDisplay, Wish
from sidelong.app.link.vehicle_status import VehicleStatus
from sidelong.app.view.address import Address
from sidelong.app.view.display import ShownAircraft, ViewDisplay
from sidelong.app.view.state import Json
from sidelong.estimators.frames import LocalPlane
from sidelong.mission.control.snapshot import Snapshot
from sidelong.mission.core.events import AlarmReported, Announce, MissionChange
from sidelong.mission.core.requirement import Side


class FleetRequests(Protocol):
    """What a person may ask of the whole fleet; each returns why not, '' where it is passed on."""

    def watch_from(self, side: Side, who: str) -> str:
        """Set the required side."""
        ...

    def relieve(self, name: str, who: str) -> str:
        """Let another one take that aircraft's place."""
        ...


class FleetView(ViewDisplay):
    """A ``FlightDisplay`` of the first aircraft; ``of`` returns each aircraft's. Use as ``with``, as ``ViewDisplay``.

    ``requests`` must be set before a button is pressed.

    Args:
        panel: The fleet on the terminal.
        configs: The configuration of each aircraft, by name.
        address: Where the page is served.
        sides: The required side of each target if there are several.
    """

    requests: FleetRequests

    def __init__(
        self,
        panel: FleetPanel,
        configs: Mapping[str, Config],
        address: Address,
        sides: Mapping[str, Side] = MappingProxyType({}),
    ) -> None:
        self._aircraft = {name: panel.of(name) for name in configs}
        first, *others = configs
        self._first = self._aircraft[first]
        self._wanted, self._sides = configs[first].requirement.requirement().side, dict(sides)
        super().__init__(self._first, configs[first], address, ", ".join(configs), tuple(configs))
        self._others = {name: _OtherAircraft(self._aircraft[name], configs[name], self) for name in others}
        self._shown += [one.shown for one in self._others.values()]

    def of(self, name: str) -> FlightDisplay:
        """Return the display of one aircraft."""
        return self._others.get(name, self)

    def received(self, name: str, since_s: float | None, kind: str, text: str) -> None:
        """Add a message to the log of the page; since_s: time since that aircraft began to watch."""
        start_s = self._own.start_s
        time_s = None if since_s is None or start_s is None else start_s + since_s
        super()._received(time_s, kind, f"{name}: {text}")

    def followed(self, points: list[list[object]]) -> None:
        """Add to the path of an aircraft, and send the states if it is time to."""
        self._trail.extend(points)
        self.pump_if_due()

    def _received(self, time_s: float | None, kind: str, text: str) -> None:
        super()._received(time_s, kind, f"{self._first.name}: {text}")

    def begin(self, plane: LocalPlane, request: Callable[[Wish], None]) -> None:
        super().begin(plane, request)
        self._request = self._ask_all

    def _pressed(self, press: Json) -> None:
        if press["action"] == "acknowledge":
            one = self._aircraft.get(press["aircraft"], self._first)
            one.ask(AlarmReported(0.0, press["alarm"], "acknowledged", who=press["who"]))
            return
        if press["action"] != "relieve":
            super()._pressed(press)
            return
        name = press["name"]
        refused = self.requests.relieve(name, press["who"]) if name in self._aircraft else "there is no such aircraft"
        self._answer(f"relieving {name} refused: {refused}" if refused else f"relieve {name} by {press['who']}")

    def _ask_all(self, wish: Wish) -> None:
        """Pass a wish on to all; the side is the coordinator's to give, and the heights are layers."""
        if isinstance(wish, AlarmReported):  # it names its aircraft
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
        for one in self._aircraft.values():
            one.ask(wish)

    def _set(self) -> Json:
        return super()._set() | {"fleet": list(self._aircraft)}

    def _states(self) -> Json:
        """Return the state of each aircraft, with its name, the required side and the side of its role."""
        return {"fleet": [self._state_of(one, one.snapshot) for one in self._shown if one.snapshot is not None]}

    def _state_of(self, one: ShownAircraft, snapshot: Snapshot) -> Json:
        one.vehicle = self._aircraft[one.name].status
        state = one.state(snapshot)
        if len(self._sides) > 1 and state["target"] is not None:
            state["target"]["name"] = snapshot.target
        if snapshot.requirement.sector is None and not snapshot.requirement.either_side:
            state["asked"]["side"] = snapshot.side
        return state | {"start_s": one.start_s, "wanted": self._sides.get(snapshot.target, self._wanted)}


class _OtherAircraft:
    """A ``FlightDisplay`` of another aircraft than the first, on the terminal and on the page."""

    def __init__(self, inner: AircraftDisplay, config: Config, page: FleetView) -> None:
        self.shown = ShownAircraft(config, inner.name)
        self._inner, self._page = inner, page

    def connected(self, status: Callable[[], VehicleStatus]) -> None:
        self._inner.connected(status)

    def begin(self, plane: LocalPlane, request: Callable[[Wish], None]) -> None:
        self._inner.begin(plane, request)
        self.shown.encoder.plane = plane

    def engage(self, start_s: float, duration_s: float | None) -> None:
        self._inner.engage(start_s, duration_s)
        self.shown.start_s = start_s

    def note(self, text: str) -> None:
        self._inner.note(text)
        self._page.received(self.shown.name, None, "note", text)

    def say(self, announcement: Announce) -> None:
        self._inner.say(announcement)
        start_s = self.shown.start_s
        since_s = None if start_s is None else announcement.time_s - start_s
        self._page.received(self.shown.name, since_s, announcement.kind, announcement.text)

    def show(self, snapshot: Snapshot) -> None:
        self._inner.show(snapshot)
        self._page.isolated("the page's state", self._observe, snapshot)

    def _observe(self, snapshot: Snapshot) -> None:
        self._page.followed(self.shown.take(snapshot))

"""The live map of a fleet: a row for each aircraft, one of them in detail; the buttons apply to all of them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Protocol

from sidelong.app.config import Config
from sidelong.app.fleet.panel import FleetPanel
from sidelong.app.flight.loop import FlightDisplay, Wish
from sidelong.app.view.address import PageAddress
from sidelong.app.view.display import ShownAircraft, ViewDisplay
from sidelong.app.view.state import Json
from sidelong.estimators.frames import LocalPlane
from sidelong.mission.control.present import Present
from sidelong.mission.core.events import AlarmReported, MissionChange
from sidelong.mission.core.requirement import Side


class FleetRequests(Protocol):
    """What a person may ask of the whole fleet; each returns why not, '' where it is passed on."""

    def watch_from(self, side: Side, who: str) -> str:
        """Set the required side."""

    def relieve(self, name: str, who: str) -> str:
        """Let another one take that aircraft's place."""


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
        address: PageAddress,
        sides: Mapping[str, Side] = MappingProxyType({}),
    ) -> None:
        self._aircraft = {name: panel.of(name) for name in configs}
        first, *others = configs
        self._first = self._aircraft[first]
        self._wanted, self._sides = configs[first].requirement.requirement().side, dict(sides)
        super().__init__(self._first, configs[first], address, ", ".join(configs), tuple(configs))
        self._others = {name: ShownAircraft(self._aircraft[name], configs[name], self, name) for name in others}
        self._shown += self._others.values()

    def of(self, name: str) -> FlightDisplay:
        """Return the display of one aircraft."""
        return self._others.get(name, self)

    def received(self, aircraft: ShownAircraft, time_s: float | None, kind: str, text: str) -> None:
        """Add a message to the log of the page, at the time since that aircraft began to watch."""
        if time_s is not None and aircraft is not self and aircraft.start_s is not None:
            time_s = None if self.start_s is None else self.start_s + (time_s - aircraft.start_s)
        super().received(aircraft, time_s, kind, f"{aircraft.name}: {text}")

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

    def _state_of(self, one: ShownAircraft, snapshot: Present) -> Json:
        state = one.state(snapshot)
        if len(self._sides) > 1 and state["target"] is not None:
            state["target"]["name"] = snapshot.target
        if snapshot.requirement.sector is None and not snapshot.requirement.either_side:
            state["asked"]["side"] = snapshot.side
        return state | {"start_s": one.start_s, "wanted": self._sides.get(snapshot.target, self._wanted)}

"""The live map of a fleet: one aircraft in detail, the others next to it; the buttons apply to all of them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Protocol

from sidelong.app.config import Config
from sidelong.app.fleet.panel import AircraftDisplay, FleetPanel
from sidelong.app.flight.display import FlightDisplay, Wish
from sidelong.app.view.address import Address
from sidelong.app.view.display import ViewDisplay
from sidelong.app.view.state import Json, alarms_of, other_aircraft, other_target
from sidelong.estimators.frames import LocalPlane
from sidelong.mission.control.snapshot import Snapshot
from sidelong.mission.core.events import AlarmReported, MissionChange
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

    ``requests`` must be set before a button is pressed. sides: the required side of each target if there are
    several.
    """

    requests: FleetRequests

    def __init__(
        self,
        panel: FleetPanel,
        names: tuple[str, ...],
        config: Config,
        address: Address,
        sides: Mapping[str, Side] = MappingProxyType({}),
    ) -> None:
        self._aircraft = {name: panel.of(name) for name in names}
        self._first = self._aircraft[names[0]]
        self._wanted, self._sides = config.requirement.requirement().side, dict(sides)
        super().__init__(self._first, config, address, ", ".join(names), names)

    def of(self, name: str) -> FlightDisplay:
        """Return the display of one aircraft."""
        one: AircraftDisplay = self._aircraft[name]
        return self if one is self._first else one

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

    def _state(self, snapshot: Snapshot, silent_s: float) -> Json:
        """Return the first aircraft's state with the others, and with the required side in place of its own."""
        state = super()._state(snapshot, silent_s)
        others = [
            other_aircraft(name, one.snapshot)
            for name, one in self._aircraft.items()
            if one is not self._first and one.snapshot is not None
        ]
        wanted = self._sides.get(snapshot.target, self._wanted)
        targets = self._other_targets(snapshot.target)
        if len(self._sides) > 1 and state["target"] is not None:
            state["target"]["name"] = snapshot.target
        asked = state["asked"] | {"side": wanted}
        state["alarms"] = [alarm for name, one in self._aircraft.items() for alarm in alarms_of(name, one.status)]
        return state | {"others": others, "targets": targets, "wanted": wanted, "asked": asked}

    def _other_targets(self, shown: str) -> list[Json]:
        """Return the targets that the first aircraft does not watch, by name."""
        found: dict[str, Json] = {}
        for one in self._aircraft.values():
            own = one.snapshot
            if own is not None and own.estimate is not None and own.target not in ("", shown):
                found[own.target] = other_target(own.target, own.estimate.position_m(own.time_s))
        return list(found.values())

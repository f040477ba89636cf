"""The live map of a fleet: one aircraft is shown whole, the others beside it; the buttons are for all of them."""

from __future__ import annotations

from collections.abc import Callable

from app.config import Config
from app.flight.display import FlightDisplay, Wish
from app.view.address import Address
from app.view.display import ViewDisplay
from app.view.fleet_panel import AircraftDisplay, FleetPanel
from app.view.state import Json, other_aircraft
from estimators.frames import LocalPlane
from mission.core.events import OperatorRequest


class FleetView(ViewDisplay):
    """A ``FlightDisplay`` of the first aircraft; ``of`` returns everybody's. Use as ``with``, as ``ViewDisplay``."""

    def __init__(self, panel: FleetPanel, names: tuple[str, ...], config: Config, address: Address) -> None:
        self._aircraft = {name: panel.of(name) for name in names}
        self._first = self._aircraft[names[0]]
        super().__init__(self._first, config, address, ", ".join(names), self._beside)

    def of(self, name: str) -> FlightDisplay:
        """Return the display of one aircraft."""
        one: AircraftDisplay = self._aircraft[name]
        return self if one is self._first else one

    def begin(self, plane: LocalPlane, request: Callable[[Wish], None]) -> None:
        super().begin(plane, request)
        self._request = self._ask_all

    def _ask_all(self, wish: Wish) -> None:
        if not isinstance(wish, OperatorRequest) or wish.action == "side":
            self.note("refused: the sides, heights and circles of a fleet are not changed in flight")
            return
        for one in self._aircraft.values():
            one.ask(wish)

    def _beside(self) -> list[Json]:
        return [
            other_aircraft(name, one.snapshot)
            for name, one in self._aircraft.items()
            if one is not self._first and one.snapshot is not None
        ]

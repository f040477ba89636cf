"""A fleet of which one is not there: refused on the ground, left out where another flies already."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from sidelong.app.errors import InputError
from sidelong.app.fleet import flight
from sidelong.app.fleet.flight import FleetFlight


@pytest.fixture
def fleet(monkeypatch):
    """Return what makes a fleet of two whose second may fly already, and what was noted."""
    monkeypatch.setattr(flight, "is_flying", lambda vehicle: vehicle.flies)
    noted: list[str] = []

    def make(flies):
        made = object.__new__(FleetFlight)
        made._aircraft = [
            SimpleNamespace(
                name=name,
                session=SimpleNamespace(vehicle=SimpleNamespace(flies=flies and name == "wing")),
                display=SimpleNamespace(note=noted.append),
            )
            for name in ("plane", "wing")
        ]
        return made

    return make, noted


def test_on_the_ground_all_have_to_be_there(fleet):
    make, _ = fleet
    with pytest.raises(InputError, match="aircraft 'plane': no autopilot was received"):
        make(flies=False)._go_on_with([InputError("no autopilot was received"), None])


def test_one_in_the_air_is_taken_over_without_the_other(fleet):
    make, noted = fleet
    made = make(flies=True)
    made._go_on_with([InputError("no autopilot was received"), None])
    assert [one.name for one in made._aircraft] == ["wing"]
    assert noted == ["left out: no autopilot was received"]


def test_a_fault_of_ours_is_not_hidden(fleet):
    make, _ = fleet
    with pytest.raises(ZeroDivisionError):
        make(flies=True)._go_on_with([ZeroDivisionError(), None])

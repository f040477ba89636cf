"""A fleet of which one is not there: refused on the ground, left out where another flies already."""

from __future__ import annotations

import asyncio
import itertools
import math
from types import SimpleNamespace

import pytest

from sidelong.app.autopilots.registry import AUTOPILOTS
from sidelong.app.errors import InputError
from sidelong.app.flight import shell
from sidelong.app.flight.shell import Shell, check_apart, describe_aircraft
from sidelong.mission.control.present import Phase
from tests.messages import message


@pytest.fixture
def fleet(monkeypatch):
    """Return what makes a fleet of two whose second may fly already, and what was noted."""
    monkeypatch.setattr(shell, "is_flying", lambda vehicle: vehicle.flies)
    noted: list[str] = []

    def make(flies):
        made = object.__new__(Shell)
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


@pytest.mark.parametrize(
    ("phase", "mode", "loaded", "does"),
    [
        (Phase.WAITING, "AUTO", False, "the aircraft flies on in AUTO"),
        (Phase.WAITING, "AUTO", True, "the aircraft flies to its first circle and stays on it"),
        (Phase.WAITING, "RTL", True, "the aircraft flies on in RTL"),
        (Phase.WATCHING, "AUTO", True, "the aircraft goes on circling where it is"),
    ],
)
def test_what_the_aircraft_does_now_is_what_it_was_ordered(monkeypatch, phase, mode, loaded, does):
    monkeypatch.setattr(shell, "is_flying", lambda _vehicle: True)
    monkeypatch.setattr(shell, "mode_of", lambda _vehicle: mode)
    vehicle = SimpleNamespace(latest={"HEARTBEAT": message("HEARTBEAT", base_mode=128)})
    (autopilot,) = [one for one in AUTOPILOTS if one.key == "arduplane"]
    present = SimpleNamespace(phase=phase, connected=True)
    assert describe_aircraft(vehicle, autopilot, present, loaded=loaded, simulated=False) == does


def test_the_duration_runs_from_when_the_clock_is_known(monkeypatch):
    monkeypatch.setattr(shell, "_POLL_S", 0.0)
    reads = itertools.count()

    class Clock:
        over = asyncio.Event()

        @property
        def now_s(self):
            return -math.inf if (read := next(reads)) < 4 else 100.0 + read

    async def flown():
        made = object.__new__(Shell)
        made._aircraft = [SimpleNamespace(settled=True)]
        made._duration_s, clock = 20.0, Clock()
        await made._until_over(clock)
        return clock.over.is_set()

    assert asyncio.run(flown())
    assert next(reads) > 20


def flying(name, system_id=1, boot_ms=60_000, lat=474_000_000, lon=85_000_000, vx=0):
    fields = {"time_boot_ms": boot_ms, "lat": lat, "lon": lon, "vx": vx, "vy": 0}
    latest = {"GLOBAL_POSITION_INT": message("GLOBAL_POSITION_INT", system=system_id, **fields)}
    return SimpleNamespace(
        name=name, session=SimpleNamespace(vehicle=SimpleNamespace(system_id=system_id, latest=latest))
    )


@pytest.mark.parametrize(
    "other",
    [
        {"system_id": 2},
        {"boot_ms": 90_000},  # side by side, with one id, on links of their own
        {"lat": 474_010_000},
    ],
)
def test_two_vehicles_are_a_fleet(other):
    check_apart([flying("plane"), flying("wing", **other)])


def test_one_vehicle_by_two_links_is_no_fleet():
    with pytest.raises(InputError, match="aircraft 'plane' and 'wing' are one vehicle by its id, clock and position"):
        check_apart([flying("plane", vx=1500), flying("wing", boot_ms=61_000, lat=474_001_350, vx=1500)])


def test_a_fleet_on_two_continents_is_refused():
    with pytest.raises(InputError, match=r"'plane' and 'wing' are \d+ km apart: a fleet flies within 100 km"):
        check_apart([flying("plane"), flying("wing", 2, lat=-353_632_621, lon=1_491_652_370)])

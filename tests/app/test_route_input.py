"""The route of a flight: what is refused, and what is reported."""

from __future__ import annotations

import asyncio
from types import SimpleNamespace

import pytest

from sidelong.app.config import RouteSection
from sidelong.app.errors import InputError
from sidelong.app.flight import payload_input
from sidelong.app.flight.payload_input import check_route, give_route
from sidelong.estimators.frames import LocalPlane


def given(tmp_path, text):
    """Return the routes and notes of a flight that begins at 47.4, 8.5."""
    (tmp_path / "route.csv").write_text(text)
    session, routes, notes = SimpleNamespace(telemetry=SimpleNamespace(now_s=1.0)), [], []
    give_route(RouteSection(file=tmp_path / "route.csv"), session, LocalPlane(47.4, 8.5), routes.append, notes.append)
    return routes, notes


def test_route_far_from_the_aircraft_is_reported(tmp_path):
    assert given(tmp_path, "lat,lon\n47.4,8.7\n47.4,9.5\n")[1] == []
    routes, (note,) = given(tmp_path, "lat,lon\n8.5,47.4\n8.6,47.4\n")
    assert len(routes) == 1
    assert note.startswith("the nearest way point of the route is more than 4938 km away")
    assert "check the route, the order of latitude and longitude" in note


def test_route_in_metres_is_refused(tmp_path):
    with pytest.raises(InputError, match="a flight needs degrees"):
        given(tmp_path, "east_m,north_m\n0,0\n0,500\n")


def test_route_whose_items_never_come_is_reported(monkeypatch):
    async def dripping(_vehicle, _system_id):
        await asyncio.Event().wait()

    async def read():
        notes, begun = [], []
        session = SimpleNamespace(vehicle=None, begin=begun.append)
        give_route(RouteSection(system_id=7), session, LocalPlane(47.4, 8.5), pytest.fail, notes.append)
        await begun[0]
        return notes

    monkeypatch.setattr(payload_input, "read_mission", dripping)
    monkeypatch.setattr(payload_input, "_ROUTE_WITHIN_S", 0.01)
    first, last = asyncio.run(read())
    assert first == "reading the route of the target from system 7"
    assert last.startswith("no route: system 7 has not sent its mission within")


def test_mission_of_the_aircraft_itself_is_refused():
    check_route(RouteSection(), (1,))
    check_route(RouteSection(system_id=7), (1,))
    with pytest.raises(InputError, match="system 1 is the aircraft itself: give the system id of the target"):
        check_route(RouteSection(system_id=1), (1,))

"""What becomes of work in the background of a connection."""

from __future__ import annotations

import asyncio
from types import SimpleNamespace

import pytest

from sidelong.app.flight.session import SenderCheck, Session, VehicleInputs
from sidelong.app.link.vehicle import LinkError, Vehicle
from tests.turns import loop_turn


@pytest.mark.parametrize(
    ("raised", "noted"),
    [
        (None, []),
        (LinkError("nothing can be sent"), []),  # reported by the link
        (KeyError("count"), ["a fault of the program, KeyError('count'); the flight continues"]),
    ],
)
def test_a_fault_in_the_background_is_shown(raised, noted):
    async def work():
        if raised is not None:
            raise raised

    async def flown():
        notes = []
        session = Session(None, None, None, None, None, set(), notes.append)
        session.begin(work())
        for _ in range(3):
            await loop_turn()
        assert not session.background
        return notes

    assert asyncio.run(flown()) == noted


def test_a_flight_leaves_nothing_behind_on_its_connection():
    async def flown():
        vehicle = Vehicle(SimpleNamespace(system_id=1, own_id=(245, 190)))
        vehicle.bystanders.append("service")
        vehicle.latest |= {"HOME_POSITION": None, "HEARTBEAT": None}
        inputs = VehicleInputs(vehicle)
        session = Session(vehicle, None, None, inputs, SenderCheck(), set(), pytest.fail)
        vehicle.listeners.append("standby")
        before = {*vehicle.listeners}
        session.begin(asyncio.Event().wait())
        (of_connection,) = session.background
        for _ in range(2):
            async with session.for_a_flight():
                assert session.inputs is not inputs
                session.inputs.close()
                vehicle.listeners.append("flight")
                vehicle.bystanders.append("flight")
                session.begin(asyncio.Event().wait())
            assert session.inputs is inputs
            assert ({*vehicle.listeners}, vehicle.bystanders) == (before, ["service"])
            assert session.background == {of_connection}
            assert list(vehicle.latest) == ["HEARTBEAT"]
        of_connection.cancel()

    asyncio.run(flown())

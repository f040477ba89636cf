"""What becomes of work in the background of a connection."""

from __future__ import annotations

import asyncio

import pytest

from sidelong.app.flight.session import Session
from sidelong.app.link.vehicle import LinkError
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

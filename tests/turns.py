"""Turns of the event loop, for tests that wait for other tasks and for no clock."""

from __future__ import annotations

import asyncio


async def loop_turn() -> None:
    """Let every task that is ready run once."""
    await asyncio.sleep(0)

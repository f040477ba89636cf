"""One attempt at a time to take the aircraft over again after a yield; a refusal is shown to the operator."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine
from typing import Any

from sidelong.app.errors import InputError


class Resumption:
    """Runs ``resume``, which raises InputError with what keeps the watch from being resumed; note: shows it."""

    def __init__(self, resume: Callable[[], Coroutine[Any, Any, None]], note: Callable[[str], object]) -> None:
        self._resume, self._note = resume, note
        self._under_way: asyncio.Task[None] | None = None

    def begin(self) -> None:
        """Begin an attempt, unless one is under way."""
        if self._under_way is None or self._under_way.done():
            self._under_way = asyncio.create_task(self._attempt())

    def stop(self) -> None:
        """Give up what is under way."""
        if self._under_way is not None:
            self._under_way.cancel()

    async def _attempt(self) -> None:
        try:
            await self._resume()
        except InputError as refusal:
            self._note(f"resume refused: {refusal}")

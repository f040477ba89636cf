"""A watch inside an asyncio program of one's own: the same flight as ``sidelong launch``, without its terminal."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator, Callable, Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Literal

from sidelong.app.analysis.summary import Summary
from sidelong.app.assembly import prepared
from sidelong.app.config import Config, config_from, load_config, with_values
from sidelong.app.config_files import check_single
from sidelong.app.errors import FlightError, InputError
from sidelong.app.flight.loop import Wish
from sidelong.app.flight.recording import Recording
from sidelong.app.flight.shell import FlightEnded, FlyingAircraft, Life, Shell
from sidelong.app.records.run_folder import RunFolder
from sidelong.estimators.frames import LocalPlane
from sidelong.mission.control.present import Present
from sidelong.mission.core.events import Announce, OperatorRequest
from sidelong.mission.core.requirement import Side

__all__ = ["FlightError", "InputError", "Watch", "watch"]

_WHO = "a program"


class Watch:
    """One watch under way; :func:`watch` makes it."""

    def __init__(self, folder: Path, note: Callable[[str], object]) -> None:
        self.folder = folder  # where its records are
        self.plane: LocalPlane | None = None  # of all positions, None before it is known
        self.summary: Summary | None = None  # None before the end
        self._note = note
        self._request: Callable[[Wish], None] | None = None
        self._news, self._over = asyncio.Event(), False
        self._snapshot: Present | None = None
        self._error: BaseException | None = None

    async def snapshots(self) -> AsyncIterator[Present]:
        """Yield the latest state whenever there is a newer one, until the watch ends.

        Raises:
            InputError: The vehicle cannot be watched with; nothing was commanded.
            FlightError: The flight failed; the text states what the aircraft does now.
        """
        while not self._over:
            await self._news.wait()
            self._news.clear()
            if self._snapshot is not None and not self._over:
                yield self._snapshot
        if self._error is not None:
            raise self._error

    def hold(self) -> None:
        """Stay on the present circle until :meth:`resume`."""
        self._ask("hold")

    def resume(self) -> None:
        """Go on after :meth:`hold`, or take the aircraft over again after a pilot has flown: it is checked first."""
        self._ask("resume")

    def end(self) -> None:
        """End the watch; the aircraft stays on its circle."""
        self._ask("end")

    def watch_from(self, side: Literal["left", "right"]) -> None:
        """Watch from another side."""
        self._ask("side", Side(side))

    def _ask(self, action: Literal["hold", "resume", "end", "side"], side: Side | None = None) -> None:
        if self._request is None or self._snapshot is None:
            raise FlightError(f"{action} refused: nothing is flown yet.")
        self._request(OperatorRequest(self._snapshot.time_s, action, side, _WHO))

    # -- as the flight's display -----------------------------------------------------------------------------

    def note(self, text: str) -> None:
        self._note(text)

    def say(self, announcement: Announce) -> None:
        self._note(announcement.text)

    def show(self, snapshot: Present) -> None:
        self._snapshot = snapshot
        self._news.set()

    def begin(self, plane: LocalPlane, request: Callable[[Wish], None], config: Config | None = None) -> None:
        self.plane, self._request = plane, request

    def show_picture(self, picture: Callable[[], bytes]) -> None:
        """Show no picture."""

    def watching_began(self, start_s: float, duration_s: float | None) -> None:
        """Learn that watching has begun."""

    def ended(self, flown: FlightEnded | None, error: BaseException | None) -> None:
        self.summary = flown.summary if flown is not None and isinstance(flown.summary, Summary) else None
        self._error = error or (None if flown is None else flown.reason)
        self._over, self._request = True, None
        self._news.set()


@contextlib.asynccontextmanager
async def watch(
    config: Config | Path | str | Mapping[str, Any] | None = None,
    *,
    url: str | None = None,
    duration_s: float | None = None,
    out: Path | str = "runs",
    note: Callable[[str], object] = lambda _text: None,
) -> AsyncIterator[Watch]:
    """Fly a watch inside the context; leaving it ends the watch, and the aircraft stays on its circle.

    Args:
        config: A configuration, its file, or its values by section and key; None: the defaults.
        url: MAVSDK URL of the vehicle, instead of the configured link; without any a vehicle is simulated.
        duration_s: How long to watch, of the vehicle's clock; None: until the context is left.
        out: Where the run folder is made.
        note: Receives each message to an operator.

    Raises:
        InputError: The configuration or the duration is wrong, or the records cannot be written.
    """
    if duration_s is not None and not duration_s > 0.0:
        raise InputError(
            f"duration_s: {duration_s:g} s is no duration; give more than 0, or None to watch until the end."
        )
    settings = await asyncio.to_thread(_settings, config, url)
    folder = RunFolder.create(Path(out), datetime.now(UTC))
    loop = asyncio.get_running_loop()
    watched = Watch(folder.path, note)

    def note_safely(text: str) -> None:
        loop.call_soon_threadsafe(watched.note, text)

    done = await asyncio.to_thread(lambda: prepared(settings, announce=note_safely))
    recording = Recording(folder, settings, note_safely)
    lives: list[Life] = []

    async def recorded() -> None:
        life = Life(lambda: recording.begun, watched.note)
        lives.append(life)
        flown: FlightEnded | None = None
        error: Exception | None = None
        try:
            with contextlib.closing(recording):
                aircraft = FlyingAircraft(settings, folder, recording, watched, note_safely, lambda: done)
                flown = await Shell([aircraft], duration_s, life, watched.note).fly()
            folder.write_summary(flown.summary.as_json())
        except asyncio.CancelledError:
            error = None if life.failure is None else FlightError(life.failure)
        except Exception as raised:
            error = raised
        watched.ended(flown, error)

    flight = asyncio.create_task(recorded())
    try:
        yield watched
    finally:
        for life in lives:
            life.stopped.set()
        if not recording.begun:
            flight.cancel()  # nothing is commanded yet
        await asyncio.wait((flight,))


def _settings(config: Config | Path | str | Mapping[str, Any] | None, url: str | None) -> Config:
    match config:
        case None:
            settings = load_config(None)
        case Path() | str():
            settings = load_config(Path(config))
        case Config():
            settings = config
        case _:
            settings = config_from(config, "config")
    if url is not None:
        settings = with_values(settings, {"link": {"url": url}}, "url")
    check_single(settings)
    return settings

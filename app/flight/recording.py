"""What a run writes while it goes on: the journal, the tlog of all frames, and the links' measures every second."""

from __future__ import annotations

import asyncio
import contextlib
import csv
import io
import math
import time
from collections.abc import AsyncIterator, Callable, Iterator, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import TypeVar, get_args

from sidelong.app.config import Config, config_from
from sidelong.app.errors import InputError
from sidelong.app.link.vehicle import Link
from sidelong.app.records.journal import Header, JournalReader, JournalWriter
from sidelong.app.records.run_folder import RunFolder
from sidelong.app.records.text_file import Appender
from sidelong.app.records.tlog import TlogClock, TlogWriter
from sidelong.estimators.frames import LocalPlane
from sidelong.mission.core.events import Event, StepOutput
from sidelong.mission.exchange.mission_controller import InboundEvent, Output
from sidelong.mission.exchange.outbox import ExternalControl, SendMessage, TakeoverFailed
from sidelong.mission.exchange.reports import ExchangeEvent

T = TypeVar("T")

_MARKER_V2, _SETUP_SIGNING = 0xFD, (256).to_bytes(3, "little")

JOURNAL_TYPES: tuple[type, ...] = (
    *get_args(Event),
    *get_args(ExchangeEvent),
    *get_args(StepOutput),
    ExternalControl,
    SendMessage,
    TakeoverFailed,
)


def journalled_config(journal: JournalReader) -> Config:
    """Return the configuration that a run was flown with. Raises InputError naming the journal."""
    return config_from(
        journal.header.config, f"{journal.path}: its configuration cannot be used; give one by --config"
    )


@contextlib.contextmanager
def opening_records(folder: Path) -> Iterator[None]:
    """Raise InputError in place of an OSError while records in ``folder`` are opened: nothing is commanded yet."""
    try:
        yield
    except OSError as error:
        raise InputError(f"{folder} takes no records ({error.strerror}); give another --out.") from error


class Recording:
    """Opens the tlog at once and the journal when the plane is known; ``on_trouble`` receives write errors.

    The tlog is stamped with the vehicle's time. Raises InputError if the files cannot be written at the start, unless
    records are not ``required``: that is then reported, and the flight goes on without them.
    """

    def __init__(
        self, folder: RunFolder, config: Config, on_trouble: Callable[[str], None], required: bool = True
    ) -> None:
        self._folder, self._config, self._on_trouble = folder, config, on_trouble
        self._required, self._unwritten = required, ""
        self._tlog: TlogWriter | None = self._opened(lambda: TlogWriter(folder.tlog, on_trouble))
        self._time = TlogClock()
        self._journal: JournalWriter | None = None
        self.begun = False  # the flight, and with it the journal

    @property
    def lost(self) -> str:
        """Why records of this flight are incomplete, '' if they are not; final once the recording is closed."""
        tlog = "" if self._tlog is None else self._tlog.failure
        if self._unwritten or self._journal is None:
            return self._unwritten or tlog
        removed = "" if self._folder.journal.exists() else f"{self._folder.path} was removed"
        return self._journal.failure or tlog or removed

    def _opened(self, make: Callable[[], T]) -> T | None:
        try:
            with opening_records(self._folder.path):
                return make()
        except InputError as error:
            if self._required:
                raise
            self._unwritten = str(error)
            self._on_trouble(f"{self._unwritten} The flight goes on without this record.")
            return None

    def frame(self, data: bytes) -> None:
        """Append a frame that was sent or received to the tlog, from any thread; keys for signing are left out."""
        if self._tlog is not None and (data[7:10] != _SETUP_SIGNING or data[0] != _MARKER_V2):
            self._tlog.write(data, self._time.stamp_s(data, time.time()))

    def follow(self, system_id: int) -> None:
        """Time-stamp frames by the clock of this vehicle (MAVLink system id) from now on."""
        self._time.system_id = system_id

    def begin(
        self,
        plane: LocalPlane,
        home_deg: tuple[float, float],
        autopilot: str = "",
        home_altitude_m: float | None = None,
        config: Config | None = None,
    ) -> None:
        """Open the journal; home is (latitude, longitude). autopilot: where the exchange with it is recorded too.

        config: as it is flown, if that differs from the one given before. Raises InputError if it cannot be written.
        """
        config = config or self._config
        header = Header(
            program=f"sidelong {version('sidelong')}",
            config=config.model_dump(mode="json"),
            plane=plane,
            seeds={"simulation": config.simulation.seed},
            home_deg=home_deg,
            autopilot=autopilot,
            home_altitude_m=home_altitude_m,
        )
        self._journal = self._opened(lambda: JournalWriter(self._folder.journal, header, self._on_trouble))
        self.begun = True

    def write(self, record: InboundEvent | Output) -> None:
        if self._journal is not None:
            self._journal.write(record)

    def close(self) -> None:
        if self._journal is not None:
            self._journal.close()
        if self._tlog is not None:
            self._tlog.close()


_EVERY_S = 1.0
_RATE_MAX = 200.0  # no simulation is faster
COLUMNS = (
    *("time_s", "url", "in_use", "silent_s", "loss", "round_trip_s", "received_bytes_s", "sent_bytes_s"),
    *("rssi", "remote_rssi", "refused"),
)


class ClockRate:
    """How many seconds of the vehicle's clock, ``now_s``, go by in one of ours: ten in a fast simulation."""

    def __init__(self, now_s: Callable[[], float]) -> None:
        self.now_s = now_s
        self._latest_s = math.nan, math.nan  # of both clocks
        self._elapsed_s = [0.0, 0.0]

    def look(self, ours_s: float) -> None:
        """Compare the clocks; a step of the vehicle's clock is left out."""
        both_s = self.now_s(), ours_s
        vehicle_s, wall_s = (now_s - latest_s for now_s, latest_s in zip(both_s, self._latest_s, strict=True))
        self._latest_s = both_s
        if wall_s > 0.0 and 0.0 < vehicle_s < _RATE_MAX * wall_s:
            self._elapsed_s[0] += vehicle_s
            self._elapsed_s[1] += wall_s

    @property
    def mean(self) -> float:
        """Seconds of the vehicle in one of this computer, over the flight; 1 before two positions."""
        return self._elapsed_s[0] / self._elapsed_s[1] if self._elapsed_s[1] else 1.0


@contextlib.asynccontextmanager
async def link_log(
    link: Link, path: Path, clock_rate: ClockRate, on_trouble: Callable[[str], None]
) -> AsyncIterator[None]:
    """Log link statistics to ``path`` inside the context; update clock_rate: rates refer to the vehicle's clock.

    A file that cannot be begun is reported, and the flight goes on without it.
    """
    try:
        file = Appender(path, on_trouble, _line(COLUMNS))
    except OSError as error:
        on_trouble(f"{path} cannot be written ({error.strerror}). The flight goes on without this record.")
        yield
        return
    with file:

        async def write() -> None:
            while True:
                await asyncio.sleep(_EVERY_S)
                clock_rate.look(time.monotonic())
                for report in link.recent():
                    values = report.as_json(clock_rate.mean) | {
                        "time_s": round(clock_rate.now_s(), 2),
                        "in_use": int(report.in_use),
                        "refused": sum(report.refused.values()),
                    }
                    file.append(_line([values[column] for column in COLUMNS]))

        writing = asyncio.create_task(write())
        try:
            yield
        finally:
            writing.cancel()
            await asyncio.gather(writing, return_exceptions=True)


def _line(values: Sequence[object]) -> bytes:
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerow(values)
    return text.getvalue().encode()

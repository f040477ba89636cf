"""What a run writes while it goes on: the journal of events and commands, and the tlog of all frames."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterator
from importlib.metadata import version
from pathlib import Path
from typing import TypeVar, get_args

from sidelong.app.config import Config, config_from
from sidelong.app.errors import InputError
from sidelong.app.records.journal import Header, JournalReader, JournalWriter
from sidelong.app.records.run_folder import RunFolder
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
def beginning(folder: Path) -> Iterator[None]:
    """Turn what keeps a record from being begun into InputError: nothing has been commanded yet."""
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
            with beginning(self._folder.path):
                return make()
        except InputError as error:
            if self._required:
                raise
            self._unwritten = str(error)
            self._on_trouble(f"{self._unwritten} The flight goes on without this record.")
            return None

    def frame(self, data: bytes) -> None:
        """Take a raw frame, from any thread; one that carries a signing key is not kept."""
        if self._tlog is not None and (data[7:10] != _SETUP_SIGNING or data[0] != _MARKER_V2):
            self._tlog.write(data, self._time.stamp_s(data, time.time()))

    def follow(self, system_id: int) -> None:
        """Let this vehicle's clock be that of the tlog."""
        self._time.system_id = system_id

    def begin(
        self,
        plane: LocalPlane,
        home_deg: tuple[float, float],
        autopilot: str = "",
        home_altitude_m: float | None = None,
    ) -> None:
        """Open the journal; home is (latitude, longitude). autopilot: where the exchange with it is recorded too.

        Raises InputError when it cannot be written: nothing has been commanded yet.
        """
        header = Header(
            program=f"sidelong {version('sidelong')}",
            config=self._config.model_dump(mode="json"),
            plane=plane,
            seeds={"simulation": self._config.simulation.seed},
            home_deg=home_deg,
            autopilot=autopilot,
            home_altitude_m=home_altitude_m,
        )
        self._journal = self._opened(lambda: JournalWriter(self._folder.journal, header, self._on_trouble))
        self.begun = True

    def write(self, record: InboundEvent | Output) -> None:
        """Write an event or an output of the core, once the journal is open."""
        if self._journal is not None:
            self._journal.write(record)

    def close(self) -> None:
        """Write what is left."""
        if self._journal is not None:
            self._journal.close()
        if self._tlog is not None:
            self._tlog.close()

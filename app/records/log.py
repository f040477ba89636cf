"""One way to read every kind of log: as the MAVLink messages that the vehicle sent, or would have sent."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass
from pathlib import Path

from sidelong.app.autopilots.registry import AUTOPILOTS, autopilot_by_mav_autopilot
from sidelong.app.errors import InputError
from sidelong.app.link.message import Message
from sidelong.app.records.dataflash import MAGIC as DATAFLASH_MAGIC
from sidelong.app.records.dataflash import ArdupilotMessages, dataflash_contents, read_dataflash
from sidelong.app.records.entry import Entry, Translator
from sidelong.app.records.log_context import ContextBuilder, LogContext
from sidelong.app.records.text_file import Progress, unseen
from sidelong.app.records.tlog import is_mavlink_1, is_tlog, read_tlog, tlog_contents
from sidelong.app.records.ulog import MAGIC as ULOG_MAGIC
from sidelong.app.records.ulog import Px4Messages, read_ulog, ulog_contents

_NAMED_AT_MOST = 20
_COMPRESSED = (b"\x1f\x8b", b"PK\x03\x04", b"BZh", b"\xfd7zXZ")  # the first bytes of gzip, zip, bzip2, xz

MessageReader = Callable[[Path, Collection[str], Progress], Iterator[Message]]


@dataclass(slots=True)
class RecordedLog:
    """A log of some kind. range_names and gimbal_names: what the kind calls a slant range and a line of sight.

    mav_autopilot: the MAV_AUTOPILOT that writes such logs.
    """

    path: Path
    kind: str
    range_names: tuple[str, ...]
    gimbal_names: tuple[str, ...]
    mav_autopilot: int
    _messages: MessageReader
    _contents: Callable[[Path], Counter[str]]
    _context: LogContext | None = None

    def messages(self, wanted: Collection[str], progress: Progress = unseen) -> Iterator[Message]:
        """Yield the messages of the ``wanted`` names in order; raises InputError when the file cannot be read."""
        builder = ContextBuilder(autopilot_by_mav_autopilot(self.mav_autopilot) or AUTOPILOTS[0])
        try:
            for message in self._messages(self.path, {*wanted, *builder.NAMES}, progress):
                if message.name in builder.NAMES:
                    builder.take(message)
                if message.name in wanted:
                    yield message
        except OSError as error:
            raise _unreadable(self.path, error) from error
        self._context = builder.context()

    def context(self) -> LogContext:
        """Return what the log contains besides the flight; it is read for that unless its messages have been."""
        if self._context is None:
            deque(self.messages(()), maxlen=0)
        assert self._context is not None
        return self._context

    def contents(self) -> Counter[str]:
        """Return how often the log has what, in the words of its kind."""
        try:
            return self._contents(self.path)
        except OSError as error:
            raise _unreadable(self.path, error) from error

    def looked_for(self) -> str:
        """Return what a sighting of the target needs and what the log has instead, as an end of a sentence."""
        counts = self.contents().most_common()
        named = ", ".join(f"{name} ({count})" for name, count in counts[:_NAMED_AT_MOST])
        others = f" and {len(counts) - _NAMED_AT_MOST} others" if len(counts) > _NAMED_AT_MOST else ""
        only_1 = self.kind == "tlog" and counts and is_mavlink_1(self.path)
        too_old = f", all of MAVLink 1, which cannot carry {self.gimbal_names[0]}" if only_1 else ""
        return (
            f"looked for a slant range ({' or '.join(self.range_names)}) and a line of sight "
            f"({' or '.join(self.gimbal_names)}); the {self.kind} has {named or 'nothing'}{others}{too_old}"
        )


def open_log(path: Path) -> RecordedLog:
    """Return the log at ``path``, of the kind that its content shows.

    Raises InputError when it cannot be read or is no log.
    """
    try:
        if path.exists() and not path.is_file():
            raise InputError(f"{path} cannot be read: it is not a file; give a tlog, a ULog or a DataFlash log.")
        with path.open("rb") as file:
            opening = file.read(len(ULOG_MAGIC))
        if not opening:
            raise InputError(f"{path} is empty.")
        tlog, ulog, dataflash = (RecordedLog(path, *of_kind) for of_kind in _KINDS)
        if opening == ULOG_MAGIC:
            return ulog
        if opening.startswith(DATAFLASH_MAGIC):
            return dataflash
        if is_tlog(path):
            return tlog
        if opening.startswith(_COMPRESSED):
            raise InputError(f"{path} is compressed; decompress it first.")
        # The first bytes may be damaged.
        for log in (ulog, dataflash):
            if log.contents():
                return log
    except (OSError, ValueError) as error:  # ValueError: a name with a zero in it
        raise _unreadable(path, error) from error
    raise InputError(f"{path} is no log: expected a tlog, a PX4 ULog (.ulg) or an ArduPilot DataFlash log (.bin).")


def _unreadable(path: Path, error: OSError | ValueError) -> InputError:
    return InputError(f"{path} cannot be read: {getattr(error, 'strerror', error)}.")


def _translated(
    translator: Callable[[], Translator], entries: Callable[[Path, Collection[str], Progress], Iterator[Entry]]
) -> MessageReader:
    def messages(path: Path, wanted: Collection[str], progress: Progress) -> Iterator[Message]:
        one = translator()
        every = one.messages(entries(path, one.names, progress))
        return (message for message in every if message.name in wanted)

    return messages


_TLOG_NAMES = ("DISTANCE_SENSOR", "RANGEFINDER"), ("GIMBAL_DEVICE_ATTITUDE_STATUS",)
_ULOG_NAMES = ("distance_sensor",), ("gimbal_device_attitude_status",)
_DATAFLASH_NAMES = ("RFND", "MNT.Dist"), ("MNT",)
_ARDUPILOT, _PX4 = 3, 12  # MAV_AUTOPILOT
_KINDS = (
    ("tlog", *_TLOG_NAMES, _ARDUPILOT, read_tlog, tlog_contents),
    ("ULog", *_ULOG_NAMES, _PX4, _translated(Px4Messages, read_ulog), ulog_contents),
    (
        "DataFlash log",
        *_DATAFLASH_NAMES,
        _ARDUPILOT,
        _translated(ArdupilotMessages, read_dataflash),
        dataflash_contents,
    ),
)

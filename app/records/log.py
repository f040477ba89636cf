"""One way to read every kind of log: as the MAVLink messages that the vehicle sent, or would have sent."""

from __future__ import annotations

import math
import re
from collections import Counter, deque
from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from statistics import median
from typing import ClassVar

from sidelong.app.autopilots.autopilot import Autopilot
from sidelong.app.autopilots.registry import AUTOPILOTS, autopilot_by_mav_autopilot
from sidelong.app.errors import InputError
from sidelong.app.link.message import Message
from sidelong.app.link.telemetry import AUTOPILOT_INVALID, TYPE_FIXED_WING
from sidelong.app.records.autopilot_logs import (
    DATAFLASH_MAGIC,
    ULOG_MAGIC,
    ArdupilotMessages,
    Entry,
    Px4Messages,
    Translator,
    dataflash_contents,
    read_dataflash,
    read_ulog,
    ulog_contents,
)
from sidelong.app.records.text_file import Progress, unseen
from sidelong.app.records.tlog import is_mavlink_1, is_tlog, read_tlog, tlog_contents

_AUTOPILOT_COMPONENT = 1
_DATED_S = 1e9  # a smaller one was not counted from 1970
_RESTARTED_MS = 10_000  # a stamp that is earlier by less was overtaken on the way
_ARDUPILOT, _PX4, _VTOL, _TYPE_MAX = 3, 12, 22, 50
# How ArduPilot's firmware announces itself, with the MAV_TYPE of most of its vehicles.
_TYPES = {"Plane": 1, "Copter": 2, "Tracker": 5, "Blimp": 7, "Rover": 10, "Sub": 12}
_FIRMWARE = re.compile(rf"(?:(?:Ardu|APM:|Antenna)?({'|'.join(_TYPES)}) V?\d|PX4 v\d)[\w. ()-]*")
_STAMPS = 21  # number of stamps for the time of day: a single one may be wrong

_TIME_MAX_S = 2.0**32  # the year 2106: a later time of boot is that of a damaged clock


@dataclass(slots=True)
class LogContext:
    """What a log's messages of ``NAMES`` state besides the flight, taken in their order.

    autopilot: until a message names it. home_altitude_m: above sea level. kind: MAV_TYPE. firmware: name and release.
    system_id: that of the first heartbeat of an autopilot; others: further vehicles.
    """

    NAMES: ClassVar = frozenset({"HEARTBEAT", "HOME_POSITION", "GLOBAL_POSITION_INT", "STATUSTEXT", "PARAM_VALUE"})
    autopilot: Autopilot = AUTOPILOTS[0]
    home_altitude_m: float | None = None
    kind: int = TYPE_FIXED_WING
    firmware: str = ""
    system_id: int | None = None
    others: set[int] = field(default_factory=set)
    _boots_s: list[float] = field(default_factory=list)
    _restarts: Counter[int] = field(default_factory=Counter)  # of each system, as is the next one
    _latest_ms: dict[int, float] = field(default_factory=dict)

    @property
    def booted(self) -> datetime | None:
        """When the vehicle's clock was zero."""
        boot_s = median(self._boots_s) if self._boots_s else -1.0
        return datetime.fromtimestamp(boot_s, UTC) if 0.0 <= boot_s < _TIME_MAX_S else None

    @property
    def restarts(self) -> int:
        """How often the vehicle's clock began again: the log then holds several flights."""
        return max(self._restarts.values(), default=0)

    @property
    def warning(self) -> str:
        """What keeps the results from being those of one fixed wing's flight, in a sentence; '' if nothing does."""
        if self.restarts:
            flights = f"the vehicle's clock starts again in it ({self.restarts + 1} flights)"
            return f"warning: {flights}, and the results mix them; give a log of one flight"
        if self.kind != TYPE_FIXED_WING:
            return f"warning: the vehicle is of MAV_TYPE {self.kind}, no fixed wing, which the results assume"
        if self.others:
            others = ", ".join(map(str, sorted(self.others)))
            return f"warning: the results are of the vehicle of system {self.system_id} only; it also has {others}"
        return ""

    def take(self, message: Message) -> None:
        """Note what a message reports of the vehicle; other systems and components are left out."""
        fields, system_id = message.fields, message.system_id
        if message.component_id != _AUTOPILOT_COMPONENT:
            return
        is_vehicle = message.name == "HEARTBEAT" and fields["autopilot"] != AUTOPILOT_INVALID
        if is_vehicle and self.system_id is None:
            self.system_id = system_id
        if self.system_id not in (None, system_id):
            if is_vehicle:
                self.others.add(system_id)
        elif message.name == "HEARTBEAT":
            known = autopilot_by_mav_autopilot(int(fields["autopilot"]))
            if known is not None:
                self.autopilot = known
                self._is_of_kind(int(fields.get("type") or TYPE_FIXED_WING))
        elif message.name == "STATUSTEXT":
            self._text(str(fields["text"]))
        elif message.name == "PARAM_VALUE":
            self._parameter(str(fields["param_id"]), fields["param_value"])
        elif message.name == "HOME_POSITION":
            self.home_altitude_m = fields["altitude"] * 1e-3
        else:
            self._position(message)

    def _position(self, message: Message) -> None:
        fields, system_id = message.fields, message.system_id
        stamp_ms = fields["time_boot_ms"]
        self._restarts[system_id] += stamp_ms < self._latest_ms.get(system_id, -math.inf) - _RESTARTED_MS
        self._latest_ms[system_id] = stamp_ms
        if self.home_altitude_m is None and fields["lat"]:
            self.home_altitude_m = (fields["alt"] - fields["relative_alt"]) * 1e-3
        if len(self._boots_s) < _STAMPS and message.received_s > _DATED_S:
            self._boots_s.append(message.received_s - stamp_ms * 1e-3)

    def _text(self, text: str) -> None:
        firmware = _FIRMWARE.match(text)
        if firmware:
            self.firmware = self.firmware or firmware[0].strip()
            self.autopilot = autopilot_by_mav_autopilot(_ARDUPILOT if firmware[1] else _PX4) or self.autopilot
            self._is_of_kind(_TYPES.get(firmware[1], TYPE_FIXED_WING))

    def _parameter(self, name: str, value: float) -> None:
        if name == "Q_ENABLE" and value:  # such a vehicle may call itself a fixed wing
            self._is_of_kind(_VTOL)
        elif name == "MAV_TYPE" and value in range(1, _TYPE_MAX + 1):
            self._is_of_kind(int(value))

    def _is_of_kind(self, kind: int) -> None:
        """Note the vehicle's MAV_TYPE by one source; if several differ, it is not a fixed wing."""
        if self.kind == TYPE_FIXED_WING:
            self.kind = kind


_NAMED_AT_MOST = 20
_COMPRESSED = (b"\x1f\x8b", b"PK\x03\x04", b"BZh", b"\xfd7zXZ")  # the first bytes of gzip, zip, bzip2, xz

MessageReader = Callable[[Path, Collection[str], Progress], Iterator[Message]]


@dataclass(slots=True)
class RecordedLog:
    """A log; range_names and gimbal_names: what its kind calls a slant range and a line of sight."""

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
        context = LogContext(autopilot_by_mav_autopilot(self.mav_autopilot) or AUTOPILOTS[0])
        try:
            for message in self._messages(self.path, {*wanted, *context.NAMES}, progress):
                if message.name in context.NAMES:
                    context.take(message)
                if message.name in wanted:
                    yield message
        except OSError as error:
            raise _unreadable(self.path, error) from error
        self._context = context

    def context(self) -> LogContext:
        """Return what the log contains besides the flight; it is read for that unless its messages have been."""
        if self._context is None:
            deque(self.messages(()), maxlen=0)
        assert self._context is not None
        return self._context

    def contents(self) -> Counter[str]:
        """Return how many messages of each name the log has. Raises InputError if it cannot be read."""
        try:
            return self._contents(self.path)
        except OSError as error:
            raise _unreadable(self.path, error) from error

    def looked_for(self) -> str:
        """Return which messages sightings need and which ones the log has instead, as the end of a sentence."""
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
    """Return the log at ``path``, of the kind that its content shows. Raises InputError."""
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
        source = translator()
        translated = source.messages(entries(path, source.names, progress))
        return (message for message in translated if message.name in wanted)

    return messages


_TLOG_NAMES = ("DISTANCE_SENSOR", "RANGEFINDER"), ("GIMBAL_DEVICE_ATTITUDE_STATUS",)
_ULOG_NAMES = ("distance_sensor",), ("gimbal_device_attitude_status",)
_DATAFLASH_NAMES = ("RFND", "MNT.Dist"), ("MNT",)
_FROM_DATAFLASH, _FROM_ULOG = _translated(ArdupilotMessages, read_dataflash), _translated(Px4Messages, read_ulog)
_KINDS = (
    ("tlog", *_TLOG_NAMES, _ARDUPILOT, read_tlog, tlog_contents),
    ("ULog", *_ULOG_NAMES, _PX4, _FROM_ULOG, ulog_contents),
    ("DataFlash log", *_DATAFLASH_NAMES, _ARDUPILOT, _FROM_DATAFLASH, dataflash_contents),
)

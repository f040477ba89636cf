"""The journal of a run: everything that went into the control step and came out of it, one JSON line each.

A line names the type of a frozen dataclass, gives its fields so that floats come back bit for bit, and ends in its
own checksum: every whole line is read, whatever happened to its neighbours. The first line is the header. The reader
receives the event types as an argument.

msgspec reads lines in today's form, which nearly all have. Lines with NaN, and those of earlier versions, are parsed
by json first; both give the same values.
"""

from __future__ import annotations

import io
import json
import re
import zlib
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass, fields, is_dataclass
from functools import cache
from itertools import count
from pathlib import Path
from typing import Any, TypeVar, get_args, get_origin, get_type_hints

import msgspec
import numpy as np

from sidelong.app.errors import InputError
from sidelong.app.records.text_file import Appender, Progress, unseen
from sidelong.estimators.frames import LocalPlane

FORMAT = 2

_OPENING = b'{"event":"'
_FIELDS = b'","fields":'
_CHECKSUM = b',"crc32":"%08x"}\n'
_CHECKSUM_BYTES = len(_CHECKSUM % 0)
_PROGRESS_LINES = 1000
_LINE_MAX_BYTES = 4 << 20  # a plan takes a hundredth of that

_Record = TypeVar("_Record")

OLDEST_FORMAT = 1  # to November 2026; some types and units had other names
_NAMES_IN_1 = {
    "Engaged": "ControlAcquired",
    "Prepare": "UploadPlan",
    "Depart": "ActivatePlan",
    "SwapReported": "PlanStatus",
    "Decided": "DecisionRecord",
}
# Types of a fleet, until late in format 2. A flight has a BatteryReported of its own.
_EARLIER_NAMES = {"BatteryReported": "ChargeReported", "Tell": "VehicleEvent"}
_UNIT_IN_1 = re.compile(r"_1_(m2|m|s)$")


@dataclass(frozen=True, slots=True)
class Header:
    """What a replay needs before the first event; plane is None when the run began before it was known.

    home_deg is (latitude, longitude). Without it, autopilot and home_altitude_m no exchange was recorded.
    """

    program: str
    config: Mapping[str, Any]
    plane: LocalPlane | None
    seeds: Mapping[str, int]
    format: int = FORMAT
    home_deg: tuple[float, float] | None = None
    autopilot: str = ""
    home_altitude_m: float | None = None


def _plain(value: Any) -> Any:
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    raise TypeError(f"a journal holds no {type(value).__name__}")


def _array(kind: type, values: Any) -> Any:
    if get_origin(kind) is not np.ndarray:
        raise NotImplementedError
    return np.array(values, dtype=np.float64)


@cache
def _shape(kind: type) -> tuple[type, Callable[[Any], Any]]:
    """Return what msgspec reads a type's fields as, and what makes an object of that.

    It cannot distinguish dataclasses: where a field is one of several, the names of the fields do.
    """
    hints = get_type_hints(kind)
    several = {name: get_args(hint) for name, hint in hints.items() if sum(map(is_dataclass, get_args(hint))) > 1}
    if not several:
        return kind, lambda read: read

    def made(read: Any) -> Any:
        given = msgspec.structs.asdict(read)
        for name, kinds in several.items():
            own = given[name].keys()
            nearest = min(kinds, key=lambda one: len({field.name for field in fields(one)} ^ own))
            given[name] = msgspec.convert(given[name], nearest, dec_hook=_array)
        return kind(**given)

    plain = [(name, dict[str, Any] if name in several else hint) for name, hint in hints.items()]
    return msgspec.defstruct(kind.__name__, plain), made


@cache
def _decode(kind: type) -> Callable[[bytes], Any]:
    shape, made = _shape(kind)
    decode: Callable[[bytes], Any] = msgspec.json.Decoder(shape, dec_hook=_array).decode
    return decode if shape is kind else lambda line: made(decode(line))


_ENCODE = json.JSONEncoder(separators=(",", ":")).encode


def to_builtins(event: Any) -> Any:
    """Return an event as dicts, lists, numbers and strings for JSON."""
    return msgspec.to_builtins(event, enc_hook=_plain)


def encode(event: Any) -> bytes:
    """Return an event as a line of the journal, with checksum, without line feed."""
    fields = _ENCODE(to_builtins(event))
    body = f'{{"event":"{type(event).__name__}","fields":{fields}'.encode()
    return body + _CHECKSUM % zlib.crc32(body)


class JournalWriter(Appender):
    def __init__(self, path: Path, header: Header, on_trouble: Callable[[str], None]) -> None:
        super().__init__(path, on_trouble, opening=encode(header))

    def write(self, event: Any) -> None:
        self.append(encode(event))


class JournalReader:
    """Reads a journal of the given event types. Iterating yields the events, each time from the first.

    damaged_lines counts what the last iteration passed over, but for a cut last line, as a kill leaves it. Raises
    InputError for a header that cannot be read or is of another format, and for an event of no known type.
    """

    def __init__(self, path: Path, types: Collection[type], progress: Progress = unseen) -> None:
        self.path, self._progress = path, progress
        present = {kind.__name__: kind for kind in (Header, *types)}
        self._types = {old: present[new] for old, new in _EARLIER_NAMES.items() if new in present} | present
        self.damaged_lines = 0
        first = next(self._records(_record), None)
        if first is None or first[0] != Header.__name__:
            raise InputError(f"{path} has no journal header: it is not a journal, or its beginning is damaged.")
        self._format: int = first[1].get("format", 0)
        if self._format not in range(OLDEST_FORMAT, FORMAT + 1):
            raise InputError(
                f"{path} is a journal of format {self._format!r:.20}; this program reads {OLDEST_FORMAT} to {FORMAT}."
            )
        # By their names as a line has them; what was written before goes the old way.
        self._kinds = {name.encode(): kind for name, kind in self._types.items()} if self._format == FORMAT else {}
        self.header: Header = next(self._records(self._event))

    def __iter__(self) -> Iterator[Any]:
        events = self._records(self._event)
        next(events)
        return events

    def _event(self, body: bytes) -> Any:
        """Return the event of a whole line, None where it holds something else."""
        end = body.find(_FIELDS, len(_OPENING))
        try:
            return _decode(self._kinds[body[len(_OPENING) : end]])(body[end + len(_FIELDS) :])
        except Exception:  # as below; the slower reader reports any error
            record = _record(body)
        return None if record is None else self._structured(*record)

    def _structured(self, name: str, fields: dict[str, Any]) -> Any:
        try:
            name, fields = upgraded(name, fields, self._format)
            shape, made = _shape(self._types[name])
            try:  # the line may only have held NaN
                return made(msgspec.convert(fields, shape, dec_hook=_array))
            except msgspec.ValidationError:
                return made(msgspec.convert(fields, shape, strict=False, dec_hook=_array))
        except Exception as error:  # whatever a type's constructor makes of another's values
            raise InputError(f"{self.path} has an event {name:.40} that this program does not know.") from error

    def _records(self, read: Callable[[bytes], _Record | None]) -> Iterator[_Record]:
        """Yield what is read of every whole line, but for those that hold something else."""
        self.damaged_lines = 0
        try:
            with self.path.open("rb") as file:
                size = max(1, file.seek(0, io.SEEK_END))
                file.seek(0)
                for number in count():
                    line = file.readline(_LINE_MAX_BYTES)
                    if not line:
                        return
                    body = _whole_body(line)
                    record = read(body) if body is not None else None
                    if record is not None:
                        yield record
                    if body is None or record is None or len(body) + _CHECKSUM_BYTES < len(line):
                        self.damaged_lines += line.endswith(b"\n")
                    if number % _PROGRESS_LINES == 0:
                        self._progress(file.tell() / size)
        except OSError as error:
            raise InputError(f"{self.path} cannot be read: {error.strerror}.") from error


def _record(body: bytes) -> tuple[str, dict[str, Any]] | None:
    """Return type name and fields; None where a whole line holds something else."""
    try:
        record = json.loads(body + b"}")
        name, fields = record["event"], record["fields"]
    except (ValueError, KeyError, RecursionError):
        return None
    return (name, fields) if isinstance(name, str) and isinstance(fields, dict) else None


def _whole_body(line: bytes) -> bytes | None:
    """Return what stands before the checksum if it holds, else None.

    A damaged line runs on into the next one, so the last opening counts; within texts JSON escapes quotation marks.
    """
    start = line.rfind(_OPENING)
    body = line[start:-_CHECKSUM_BYTES]
    return body if start >= 0 and line.endswith(_CHECKSUM % zlib.crc32(body)) else None


def upgraded(name: str, fields: dict[str, Any], written_format: int) -> tuple[str, dict[str, Any]]:
    """Return a record's type name and fields as the present format spells them."""
    if name == "Announce" and fields.get("kind") == "swap":  # until late in format 2
        fields = fields | {"kind": "plan"}
    if written_format > OLDEST_FORMAT:
        return name, fields
    return _NAMES_IN_1.get(name, name), _with_units(fields)


def _with_units(value: Any) -> Any:
    if isinstance(value, dict):
        return {_UNIT_IN_1.sub(r"_per_\1", key): _with_units(item) for key, item in value.items()}
    if isinstance(value, list) and value and isinstance(value[0], dict):
        return [_with_units(item) for item in value]
    return value

"""The journal of a run: everything that went into the control step and came out of it, one JSON line each.

A line names the type of a frozen dataclass and gives its fields; floats are written so that they come back bit for
bit, NaN and the infinities as Python's json spells them. It ends in its own checksum: a line that was cut or
damaged is recognised, and every whole line is read, whatever happened to its neighbours. The first line is the
header. The journal defines no event types; the reader receives them as an argument.

msgspec reads lines in today's form, which nearly all have. Lines with NaN are parsed by json. The other lines that
msgspec refuses (a number where another kind is expected, names of earlier versions) are also structured by cattrs,
ten times slower; all give the same values.
"""

from __future__ import annotations

import contextlib
import io
import json
import re
import zlib
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, fields, is_dataclass
from functools import cache
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar, get_args, get_origin, get_type_hints

import msgspec
import numpy as np

from sidelong.app.errors import InputError
from sidelong.app.records.appender import Appender
from sidelong.app.records.text_file import Progress, unseen
from sidelong.estimators.frames import LocalPlane

if TYPE_CHECKING:
    import cattrs

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
_UNIT_IN_1 = re.compile(r"_1_(m2|m|s)$")


@dataclass(frozen=True, slots=True)
class Header:
    """What a replay needs before the first event. plane is None when the run began before it was known.

    home_deg is (latitude, longitude); journals of earlier versions lack it. autopilot and home_altitude_m are present
    if the exchange with the autopilot was recorded too.
    """

    program: str
    config: Mapping[str, Any]
    plane: LocalPlane | None
    seeds: Mapping[str, int]
    format: int = FORMAT
    home_deg: tuple[float, float] | None = None
    autopilot: str = ""
    home_altitude_m: float | None = None


def _is_array(kind: object) -> bool:
    return get_origin(kind) is np.ndarray


@cache
def _converter() -> cattrs.Converter:
    import cattrs  # noqa: PLC0415  # only what msgspec refuses needs it

    converter = cattrs.Converter(detailed_validation=False)
    converter.register_structure_hook_func(
        _is_array,
        lambda values, _: np.array(values, dtype=np.float64),
    )
    return converter


def _plain(value: Any) -> Any:
    """Return what msgspec does not know as it does: arrays and scalars of numpy."""
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    raise TypeError(f"a journal holds no {type(value).__name__}")


def _array(kind: type, values: Any) -> Any:
    """Return what msgspec has read for an array."""
    if not _is_array(kind):
        raise NotImplementedError
    return np.array(values, dtype=np.float64)


@cache
def _decode(kind: type) -> Callable[[bytes], Any]:
    """Return the decoder of a type's fields. msgspec cannot distinguish dataclasses, so their fields do."""
    hints = get_type_hints(kind)
    several = {name: get_args(hint) for name, hint in hints.items() if sum(map(is_dataclass, get_args(hint))) > 1}
    if not several:
        return msgspec.json.Decoder(kind, dec_hook=_array).decode
    plain = [(name, dict[str, Any] if name in several else hint) for name, hint in hints.items()]
    decode = msgspec.json.Decoder(msgspec.defstruct(kind.__name__, plain), dec_hook=_array).decode

    def read(line: bytes) -> Any:
        given = msgspec.structs.asdict(decode(line))
        return kind(**given | {name: _one_of(kinds, given[name]) for name, kinds in several.items()})

    return read


def _one_of(kinds: Iterable[type], given: dict[str, Any]) -> Any:
    """Return an object of the kind that has these very fields."""
    kind = next(kind for kind in kinds if [field.name for field in fields(kind)] == list(given))
    return msgspec.convert(given, kind, dec_hook=_array)


_ENCODE = json.JSONEncoder(separators=(",", ":")).encode


def to_builtins(event: Any) -> Any:
    """Return a frozen dataclass as dictionaries, lists, texts and numbers."""
    return msgspec.to_builtins(event, enc_hook=_plain)


def encode(event: Any) -> bytes:
    """Return the line for a frozen dataclass."""
    fields = _ENCODE(to_builtins(event))
    body = f'{{"event":"{type(event).__name__}","fields":{fields}'.encode()
    return body + _CHECKSUM % zlib.crc32(body)


class JournalWriter(Appender):
    """Writes a new journal, from any thread."""

    def __init__(self, path: Path, header: Header, on_trouble: Callable[[str], None]) -> None:
        super().__init__(path, on_trouble, opening=encode(header))

    def write(self, event: Any) -> None:
        self.append(encode(event))


class JournalReader:
    """Reads a journal of the given event types. Iterating yields the events, each time from the first.

    damaged_lines counts what the last iteration had to pass over; a cut last line, as a kill leaves it, is not
    damage. Raises InputError when the header cannot be read or is of another format; iterating does when an event
    is of no known type.
    """

    def __init__(self, path: Path, types: Collection[type], progress: Progress = unseen) -> None:
        self.path, self._progress = path, progress
        self._types = {kind.__name__: kind for kind in (Header, *types)}
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
            with contextlib.suppress(msgspec.ValidationError, TypeError):  # the line may only have held NaN
                return msgspec.convert(fields, self._types[name], dec_hook=_array)
            return _converter().structure(fields, self._types[name])
        except Exception as error:  # cattrs passes on whatever a type's constructor makes of another's values
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

    A line whose end was damaged runs on into the next one, which is whole: so the last opening counts. There is no
    other in a whole line, since JSON writes quotation marks inside texts with a backslash.
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

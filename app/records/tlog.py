"""Telemetry logs (tlog): MAVLink 1 and 2 frames, each behind an 8-byte big-endian stamp of microseconds since 1970.

A frame is accepted by its checksum, wherever it begins: every place in the file that could begin a wanted
frame is checked, so garbage, cuts and damaged neighbours cost no whole frame, and there is no synchronisation to
lose. A frame inside the payload of another whole frame (a log sent over the link, a tunnel) is that frame's
content and left alone. Only wanted frames are decoded; others are looked at only where they reach over a wanted one.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Collection, Iterator
from functools import cached_property
from itertools import repeat, starmap
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from pymavlink.dialects.v20 import all as dialect

from sidelong.app.link.message import Message
from sidelong.app.records.windows import Progress, Window, windows

MessageSource = tuple[str, int, int]
"""Message name, system id, component id."""

_MARKER_V1, _MARKER_V2 = 0xFE, 0xFD
_SIGNED = 0x01  # the one incompatibility flag that is defined
_STAMP_BYTES = 8
_FRAME_MAX_BYTES = 10 + 255 + 2 + 13
_STAMP_MIN_US, _STAMP_MAX_US = 10**15, 4 * 10**15  # 2001 to 2096: anything else was not written as a stamp

_Bytes = npt.NDArray[np.uint8]
_Ints = npt.NDArray[np.integer[Any]]
_Bools = npt.NDArray[np.bool_]


class _Kind:
    """One message definition: how payloads become fields."""

    def __init__(self, definition: Any) -> None:
        self.name: str = definition.msgname
        self.crc_extra: int = definition.crc_extra
        self.payload_bytes: int = definition.unpacker.size
        self._definition, self._unpacker = definition, definition.unpacker

    @cached_property
    def _as_fields(self) -> Callable[..., dict[str, Any]]:
        return _fields_maker(self._definition)

    def fields(self, data: _Bytes, frames: _Frames) -> Iterator[dict[str, Any]]:
        """Yield the fields of each payload; a short one goes on with zeros, which MAVLink 2 clips off."""
        payloads = np.lib.stride_tricks.sliding_window_view(data, self.payload_bytes)[frames.payload]
        present = frames.payload_end - frames.payload
        if present.min() < self.payload_bytes:
            payloads *= np.arange(self.payload_bytes) < present[:, None]
        return starmap(self._as_fields, self._unpacker.iter_unpack(payloads.tobytes()))


def _fields_maker(definition: Any) -> Callable[..., dict[str, Any]]:
    """Return a function from a payload's unpacked values to its fields: arrays as lists, characters as text.

    Written out as one dict display for the definition, it takes half the time of ``dict(zip(...))``.
    """
    items: dict[str, str] = {}
    arguments: list[str] = []
    codes = re.findall(r"\d*[a-zA-Z]", definition.unpacker.format)
    for name, length, code in zip(definition.ordered_fieldnames, definition.lengths, codes, strict=True):
        own = [f"value_{len(arguments) + i}" for i in range(length)]
        value = f"_text({own[0]})" if code[-1] in "sc" else own[0] if code.isalpha() else f"[{', '.join(own)}]"
        items[name] = f"{name!r}: {value}"
        arguments += own
    display = ", ".join(items[name] for name in definition.fieldnames)
    made: Callable[..., dict[str, Any]] = eval(f"lambda {', '.join(arguments)}: {{{display}}}", {"_text": _text})
    return made


def _text(characters: bytes) -> str:
    return characters.split(b"\0", 1)[0].decode("ascii", "replace")


_KINDS: dict[int, _Kind] = {number: _Kind(definition) for number, definition in dialect.mavlink_map.items()}
_CRC_EXTRA = np.zeros(1 << 16, np.uint16)
_PAYLOAD_BYTES = np.zeros(1 << 16, np.int64)
for _number, _kind in _KINDS.items():  # the dialects number no message beyond 16 bits
    _CRC_EXTRA[_number], _PAYLOAD_BYTES[_number] = _kind.crc_extra, _kind.payload_bytes


def _flags_by_number(names: Collection[str] | None) -> _Bools:
    """Return which message numbers carry one of these names; None stands for all that are defined."""
    flags = np.zeros(1 << 16, np.bool_)
    flags[[number for number, kind in _KINDS.items() if names is None or kind.name in names]] = True
    return flags


_DEFINED = _flags_by_number(None)


def _crc_tables() -> tuple[npt.NDArray[np.uint16], npt.NDArray[np.uint16]]:
    """CRC-16/MCRF4XX: the state after one and after two more bytes, by state xor bytes."""
    state = np.arange(1 << 16, dtype=np.uint16)
    low = state & 0xFF
    for _ in range(8):
        low = (low >> 1) ^ 0x8408 * (low & 1)
    after_byte = (state >> 8) ^ low
    return after_byte.astype(np.uint16), after_byte[after_byte].astype(np.uint16)


_AFTER_BYTE, _AFTER_TWO_BYTES = _crc_tables()


class _Frames(NamedTuple):
    """Places that could be frames, in file order: columns of shape (n,), counted from the window's start."""

    marker: _Ints
    payload: _Ints
    payload_end: _Ints
    number: _Ints

    def where(self, chosen: _Bools | _Ints) -> _Frames:
        return _Frames(*(column[chosen] for column in self))


def _byte_pairs(data: _Bytes) -> npt.NDArray[np.uint16]:
    """Return the little-endian 16-bit number at every byte, without a copy."""
    return np.ndarray(len(data) - 1, "<u2", data, strides=1)


def _numbers_at(data: _Bytes, marker: _Ints) -> _Ints:
    """Return the message numbers of the headers at ``marker``, 65535 (none has it) beyond 16 bits."""
    is_v2 = data[marker] == _MARKER_V2
    number = np.where(is_v2, _byte_pairs(data)[marker + 7], data[marker + 5])
    number[is_v2 & (data[marker + 9] != 0)] = 0xFFFF
    return number


def _frames_at(data: _Bytes, size: int, marker: _Ints) -> _Frames:
    """Return those frames at ``marker`` whose header makes sense and that end within ``size`` bytes."""
    is_v2 = data[marker] == _MARKER_V2
    number = _numbers_at(data, marker)
    flags = data[marker + 2] * is_v2
    payload_bytes = data[marker + 1].astype(np.int64)
    payload = marker + np.where(is_v2, 10, 6)
    payload_end = payload + payload_bytes
    # A MAVLink 1 payload has no extensions, so it cannot outgrow its definition.
    fits = (is_v2 | (payload_bytes <= _PAYLOAD_BYTES[number])) & (payload_end + 2 + 13 * flags <= size)
    return _Frames(marker, payload, payload_end, number).where(_DEFINED[number] & (flags <= _SIGNED) & fits)


def _whole(data: _Bytes, frames: _Frames) -> _Frames:
    """Return those frames whose checksum is that of their bytes."""
    frames = frames.where(np.argsort(frames.marker - frames.payload_end, kind="stable"))  # longest first
    first = frames.marker + 1
    length = frames.payload_end - first
    crc = np.full(len(length), 0xFFFF, np.uint16)
    pairs = _byte_pairs(data)
    unfinished = len(length) - np.cumsum(np.bincount(length // 2))
    for step, count in enumerate(unfinished[:-1].tolist()):
        crc[:count] = _AFTER_TWO_BYTES[crc[:count] ^ pairs[first[:count] + 2 * step]]
    odd = np.flatnonzero(length & 1)
    crc[odd] = _AFTER_BYTE[crc[odd] ^ data[frames.payload_end[odd] - 1]]
    crc = _AFTER_BYTE[crc ^ _CRC_EXTRA[frames.number]]
    whole = frames.where(crc == pairs[frames.payload_end])
    return whole.where(np.argsort(whole.marker))


def _whole_wanted(data: _Bytes, size: int, wanted: _Bools) -> _Frames:
    """Return the whole frames of wanted kinds in ``data[:size]``; ``data`` goes on behind for a frame's length."""
    marker = np.flatnonzero(data[:size] + np.uint8(256 - _MARKER_V2) < 2)  # the two markers are neighbours
    frames = _whole(data, _frames_at(data, size, marker[wanted[_numbers_at(data, marker)]]))
    # Which of the other places could be frames around one of these?
    following = np.searchsorted(frames.marker, marker, side="right")
    next_end = np.append(frames.payload_end, np.iinfo(np.int64).max)[following]
    around = _whole(data, _frames_at(data, size, marker[next_end < marker + 10 + data[marker + 1]]))
    outermost = np.ones(len(frames.marker), np.bool_)
    for begin, end in zip(around.payload, around.payload_end, strict=True):
        outermost[slice(*np.searchsorted(frames.marker, (begin, end)))] = False
    return frames.where(outermost)


class _Reading:
    """The whole frames of wanted kinds that begin in one window of the file."""

    def __init__(self, window: Window, wanted: _Bools, last_received_s: float) -> None:
        size = len(window.data)
        self._data = np.zeros(size + _FRAME_MAX_BYTES, np.uint8)
        self._data[:size] = np.frombuffer(window.data, np.uint8)
        frames = _whole_wanted(self._data, size, wanted)
        own = (frames.marker >= window.own_begin) & (frames.marker < window.own_end)
        self._frames = frames.where(own)
        self._received_s = self._stamps_s(last_received_s)
        self.last_received_s = float(self._received_s[-1]) if len(self._received_s) else last_received_s

    @property
    def sources(self) -> Counter[MessageSource]:
        """How many whole frames each source has here."""
        system_id, component_id = self._senders()
        keys = self._frames.number.astype(np.int64) << 16 | system_id.astype(np.int64) << 8 | component_id
        unique, counts = (column.tolist() for column in np.unique(keys, return_counts=True))
        sources = ((_KINDS[key >> 16].name, key >> 8 & 0xFF, key & 0xFF) for key in unique)
        return Counter(dict(zip(sources, counts, strict=True)))

    def messages(self) -> Iterator[Message]:
        """Yield the frames as messages, each made when it is asked for: a window of them would not fit a cache."""
        numbers = self._frames.number
        system_id, component_id = self._senders()
        of_kind: dict[int, Iterator[Message]] = {}
        for number in np.unique(numbers).tolist():
            here = np.flatnonzero(numbers == number)
            of_kind[number] = map(
                Message,
                repeat(_KINDS[number].name),
                system_id[here].tolist(),
                component_id[here].tolist(),
                _KINDS[number].fields(self._data, self._frames.where(here)),
                self._received_s[here].tolist(),
            )
        return map(next, map(of_kind.__getitem__, numbers.tolist()))

    def _senders(self) -> tuple[_Bytes, _Bytes]:
        """System and component of each frame: the last header bytes before the message number."""
        marker = self._frames.marker
        system = marker + np.where(self._data[marker] == _MARKER_V2, 5, 3)
        return self._data[system], self._data[system + 1]

    def _stamps_s(self, last_s: float) -> npt.NDArray[np.float64]:
        """Return the frames' stamps; where there is none that is credible, that of the frame before."""
        stamp = self._frames.marker - _STAMP_BYTES
        stamp_us = np.lib.stride_tricks.sliding_window_view(self._data, _STAMP_BYTES)[np.maximum(stamp, 0)]
        stamp_us = stamp_us.view(">u8")[:, 0].astype(np.uint64)
        credible = (stamp >= 0) & (stamp_us > _STAMP_MIN_US) & (stamp_us < _STAMP_MAX_US)
        latest = np.maximum.accumulate(np.where(credible, np.arange(len(stamp)), -1))
        return np.append(stamp_us * 1e-6, last_s)[latest]


def _readings(path: Path, wanted: _Bools, progress: Progress | None) -> Iterator[_Reading]:
    last_received_s = 0.0
    for window in windows(path, _STAMP_BYTES + _FRAME_MAX_BYTES, progress):
        reading = _Reading(window, wanted, last_received_s)
        last_received_s = reading.last_received_s
        yield reading


def read_tlog(
    path: Path, wanted: Collection[str] | None = None, progress: Progress | None = None
) -> Iterator[Message]:
    """Yield the messages of the ``wanted`` names (None: all defined ones) in file order.

    Damaged and cut frames are passed over, those of a definition that pymavlink does not know as well. Raises
    OSError when the file cannot be read.
    """
    for reading in _readings(path, _flags_by_number(wanted), progress):
        yield from reading.messages()


def summary(path: Path, progress: Progress | None = None) -> Counter[MessageSource]:
    """Return how many whole frames each source has in the file."""
    counts: Counter[MessageSource] = Counter()
    for reading in _readings(path, _DEFINED, progress):
        counts += reading.sources
    return counts


def is_tlog(path: Path) -> bool:
    """Return whether there is a whole frame in the file."""
    return any(reading.sources for reading in _readings(path, _DEFINED, None))

"""PX4's ULog, read from those parts of the file that are whole.

pyulog goes from message to message and, behind damage, on to the next synchronisation mark, which may be many
seconds away. So the file is searched for the wanted topics instead: a message is known by its type's letter and its
size and, for data, by its topic's number. The result is bounded, whatever a damaged definition contains.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from sidelong.app.records.entry import Entry, in_order
from sidelong.app.records.windows import Progress, Window, windows

MAGIC = b"ULog\x01\x12\x35"

_HEADER_BYTES = 3  # size of the body, then the type's letter
_DATA_HEADER_BYTES = _HEADER_BYTES + 2  # and the topic's number
_MARGIN_BYTES = _HEADER_BYTES + (1 << 16)
_DEFINITION_MAX_BYTES, _SUBSCRIPTION_MAX_BYTES = 1 << 13, 1 << 8
_DEFINITION = re.compile(rb"([\w/-]+):((?:[\w/-]+(?:\[\d{1,5}\])? \w+;)+)")
_FIELD = re.compile(rb"([\w/-]+)(?:\[(\d+)\])? (\w+);")
_TYPES = {
    **{b"int%d_t" % bits: f"<i{bits // 8}" for bits in (8, 16, 32, 64)},
    **{b"uint%d_t" % bits: f"<u{bits // 8}" for bits in (8, 16, 32, 64)},
    **{b"float": "<f4", b"double": "<f8", b"bool": "?", b"char": "i1"},
}
# Beyond what any topic has: a definition may nest arrays of arrays without end.
_FIELDS_MAX, _DEPTH_MAX, _TOPICS_MAX = 1024, 8, 1024

_Field = tuple[str, str]  # name and type for numpy


@dataclass(frozen=True, slots=True)
class _Topic:
    """One instance of a topic. row: as numpy reads it, without the padding at its end."""

    name: str
    instance: int
    row: np.dtype[np.void]


class _Salvage:
    """The whole messages that matter. What it learns of one window holds for those after it."""

    def __init__(self, wanted: Collection[str] | None) -> None:
        self._wanted = None if wanted is None else {name.encode() for name in wanted}
        self._definitions: dict[bytes, bytes] = {}
        self._rows: dict[bytes, tuple[np.dtype[np.void], int] | None] = {}  # by topic name, as far as asked for
        self._topics: dict[int, _Topic] = {}
        self._min_bytes = np.full(1 << 16, 1 << 17, np.int64)  # by topic number; of one not known none is long enough
        self._max_bytes = np.zeros(1 << 16, np.int64)

    def read(self, window: Window) -> Iterator[tuple[_Topic, npt.NDArray[np.int64], npt.NDArray[np.void]]]:
        """Yield what there is of the wanted topics in a window: positions and rows of each."""
        self._learn(window.data)
        data = np.frombuffer(window.data, np.uint8)
        letter = np.flatnonzero(data[: max(len(data) - 2, 0)] == ord("D"))
        begin = letter - (_HEADER_BYTES - 1)
        mine = (begin >= window.own_begin) & (begin < window.own_end)
        letter, begin = letter[mine], begin[mine]
        size = data[begin].astype(np.int64) | data[begin + 1].astype(np.int64) << 8
        number = data[letter + 1].astype(np.int64) | data[letter + 2].astype(np.int64) << 8
        row_bytes = size - (_DATA_HEADER_BYTES - _HEADER_BYTES)
        whole = (row_bytes >= self._min_bytes[number]) & (row_bytes <= self._max_bytes[number])
        whole &= begin + _HEADER_BYTES + size <= len(data)
        begin, number = begin[whole], number[whole]
        for which in np.unique(number).tolist():
            topic, positions = self._topics[which], begin[number == which]
            # Rows of a log do not lie over each other; those of a damaged one may, without end.
            positions = positions[: 2 * len(data) // topic.row.itemsize]
            rows = np.lib.stride_tricks.sliding_window_view(data, topic.row.itemsize)[positions + _DATA_HEADER_BYTES]
            yield topic, positions, np.ascontiguousarray(rows).view(topic.row)[:, 0]

    def _learn(self, data: bytes) -> None:
        for message in _messages(data, b"F", _DEFINITION_MAX_BYTES):
            definition = _DEFINITION.fullmatch(message)
            if definition and len(self._definitions) < _TOPICS_MAX:
                self._definitions[definition[1]] = definition[2]
        self._rows.clear()
        for message in _messages(data, b"A", _SUBSCRIPTION_MAX_BYTES):
            instance, number, name = message[0], int.from_bytes(message[1:3], "little"), message[3:]
            if name not in self._definitions or (self._wanted is not None and name not in self._wanted):
                continue
            if name not in self._rows:
                self._rows[name] = self._row(name)
            row = self._rows[name]
            if row is not None and (number in self._topics or len(self._topics) < _TOPICS_MAX):
                data_type, self._max_bytes[number] = row
                self._min_bytes[number] = data_type.itemsize
                self._topics[number] = _Topic(name.decode(), instance, data_type)

    def _row(self, name: bytes) -> tuple[np.dtype[np.void], int] | None:
        """Return a topic's row, and how long it is with the padding at its end.

        None when its definition is damaged or has no time.
        """
        try:
            fields = list(self._fields(name))
            padded_bytes = np.dtype(fields).itemsize
            while fields and fields[-1][0].startswith("_padding"):
                fields.pop()
            return (np.dtype(fields), padded_bytes) if ("timestamp", "<u8") in fields else None
        except (KeyError, ValueError):
            return None

    def _fields(self, name: bytes) -> Iterator[_Field]:
        """Yield the fields of a definition, nested ones as ``outer.inner``, arrays as ``name[0]``, ``name[1]``.

        Raises KeyError for a type that is not defined and ValueError for what no topic can be.
        """
        budget = _FIELDS_MAX

        def flat(name: bytes, prefix: str, depth: int) -> Iterator[_Field]:
            nonlocal budget
            for part in _FIELD.finditer(self._definitions[name]):
                kind, length, field = part.groups()
                places = [""] if length is None else [f"[{i}]" for i in range(min(int(length), _FIELDS_MAX))]
                budget -= max(len(places), 1)
                if budget < 0 or depth > _DEPTH_MAX:
                    raise ValueError("more fields than a topic has")
                for place in places:
                    if kind in _TYPES:
                        yield f"{prefix}{field.decode()}{place}", _TYPES[kind]
                    else:
                        yield from flat(kind, f"{prefix}{field.decode()}{place}.", depth + 1)

        yield from flat(name, "", 0)


def _messages(data: bytes, letter: bytes, longest_bytes: int) -> Iterator[bytes]:
    """Yield the body of whatever could be a message of a type."""
    at = data.find(letter, _HEADER_BYTES - 1)
    while at >= 0:
        size = int.from_bytes(data[at - 2 : at], "little")
        if 3 < size <= longest_bytes and at + 1 + size <= len(data):
            yield data[at + 1 : at + 1 + size]
        at = data.find(letter, at + 1)


def read_ulog(path: Path, wanted: Collection[str], progress: Progress | None = None) -> Iterator[Entry]:
    """Yield the entries of the wanted topics, arrays as ``name[0]``, ``name[1]``, in order of time.

    Damage to an entry costs that entry, damage to a topic's definition the topic. Raises OSError when the file
    cannot be read.
    """
    salvage = _Salvage(wanted)
    for window in windows(path, _MARGIN_BYTES, progress):
        placed = []
        for topic, positions, rows in salvage.read(window):
            names = topic.row.names or ()
            for position, values in zip(positions.tolist(), rows.tolist(), strict=True):
                fields = dict(zip(names, values, strict=True))
                placed.append((position, Entry(fields["timestamp"], topic.name, topic.instance, fields)))
        placed.sort(key=lambda one: one[0])
        yield from in_order(entry for _, entry in placed)


def ulog_contents(path: Path, progress: Progress | None = None) -> Counter[str]:
    """Return how many entries of each topic the file has."""
    salvage = _Salvage(None)
    counts: Counter[str] = Counter()
    for window in windows(path, _MARGIN_BYTES, progress):
        for topic, positions, _ in salvage.read(window):
            counts[topic.name] += len(positions)
    return counts

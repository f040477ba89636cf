"""ArduPilot's DataFlash log (.bin): entries of fixed length behind two header bytes and a type, no checksums.

pymavlink's reader gives up what follows damage, so only its table of field formats is used. Here every place that
could begin an entry is judged by what follows it: an entry is whole when it ends at another header or at the end of
the file, and whole as well when what follows is damage, unless a whole one begins inside it.
"""

from __future__ import annotations

import struct
from collections import Counter
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from sidelong.app.records.entry import Entry, in_order
from sidelong.app.records.windows import Progress, Window, windows

_HEADER = b"\xa3\x95"
_FORMAT_TYPE = 0x80
_FORMAT = struct.Struct("<BB4s16s64s")  # type, length, name, one letter a field, field names
_FORMAT_BYTES = 3 + _FORMAT.size
_LONGEST_BYTES = 255
_INSTANCE_NAMES = ("Instance", "I", "C")

MAGIC = _HEADER + bytes([_FORMAT_TYPE])


class _Kind:
    """One type of entry. Raises KeyError or ValueError when its definition is damaged."""

    def __init__(self, length: int, name: bytes, letters: bytes, fields: bytes) -> None:
        from pymavlink.DFReader import FORMAT_TO_STRUCT  # noqa: PLC0415  # loads much that no other log needs

        formats = [FORMAT_TO_STRUCT[letter] for letter in _text(letters)]
        self._unpacker = struct.Struct("<" + "".join(code for code, _, _ in formats))
        self._divisors = [None if scale is None else round(1.0 / scale) for _, scale, _ in formats]
        self._field_names = _text(fields).split(",")
        self.name = _text(name)
        self.length = length
        if length != 3 + self._unpacker.size or len(self._field_names) != len(formats):
            raise ValueError(f"the definition of {self.name} contradicts itself")
        if ("TimeUS", "Q") not in zip(self._field_names, _text(letters), strict=True):
            self._field_names = []  # no time: nothing to be read of it

    def entry(self, data: bytes, position: int) -> Entry | None:
        """Return the entry at ``position``; None for those without a time."""
        if not self._field_names:
            return None
        values = self._unpacker.unpack_from(data, position + 3)
        scaled = (
            value if divisor is None else value / divisor
            for value, divisor in zip(values, self._divisors, strict=True)
        )
        fields: dict[str, Any] = dict(zip(self._field_names, scaled, strict=True))
        instance = next((fields[name] for name in _INSTANCE_NAMES if name in fields), 0)
        return Entry(fields["TimeUS"], self.name, instance, fields)


def _text(characters: bytes) -> str:
    return characters.split(b"\0", 1)[0].decode("ascii")


class _Kinds:
    """The definitions met so far, and the lengths that they give each type (0: not known)."""

    def __init__(self) -> None:
        self.by_type: dict[int, _Kind] = {}
        self.lengths = np.zeros(256, np.int64)
        self.lengths[_FORMAT_TYPE] = _FORMAT_BYTES

    def learn(self, data: bytes) -> None:
        at = data.find(MAGIC)
        while 0 <= at <= len(data) - _FORMAT_BYTES:
            number, length, *definition = _FORMAT.unpack_from(data, at + 3)
            if number not in self.by_type:
                try:
                    self.by_type[number] = _Kind(length, *definition)
                    self.lengths[number] = length
                except (KeyError, ValueError):
                    pass  # damaged, or no definition at all
            at = data.find(MAGIC, at + 1)

    def whole(self, window: Window) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.uint8]]:
        """Return position and type of the window's own whole entries, in order."""
        size = len(window.data)
        data = np.frombuffer(window.data, np.uint8)
        is_header = np.zeros(size + 1, np.bool_)
        is_header[: size - 1] = (data[:-1] == _HEADER[0]) & (data[1:] == _HEADER[1])
        position = np.flatnonzero(is_header[: size - 2])
        kind = data[position + 2]
        is_header[size] = window.at_end
        end = position + self.lengths[kind]
        known = (end > position) & (end <= size)
        position, kind, end = position[known], kind[known], end[known]
        followed = is_header[end]
        # Whole ones are those that are followed and have no other such within; then those outside all of these.
        start = np.append(position[followed], np.iinfo(np.int64).max)
        whole = start[np.searchsorted(start, position, side="right")] >= end
        taken_to = np.maximum.accumulate(np.append(0, np.where(followed & whole, end, 0)))[:-1]
        whole &= position >= taken_to
        own = whole & (position >= window.own_begin) & (position < window.own_end)
        return position[own], kind[own]


def read_dataflash(path: Path, wanted: Collection[str], progress: Progress | None = None) -> Iterator[Entry]:
    """Yield the entries of the wanted names in order of time, in the units that pymavlink gives them.

    Damage to an entry costs that entry, damage to a definition its type. Raises OSError when the file cannot be
    read.
    """
    kinds = _Kinds()
    for window in windows(path, _LONGEST_BYTES, progress):
        kinds.learn(window.data)
        chosen = [number for number, kind in kinds.by_type.items() if kind.name in wanted]
        positions, numbers = kinds.whole(window)
        is_chosen = np.isin(numbers, chosen)
        entries = (
            kinds.by_type[number].entry(window.data, position)
            for position, number in zip(positions[is_chosen].tolist(), numbers[is_chosen].tolist(), strict=True)
        )
        yield from in_order(entry for entry in entries if entry is not None)


def dataflash_contents(path: Path, progress: Progress | None = None) -> Counter[str]:
    """Return how many entries of each name the file has."""
    kinds = _Kinds()
    counts: Counter[str] = Counter()
    for window in windows(path, _LONGEST_BYTES, progress):
        kinds.learn(window.data)
        numbers, here = np.unique(kinds.whole(window)[1], return_counts=True)
        for number, count in zip(numbers.tolist(), here.tolist(), strict=True):
            counts[kinds.by_type[number].name if number in kinds.by_type else "FMT"] += count
    return counts

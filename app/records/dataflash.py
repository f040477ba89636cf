"""ArduPilot's DataFlash log (.bin): entries of fixed length behind two header bytes and a type, no checksums.

pymavlink's reader gives up what follows damage, so only its table of field formats is used. Here every place that
could begin an entry is judged by what follows: an entry is followed when it ends at another header or at the end of
the file. An entry that is not followed is whole as well, because damage follows it, unless a followed
one begins inside it.
"""

from __future__ import annotations

import re
import struct
from collections import Counter
from collections.abc import Collection, Iterator
from contextlib import suppress
from mmap import mmap
from pathlib import Path
from typing import Any

from sidelong.app.records.entry import Entry, in_order
from sidelong.app.records.mapped_file import Progress, mapped, unseen

_HEADER = b"\xa3\x95"
_HEADERS = re.compile(re.escape(_HEADER))
_FORMAT_TYPE = 0x80
_FORMAT = struct.Struct("<BB4s16s64s")  # type, length, name, one letter a field, field names
_FORMAT_BYTES = 3 + _FORMAT.size
_WITH_TEXT = ("MSG", "PARM", "VER")
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
        has_time = ("TimeUS", "Q") in zip(self._field_names, _text(letters), strict=True)
        # Little that is read has text: by a damaged definition other entries may seem to.
        has_text = any(code.endswith("s") for code, _, _ in formats)
        self.is_usable = has_time and (not has_text or self.name in _WITH_TEXT)

    def entry(self, data: mmap | bytes, at: int) -> Entry:
        """Return the entry at ``at``; it must have a time."""
        values = self._unpacker.unpack_from(data, at + 3)
        scaled = (
            (_text(value, "replace") if isinstance(value, bytes) else value) if divisor is None else value / divisor
            for value, divisor in zip(values, self._divisors, strict=True)
        )
        fields: dict[str, Any] = dict(zip(self._field_names, scaled, strict=True))
        instance = next((fields[name] for name in _INSTANCE_NAMES if name in fields), 0)
        return Entry(fields["TimeUS"], self.name, instance, fields)


def _text(characters: bytes, errors: str = "strict") -> str:
    return characters.split(b"\0", 1)[0].decode("ascii", errors)


def _kinds(data: mmap | bytes) -> dict[int, _Kind]:
    """Return the types that the file defines, by their numbers."""
    kinds: dict[int, _Kind] = {}
    for found in re.finditer(re.escape(MAGIC), data):
        if found.start() + _FORMAT_BYTES <= len(data):
            number, *definition = _FORMAT.unpack_from(data, found.end())
            with suppress(KeyError, ValueError):  # damaged, or no definition at all
                kinds.setdefault(number, _Kind(*definition))
    return kinds


def _entries(data: mmap | bytes, kinds: dict[int, _Kind]) -> Iterator[tuple[int, int]]:
    """Yield where the whole entries begin, with the numbers of their types."""
    size = len(data)
    lengths = {number: kind.length for number, kind in kinds.items()} | {_FORMAT_TYPE: _FORMAT_BYTES}

    def end_of(begin: int) -> int:
        return begin + lengths.get(data[begin + 2], size + 1) if begin + 2 < size else size + 1

    def is_followed(begin: int) -> bool:
        end = end_of(begin)
        return end == size or data[end : end + 2] == _HEADER

    at = 0
    while found := _HEADERS.search(data, at):
        begin = found.start()
        end, at = end_of(begin), begin + 1
        if end <= size and not any(is_followed(one.start()) for one in _HEADERS.finditer(data, begin + 1, end)):
            yield begin, data[begin + 2]
            at = end


def read_dataflash(path: Path, wanted: Collection[str], progress: Progress = unseen) -> Iterator[Entry]:
    """Yield the entries of the wanted names in order of time, in the units that pymavlink gives them.

    Damage to an entry costs that entry, damage to a definition its type. Raises OSError when the file cannot be
    read.
    """
    with mapped(path) as data:

        def read() -> Iterator[tuple[float, Entry]]:
            kinds = _kinds(data)
            chosen = {number: kind for number, kind in kinds.items() if kind.name in wanted and kind.is_usable}
            for at, number in _entries(data, kinds):
                if number in chosen:
                    yield at / len(data), chosen[number].entry(data, at)

        yield from in_order(read(), progress)


def dataflash_contents(path: Path) -> Counter[str]:
    """Return how many entries of each name the file has."""
    with mapped(path) as data:
        kinds = _kinds(data)
        return Counter(kinds[one].name if one in kinds else "FMT" for _, one in _entries(data, kinds))

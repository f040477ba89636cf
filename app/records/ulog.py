"""PX4's ULog, read from those parts of the file that are whole.

pyulog goes from message to message and, behind damage, on to the next synchronisation mark, which may be many
seconds away. So the file is searched for the wanted topics instead: a message is known by its type's letter and its
size and, for data, by its topic's number. The result is bounded, whatever a damaged definition contains.
"""

from __future__ import annotations

import re
import struct
from collections import Counter
from collections.abc import Collection, Iterator
from mmap import mmap
from pathlib import Path
from typing import NamedTuple

from sidelong.app.records.entry import Entry, in_order
from sidelong.app.records.mapped_file import Progress, mapped, unseen

MAGIC = b"ULog\x01\x12\x35"

_HEADER = struct.Struct("<HcH")  # size of what follows the letter, the letter, and of data the topic's number
_DEFINITION_MAX_BYTES, _SUBSCRIPTION_MAX_BYTES = 1 << 13, 1 << 8
_DEFINITION = re.compile(rb"([\w/-]+):((?:[\w/-]+(?:\[\d{1,5}\])? \w+;)+)")
_FIELD = re.compile(rb"([\w/-]+)(?:\[(\d+)\])? (\w+);")
_CODES = {
    **{b"int8_t": "b", b"int16_t": "h", b"int32_t": "i", b"int64_t": "q", b"float": "f", b"bool": "?"},
    **{b"uint8_t": "B", b"uint16_t": "H", b"uint32_t": "I", b"uint64_t": "Q", b"double": "d", b"char": "b"},
}
TYPE_PARAMETER, FIRMWARE = "MAV_TYPE", "information"
_TYPE = re.compile(rb"P\x10int32_t MAV_TYPE(....)", re.DOTALL)  # a parameter's message, from its type's letter on
# Information messages, from their type's letter on. The release is a byte each for patch, minor and major.
_SYSTEM = re.compile(rb"I.char\[(\d{1,2})\] sys_name", re.DOTALL)
_RELEASE = re.compile(rb"I\x17uint32_t ver_sw_release.(...)", re.DOTALL)
# Beyond what any topic has: a definition may nest arrays of arrays without end.
_FIELDS_MAX, _DEPTH_MAX, _TOPICS_MAX = 1024, 8, 1024

_Field = tuple[str, str]  # name, and code for struct


class _Topic(NamedTuple):
    """One instance of a topic. row: its fields without the padding at its end, which messages may leave out."""

    name: str
    instance: int
    field_names: list[str]
    row: struct.Struct
    padded_bytes: int


def _topics(data: mmap | bytes, wanted: Collection[str] | None) -> dict[int, _Topic]:
    """Return the wanted topics (None: all) by their numbers."""
    definitions: dict[bytes, bytes] = {}
    for message in _messages(data, b"F", _DEFINITION_MAX_BYTES):
        definition = _DEFINITION.fullmatch(message)
        if definition and len(definitions) < _TOPICS_MAX:
            definitions[definition[1]] = definition[2]
    topics: dict[int, _Topic] = {}
    for message in _messages(data, b"A", _SUBSCRIPTION_MAX_BYTES):
        instance, number, name = message[0], int.from_bytes(message[1:3], "little"), message[3:].decode("latin-1")
        if number in topics or len(topics) == _TOPICS_MAX or (wanted is not None and name not in wanted):
            continue
        try:
            fields = list(_fields(definitions, message[3:]))
        except (KeyError, ValueError):
            continue  # the definition is damaged
        padded_bytes = struct.calcsize("<" + "".join(code for _, code in fields))
        while fields and fields[-1][0].startswith("_padding"):
            fields.pop()
        if ("timestamp", "Q") in fields and len(dict(fields)) == len(fields):  # a name twice is damage
            names, codes = zip(*fields, strict=True)
            topics[number] = _Topic(name, instance, list(names), struct.Struct("<" + "".join(codes)), padded_bytes)
    return topics


def _fields(definitions: dict[bytes, bytes], name: bytes) -> Iterator[_Field]:
    """Yield the fields of a definition, nested ones as ``outer.inner``, arrays as ``name[0]``, ``name[1]``.

    Raises KeyError for a type that is not defined and ValueError for what no topic can be.
    """
    budget = _FIELDS_MAX

    def flat(name: bytes, prefix: str, depth: int) -> Iterator[_Field]:
        nonlocal budget
        for part in _FIELD.finditer(definitions[name]):
            kind, length, field = part.groups()
            places = [""] if length is None else [f"[{i}]" for i in range(min(int(length), _FIELDS_MAX))]
            budget -= max(len(places), 1)
            if budget < 0 or depth > _DEPTH_MAX:
                raise ValueError("more fields than a topic has")
            for place in places:
                if kind in _CODES:
                    yield f"{prefix}{field.decode()}{place}", _CODES[kind]
                else:
                    yield from flat(kind, f"{prefix}{field.decode()}{place}.", depth + 1)

    yield from flat(name, "", 0)


def _messages(data: mmap | bytes, letter: bytes, longest_bytes: int) -> Iterator[bytes]:
    """Yield the body of whatever could be a message of a type."""
    at = data.find(letter, 2)
    while at >= 0:
        size = int.from_bytes(data[at - 2 : at], "little")
        if 3 < size <= longest_bytes and at + 1 + size <= len(data):
            yield data[at + 1 : at + 1 + size]
        at = data.find(letter, at + 1)


def _entries(data: mmap | bytes, topics: dict[int, _Topic]) -> Iterator[tuple[int, _Topic]]:
    """Yield where the whole entries of the topics begin, and what they are."""
    headers = {
        _HEADER.pack(size + 2, b"D", number): (size, topic)
        for number, topic in topics.items()
        for size in range(topic.row.size, topic.padded_bytes + 1)
    }
    for found in re.compile(b"|".join(map(re.escape, headers)) or b"(?!)", re.DOTALL).finditer(data):
        size, topic = headers[found[0]]
        if found.end() + size <= len(data):
            yield found.end(), topic


def read_ulog(path: Path, wanted: Collection[str], progress: Progress = unseen) -> Iterator[Entry]:
    """Yield the entries of the wanted topics, arrays as ``name[0]``, ``name[1]``, in order of time.

    The parameter MAV_TYPE and the firmware, which are wanted by their names, follow the first entry.

    Damage to an entry costs that entry, damage to a topic's definition the topic. Raises OSError when the file
    cannot be read.
    """
    with mapped(path) as data:

        def read() -> Iterator[tuple[float, Entry]]:
            for at, (name, instance, field_names, row, _) in _entries(data, _topics(data, wanted)):
                fields = dict(zip(field_names, row.unpack_from(data, at), strict=True))
                yield at / len(data), Entry(fields["timestamp"], name, instance, fields)

        about = {name: value for name, value in _about(data) if name in wanted}
        for entry in in_order(read(), progress):
            yield entry
            while about:
                name, value = about.popitem()
                yield Entry(entry.time_us, name, 0, {"value": value})


def _about(data: mmap | bytes) -> Iterator[tuple[str, int | str]]:
    """Yield the vehicle's MAV_TYPE, and its firmware, as far as the log has them."""
    kind, system, release = (pattern.search(data) for pattern in (_TYPE, _SYSTEM, _RELEASE))
    if kind:
        yield TYPE_PARAMETER, int.from_bytes(kind[1], "little")
    if system and release:
        patch, minor, major = release[1]
        name = data[system.end() : system.end() + int(system[1])].decode("ascii", "replace")
        yield FIRMWARE, f"{name} v{major}.{minor}.{patch}"


def ulog_contents(path: Path) -> Counter[str]:
    """Return how many entries of each topic the file has."""
    with mapped(path) as data:
        return Counter(topic.name for _, topic in _entries(data, _topics(data, None)))

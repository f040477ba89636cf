"""PX4's ULog, read by pyulog from those parts of the file that are whole.

pyulog itself goes from message to message and, behind damage, on to the next synchronisation mark, which may be
many seconds away. So the file is searched for the wanted topics instead: a message is known by its size, its type's
letter and, for data, its topic's number. What is found is given to pyulog, window by window.
"""

from __future__ import annotations

import io
import re
from collections import Counter
from collections.abc import Collection, Iterator
from pathlib import Path

from pyulog import ULog

from app.records.entry import Entry, in_order
from app.records.windows import Progress, Window, windows

MAGIC = b"ULog\x01\x12\x35"

_FILE_HEADER = MAGIC + b"\x01" + bytes(8)
_HEADER_BYTES = 3  # size of the body, then the type's letter
_DATA_HEADER_BYTES = _HEADER_BYTES + 2  # and the topic's number
_MARGIN_BYTES = _HEADER_BYTES + (1 << 16)
_DEFINITION_MAX_BYTES, _SUBSCRIPTION_MAX_BYTES = 1 << 13, 1 << 8
_DEFINITION = re.compile(rb"([\w/-]+):(?:[\w/-]+(?:\[\d+\])? \w+;)+")


class _Salvage:
    """The whole messages that matter. What it learns of one window holds for those after it."""

    def __init__(self, wanted: Collection[str] | None) -> None:
        self._wanted = None if wanted is None else {name.encode() for name in wanted}
        self._definitions: dict[bytes, bytes] = {}
        self._subscriptions: dict[bytes, bytes] = {}

    def read(self, window: Window) -> Iterator[tuple[ULog.Data, list[int]]]:
        """Yield what there is of the wanted topics in a window, each with the positions of its entries."""
        for _, message in _messages(window.data, b"F", _DEFINITION_MAX_BYTES):
            definition = _DEFINITION.fullmatch(message, _HEADER_BYTES)
            if definition:
                self._definitions[definition[1]] = message
        for _, message in _messages(window.data, b"A", _SUBSCRIPTION_MAX_BYTES):
            number, name = message[4:6], message[6:]
            if name in self._definitions and (self._wanted is None or name in self._wanted):
                self._subscriptions[number] = message
        data = {
            number: [
                (position, message)
                for position, message in _messages(window.data, b"D" + number, _MARGIN_BYTES)
                if window.own_begin <= position < window.own_end
            ]
            for number in self._subscriptions
        }
        whole = [*self._definitions.values(), *self._subscriptions.values()]
        whole += [message for several in data.values() for _, message in several]
        for topic in ULog(io.BytesIO(_FILE_HEADER + b"".join(whole))).data_list:
            size = _DATA_HEADER_BYTES + sum(column.itemsize for column in topic.data.values())
            found = data[topic.msg_id.to_bytes(2, "little")]
            yield topic, [position for position, message in found if len(message) == size]


def _messages(data: bytes, opening: bytes, longest_bytes: int) -> Iterator[tuple[int, bytes]]:
    """Yield position and bytes of whatever could be a message; ``opening`` is its letter and what follows."""
    at = data.find(opening, _HEADER_BYTES - 1)
    while at >= 0:
        begin = at - (_HEADER_BYTES - 1)
        end = begin + _HEADER_BYTES + int.from_bytes(data[begin:at], "little")
        if len(opening) < end - at and end - begin <= longest_bytes and end <= len(data):
            yield begin, data[begin:end]
        at = data.find(opening, at + 1)


def read_ulog(path: Path, wanted: Collection[str], progress: Progress | None = None) -> Iterator[Entry]:
    """Yield the entries of the wanted topics, arrays as ``name[0]``, ``name[1]``, in order of time.

    Damage to an entry costs that entry, damage to a topic's definition the topic. Raises OSError when the file
    cannot be read.
    """
    salvage = _Salvage(wanted)
    for window in windows(path, _MARGIN_BYTES, progress):
        placed = []
        for topic, positions in salvage.read(window):
            columns = [column.tolist() for column in topic.data.values()]
            for position, *values in zip(positions, *columns, strict=True):
                fields = dict(zip(topic.data, values, strict=True))
                placed.append((position, Entry(fields["timestamp"], topic.name, topic.multi_id, fields)))
        placed.sort(key=lambda one: one[0])
        yield from in_order(entry for _, entry in placed)


def ulog_contents(path: Path, progress: Progress | None = None) -> Counter[str]:
    """Return how many entries of each topic the file has."""
    salvage = _Salvage(None)
    counts: Counter[str] = Counter()
    for window in windows(path, _MARGIN_BYTES, progress):
        for topic, positions in salvage.read(window):
            counts[topic.name] += len(positions)
    return counts

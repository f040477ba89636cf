"""Timed records of an autopilot's own log, and how they are put into MAVLink's words."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import suppress
from itertools import groupby, islice
from typing import Any, NamedTuple

import numpy as np

from sidelong.app.link.message import Message
from sidelong.app.records.mapped_file import Progress

_ABSURD = 1e10
_JUMP_US = 60_000_000
_CREDIBLE = 10  # entries this many together are no damage
_STRETCH = 20_000
_LATEST_US = 10**13  # no vehicle has been up for longer than four months


class Entry(NamedTuple):
    """name and fields are those of the log's own format; instance distinguishes devices of a kind."""

    time_us: int
    name: str
    instance: int
    fields: Mapping[str, Any]


def in_order(entries: Iterator[tuple[float, Entry]], progress: Progress) -> Iterator[Entry]:
    """Yield the entries of a log in order of time, stretch by stretch, without those whose time stamp is damaged.

    Args:
        entries: with the share of the file that is read.
        progress: called with that share.

    """
    while stretch := list(islice(entries, _STRETCH)):
        progress(stretch[-1][0])
        yield from _sorted([entry for _, entry in stretch])
    progress(1.0)


def _sorted(entries: list[Entry]) -> list[Entry]:
    """Return the entries of a stretch of a log in order of time, without those whose time stamp is damaged.

    These logs have no checksums: a damaged stamp shows only in standing alone or with few, a minute or more from all
    others.
    """
    ordered = sorted((entry for entry in entries if 0 <= entry.time_us < _LATEST_US), key=lambda entry: entry.time_us)
    jumps = np.diff([entry.time_us for entry in ordered], prepend=0) > _JUMP_US
    periods = zip(ordered, np.cumsum(jumps).tolist(), strict=True)
    groups = [[entry for entry, _ in group] for _, group in groupby(periods, key=lambda pair: pair[1])]
    enough = min(_CREDIBLE, max(map(len, groups), default=0))
    return [entry for group in groups if len(group) >= enough for entry in group]


Made = Iterator[tuple[str, dict[str, Any]]]
"""Message names with their fields."""


class Translator:
    """Turns entries in order of time into the messages the autopilot would send; ``makers`` go by the entries' names.

    A maker that learns when the vehicle's clock was zero, in seconds since 1970, sets ``_boot_s``; until then the
    messages' received_s counts from boot.
    """

    def __init__(self, makers: Mapping[str, Callable[[Entry], Made]]) -> None:
        self._makers = makers
        self._boot_s = 0.0

    @property
    def names(self) -> frozenset[str]:
        """Names of the entries that are looked at."""
        return frozenset(self._makers)

    def messages(self, entries: Iterable[Entry]) -> Iterator[Message]:
        """Yield the messages; entries that lack a field (another version) or make no sense are passed over.

        TypeError: a damaged definition may make text of a number.
        """
        for entry in entries:
            with suppress(KeyError, ValueError, ArithmeticError, TypeError):
                for name, fields in self._makers[entry.name](entry):
                    if any(_ABSURD < abs(value) < math.inf for value in fields.values() if isinstance(value, float)):
                        continue  # damaged: no unit here makes a flight's number that great
                    yield Message(name, 1, 1, fields, self._boot_s + entry.time_us * 1e-6)

"""Timed records of an autopilot's own log, and how they are put into MAVLink's words."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import suppress
from itertools import groupby, islice
from typing import Any, NamedTuple

import numpy as np

from sidelong.app.link.message import Message
from sidelong.app.records.text_file import Progress

_ABSURD = 1e10
_JUMP_US = 60_000_000
_RESTARTED_US = 10_000_000  # a clock that is that much earlier has started again
_CREDIBLE = 10  # entries this many together are no damage
_STRETCH = 20_000
_WRAP_US = 2**32 * 1000  # time_boot_ms of MAVLink has 32 bits: 49.7 days
_FIRST_US = 1_000_000  # the first stamp of such a log: 0 is that of a sender which does not know the time


class Entry(NamedTuple):
    """name and fields are those of the log's own format; instance distinguishes devices of a kind."""

    time_us: int
    name: str
    instance: int
    fields: Mapping[str, Any]


def in_order(entries: Iterator[tuple[float, Entry]], progress: Progress) -> Iterator[Entry]:
    """Yield the entries, given with the share of the file that is read, in order of time, stretch by stretch."""
    while stretch := list(islice(entries, _STRETCH)):
        progress(stretch[-1][0])
        for flight in _flights([entry for _, entry in stretch]):
            yield from _sorted(flight)
    progress(1.0)


def _flights(entries: list[Entry]) -> Iterator[list[Entry]]:
    """Yield a stretch in parts that end where the clock starts again: the order of time holds within them only."""
    times_us = np.array([entry.time_us for entry in entries], float)
    begin = 0
    for at in (np.flatnonzero(np.diff(times_us) < -_RESTARTED_US) + 1).tolist():
        before, after = times_us[max(at - _CREDIBLE, begin) : at], times_us[at : at + _CREDIBLE]
        enough = before.size == after.size == _CREDIBLE
        if enough and np.median(before) - np.median(after) > _RESTARTED_US:
            yield entries[begin:at]
            begin = at
    yield entries[begin:]


def _sorted(entries: list[Entry]) -> list[Entry]:
    """Return the entries of a stretch in order of time, without those whose time stamp is damaged.

    There are no checksums: a damaged stamp stands alone or with few, a minute or more from all others.
    """
    ordered = sorted((entry for entry in entries if entry.time_us >= 0), key=lambda entry: entry.time_us)
    jumps = np.diff(np.array([entry.time_us for entry in ordered], float), prepend=0.0) > _JUMP_US
    periods = zip(ordered, np.cumsum(jumps).tolist(), strict=True)
    groups = [[entry for entry, _ in group] for _, group in groupby(periods, key=lambda pair: pair[1])]
    enough = min(_CREDIBLE, max(map(len, groups), default=0))
    return [entry for group in groups if len(group) >= enough for entry in group]


Made = Iterator[tuple[str, dict[str, Any]]]
"""Message names with their fields but for time_boot_ms, which is the entry's time."""


def global_position(
    latitude_deg: float, longitude_deg: float, altitude_m: float, height_m: float, velocity_ned_m_s: Iterable[float]
) -> Made:
    """Yield a position of the vehicle; none where a value is unknown or no place on Earth."""
    vx, vy, vz = (100.0 * component_m_s for component_m_s in velocity_ned_m_s)
    on_earth = abs(latitude_deg) <= 90.0 and abs(longitude_deg) <= 180.0
    if on_earth and all(map(math.isfinite, (altitude_m, height_m, vx, vy, vz))):
        place = {"lat": round(latitude_deg * 1e7), "lon": round(longitude_deg * 1e7)}
        heights = {"alt": 1e3 * altitude_m, "relative_alt": 1e3 * height_m}
        yield "GLOBAL_POSITION_INT", place | heights | {"vx": vx, "vy": vy, "vz": vz}


class Translator:
    """Turns entries in order of time into the messages the autopilot would send; ``makers`` go by the entries' names.

    Stamps that count from 1970 are reduced to the 32 bits of MAVLink's milliseconds, without a wrap within the
    flight. A maker sets ``_boot_s`` to when the vehicle's clock was zero, s since 1970; until then received_s counts
    from boot.
    """

    def __init__(self, makers: Mapping[str, Callable[[Entry], Made]]) -> None:
        self._makers = makers
        self._boot_s = 0.0
        self._base_us: int | None = None

    @property
    def names(self) -> frozenset[str]:
        return frozenset(self._makers)

    def messages(self, entries: Iterable[Entry]) -> Iterator[Message]:
        """Yield the messages; entries that lack a field (another version) or make no sense are passed over."""
        for entry in entries:
            if self._base_us is None:
                self._base_us = entry.time_us - _FIRST_US if entry.time_us >= _WRAP_US else 0
            boot_ms = (entry.time_us - self._base_us) % _WRAP_US * 1e-3
            with suppress(
                KeyError, ValueError, ArithmeticError, TypeError
            ):  # TypeError: text by a damaged definition
                for name, fields in self._makers[entry.name](entry):
                    if any(_ABSURD < abs(value) < math.inf for value in fields.values() if isinstance(value, float)):
                        continue  # damaged: no unit here makes a flight's number that great
                    stamped = {"time_boot_ms": boot_ms, **fields}
                    yield Message(name, 1, 1, stamped, self._boot_s + entry.time_us * 1e-6)

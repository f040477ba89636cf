"""One timed record of an autopilot's own log, before it is put into MAVLink's words."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from itertools import groupby
from typing import Any, NamedTuple

import numpy as np

_JUMP_US = 60_000_000


class Entry(NamedTuple):
    """name and fields are those of the log's own format; instance tells devices of a kind apart."""

    time_us: int
    name: str
    instance: int
    fields: Mapping[str, Any]


def in_order(entries: Iterable[Entry]) -> list[Entry]:
    """Return the entries of a stretch of a log in order of time, without those whose time stamp is damaged.

    These logs have no checksums: a damaged stamp shows only in standing alone, a minute or more from all others.
    """
    ordered = sorted(entries, key=lambda entry: entry.time_us)
    jumps = np.diff([entry.time_us for entry in ordered], prepend=0) > _JUMP_US
    periods = zip(ordered, np.cumsum(jumps).tolist(), strict=True)
    groups = [[entry for entry, _ in group] for _, group in groupby(periods, key=lambda pair: pair[1])]
    longest = max(map(len, groups), default=0)
    return [entry for group in groups if len(group) > 1 or longest == 1 for entry in group]

"""Merge several links to one vehicle: select the link in use, and drop duplicate frames.

Each link of an autopilot has its own sequence numbers, its own send times and its own delay. These rules prevent
duplicates and steps back in time:

- a message with a time stamp is passed on, from any link, if it is newer than the latest one passed on; a stamp far
  from the others is accepted only if similar ones follow while the others are silent;
- what it sends without one (mode, mission item) is passed on from the link in use only, and after a change of links
  only once that link has caught up;
- answers, and what other components send, are passed on from any link, the copies of the others are not.

The link in use is left when it is silent, or clearly worse than another for some seconds, as when nothing that is
sent on it is answered. One that brings nothing of the autopilot's, as from a payload with a link of its own, is never
used. Pure: time is an argument.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from pymavlink.dialects.v20 import all as dialect

from sidelong.app.link.frames import Frame, message_ids
from sidelong.app.link.quality import Measured

AUTOPILOT_COMPONENT = 1
_ANSWERS = message_ids(
    "COMMAND_ACK PARAM_VALUE MISSION_ITEM MISSION_ITEM_INT MISSION_REQUEST MISSION_REQUEST_INT MISSION_COUNT "
    "MISSION_ACK AUTOPILOT_VERSION STATUSTEXT"
)
_SILENT_S, _SPARSE_SILENT_S, _SPARSE_BYTES_S = 1.0, 3.5, 200.0
_FRESH_S = 0.5
_WORSE_BY, _WORSE_FOR_S = 0.15, 3.0
_UNANSWERED_S = 3.0  # some questions may be lost
_COPY_WITHIN_S, _TIMED_COPY_WITHIN_S = 1.0, 10.0
_STEP_BACK_S = 5.0  # as in telemetry: the vehicle has rebooted
_AHEAD_S, _AHEAD_PER_S, _BEHIND_S = 5.0, 1.5, 10.0
_PROOF_COUNT, _PROOF_STEP_S, _PROOF_SILENCE_S = 5, 5.0, 2.0
_KEPT_MAX = 4000


_UNITS_PER_S = {"time_boot_ms": 1e3, "time_usec": 1e6}


def _clock_of(definition: Any) -> tuple[int, str, float] | None:
    """Return where a message has its time: offset, format and units per second; None where it has none."""
    codes = re.findall(r"\d*[a-zA-Z]", definition.unpacker.format)
    for index, (name, code) in enumerate(zip(definition.ordered_fieldnames, codes, strict=True)):
        if name in _UNITS_PER_S and code in ("I", "Q"):
            return struct.calcsize("<" + "".join(codes[:index])), "<" + code, _UNITS_PER_S[name]
    return None


_CLOCKS = {number: _clock_of(definition) for number, definition in dialect.mavlink_map.items()}


def time_of(frame: Frame) -> float | None:
    """Return the time stamp of a frame's message, s, of the sender's clock; None where it has none."""
    clock = _CLOCKS[frame.message_id]
    if clock is None:
        return None
    offset, code, units_per_s = clock
    return float(struct.unpack_from(code, frame.payload[offset:].ljust(8, b"\0"))[0]) / units_per_s


@dataclass(slots=True)
class _Newest:
    """The newest stamp of one kind of message: its link, when it came, and a series of stamps far from it."""

    stamp_s: float
    link: int
    received_s: float
    far_s: float = 0.0
    far_count: int = 0

    def take(self, stamp_s: float, link: int, now_s: float) -> None:
        """Go on from here."""
        self.stamp_s, self.link, self.received_s, self.far_count = stamp_s, link, now_s, 0

    def is_far(self, stamp_s: float, now_s: float) -> bool:
        """Return whether a stamp cannot be the next one, nor an older one of a later link."""
        passed_s = now_s - self.received_s
        return not -_BEHIND_S <= stamp_s - self.stamp_s <= _AHEAD_S + _AHEAD_PER_S * passed_s

    def proves(self, stamp_s: float, now_s: float) -> bool:
        """Take a stamp far from the newest; return whether enough of them have followed one another."""
        goes_on = 0.0 <= stamp_s - self.far_s <= _PROOF_STEP_S
        self.far_count = self.far_count + 1 if goes_on and self.far_count else 1
        self.far_s = stamp_s
        return self.far_count >= _PROOF_COUNT and now_s - self.received_s >= _PROOF_SILENCE_S


class LinkMerger:
    """Decides for each frame; ``in_use`` is the index of the link that is spoken on."""

    def __init__(self, links: int) -> None:
        self.in_use = 0
        self._links = links
        self._caught_up = True
        self._leads_to_autopilot: set[int] = set()
        self._worse_since_s: float | None = None
        self._newest: dict[tuple[tuple[int, int], int], _Newest] = {}
        self._newest_of_link_s: dict[tuple[int, tuple[int, int], int], float] = {}
        self._passed: dict[tuple[tuple[int, int], int, bytes], list[tuple[float, set[int]]]] = {}

    def passes(self, link: int, frame: Frame, now_s: float) -> bool:
        """Return whether to pass on a frame received on ``link``."""
        if self._links == 1:
            return True
        if frame.component_id == AUTOPILOT_COMPONENT:
            if not self._leads_to_autopilot:
                self.in_use = link
            self._leads_to_autopilot.add(link)
        stamp_s = time_of(frame)
        if frame.component_id != AUTOPILOT_COMPONENT or frame.message_id in _ANSWERS:
            window_s = _COPY_WITHIN_S if stamp_s is None else _TIMED_COPY_WITHIN_S
            return not self._is_copy(link, frame, now_s, window_s)
        if stamp_s is None:
            return link == self.in_use and self._caught_up
        return self._is_newest(link, frame, stamp_s, now_s)

    def _is_newest(self, link: int, frame: Frame, stamp_s: float, now_s: float) -> bool:
        kind = (frame.source, frame.message_id)
        own_s = self._newest_of_link_s.get((link, *kind), stamp_s)
        self._newest_of_link_s[(link, *kind)] = stamp_s
        newest = self._newest.get(kind)
        if newest is None:
            newest = self._newest[kind] = _Newest(stamp_s, link, now_s)
        restarted = stamp_s < own_s - _STEP_BACK_S and stamp_s < newest.stamp_s and link == newest.link
        if not restarted:
            if newest.is_far(stamp_s, now_s):
                if not newest.proves(stamp_s, now_s):
                    return False
            elif stamp_s < newest.stamp_s or (stamp_s == newest.stamp_s and link != newest.link):
                return False
        newest.take(stamp_s, link, now_s)
        self._caught_up |= link == self.in_use
        return True

    def _is_copy(self, link: int, frame: Frame, now_s: float, window_s: float) -> bool:
        """Return whether another link has already delivered this frame; each earlier frame matches one copy only."""
        key = (frame.source, frame.message_id, frame.payload)
        passed = [entry for entry in self._passed.get(key, ()) if now_s - entry[0] < window_s]
        self._passed[key] = passed
        for _, links in passed:
            if link not in links:
                links.add(link)
                return True
        passed.append((now_s, {link}))
        if len(self._passed) > _KEPT_MAX:
            self._passed = {k: p for k, p in self._passed.items() if now_s - p[-1][0] < _TIMED_COPY_WITHIN_S}
        return False

    def choose(self, measured: Sequence[Measured], now_s: float) -> bool:
        """Switch to a better link if there is one; return whether the link in use changed."""
        others = [i for i in self._leads_to_autopilot - {self.in_use} if measured[i].silent_s < _FRESH_S]
        if not others:
            self._worse_since_s = None
            return False
        best, present = min(others, key=lambda i: _badness(measured[i])), measured[self.in_use]
        sparse = present.received_bytes_s < _SPARSE_BYTES_S and present.silent_s < _SPARSE_SILENT_S
        if present.silent_s < _SILENT_S or sparse:
            if _badness(present) < _badness(measured[best]) + _WORSE_BY:
                self._worse_since_s = None
                return False
            if self._worse_since_s is None:
                self._worse_since_s = now_s
            if now_s - self._worse_since_s < _WORSE_FOR_S:
                return False
        self.in_use, self._caught_up, self._worse_since_s = best, False, None
        return True


def _badness(measured: Measured) -> float:
    unanswered_s = max(measured.unanswered_s - _UNANSWERED_S, 0.0)
    return (measured.loss or 0.0) + (measured.round_trip_s or 0.0) + unanswered_s

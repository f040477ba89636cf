"""Telemetry logs (tlog): MAVLink 1 and 2 frames, each behind an 8-byte big-endian stamp of microseconds since 1970.

A frame is accepted by its checksum, wherever it begins, so damaged neighbours cost no whole frame. The content of a
whole frame (a log sent over the link, a tunnel) is not searched for further frames.
"""

from __future__ import annotations

import re
import struct
import threading
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Mapping
from mmap import mmap
from pathlib import Path
from typing import Any

from pymavlink.dialects.v20 import all as dialect

from sidelong.app.link.frames import Frame, frame_at
from sidelong.app.link.message import Message
from sidelong.app.records.text_file import Appender, Progress, mapped, unseen

_MARKER_V1, _MARKER_V2 = 0xFE, 0xFD
_MARKER = re.compile(rb"[\xfd\xfe]")
_STAMP = struct.Struct(">Q")
_STAMP_MIN_US, _STAMP_MAX_US = 10**15, 4 * 10**15  # 2001 to 2096: anything else was not written as a stamp
_PROGRESS_FRAMES = 1000
_STAMPED_HEADER = struct.Struct(">QBBBxxBxBBB")  # stamp, marker, length, flags, id of MAVLink 1, id of MAVLink 2
_KINDS: dict[int, Any] = dialect.mavlink_map
_ATTITUDE, _GLOBAL_POSITION_INT = 30, 33
_AUTOPILOT_COMPONENT = 1
_LATE_MAX_S = 1.0  # messages of one moment overtake one another
_SPEED_MAX, _AHEAD_MAX_S = 100.0, 5.0  # what a clock may gain over the wall's, and at once


class TlogWriter(Appender):
    def write(self, frame: bytes, time_s: float) -> None:
        """Append a frame that was received or sent at ``time_s``, seconds since 1970."""
        self.append(_STAMP.pack(round(time_s * 1e6)) + frame)


class TlogClock:
    """Gives each frame, from any thread, the wall's time at the first one, carried on by the vehicle's stamps.

    Those of ATTITUDE and GLOBAL_POSITION_INT of the autopilot of ``system_id`` (None: of the first); where the
    vehicle's clock jumps, by the wall's.
    """

    def __init__(self) -> None:
        self.system_id: int | None = None
        self._lock = threading.Lock()
        self._now_s: float | None = None
        self._wall_s = 0.0  # when now_s was moved
        self._boot_s: float | None = None  # the vehicle's time then

    def stamp_s(self, frame: bytes, wall_s: float) -> float:
        """Return the time of a frame that came or went at ``wall_s``, seconds since 1970."""
        with self._lock:
            if self._now_s is None:
                self._now_s, self._wall_s = wall_s, wall_s
            boot_s = self._boot_time_s(frame)
            if boot_s is not None:
                self._move(boot_s, wall_s)
            elif self._boot_s is None:
                self._now_s += max(wall_s - self._wall_s, 0.0)
                self._wall_s = wall_s
            return self._now_s

    def _move(self, boot_s: float, wall_s: float) -> None:
        assert self._now_s is not None
        waited_s = max(wall_s - self._wall_s, 0.0)
        gained_s = waited_s if self._boot_s is None else boot_s - self._boot_s
        if -_LATE_MAX_S < gained_s < 0.0:
            return
        if not 0.0 <= gained_s <= _SPEED_MAX * waited_s + _AHEAD_MAX_S:
            gained_s = waited_s
        self._now_s += gained_s
        self._wall_s, self._boot_s = wall_s, boot_s

    def _boot_time_s(self, frame: bytes) -> float | None:
        read = Frame(frame)
        if read.component_id != _AUTOPILOT_COMPONENT or read.message_id not in {_ATTITUDE, _GLOBAL_POSITION_INT}:
            return None
        if self.system_id is None:
            self.system_id = read.system_id
        return int.from_bytes(read.payload[:4], "little") * 1e-3 if read.system_id == self.system_id else None


def _frames(path: Path, wanted: Collection[int], progress: Progress = unseen) -> Iterator[tuple[float, Frame]]:
    """Yield the whole frames of the ``wanted`` message ids with their stamps, s; one not credible is the last one."""
    unwanted_max_bytes = {number: kind.unpacker.size for number, kind in _KINDS.items() if number not in wanted}
    received_s, count = 0.0, 0
    with mapped(path) as data:
        at = end = _unwanted_end(data, 0, unwanted_max_bytes)
        while found := _MARKER.search(data, at):
            begin = found.start()
            frame = frame_at(data, begin)
            if frame is None:
                at = begin + 1
                continue
            if begin >= end + _STAMP.size:  # else these bytes are of the frame before
                (stamp_us,) = _STAMP.unpack_from(data, begin - _STAMP.size)
                received_s = stamp_us * 1e-6 if _STAMP_MIN_US < stamp_us < _STAMP_MAX_US else received_s
            if frame.message_id in wanted:
                yield received_s, frame
            at = end = _unwanted_end(data, begin + len(frame.data), unwanted_max_bytes)
            count += 1
            if count % _PROGRESS_FRAMES == 0:
                progress(at / len(data))
    progress(1.0)


def _unwanted_end(data: mmap | bytes, at: int, max_bytes: Mapping[int, int]) -> int:
    """Return where the unwanted frames end whose first stamp is at ``at``; max_bytes: of their payloads, by id.

    Their checksums are not computed: such a frame is no longer than its message is, and a stamped frame follows it.
    """
    unpack, end, last = _STAMPED_HEADER.unpack_from, at, len(data) - _STAMPED_HEADER.size
    while end <= last:
        stamp_us, marker, length, flags, v1_id, low, middle, high = unpack(data, end)
        if not _STAMP_MIN_US < stamp_us < _STAMP_MAX_US:
            break
        if marker == _MARKER_V2 and flags <= 1:
            number, overhead = low | middle << 8 | high << 16, 20 + 13 * flags
        elif marker == _MARKER_V1:
            number, overhead = v1_id, 16
        else:
            break
        at = end  # the frames before are followed by a stamped one
        if length > max_bytes.get(number, -1):
            break
        end += overhead + length
    return at


def _decoder(kind: Any) -> Callable[[bytes], dict[str, Any]]:
    """Return what turns a message's payload into its fields, faster than pymavlink, with the same values."""
    unpack, size = kind.unpacker.unpack, kind.unpacker.size
    lengths = list(zip(kind.ordered_fieldnames, kind.lengths, strict=True))
    names = [name for name, length in lengths for _ in range(length)]
    arrays = [(name, names.index(name), length) for name, length in lengths if length > 1]
    texts = [name for name, value in zip(names, unpack(bytes(size)), strict=True) if isinstance(value, bytes)]

    def fields(payload: bytes) -> dict[str, Any]:
        values = unpack(payload[:size].ljust(size, b"\0"))
        made = dict(zip(names, values, strict=True))  # of an array, the last value
        for name, begin, length in arrays:
            made[name] = list(values[begin : begin + length])
        for name in texts:
            made[name] = made[name].split(b"\0", 1)[0].decode("ascii", "replace")
        return made

    return fields


def read_tlog(path: Path, wanted: Collection[str] | None = None, progress: Progress = unseen) -> Iterator[Message]:
    """Yield the whole messages of the ``wanted`` names (None: all known) in file order. Raises OSError."""
    kinds = {number: kind for number, kind in _KINDS.items() if wanted is None or kind.msgname in wanted}
    decoders = {number: (kind.msgname, _decoder(kind)) for number, kind in kinds.items()}
    for received_s, frame in _frames(path, kinds, progress):
        name, fields = decoders[frame.message_id]
        yield Message(name, frame.system_id, frame.component_id, fields(frame.payload), received_s)


def tlog_contents(path: Path) -> Counter[str]:
    """Return how many messages of each name a tlog has. Raises OSError."""
    return Counter(_KINDS[frame.message_id].msgname for _, frame in _frames(path, _KINDS))


def is_mavlink_1(path: Path) -> bool:
    """Return whether no frame of the file is MAVLink 2."""
    return not any(frame.is_v2 for _, frame in _frames(path, _KINDS))


def is_tlog(path: Path) -> bool:
    """Return whether a MAVLink frame is found in the file."""
    return next(_frames(path, _KINDS), None) is not None

"""Frames of any protocol in a stream of bytes. A payload's driver needs no MAVLink."""

from __future__ import annotations

from collections.abc import Callable, Sequence

_KEPT_MAX_BYTES = 4096


class Framer:
    """Incremental parser that continues at the next header after a damaged frame. Headers are all of one length.

    length_of: returns the length of the frame at the beginning of the buffer; 0: it is not a frame; None: more bytes
    are needed. is_intact: returns whether the checksum of a complete frame is right.
    """

    def __init__(
        self, headers: Sequence[bytes], length_of: Callable[[bytes], int | None], is_intact: Callable[[bytes], bool]
    ) -> None:
        self.damaged = 0
        self._headers = tuple(headers)
        self._length_of, self._is_intact = length_of, is_intact
        self._buffer = b""

    def clear(self) -> None:
        self._buffer = b""

    def feed(self, data: bytes) -> list[bytes]:
        """Return the intact frames that ``data`` completes, in order."""
        buffer = self._buffer + data
        frames: list[bytes] = []
        at = 0
        while (at := self._next_header(buffer, at)) < len(buffer):
            length = self._length_of(buffer[at : at + _KEPT_MAX_BYTES])
            if length is None or at + length > len(buffer):
                break
            frame = buffer[at : at + length]
            if length and self._is_intact(frame):
                frames.append(frame)
                at += length
            else:
                self.damaged += 1
                at += 1
        self._buffer = buffer[at:][-_KEPT_MAX_BYTES:]
        return frames

    def _next_header(self, buffer: bytes, at: int) -> int:
        """Return the index of the next header, or of an incomplete one at the end."""
        found = [index for header in self._headers if (index := buffer.find(header, at)) >= 0]
        if found:
            return min(found)
        for kept in range(len(self._headers[0]) - 1, 0, -1):
            tail = buffer[max(at, len(buffer) - kept) :]
            if len(tail) == kept and any(header.startswith(tail) for header in self._headers):
                return len(buffer) - kept
        return len(buffer)

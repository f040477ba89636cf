"""MAVLink 2 signatures: frames out are signed, frames in are checked (mavlink.io, "Message Signing").

A signature is 13 bytes behind the checksum: link id, time in units of 10 us since 2015-01-01 UTC (48 bits, little
endian), and the first 48 bits of SHA-256 over key, frame, link id and time. Pure: the time comes as an argument.
"""

from __future__ import annotations

import hashlib
import hmac
from collections.abc import Mapping
from enum import StrEnum
from typing import NoReturn

from sidelong.app.link.frames import Frame

KEY_BYTES = 32
UNITS_PER_S = 100_000
EPOCH_UNIX_S = 1_420_070_400  # 2015-01-01
RADIO_STATUS_ID = 109
_NEW_STREAM_BEHIND = 60 * UNITS_PER_S  # the standard's minute
_YEAR = 31_557_600 * UNITS_PER_S
# A clock without battery starts years behind, so the local clock is not a reference; the 48 bits last until 2104.
_AHEAD_MAX, _WRITTEN = 20 * _YEAR, 11 * _YEAR
_CHANGED_LINK_AFTER = 10 * UNITS_PER_S  # after this silence, a source may return with another link id

Stream = tuple[int, int, int]
"""Link id, system, component: each has its own time stamp."""


def signing_time(unix_s: float) -> int:
    return max(0, int((unix_s - EPOCH_UNIX_S) * UNITS_PER_S))


def latest_time(now: int) -> int:
    """Return the latest time that is accepted of anyone; without it one broken clock would end all sending."""
    return max(now, _WRITTEN) + _AHEAD_MAX


class SigningKey:
    """A secret of 32 bytes that shows itself nowhere: not printed, not copied into another process."""

    __slots__ = ("_secret",)

    def __init__(self, secret: bytes) -> None:
        if len(secret) != KEY_BYTES:
            raise ValueError(f"a signing key has {KEY_BYTES} bytes")
        self._secret = secret

    def __repr__(self) -> str:
        return "SigningKey(...)"

    def __reduce__(self) -> NoReturn:
        raise TypeError("a signing key is not copied")

    def signature(self, signed: bytes) -> bytes:
        """Return the signature of a frame with link id and time behind it."""
        return hashlib.sha256(self._secret + signed).digest()[:6]

    def for_setup(self) -> list[int]:
        """Return the key's bytes for SETUP_SIGNING: the only access to them."""
        return list(self._secret)


class Refusal(StrEnum):
    """Why a frame is not let in."""

    UNSIGNED = "unsigned"
    WRONG_KEY = "signed with another key"
    OLD = "replayed or too old"
    OTHER_LINK = "of another link"
    OWN = "our own, sent back"
    FUTURE = "stamped decades ahead"


class SigningTimes:
    """The times of all streams under one key: what is sent only rises, and so does what is accepted of a stream.

    sent: the last time sent; streams: the last time accepted of each. All links of one key share it.
    """

    def __init__(self, sent: int = 0, streams: Mapping[Stream, int] | None = None) -> None:
        self._sent = [sent]
        self.streams = dict(streams or {})

    @property
    def sent(self) -> int:
        """The last time sent."""
        return self._sent[0]

    @sent.setter
    def sent(self, time: int) -> None:
        self._sent[0] = time

    def apart(self) -> SigningTimes:
        """Return times for another receiver of the same frames: a common send order, separate acceptance."""
        other = SigningTimes(streams=self.streams)
        other._sent = self._sent
        return other

    def next(self, now: int) -> int:
        """Return the time for the next frame out."""
        self.sent = max(self.sent + 1, now)
        return self.sent


class LinkSigning:
    """Signs and checks the frames of one link.

    link_id: of what this side sends; own: its system and component.
    """

    def __init__(self, key: SigningKey, times: SigningTimes, link_id: int, own: tuple[int, int]) -> None:
        self._key, self._times, self._link_id, self.own = key, times, link_id, own
        self._link_of: dict[tuple[int, int], tuple[int, int]] = {}  # source: (its link id here, its last time)

    def signed(self, unsigned: bytes, now: int) -> bytes:
        """Return a frame that has the flag for a signature with its signature."""
        tail = bytes((self._link_id,)) + self._times.next(now).to_bytes(6, "little")
        return unsigned + tail + self._key.signature(unsigned + tail)

    def genuine(self, frame: Frame) -> bool:
        """Return whether the frame was signed with the key, whatever its time stamp."""
        return frame.signed and hmac.compare_digest(self._key.signature(frame.data[:-6]), frame.data[-6:])

    def refusal(self, frame: Frame, now: int) -> Refusal | None:
        """Return why a frame is refused; None lets it in, and then never again."""
        if not frame.signed:
            return Refusal.UNSIGNED
        if not self.genuine(frame):
            return Refusal.WRONG_KEY
        if frame.source == self.own:
            return Refusal.OWN
        link_id, time = frame.data[-13], int.from_bytes(frame.data[-12:-6], "little")
        if time > latest_time(now):
            return Refusal.FUTURE
        stream = (link_id, *frame.source)
        known = self._times.streams.get(stream)
        if time <= (known if known is not None else max(self._times.sent, now) - _NEW_STREAM_BEHIND):
            return Refusal.OLD
        pinned = self._link_of.get(frame.source)
        if pinned is not None and pinned[0] != link_id and time < pinned[1] + _CHANGED_LINK_AFTER:
            return Refusal.OTHER_LINK
        self._times.streams[stream] = time
        self._times.sent = max(self._times.sent, time)
        self._link_of[frame.source] = (link_id, time)
        return None

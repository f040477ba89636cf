"""MAVLink 2 signatures: frames out are signed, frames in are checked (mavlink.io, "Message Signing").

A signature is 13 bytes behind the checksum: link id, time in units of 10 us since 2015-01-01 UTC (48 bits, little
endian), and the first 48 bits of SHA-256 over key, frame, link id and time.

The key is 64 hexadecimal digits in a file that only its owner can read. ``FILE.times`` holds what ``SigningTimes``
needs, always slightly ahead: after a restart or a crash no time stamp is signed or accepted twice.
"""

from __future__ import annotations

import contextlib
import fcntl
import hashlib
import hmac
import json
import os
import secrets
import stat
import threading
from collections.abc import Callable, Iterator, Mapping
from enum import StrEnum
from pathlib import Path
from typing import NoReturn

from sidelong.app.errors import InputError
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
    """Return a time of day in signing's units of 10 us since 2015, not below 0."""
    return max(0, int((unix_s - EPOCH_UNIX_S) * UNITS_PER_S))


def latest_time(now: int) -> int:
    """Return the latest accepted time stamp, 10 us units: a later one of a broken clock would end all sending."""
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
        """The time of the last signed frame sent here, in units of 10 us."""
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
        """Return the time stamp for the next frame, 10 us: ``now``, or one above the last where that is later."""
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
        """Return why a frame is refused; None: it is accepted, a replay of it will be refused. now: 10 us units."""
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


_SAVE_EVERY_S = 1.0
_SENT_AHEAD = 5 * UNITS_PER_S
_ACCEPTED_AHEAD = 2 * UNITS_PER_S  # a vehicle's next frame after a restart here is later than that


def make_key(path: Path) -> SigningKey:
    """Write a new random key that only the owner can read. Raises InputError where it exists or cannot be made."""
    secret = secrets.token_bytes(KEY_BYTES)
    try:
        descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW, 0o600)
        with os.fdopen(descriptor, "w", encoding="ascii") as file:
            file.write(secret.hex() + "\n")
            file.flush()
            os.fsync(file.fileno())
    except FileExistsError as error:
        raise InputError(f"{path} exists already; give another file, or use the key in it.") from error
    except OSError as error:
        raise InputError(f"{path} cannot be written ({error.strerror}); give another place for the key.") from error
    return SigningKey(secret)


def read_key(path: Path) -> SigningKey:
    """Return the key. Raises InputError if other users can read the file or it holds no key; never prints the key."""
    if path.is_dir():
        raise InputError(f"{path} is a folder; name the key's file in it, such as {path / 'plane.key'}.")
    try:
        # Without waiting: the other end of a FIFO may never come.
        with os.fdopen(os.open(path, os.O_RDONLY | os.O_NONBLOCK), "rb") as file:
            mode = os.fstat(file.fileno()).st_mode
            text = file.read(4096) if stat.S_ISREG(mode) else b""
    except (OSError, ValueError) as error:  # ValueError: a name with a zero in it
        raise InputError(
            f"signing key {path} cannot be read ({getattr(error, 'strerror', error)}); "
            f"make one with: sidelong sign {path}"
        ) from error
    if not stat.S_ISREG(mode):
        raise InputError(f"signing key {path} is not a regular file; make one with: sidelong sign FILE")
    if stat.S_IMODE(mode) & 0o077:
        raise InputError(f"signing key {path} can be read by others; make it your own with: chmod 600 {path}")
    digits = text.strip()
    if len(digits) == 2 * KEY_BYTES and all(digit in b"0123456789abcdefABCDEF" for digit in digits):
        return SigningKey(bytes.fromhex(digits.decode()))
    raise InputError(f"{path} holds no signing key (64 hexadecimal digits); make one with: sidelong sign FILE")


class KeyInUse:
    """A key with its times, which are kept in ``FILE.times``. Make one with :func:`key_in_use`.

    locked: to be held while ``times`` are used, which happens in several threads.
    """

    def __init__(self, key: SigningKey, times: SigningTimes, save: Callable[[SigningTimes], None]) -> None:
        self.key, self.times = key, times
        self.locked = threading.Lock()
        self._save = save
        self._all = [times]

    def apart(self) -> KeyInUse:
        """Return the same for another receiver of the same frames, as on a link shared by several vehicles."""
        with self.locked:
            other = KeyInUse(self.key, self.times.apart(), self._save)
            other.locked, other._all = self.locked, self._all
            self._all.append(other.times)
        return other

    def save(self) -> None:
        """Write the times of all down, a little ahead of themselves."""
        with self.locked:
            streams: dict[Stream, int] = {}
            for times in self._all:
                for stream, time in times.streams.items():
                    streams[stream] = max(time + _ACCEPTED_AHEAD, streams.get(stream, 0))
            ahead = SigningTimes(self.times.sent + _SENT_AHEAD, streams)
        self._save(ahead)


@contextlib.contextmanager
def key_in_use(key_path: Path, now: int, on_trouble: Callable[[str], object]) -> Iterator[KeyInUse]:
    """Read a key, lock its times for this process, and save them every second and at the end.

    now: current time in signature units (10 us). on_trouble: called once when the times can no longer be written.
    Raises InputError as :func:`read_key`, if another process uses the key, or if the file of times is damaged or not
    writable.
    """
    key = read_key(key_path)
    key_path = key_path.resolve()  # one file of times per key, whichever symbolic link names it
    path = key_path.with_name(key_path.name + ".times")
    try:
        lock = os.open(path.with_name(path.name + ".lock"), os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o600)
    except OSError as error:
        raise InputError(
            f"{path} cannot be written ({error.strerror}); a key's times are kept next to it."
        ) from error
    try:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            raise InputError(f"{key_path} is in use by another sidelong; end that one first.") from error
        before, latest = _read(path), latest_time(now)
        streams = {stream: min(time, latest) for stream, time in before.streams.items()}
        times = SigningTimes(max(min(before.sent, latest), now), streams)
        kept = KeyInUse(key, times, lambda ahead: _write(path, ahead))
        try:
            kept.save()
        except OSError as error:
            raise InputError(f"{path} cannot be written ({error.strerror}); a key's times are kept there.") from error
        ended = threading.Event()
        saver = threading.Thread(target=_keep_saving, args=(kept, ended, path, on_trouble), daemon=True)
        saver.start()
        try:
            yield kept
        finally:
            ended.set()
            saver.join(2.0 * _SAVE_EVERY_S)
            with contextlib.suppress(OSError):
                kept.save()
    finally:
        os.close(lock)


def _keep_saving(kept: KeyInUse, ended: threading.Event, path: Path, on_trouble: Callable[[str], object]) -> None:
    announced = False
    while not ended.wait(_SAVE_EVERY_S):
        try:
            kept.save()
        except OSError as error:
            if not announced:
                on_trouble(f"{path} cannot be written ({error.strerror}): after a restart old frames may be accepted")
            announced = True


def _read(path: Path) -> SigningTimes:
    try:
        values = json.loads(path.read_bytes()[: 1 << 20])
        streams = {(int(s[0]), int(s[1]), int(s[2])): int(s[3]) for s in values["streams"]}
        return SigningTimes(int(values["sent"]), streams)
    except FileNotFoundError:
        return SigningTimes()
    except (OSError, ValueError, TypeError, KeyError, IndexError, RecursionError) as error:
        raise InputError(
            f"{path} does not hold the times of a key; delete it to start again, then frames of the last flights "
            "could be replayed once."
        ) from error


def _write(path: Path, times: SigningTimes) -> None:
    new = path.with_name(path.name + ".new")
    streams = [[*stream, time] for stream, time in times.streams.items()]
    descriptor = os.open(new, os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_NOFOLLOW, 0o600)
    with os.fdopen(descriptor, "w", encoding="ascii") as file:
        json.dump({"sent": times.sent, "streams": streams}, file)
        file.flush()
        os.fsync(file.fileno())
    new.replace(path)

"""The signing key file and its file of used time stamps: after a restart, no time stamp is signed or accepted twice.

The key is 64 hexadecimal digits in a file that only its owner can read. ``FILE.times`` holds what ``SigningTimes``
needs. The stored times are always slightly ahead of those in use, so a crash at any moment loses nothing.
"""

from __future__ import annotations

import contextlib
import fcntl
import json
import os
import secrets
import stat
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

from sidelong.app.errors import InputError
from sidelong.app.link.signing import KEY_BYTES, UNITS_PER_S, SigningKey, SigningTimes, Stream, latest_time

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

"""Ways in which a file comes to harm, drawn from a seed: by disks, cut copies, careless editors and malice."""

from __future__ import annotations

import json
import random
import re
import zlib
from collections.abc import Callable
from typing import Any

_LONGEST = 400_000
_NUMBERS = ["nan", "inf", "-inf", "1e308", "-1e308", "1e-320", "0", "-0.0", "-1", "9" * 25, "1e5000", "9" * 5000, ""]
_PIECES = [
    *(b"\0", b"\xff\xfe", b"\x1b[2J", "\u202e".encode(), b"\xed\xa0\x80", b"\n" * 50, b"\r", b"," * 2000),
    *(b"[" * 30_000, b"{" * 20_000, b"a." * 20_000, b'"' * 999, b"<a>" * 9_999, b"&lt;", b"<!--", b"x" * 140_000),
    *(
        b"\xfd\x09\0\0\0\x01\x01\0\0\0",
        b"\xfe\x1c\0\x01\x01\x21",
        b"\xa3\x95\x80",
        b"\xa3\x95" * 5000,
        b"D\0\0" * 9999,
    ),
    *(b"\x08\0F", b"ULog\x01\x12\x35", b"<?xml version='1.0' encoding='no-such'?>", b"[[a]]\n" * 3000),
]
_NUMBER = re.compile(rb"-?\d+(?:\.\d+)?(?:e[-+]?\d+)?")

Damage = Callable[[bytes, random.Random], bytes]


def _place(data: bytes, rng: random.Random) -> int:
    # Half of the time near the beginning, where headers and definitions are.
    return rng.randrange(min(len(data), 600) + 1) if rng.random() < 0.5 else rng.randrange(len(data) + 1)


def flipped(data: bytes, rng: random.Random) -> bytes:
    changed = bytearray(data)
    for _ in range(rng.choice((1, 1, 3, 30))):
        if changed:
            at = min(_place(data, rng), len(changed) - 1)
            changed[at] ^= 1 << rng.randrange(8)
    return bytes(changed)


def overwritten(data: bytes, rng: random.Random) -> bytes:
    at, length = _place(data, rng), rng.choice((1, 2, 4, 8, 100, 5000))
    return data[:at] + rng.choice((rng.randbytes(length), bytes(length), b"\xff" * length)) + data[at + length :]


def cut(data: bytes, rng: random.Random) -> bytes:
    return data[: _place(data, rng)]


def without_a_piece(data: bytes, rng: random.Random) -> bytes:
    at = _place(data, rng)
    return data[:at] + data[at + rng.choice((1, 2, 7, 64, 4096)) :]


def with_a_piece(data: bytes, rng: random.Random) -> bytes:
    at = _place(data, rng)
    return data[:at] + rng.choice(_PIECES) + data[at:]


def doubled(data: bytes, rng: random.Random) -> bytes:
    at, length = _place(data, rng), rng.choice((1, 10, 500, 20_000))
    return data[:at] + data[at : at + length] * rng.choice((2, 2, 20)) + data[at + length :]


def swapped(data: bytes, rng: random.Random) -> bytes:
    a, b = sorted((_place(data, rng), _place(data, rng)))
    return data[b:] + data[a:b] + data[:a]


def other_numbers(data: bytes, rng: random.Random) -> bytes:
    found = [match.span() for match in _NUMBER.finditer(data[:20_000])]
    for begin, end in sorted(rng.sample(found, min(len(found), rng.choice((1, 1, 2, 9)))), reverse=True):
        data = data[:begin] + rng.choice(_NUMBERS).encode() + data[end:]
    return data


def noise(data: bytes, rng: random.Random) -> bytes:
    return rng.choice((b"", data[:16], data[:200])) + rng.randbytes(rng.choice((0, 1, 100, 3000, 60_000)))


WAYS: tuple[Damage, ...] = (
    *(flipped, overwritten, cut, without_a_piece, with_a_piece, doubled, swapped, other_numbers, noise),
)


def damaged(data: bytes, rng: random.Random) -> bytes:
    """Return the data after one to three kinds of harm."""
    for _ in range(rng.choice((1, 1, 1, 2, 3))):
        data = rng.choice(WAYS)(data, rng)[:_LONGEST]
    return data


# -- harm that a checksum does not show ----------------------------------------------------------------------

_VALUES: tuple[Any, ...] = (
    *(None, True, -1, 0, 10**400, 1e308, float("nan"), float("inf"), "", "left", "\x1b[2J", [], {}, [[]], [1, "a"]),
    *({"a": 1}, [0.0] * 1000, "x" * 5000),
)


def other_values(values: Any, rng: random.Random) -> Any:
    """Return plain values with one of them, at any depth, changed, left out, doubled or made another."""
    if isinstance(values, dict) and values and rng.random() < 0.85:
        key = rng.choice(list(values))
        way = rng.random()
        if way < 0.15:
            return {name: value for name, value in values.items() if name != key}
        if way < 0.25:
            return {rng.choice(("", key + "_x", "event")) if name == key else name: v for name, v in values.items()}
        return values | {key: other_values(values[key], rng)}
    if isinstance(values, list) and values and rng.random() < 0.8:
        at = rng.randrange(len(values))
        if rng.random() < 0.3:
            return values[:at] + values[at + 1 :] if rng.random() < 0.5 else values[: at + 1] + values[at:]
        return [*values[:at], other_values(values[at], rng), *values[at + 1 :]]
    if isinstance(values, float | int) and rng.random() < 0.5:
        return values * rng.choice((-1, 0, 1e-9, 1e3, 1e9, 1e30))
    return rng.choice(_VALUES)


def resealed(journal: bytes, rng: random.Random) -> bytes:
    """Return a journal of which some lines say something else, with checksums that hold."""
    lines = journal.splitlines(keepends=True)
    several = rng.sample(range(len(lines)), rng.choice((1, 1, 5)))
    for at in (0,) if rng.random() < 0.3 else several:
        body = lines[at][: lines[at].rindex(b',"crc32"')]
        record = json.loads(body + b"}")
        changed = {"event": record.get("event"), "fields": other_values(record.get("fields"), rng)}
        if rng.random() < 0.1:
            changed["event"] = rng.choice(("Header", "Announce", "PositionReading", 3, None, ["x"]))
        text = json.dumps(changed, separators=(",", ":")).encode()[:-1]
        if rng.random() < 0.05:
            depth = rng.choice((100, 900, 30_000))
            text = b'{"event":"Announce","fields":{"time_s":' + b"[" * depth + b"]" * depth + b"}"
        lines[at] = text + b',"crc32":"%08x"}\n' % zlib.crc32(text)
    return b"".join(lines)

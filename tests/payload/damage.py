"""Streams of a payload's bytes in which many are damaged, and an own reading of the intact frames in them."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np
from pymavlink.dialects.v20 import common as mavlink
from pymavlink.generator.mavcrc import x25crc

from sidelong.app.payload.driver import DriverSettings, Measured, RangeMeasured
from sidelong.app.payload.gremsy import GremsyDriver
from sidelong.app.payload.registry import kind_by_name
from sidelong.sitl.payload.devices import DEVICES, DeviceView
from sidelong.sitl.settings import Quirks
from tests.payload.golden import SIYI_REQUESTS

_REQUESTS = {
    "siyi": b"".join(bytes.fromhex(frame) for *_, frame in SIYI_REQUESTS),
    "viewpro": bytes.fromhex("55 AA DC 05 1C 40 00 59 55 AA DC 04 00 00 04"),
    "gremsy": b"".join(GremsyDriver(DriverSettings()).due(0.0)),
    "topotek": b"#TPUM2wLRF0359#TPUM2rLRF0051#TPUG2wGIA013E",
}


def damaged_stream(kind: str, size: int, seed: int) -> bytes:
    """Return about ``size`` bytes: frames with changed, missing and added bytes, and noise between them."""
    rng = np.random.default_rng(seed)
    device = DEVICES[kind](Quirks(), rng)
    stream, now_s = bytearray(), 0.0
    while len(stream) < size:
        now_s += 0.1
        seen = DeviceView(float(rng.uniform(20.0, 900.0)), float(rng.uniform(-math.pi, math.pi)), -0.4)
        for frame in [*device.receive(_REQUESTS[kind], now_s, seen), *device.stream(now_s, seen)]:
            stream += _damaged(frame, rng)
    return bytes(stream[:size])


def _damaged(frame: bytes, rng: np.random.Generator) -> bytes:
    """Return a frame as a bad line delivers it: one in three is intact."""
    choice, at = rng.integers(6), int(rng.integers(len(frame)))
    if choice == 0:
        return frame[:at] + bytes((frame[at] ^ int(rng.integers(1, 256)),)) + frame[at + 1 :]
    if choice == 1:
        return frame[:at] + frame[at + 1 :]
    if choice == 2:
        return frame[:at] + rng.bytes(int(rng.integers(1, 5))) + frame[at:]
    if choice == 3:
        return rng.bytes(int(rng.integers(1, 40))) + frame[:at]
    return frame


def intact_frames(kind: str, data: bytes) -> list[bytes]:
    """Return all stretches of the bytes that are frames with the right checksum, wherever they begin."""
    ends = ((at, _END[kind](data, at)) for at in range(len(data)))
    return [data[at:end] for at, end in ends if end is not None]


def values_of(measured: Iterable[Measured]) -> list[object]:
    """Return readings without their times."""
    return [one.slant_range_m if isinstance(one, RangeMeasured) else one.quaternion_wxyz for one in measured]


def unfounded(kind: str, data: bytes, measured: Iterable[Measured]) -> list[object]:
    """Return the readings that no intact frame of the bytes gives, in their order."""
    driver = kind_by_name(kind).make(DriverSettings())
    founded = iter([value for frame in intact_frames(kind, data) for value in values_of(driver.receive(frame, 0.0))])
    return [value for value in values_of(measured) if value not in founded]


def _siyi(data: bytes, at: int) -> int | None:
    if data[at : at + 2] != b"\x55\x66":
        return None
    end = at + 10 + int.from_bytes(data[at + 3 : at + 5], "little")
    return end if end <= len(data) and _crc(data[at:end]) == 0 else None


def _viewpro(data: bytes, at: int) -> int | None:
    if data[at : at + 3] != b"\x55\xaa\xdc" or at + 4 > len(data):
        return None
    end, check = at + 3 + (data[at + 3] & 0x3F), 0
    for byte in data[at + 3 : end]:
        check ^= byte
    return end if at + 6 <= end <= len(data) and check == 0 else None


def _topotek(data: bytes, at: int) -> int | None:
    length = data[at + 5 : at + 6]
    if data[at : at + 3].upper() != b"#TP" or not length or length not in b"0123456789ABCDEF":
        return None
    end = at + 10 + int(length, 16)
    return end + 2 if data[end : end + 2] == b"%02X" % (sum(data[at:end]) % 256) else None


def _gremsy(data: bytes, at: int) -> int | None:
    number = int.from_bytes(data[at + 7 : at + 10], "little")
    if data[at] != 0xFD or number not in mavlink.mavlink_map:
        return None
    end = at + 10 + data[at + 1]
    checksum = x25crc(data[at + 1 : end])
    checksum.accumulate(bytes((mavlink.mavlink_map[number].crc_extra,)))
    return end + 2 if data[end : end + 2] == checksum.crc.to_bytes(2, "little") else None


# Where an intact frame that begins at a byte ends; None if none begins there.
_END = {"siyi": _siyi, "viewpro": _viewpro, "topotek": _topotek, "gremsy": _gremsy}


def _crc(frame: bytes) -> int:
    """Return the frame's CRC against the one at its end, which is little-endian: 0 where they agree."""
    crc = 0
    for byte in frame[:-2]:
        crc ^= byte << 8
        for _ in range(8):
            crc = ((crc << 1) ^ 0x1021 if crc & 0x8000 else crc << 1) & 0xFFFF
    return crc ^ int.from_bytes(frame[-2:], "little")

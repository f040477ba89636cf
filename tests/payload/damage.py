"""Streams of a payload's bytes in which many are damaged, and an own reading of which frames in them are intact."""

from __future__ import annotations

import math

import numpy as np
from pymavlink.dialects.v20 import common as mavlink
from pymavlink.generator.mavcrc import x25crc

from sidelong.app.payload.driver import DriverSettings
from sidelong.app.payload.gremsy import GremsyDriver
from sidelong.sitl.payload.device import Seen
from sidelong.sitl.payload.devices import DEVICES
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
        seen = Seen(float(rng.uniform(20.0, 900.0)), float(rng.uniform(-math.pi, math.pi)), -0.4)
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


def intact_frames(kind: str, data: bytes) -> int:
    """Return how many stretches of the bytes are frames with the right checksum, wherever they begin."""
    return sum(_is_frame(kind, data, at) for at in range(len(data)))


def _is_frame(kind: str, data: bytes, at: int) -> bool:
    if kind == "siyi":
        if data[at : at + 2] != b"\x55\x66":
            return False
        end = at + 10 + int.from_bytes(data[at + 3 : at + 5], "little")
        return end <= len(data) and _crc(data[at:end]) == 0
    if kind == "viewpro":
        if data[at : at + 3] != b"\x55\xaa\xdc" or at + 4 > len(data):
            return False
        end = at + 3 + (data[at + 3] & 0x3F)
        check = 0
        for byte in data[at + 3 : end]:
            check ^= byte
        return at + 6 <= end <= len(data) and check == 0
    if kind == "gremsy":
        return _is_mavlink(data, at)
    if data[at : at + 3].upper() != b"#TP" or data[at + 5 : at + 6] not in b"0123456789ABCDEF":
        return False
    end = at + 10 + int(data[at + 5 : at + 6] or b"0", 16)
    return data[end : end + 2] == b"%02X" % (sum(data[at:end]) % 256)


def _is_mavlink(data: bytes, at: int) -> bool:
    number = int.from_bytes(data[at + 7 : at + 10], "little")
    if data[at] != 0xFD or number not in mavlink.mavlink_map:
        return False
    end = at + 10 + data[at + 1]
    checksum = x25crc(data[at + 1 : end])
    checksum.accumulate(bytes((mavlink.mavlink_map[number].crc_extra,)))
    return data[end : end + 2] == checksum.crc.to_bytes(2, "little")


def _crc(frame: bytes) -> int:
    """Return the frame's CRC against the one at its end, which is little-endian: 0 where they agree."""
    crc = 0
    for byte in frame[:-2]:
        crc ^= byte << 8
        for _ in range(8):
            crc = ((crc << 1) ^ 0x1021 if crc & 0x8000 else crc << 1) & 0xFFFF
    return crc ^ int.from_bytes(frame[-2:], "little")

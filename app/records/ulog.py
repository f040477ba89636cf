"""PX4's ULog, read from those parts of the file that are whole.

pyulog goes on behind damage only at the next synchronisation mark, which may be many seconds away. So the file is
searched: a message is known by its type's letter and its size and, for data, by its topic's number.
"""

from __future__ import annotations

import math
import re
import struct
from collections import Counter
from collections.abc import Collection, Iterator, Mapping
from mmap import mmap
from pathlib import Path
from typing import Any, NamedTuple

from sidelong.app.records.entry import Entry, Made, Translator, global_position, in_order
from sidelong.app.records.text_file import Progress, mapped, unseen
from sidelong.estimators.frames import LocalPlane

MAGIC = b"ULog\x01\x12\x35"

_HEADER = struct.Struct("<HcH")  # size of what follows the letter, the letter, and of data the topic's number
_DEFINITION_MAX_BYTES, _SUBSCRIPTION_MAX_BYTES = 1 << 13, 1 << 8
_DEFINITION = re.compile(rb"([\w/-]+):((?:[\w/-]+(?:\[\d{1,5}\])? \w+;)+)")
_FIELD = re.compile(rb"([\w/-]+)(?:\[(\d+)\])? (\w+);")
_CODES = {
    **{b"int8_t": "b", b"int16_t": "h", b"int32_t": "i", b"int64_t": "q", b"float": "f", b"bool": "?"},
    **{b"uint8_t": "B", b"uint16_t": "H", b"uint32_t": "I", b"uint64_t": "Q", b"double": "d", b"char": "b"},
}
TYPE_PARAMETER, FIRMWARE = "MAV_TYPE", "information"
_TYPE = re.compile(rb"P\x10int32_t MAV_TYPE(....)", re.DOTALL)  # a parameter's message, from its type's letter on
# Information messages, from their type's letter on. The release is a byte each for patch, minor and major.
_SYSTEM = re.compile(rb"I.char\[(\d{1,2})\] sys_name", re.DOTALL)
_RELEASE = re.compile(rb"I\x17uint32_t ver_sw_release.(...)", re.DOTALL)
# Beyond what any topic has: a definition may nest arrays of arrays without end.
_FIELDS_MAX, _DEPTH_MAX, _TOPICS_MAX = 1024, 8, 1024

_Field = tuple[str, str]  # name, and code for struct


class _Topic(NamedTuple):
    """One instance of a topic. row: its fields without the padding at its end, which messages may leave out."""

    name: str
    instance: int
    field_names: list[str]
    row: struct.Struct
    padded_bytes: int


def _topics(data: mmap | bytes, wanted: Collection[str] | None) -> dict[int, _Topic]:
    """Return the wanted topics (None: all) by their numbers."""
    definitions: dict[bytes, bytes] = {}
    for message in _messages(data, b"F", _DEFINITION_MAX_BYTES):
        definition = _DEFINITION.fullmatch(message)
        if definition and len(definitions) < _TOPICS_MAX:
            definitions[definition[1]] = definition[2]
    topics: dict[int, _Topic] = {}
    for message in _messages(data, b"A", _SUBSCRIPTION_MAX_BYTES):
        instance, number, name = message[0], int.from_bytes(message[1:3], "little"), message[3:].decode("latin-1")
        if number in topics or len(topics) == _TOPICS_MAX or (wanted is not None and name not in wanted):
            continue
        try:
            fields = list(_fields(definitions, message[3:]))
        except (KeyError, ValueError):
            continue  # the definition is damaged
        padded_bytes = struct.calcsize("<" + "".join(code for _, code in fields))
        while fields and fields[-1][0].startswith("_padding"):
            fields.pop()
        if ("timestamp", "Q") in fields and len(dict(fields)) == len(fields):  # a name twice is damage
            names, codes = zip(*fields, strict=True)
            topics[number] = _Topic(name, instance, list(names), struct.Struct("<" + "".join(codes)), padded_bytes)
    return topics


def _fields(definitions: dict[bytes, bytes], name: bytes) -> Iterator[_Field]:
    """Yield the fields of a definition, nested ones as ``outer.inner``, arrays as ``name[0]``.

    Raises KeyError for a type that is not defined and ValueError for what no topic can be.
    """
    budget = _FIELDS_MAX

    def flat(name: bytes, prefix: str, depth: int) -> Iterator[_Field]:
        nonlocal budget
        for part in _FIELD.finditer(definitions[name]):
            kind, length, field = part.groups()
            places = [""] if length is None else [f"[{i}]" for i in range(min(int(length), _FIELDS_MAX))]
            budget -= max(len(places), 1)
            if budget < 0 or depth > _DEPTH_MAX:
                raise ValueError("more fields than a topic has")
            for place in places:
                if kind in _CODES:
                    yield f"{prefix}{field.decode()}{place}", _CODES[kind]
                else:
                    yield from flat(kind, f"{prefix}{field.decode()}{place}.", depth + 1)

    yield from flat(name, "", 0)


def _messages(data: mmap | bytes, letter: bytes, longest_bytes: int) -> Iterator[bytes]:
    """Yield the body of whatever could be a message of a type."""
    at = data.find(letter, 2)
    while at >= 0:
        size = int.from_bytes(data[at - 2 : at], "little")
        if 3 < size <= longest_bytes and at + 1 + size <= len(data):
            yield data[at + 1 : at + 1 + size]
        at = data.find(letter, at + 1)


def _entries(data: mmap | bytes, topics: dict[int, _Topic]) -> Iterator[tuple[int, _Topic]]:
    """Yield where the whole entries of the topics begin, and what they are."""
    headers = {
        _HEADER.pack(size + 2, b"D", number): (size, topic)
        for number, topic in topics.items()
        for size in range(topic.row.size, topic.padded_bytes + 1)
    }
    for found in re.compile(b"|".join(map(re.escape, headers)) or b"(?!)", re.DOTALL).finditer(data):
        size, topic = headers[found[0]]
        if found.end() + size <= len(data):
            yield found.end(), topic


def read_ulog(path: Path, wanted: Collection[str], progress: Progress = unseen) -> Iterator[Entry]:
    """Yield the whole entries of the wanted topics, arrays as ``name[0]``, in order of time. Raises OSError.

    MAV_TYPE and the firmware, which are wanted by their names, follow the first entry.
    """
    with mapped(path) as data:

        def read() -> Iterator[tuple[float, Entry]]:
            for at, (name, instance, field_names, row, _) in _entries(data, _topics(data, wanted)):
                fields = dict(zip(field_names, row.unpack_from(data, at), strict=True))
                yield at / len(data), Entry(fields["timestamp"], name, instance, fields)

        about = {name: value for name, value in _about(data) if name in wanted}
        for entry in in_order(read(), progress):
            yield entry
            while about:
                name, value = about.popitem()
                yield Entry(entry.time_us, name, 0, {"value": value})


def _about(data: mmap | bytes) -> Iterator[tuple[str, int | str]]:
    """Yield the vehicle's MAV_TYPE, and its firmware, as far as the log has them."""
    kind, system, release = (pattern.search(data) for pattern in (_TYPE, _SYSTEM, _RELEASE))
    if kind:
        yield TYPE_PARAMETER, int.from_bytes(kind[1], "little")
    if system and release:
        patch, minor, major = release[1]
        name = data[system.end() : system.end() + int(system[1])].decode("ascii", "replace")
        yield FIRMWARE, f"{name} v{major}.{minor}.{patch}"


def ulog_contents(path: Path) -> Counter[str]:
    with mapped(path) as data:
        return Counter(topic.name for _, topic in _entries(data, _topics(data, None)))


_VTOL, _TYPES = 22, {1: 2, 2: 1, 3: 10, 4: 7}  # MAV_TYPE; by vehicle_status.vehicle_type
_GLOBAL_POSITION_SILENCE_US = 1_000_000


class Px4Messages(Translator):
    """A position takes its velocity from the latest vehicle_local_position.

    Without vehicle_global_position (older PX4), it is made of vehicle_local_position alone. Heights above home go by
    home_position, else by the origin of the local position.
    """

    def __init__(self) -> None:
        makers = {
            "home_position": self._home,
            "vehicle_gps_position": self._gps,
            "vehicle_global_position": self._global_position,
            "vehicle_local_position": self._local_position,
            "vehicle_attitude": self._attitude,
            "distance_sensor": self._distance_sensor,
            "gimbal_device_attitude_status": self._gimbal,
            "wind": self._wind,
            "wind_estimate": self._wind,
            "vehicle_status": self._status,
            TYPE_PARAMETER: self._parameter,
            FIRMWARE: self._firmware,
        }
        super().__init__(makers)
        self._home_altitude_m = math.nan
        self._local: Mapping[str, Any] = {}
        self._global_us: int | None = None  # when the latest global position came, at first when one could have

    def _home(self, entry: Entry) -> Made:
        self._home_altitude_m = entry.fields["alt"]
        yield from ()

    def _gps(self, entry: Entry) -> Made:
        utc_us = entry.fields["time_utc_usec"]
        self._boot_s = (utc_us - entry.time_us) * 1e-6 if utc_us else self._boot_s
        yield from ()

    def _global_position(self, entry: Entry) -> Made:
        self._global_us = entry.time_us
        fields = entry.fields
        yield from self._position(fields["lat"], fields["lon"], fields["alt"])

    def _local_position(self, entry: Entry) -> Made:
        self._local = fields = entry.fields
        if math.isnan(self._home_altitude_m) and fields["z_global"]:
            self._home_altitude_m = fields["ref_alt"]
        if self._global_us is None:
            self._global_us = entry.time_us
        if fields["xy_global"] and entry.time_us - self._global_us > _GLOBAL_POSITION_SILENCE_US:
            plane = LocalPlane(fields["ref_lat"], fields["ref_lon"])
            latitude_deg, longitude_deg = plane.latitude_longitude_deg(fields["y"], fields["x"])
            yield from self._position(latitude_deg, longitude_deg, fields["ref_alt"] - fields["z"])

    def _position(self, latitude_deg: float, longitude_deg: float, altitude_m: float) -> Made:
        velocity_ned_m_s = (self._local.get(name, math.nan) for name in ("vx", "vy", "vz"))
        height_m = altitude_m - self._home_altitude_m
        return global_position(latitude_deg, longitude_deg, altitude_m, height_m, velocity_ned_m_s)

    def _attitude(self, entry: Entry) -> Made:
        w, x, y, z = _quaternion(entry.fields)
        yield (
            "ATTITUDE",
            {
                "roll": math.atan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y)),
                "pitch": math.asin(max(-1.0, min(1.0, 2.0 * (w * y - z * x)))),
                "yaw": math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z)),
            },
        )

    def _distance_sensor(self, entry: Entry) -> Made:
        fields = entry.fields
        quality = fields["signal_quality"]  # -1 unknown, 0 invalid; in MAVLink 0 and 1
        variance_cm2 = 1e4 * fields["variance"]
        if math.isfinite(fields["current_distance"]):
            yield (
                "DISTANCE_SENSOR",
                {
                    "min_distance": 100.0 * fields["min_distance"],
                    "max_distance": 100.0 * fields["max_distance"],
                    "current_distance": 100.0 * fields["current_distance"],
                    "type": fields["type"],
                    "id": entry.instance,
                    "orientation": fields["orientation"],
                    "covariance": variance_cm2 if math.isfinite(variance_cm2) else 255,
                    "quaternion": list(_quaternion(fields)),
                    "signal_quality": 0 if quality < 0 else max(1, quality),
                },
            )

    def _gimbal(self, entry: Entry) -> Made:
        fields = entry.fields
        yield (
            "GIMBAL_DEVICE_ATTITUDE_STATUS",
            {
                "flags": fields["device_flags"],
                "q": list(_quaternion(fields)),
                "gimbal_device_id": fields.get("gimbal_device_id", 0),
            },
        )

    def _status(self, entry: Entry) -> Made:
        fields = entry.fields
        vtol = fields.get("is_vtol") and _VTOL
        kind = vtol or fields.get("system_type") or _TYPES.get(fields.get("vehicle_type", 0))
        if kind:
            yield "PARAM_VALUE", {"param_id": TYPE_PARAMETER, "param_value": kind}

    def _parameter(self, entry: Entry) -> Made:
        yield "PARAM_VALUE", {"param_id": entry.name, "param_value": entry.fields["value"]}

    def _firmware(self, entry: Entry) -> Made:
        yield "STATUSTEXT", {"text": entry.fields["value"]}

    def _wind(self, entry: Entry) -> Made:
        north_m_s, east_m_s = entry.fields["windspeed_north"], entry.fields["windspeed_east"]
        yield "WIND_COV", {"time_usec": entry.time_us, "wind_x": north_m_s, "wind_y": east_m_s}


def _quaternion(fields: Mapping[str, Any]) -> tuple[float, float, float, float]:
    return fields["q[0]"], fields["q[1]"], fields["q[2]"], fields["q[3]"]

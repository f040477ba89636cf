"""The autopilots' own logs, read from their whole parts and put into MAVLink's words: DataFlash (.bin) and ULog.

A DataFlash log has entries of fixed length behind two header bytes and a type, without checksums. An entry is whole
if another header or the end of the file follows it, or if damage does and no such entry begins inside it; pymavlink's
reader gives up there, so only its table of field formats is used.

A ULog message is known by its type's letter and its size and, for data, by its topic's number; pyulog goes on behind
damage only at the next synchronisation mark, which may be many seconds away.
"""

from __future__ import annotations

import math
import re
import struct
from collections import Counter, deque
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from contextlib import suppress
from itertools import groupby, islice
from mmap import mmap
from pathlib import Path
from statistics import median
from typing import Any, NamedTuple

import numpy as np

from sidelong.app.link.message import Message
from sidelong.app.records.text_file import Progress, mapped, unseen
from sidelong.estimators.frames import LocalPlane
from sidelong.estimators.rotations import from_roll_pitch_yaw

_ABSURD = 1e10
_JUMP_US = 60_000_000
_RESTARTED_US = 10_000_000  # a clock that is that much earlier has started again
_CREDIBLE = 10  # entries this many together are no damage
_STRETCH = 20_000
_WRAP_US = 2**32 * 1000  # time_boot_ms of MAVLink has 32 bits: 49.7 days
_FIRST_US = 1_000_000  # the first stamp of such a log: 0 is that of a sender which does not know the time


class Entry(NamedTuple):
    """name and fields are those of the log's own format; instance distinguishes devices of a kind."""

    time_us: int
    name: str
    instance: int
    fields: Mapping[str, Any]


def in_order(entries: Iterator[tuple[float, Entry]], progress: Progress) -> Iterator[Entry]:
    """Yield the entries, given with the share of the file that is read, in order of time, stretch by stretch."""
    while stretch := list(islice(entries, _STRETCH)):
        progress(stretch[-1][0])
        for flight in _flights([entry for _, entry in stretch]):
            yield from _sorted(flight)
    progress(1.0)


def _flights(entries: list[Entry]) -> Iterator[list[Entry]]:
    """Yield a stretch in parts that end where the clock starts again: the order of time holds within them only."""
    times_us = np.array([entry.time_us for entry in entries], float)
    begin = 0
    for at in (np.flatnonzero(np.diff(times_us) < -_RESTARTED_US) + 1).tolist():
        before, after = times_us[max(at - _CREDIBLE, begin) : at], times_us[at : at + _CREDIBLE]
        enough = before.size == after.size == _CREDIBLE
        if enough and np.median(before) - np.median(after) > _RESTARTED_US:
            yield entries[begin:at]
            begin = at
    yield entries[begin:]


def _sorted(entries: list[Entry]) -> list[Entry]:
    """Return the entries of a stretch in order of time, without those whose time stamp is damaged.

    There are no checksums: a damaged stamp stands alone or with few, a minute or more from all others.
    """
    ordered = sorted((entry for entry in entries if entry.time_us >= 0), key=lambda entry: entry.time_us)
    jumps = np.diff(np.array([entry.time_us for entry in ordered], float), prepend=0.0) > _JUMP_US
    periods = zip(ordered, np.cumsum(jumps).tolist(), strict=True)
    groups = [[entry for entry, _ in group] for _, group in groupby(periods, key=lambda pair: pair[1])]
    enough = min(_CREDIBLE, max(map(len, groups), default=0))
    return [entry for group in groups if len(group) >= enough for entry in group]


Made = Iterator[tuple[str, dict[str, Any]]]
"""Message names with their fields but for time_boot_ms, which is the entry's time."""
Maker = Callable[[Entry], Made | None]


def global_position(
    latitude_deg: float, longitude_deg: float, altitude_m: float, height_m: float, velocity_ned_m_s: Iterable[float]
) -> Made:
    """Yield a position of the vehicle; none where a value is unknown or no place on Earth."""
    vx, vy, vz = (100.0 * component_m_s for component_m_s in velocity_ned_m_s)
    on_earth = abs(latitude_deg) <= 90.0 and abs(longitude_deg) <= 180.0
    if on_earth and all(map(math.isfinite, (altitude_m, height_m, vx, vy, vz))):
        place = {"lat": round(latitude_deg * 1e7), "lon": round(longitude_deg * 1e7)}
        heights = {"alt": 1e3 * altitude_m, "relative_alt": 1e3 * height_m}
        yield "GLOBAL_POSITION_INT", place | heights | {"vx": vx, "vy": vy, "vz": vz}


class Translator:
    """Turns entries in order of time into the messages the autopilot would send; ``makers`` go by the entries' names.

    Stamps that count from 1970 are reduced to the 32 bits of MAVLink's milliseconds, without a wrap within the
    flight. A maker sets ``_boot_s`` to when the vehicle's clock was zero, s since 1970; until then received_s counts
    from boot.
    """

    def __init__(self, makers: Mapping[str, Maker]) -> None:
        self._makers, self.names = makers, frozenset(makers)
        self._boot_s = 0.0
        self._base_us: int | None = None

    def messages(self, entries: Iterable[Entry]) -> Iterator[Message]:
        """Yield the messages; entries that lack a field (another version) or make no sense are passed over."""
        for entry in entries:
            if self._base_us is None:
                self._base_us = entry.time_us - _FIRST_US if entry.time_us >= _WRAP_US else 0
            boot_ms = (entry.time_us - self._base_us) % _WRAP_US * 1e-3
            # TypeError: text by a damaged definition.
            with suppress(KeyError, ValueError, ArithmeticError, TypeError):
                for name, fields in self._makers[entry.name](entry) or ():
                    if any(_ABSURD < abs(value) < math.inf for value in fields.values() if isinstance(value, float)):
                        continue  # damaged: no unit here makes a flight's number that great
                    stamped = {"time_boot_ms": boot_ms, **fields}
                    yield Message(name, 1, 1, stamped, self._boot_s + entry.time_us * 1e-6)


_HEADER = b"\xa3\x95"
_HEADERS = re.compile(re.escape(_HEADER))
_FORMAT_TYPE = 0x80
_FORMAT = struct.Struct("<BB4s16s64s")  # type, length, name, one letter a field, field names
_FORMAT_BYTES = 3 + _FORMAT.size
_WITH_TEXT = ("MSG", "PARM", "VER")
_INSTANCE_NAMES = ("Instance", "I", "C")

DATAFLASH_MAGIC = _HEADER + bytes([_FORMAT_TYPE])


class _Kind:
    """One type of entry. Raises KeyError or ValueError when its definition is damaged."""

    def __init__(self, length: int, name: bytes, letters: bytes, fields: bytes) -> None:
        from pymavlink.DFReader import FORMAT_TO_STRUCT  # noqa: PLC0415  # loads much that no other log needs

        formats = [FORMAT_TO_STRUCT[letter] for letter in _text(letters)]
        self._unpacker = struct.Struct("<" + "".join(code for code, _, _ in formats))
        self._divisors = [None if scale is None else round(1.0 / scale) for _, scale, _ in formats]
        self._field_names = _text(fields).split(",")
        self.name = _text(name)
        self.length = length
        if length != 3 + self._unpacker.size or len(self._field_names) != len(formats):
            raise ValueError(f"the definition of {self.name} contradicts itself")
        has_time = ("TimeUS", "Q") in zip(self._field_names, _text(letters), strict=True)
        # Little that is read has text: by a damaged definition other entries may seem to.
        has_text = any(code.endswith("s") for code, _, _ in formats)
        self.is_usable = has_time and (not has_text or self.name in _WITH_TEXT)

    def entry(self, data: mmap | bytes, at: int) -> Entry:
        """Return the entry at ``at``; it must have a time."""
        values = self._unpacker.unpack_from(data, at + 3)
        fields: dict[str, Any] = {}
        for name, value, divisor in zip(self._field_names, values, self._divisors, strict=True):
            plain = _text(value, "replace") if isinstance(value, bytes) else value
            fields[name] = plain if divisor is None else plain / divisor
        instance = next((fields[name] for name in _INSTANCE_NAMES if name in fields), 0)
        return Entry(fields["TimeUS"], self.name, instance, fields)


def _text(characters: bytes, errors: str = "strict") -> str:
    return characters.split(b"\0", 1)[0].decode("ascii", errors)


def _kinds(data: mmap | bytes) -> dict[int, _Kind]:
    kinds: dict[int, _Kind] = {}
    for found in re.finditer(re.escape(DATAFLASH_MAGIC), data):
        if found.start() + _FORMAT_BYTES <= len(data):
            number, *definition = _FORMAT.unpack_from(data, found.end())
            with suppress(KeyError, ValueError):  # damaged, or no definition at all
                kinds.setdefault(number, _Kind(*definition))
    return kinds


def _whole_entries(data: mmap | bytes, kinds: dict[int, _Kind]) -> Iterator[tuple[int, int]]:
    size = len(data)
    lengths = {number: kind.length for number, kind in kinds.items()} | {_FORMAT_TYPE: _FORMAT_BYTES}

    def end_of(begin: int) -> int:
        return begin + lengths.get(data[begin + 2], size + 1) if begin + 2 < size else size + 1

    def is_followed(begin: int) -> bool:
        end = end_of(begin)
        return end == size or data[end : end + 2] == _HEADER

    at = 0
    while found := _HEADERS.search(data, at):
        begin = found.start()
        end, at = end_of(begin), begin + 1
        if end <= size and not any(is_followed(header.start()) for header in _HEADERS.finditer(data, begin + 1, end)):
            yield begin, data[begin + 2]
            at = end


def read_dataflash(path: Path, wanted: Collection[str], progress: Progress = unseen) -> Iterator[Entry]:
    """Yield the whole entries of the wanted names in order of time, in the units of pymavlink. Raises OSError."""
    with mapped(path) as data:

        def read() -> Iterator[tuple[float, Entry]]:
            kinds = _kinds(data)
            chosen = {number: kind for number, kind in kinds.items() if kind.name in wanted and kind.is_usable}
            for at, number in _whole_entries(data, kinds):
                if number in chosen:
                    yield at / len(data), chosen[number].entry(data, at)

        yield from in_order(read(), progress)


def dataflash_contents(path: Path) -> Counter[str]:
    """Return how many entries of each name a DataFlash log has. Raises OSError."""
    with mapped(path) as data:
        kinds = _kinds(data)
        return Counter(kinds[one].name if one in kinds else "FMT" for _, one in _whole_entries(data, kinds))


_GPS_EPOCH_S = 315_964_800  # 1980-01-06
_LEAP_S = 18  # GPS is ahead of UTC by this since 2017
_WEEK_S = 604_800
_GPS_FIX_3D = 3
_RANGE_GOOD = 4  # of RFND.Stat
_SIGNAL_UNKNOWN, _SIGNAL_INVALID = 0, 1  # of DISTANCE_SENSOR.signal_quality
_COVARIANCE_UNKNOWN = 255
_ORIENTATION_CUSTOM = 100
_MOUNT_RANGE_ID = 100  # apart from the ids of RFND
_UNIT_RANGES = 50
_DROP_MIN, _HEIGHT_MIN_M = 0.05, 20.0  # below them the ground that the line of sight meets is not known
_LOCKED_YAW_IN_EARTH_FRAME = 4 | 8 | 16 | 64


class ArdupilotMessages(Translator):
    """A position takes its velocity from the first core of the EKF, else from GPS.

    A mount's own ranges become DISTANCE_SENSOR of custom orientation, each once although the log repeats it. Some
    drivers write decimetres: the unit is that which agrees with height and pitch.
    """

    def __init__(self) -> None:
        own: dict[str, Maker] = {
            "GPS": self._gps,
            "POS": self._position,
            "RFND": self._rangefinder,
            "MNT": self._mount,
        }
        texts: dict[str, Maker] = {
            "MSG": self._text,
            "VER": self._text,
            "PARM": self._parameter,
            "ATT": self._attitude,
        }
        of_ekf: dict[str, Maker] = {"XKF1": self._ekf, "NKF1": self._ekf, "XKF2": self._wind, "NKF2": self._wind}
        super().__init__(own | texts | of_ekf)
        self._velocity_ned_m_s: tuple[float, float, float] | None = None
        self._has_ekf = False
        self._height_m = math.nan
        self._mount_ranges: dict[int, float] = {}  # the latest of each mount, as logged
        self._exponents: deque[float] = deque(maxlen=_UNIT_RANGES)  # powers of ten between logged and expected ranges

    def _gps(self, entry: Entry) -> None:
        fields = entry.fields
        if entry.instance == 0 and fields["Status"] >= _GPS_FIX_3D:
            utc_s = _GPS_EPOCH_S + fields["GWk"] * _WEEK_S + fields["GMS"] * 1e-3 - _LEAP_S
            self._boot_s = utc_s - entry.time_us * 1e-6
            if not self._has_ekf:
                course_rad = math.radians(fields["GCrs"])
                north_m_s, east_m_s = fields["Spd"] * math.cos(course_rad), fields["Spd"] * math.sin(course_rad)
                self._velocity_ned_m_s = north_m_s, east_m_s, fields["VZ"]

    def _ekf(self, entry: Entry) -> None:
        if entry.instance == 0:
            self._has_ekf = True
            self._velocity_ned_m_s = entry.fields["VN"], entry.fields["VE"], entry.fields["VD"]

    def _position(self, entry: Entry) -> Made:
        lat, lng, alt, height = (entry.fields[name] for name in ("Lat", "Lng", "Alt", "RelHomeAlt"))
        self._height_m = height
        if self._velocity_ned_m_s is not None:
            yield from global_position(lat, lng, alt, height, self._velocity_ned_m_s)

    def _attitude(self, entry: Entry) -> Made:
        roll, pitch, yaw = (math.radians(entry.fields[name]) for name in ("Roll", "Pitch", "Yaw"))
        yield "ATTITUDE", {"roll": roll, "pitch": pitch, "yaw": yaw}

    def _rangefinder(self, entry: Entry) -> Made:
        fields = entry.fields
        quality = fields.get("Quality", -1)  # per cent, -1 unknown; in MAVLink 0 is unknown and 1 invalid
        signal = _SIGNAL_UNKNOWN if quality < 0 else max(_SIGNAL_INVALID, quality)
        signal = signal if fields["Stat"] == _RANGE_GOOD else _SIGNAL_INVALID
        yield _range(fields["Dist"], entry.instance, fields["Orient"], signal)

    def _mount(self, entry: Entry) -> Made:
        fields = entry.fields
        roll_rad, pitch_rad, yaw_rad = (math.radians(fields[name]) for name in ("Roll", "Pitch", "YawE"))
        if all(map(math.isfinite, (roll_rad, pitch_rad, yaw_rad))):
            device = {"flags": _LOCKED_YAW_IN_EARTH_FRAME, "gimbal_device_id": entry.instance + 1}
            quaternion = list(from_roll_pitch_yaw(roll_rad, pitch_rad, yaw_rad))
            yield "GIMBAL_DEVICE_ATTITUDE_STATUS", device | {"q": quaternion}
        logged = fields.get("Dist", math.nan)
        if math.isfinite(logged) and logged != self._mount_ranges.get(entry.instance):
            self._mount_ranges[entry.instance] = logged
            range_m = logged * self._mount_unit_m(logged, pitch_rad)
            yield _range(range_m, _MOUNT_RANGE_ID + entry.instance, _ORIENTATION_CUSTOM, _SIGNAL_UNKNOWN)

    def _mount_unit_m(self, logged: float, pitch_rad: float) -> float:
        """Return the unit of a mount's ranges: 1, 0.1 or 0.01 m."""
        drop = math.sin(-pitch_rad)
        if logged > 0.0 and drop > _DROP_MIN and self._height_m > _HEIGHT_MIN_M:
            self._exponents.append(math.log10(logged * drop / self._height_m))
        return 10.0 ** -min(max(round(median(self._exponents)), 0), 2) if self._exponents else 1.0

    def _text(self, entry: Entry) -> Made:
        yield "STATUSTEXT", {"text": entry.fields["Message" if entry.name == "MSG" else "FWS"]}

    def _parameter(self, entry: Entry) -> Made:
        yield "PARAM_VALUE", {"param_id": entry.fields["Name"], "param_value": entry.fields["Value"]}

    def _wind(self, entry: Entry) -> Made:
        if entry.instance == 0:
            north_m_s, east_m_s = entry.fields["VWN"], entry.fields["VWE"]
            yield "WIND_COV", {"time_usec": entry.time_us, "wind_x": north_m_s, "wind_y": east_m_s}


def _range(distance_m: float, sensor_id: int, orientation: int, signal: int) -> tuple[str, dict[str, Any]]:
    limits = {"min_distance": 0.0, "max_distance": math.inf, "covariance": _COVARIANCE_UNKNOWN}
    measured = {"current_distance": 100.0 * distance_m, "id": sensor_id, "orientation": orientation}
    return "DISTANCE_SENSOR", limits | measured | {"signal_quality": signal}


ULOG_MAGIC = b"ULog\x01\x12\x35"

_ULOG_HEADER = struct.Struct("<HcH")  # size of what follows the letter, the letter, and of data the topic's number
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


def _topic_entries(data: mmap | bytes, topics: dict[int, _Topic]) -> Iterator[tuple[int, _Topic]]:
    headers = {
        _ULOG_HEADER.pack(size + 2, b"D", number): (size, topic)
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
            for at, (name, instance, field_names, row, _) in _topic_entries(data, _topics(data, wanted)):
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
    """Return how many entries of each topic a ULog has. Raises OSError."""
    with mapped(path) as data:
        return Counter(topic.name for _, topic in _topic_entries(data, _topics(data, None)))


_VTOL, _TYPES = 22, {1: 2, 2: 1, 3: 10, 4: 7}  # MAV_TYPE; by vehicle_status.vehicle_type
_GLOBAL_POSITION_SILENCE_US = 1_000_000


class Px4Messages(Translator):
    """A position takes its velocity from the latest vehicle_local_position.

    Without vehicle_global_position (older PX4), it is made of vehicle_local_position alone. Heights above home go by
    home_position, else by the origin of the local position.
    """

    def __init__(self) -> None:
        makers: dict[str, Maker] = {
            "home_position": self._home,
            "vehicle_gps_position": self._gps,
            "vehicle_global_position": self._global_position,
            "vehicle_local_position": self._local_position,
            "distance_sensor": self._distance_sensor,
            "gimbal_device_attitude_status": self._gimbal,
            "vehicle_attitude": self._attitude,
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

    def _home(self, entry: Entry) -> None:
        self._home_altitude_m = entry.fields["alt"]

    def _gps(self, entry: Entry) -> None:
        utc_us = entry.fields["time_utc_usec"]
        self._boot_s = (utc_us - entry.time_us) * 1e-6 if utc_us else self._boot_s

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
        roll_rad = math.atan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y))
        pitch_rad = math.asin(max(-1.0, min(1.0, 2.0 * (w * y - z * x))))
        yaw_rad = math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
        yield "ATTITUDE", {"roll": roll_rad, "pitch": pitch_rad, "yaw": yaw_rad}

    def _distance_sensor(self, entry: Entry) -> Made:
        fields = entry.fields
        quality = fields["signal_quality"]  # -1 unknown, 0 invalid; in MAVLink 0 and 1
        variance_cm2 = 1e4 * fields["variance"]
        if math.isfinite(fields["current_distance"]):
            distances = {name: 100.0 * fields[name] for name in ("min_distance", "max_distance", "current_distance")}
            mounted = {name: fields[name] for name in ("type", "orientation")} | {"id": entry.instance}
            read = distances | mounted | {"quaternion": list(_quaternion(fields))}
            read["covariance"] = variance_cm2 if math.isfinite(variance_cm2) else 255
            yield "DISTANCE_SENSOR", read | {"signal_quality": 0 if quality < 0 else max(1, quality)}

    def _gimbal(self, entry: Entry) -> Made:
        fields = entry.fields
        device = {"flags": fields["device_flags"], "gimbal_device_id": fields.get("gimbal_device_id", 0)}
        yield "GIMBAL_DEVICE_ATTITUDE_STATUS", device | {"q": list(_quaternion(fields))}

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

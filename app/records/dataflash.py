"""ArduPilot's DataFlash log (.bin): entries of fixed length behind two header bytes and a type, no checksums.

pymavlink's reader gives up what follows damage, so only its table of field formats is used. Here an entry is whole if
another header or the end of the file follows it, or if damage does and no such entry begins inside it.
"""

from __future__ import annotations

import math
import re
import struct
from collections import Counter, deque
from collections.abc import Collection, Iterator
from contextlib import suppress
from mmap import mmap
from pathlib import Path
from statistics import median
from typing import Any

from sidelong.app.records.entry import Entry, Made, Translator, global_position, in_order
from sidelong.app.records.text_file import Progress, mapped, unseen
from sidelong.estimators.rotations import from_roll_pitch_yaw

_HEADER = b"\xa3\x95"
_HEADERS = re.compile(re.escape(_HEADER))
_FORMAT_TYPE = 0x80
_FORMAT = struct.Struct("<BB4s16s64s")  # type, length, name, one letter a field, field names
_FORMAT_BYTES = 3 + _FORMAT.size
_WITH_TEXT = ("MSG", "PARM", "VER")
_INSTANCE_NAMES = ("Instance", "I", "C")

MAGIC = _HEADER + bytes([_FORMAT_TYPE])


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
        scaled = (
            (_text(value, "replace") if isinstance(value, bytes) else value) if divisor is None else value / divisor
            for value, divisor in zip(values, self._divisors, strict=True)
        )
        fields: dict[str, Any] = dict(zip(self._field_names, scaled, strict=True))
        instance = next((fields[name] for name in _INSTANCE_NAMES if name in fields), 0)
        return Entry(fields["TimeUS"], self.name, instance, fields)


def _text(characters: bytes, errors: str = "strict") -> str:
    return characters.split(b"\0", 1)[0].decode("ascii", errors)


def _kinds(data: mmap | bytes) -> dict[int, _Kind]:
    kinds: dict[int, _Kind] = {}
    for found in re.finditer(re.escape(MAGIC), data):
        if found.start() + _FORMAT_BYTES <= len(data):
            number, *definition = _FORMAT.unpack_from(data, found.end())
            with suppress(KeyError, ValueError):  # damaged, or no definition at all
                kinds.setdefault(number, _Kind(*definition))
    return kinds


def _entries(data: mmap | bytes, kinds: dict[int, _Kind]) -> Iterator[tuple[int, int]]:
    """Yield where the whole entries begin, with the numbers of their types."""
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
        if end <= size and not any(is_followed(one.start()) for one in _HEADERS.finditer(data, begin + 1, end)):
            yield begin, data[begin + 2]
            at = end


def read_dataflash(path: Path, wanted: Collection[str], progress: Progress = unseen) -> Iterator[Entry]:
    """Yield the whole entries of the wanted names in order of time, in the units of pymavlink. Raises OSError."""
    with mapped(path) as data:

        def read() -> Iterator[tuple[float, Entry]]:
            kinds = _kinds(data)
            chosen = {number: kind for number, kind in kinds.items() if kind.name in wanted and kind.is_usable}
            for at, number in _entries(data, kinds):
                if number in chosen:
                    yield at / len(data), chosen[number].entry(data, at)

        yield from in_order(read(), progress)


def dataflash_contents(path: Path) -> Counter[str]:
    with mapped(path) as data:
        kinds = _kinds(data)
        return Counter(kinds[one].name if one in kinds else "FMT" for _, one in _entries(data, kinds))


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
        makers = {
            "GPS": self._gps,
            "XKF1": self._ekf,
            "NKF1": self._ekf,
            "POS": self._position,
            "ATT": self._attitude,
            "RFND": self._rangefinder,
            "MNT": self._mount,
            "XKF2": self._wind,
            "NKF2": self._wind,
            "MSG": self._text,
            "VER": self._text,
            "PARM": self._parameter,
        }
        super().__init__(makers)
        self._velocity_ned_m_s: tuple[float, float, float] | None = None
        self._has_ekf = False
        self._height_m = math.nan
        self._mount_ranges: dict[int, float] = {}  # the latest of each mount, as logged
        self._exponents: deque[float] = deque(maxlen=_UNIT_RANGES)  # powers of ten between logged and expected ranges

    def _gps(self, entry: Entry) -> Made:
        fields = entry.fields
        if entry.instance == 0 and fields["Status"] >= _GPS_FIX_3D:
            utc_s = _GPS_EPOCH_S + fields["GWk"] * _WEEK_S + fields["GMS"] * 1e-3 - _LEAP_S
            self._boot_s = utc_s - entry.time_us * 1e-6
            if not self._has_ekf:
                course_rad = math.radians(fields["GCrs"])
                north_m_s, east_m_s = fields["Spd"] * math.cos(course_rad), fields["Spd"] * math.sin(course_rad)
                self._velocity_ned_m_s = north_m_s, east_m_s, fields["VZ"]
        yield from ()

    def _ekf(self, entry: Entry) -> Made:
        if entry.instance == 0:
            self._has_ekf = True
            self._velocity_ned_m_s = entry.fields["VN"], entry.fields["VE"], entry.fields["VD"]
        yield from ()

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
            yield (
                "GIMBAL_DEVICE_ATTITUDE_STATUS",
                {
                    "flags": _LOCKED_YAW_IN_EARTH_FRAME,
                    "q": list(from_roll_pitch_yaw(roll_rad, pitch_rad, yaw_rad)),
                    "gimbal_device_id": entry.instance + 1,
                },
            )
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
    return (
        "DISTANCE_SENSOR",
        {
            "min_distance": 0.0,
            "max_distance": math.inf,
            "current_distance": 100.0 * distance_m,
            "id": sensor_id,
            "orientation": orientation,
            "covariance": _COVARIANCE_UNKNOWN,
            "signal_quality": signal,
        },
    )

"""Convert command-line options to values. An invalid option ends the program with a sentence that names it."""

from __future__ import annotations

import contextlib
import math
import re
import socket
import sys
from collections.abc import Collection, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NoReturn

import typer

from sidelong.sitl.binary import BinaryError
from sidelong.sitl.payload.companion import CompanionError
from sidelong.sitl.payload.device_port import Address
from sidelong.sitl.payload.devices import DEVICES
from sidelong.sitl.protocol.signing import KeyFileError
from sidelong.sitl.settings import DEFAULT_HOMES, NEWEST, OLDEST, STARTS_M, Flavour, Home, Release, TargetSettings
from sidelong.sitl.world.geodesy import HomePlane
from sidelong.sitl.world.hills import Hills, HillsError
from sidelong.sitl.world.motion import MOTIONS
from sidelong.sitl.world.track import TrackError

_NAMED = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]{0,31}=")
_OPTION_OF: dict[type[Exception], str] = {
    BinaryError: "--binary",
    CompanionError: "--payload-for",
    HillsError: "--terrain",
    KeyFileError: "--require-signing",
    TrackError: "--target",
}
DEFAULT_STATIONS = ("127.0.0.1:14540", "127.0.0.1:14550")


def check_ranges(values: dict[str, tuple[float, float, float, bool]]) -> None:
    for option, (value, least, greatest, min_included) in values.items():
        if not (least <= value <= greatest) or (value == least and not min_included):
            at_least = "at least" if min_included else "more than"
            most = "" if greatest == math.inf else f" and at most {greatest:g}"
            refuse(option, f"must be {at_least} {least:g}{most}, not {value:g}")


def check_programs(programs: Sequence[Path], vehicles: int, logs: Path | None) -> None:
    if logs is not None and not programs:
        refuse("--logs", "goes with --binary: a simulated vehicle writes none")
    if programs and vehicles != len(programs):
        refuse("--binary", f"is given {len(programs)} times for {vehicles} vehicles")


def targets_of(
    specs: Sequence[str], speeds_m_s: Sequence[float | None], starts: Sequence[str] | None, skip_s: float | None
) -> tuple[TargetSettings, ...]:
    """Return the targets; speeds are gone through again and again. Ends the program where there are too many."""
    if len(specs) > len(STARTS_M):
        refuse("--target", f"is given {len(specs)} times; at most {len(STARTS_M)}")
    for speed_m_s in speeds_m_s:
        check_ranges({"--target-speed": (speed_m_s or 0.0, 0.0, 50.0, True)})
    starts_m = [east_north_m(text) for text in starts or ()]
    targets = []
    for number, text in enumerate(specs):
        name, _, spec = text.partition("=") if _NAMED.match(text) else ("", "", text)
        start_m = starts_m[number % len(starts_m)] if starts_m else STARTS_M[number]
        speed_m_s = speeds_m_s[number % len(speeds_m_s)]
        targets.append(TargetSettings(motion_of(spec), speed_m_s, start_m, skip_s, name))
    return tuple(targets)


def targets_seen(text: str, count: int) -> list[int]:
    """Return which target each vehicle's payload sees first, from 0 on."""
    numbers_ = text.split(",")
    for number in numbers_:
        if not number.isdecimal() or not 1 <= int(number) <= count:
            refuse("--looks-at", f"names the target {number!r}; there are {count}, from 1 on")
    return [int(number) - 1 for number in numbers_]


def motion_of(spec: str) -> str | Path:
    if spec in MOTIONS:
        return spec
    if Path(spec).suffix.lower() in (".gpx", ".csv"):
        return Path(spec)
    return refuse("--target", f"is one of {', '.join(MOTIONS)} or a .gpx or .csv file, not {spec!r}")


def flavour_of(name: str) -> Flavour:
    try:
        return Flavour(name)
    except ValueError:
        return refuse("--autopilot", f"is one of {', '.join(Flavour)}, not {name!r}")


def releases_of(text: str | None, flavours: Sequence[Flavour]) -> list[Release | None]:
    """Return the release that each of the flavours behaves like, None: the newest."""
    if text is None:
        return [None]
    names, releases = text.split(","), []
    if len(names) != len(flavours):
        refuse("--version", f"names {len(names)} releases for {len(flavours)} autopilots")
    for name, flavour in zip(names, flavours, strict=True):
        numbers = re.fullmatch(r"(\d{1,3})\.(\d{1,3})(?:\.\d{1,3})?", name)
        release = None if numbers is None else (int(numbers[1]), int(numbers[2]))
        if release is None or not OLDEST[flavour] <= release <= NEWEST[flavour]:
            oldest, newest = (f"{major}.{minor}" for major, minor in (OLDEST[flavour], NEWEST[flavour]))
            refuse("--version", f"is {oldest} to {newest} for {flavour}, not {name!r}")
        releases.append(release)
    return list(releases)


def stations_of(to: list[str] | None, ids: Sequence[int]) -> list[list[Address]]:
    """Return where each vehicle sends to."""
    several = [f"{vehicle_id}@127.0.0.1:{14540 + number}" for number, vehicle_id in enumerate(ids)]
    named = to or (DEFAULT_STATIONS if len(ids) == 1 else [*several, DEFAULT_STATIONS[1]])
    stations: dict[int, list[Address]] = {vehicle_id: [] for vehicle_id in ids}
    for text in named:
        own, at, address = text.rpartition("@")
        for vehicle_id in (_vehicle_id("--to", own, ids),) if at else ids:
            stations[vehicle_id].append(_address("--to", address))
    return list(stations.values())


def lost_at(texts: list[str], ids: Sequence[int]) -> list[tuple[int, float]]:
    found = []
    for text in texts:
        own, _, time_text = text.partition("@")
        (time_s,) = numbers("--lose", time_text, (1,), "ID@S")
        found.append((_vehicle_id("--lose", own, ids), time_s))
    return found


def _vehicle_id(option: str, text: str, ids: Sequence[int]) -> int:
    if not text.isdecimal() or int(text) not in ids:
        refuse(option, f"names the vehicle {text!r}; there are {', '.join(map(str, ids))}")
    return int(text)


def _home(text: str) -> Home:
    values = numbers("--home", text, (2, 3), "LAT,LON[,ALT]")
    if not (abs(values[0]) < 89.0 and abs(values[1]) <= 180.0):
        refuse("--home", f"needs a latitude within 89 and a longitude within 180 degrees, not {text!r}")
    return Home(values[0], values[1], values[2] if len(values) == 3 else 0.0)


def home_on_ground(text: str | None, terrain: Path | None, flavour: Flavour) -> Home | None:
    """Return home as it was given, at the height of the ground there if it was given none. Raises HillsError."""
    home = None if text is None else _home(text)
    if terrain is None or (text is not None and text.count(",") == 2):
        return home
    home = home or DEFAULT_HOMES[flavour]
    hills = Hills(terrain, HomePlane(home.latitude_deg, home.longitude_deg))
    return replace(home, altitude_m=hills.home_altitude_m)


def east_north_m(text: str) -> tuple[float, float]:
    east_m, north_m = numbers("--target-start", text, (2,), "EAST,NORTH")
    return east_m, north_m


def numbers(option: str, text: str, counts: Collection[int], form: str) -> list[float]:
    try:
        values = [float(part) for part in text.split(",")]
    except ValueError:
        values = []
    if len(values) not in counts or not all(math.isfinite(value) for value in values):
        refuse(option, f"must look like {form} in numbers, not {text!r}")
    return values


def device_of(text: str | None, *, only: bool) -> tuple[str, Address | None]:
    """Return protocol and address of a payload with a port of its own; only: whether it is the only payload."""
    if text is None:
        return "", None
    if not only:
        refuse("--device", "goes with one vehicle and its payload")
    kind, _, address = text.partition("@")
    if kind not in DEVICES:
        refuse("--device", f"is KIND@HOST:PORT with a KIND of {', '.join(DEVICES)}, not {text!r}")
    return kind, _address("--device", address)


def _address(option: str, text: str) -> Address:
    host, _, port = text.rpartition(":")
    if not host or not port.isdigit() or not 0 < int(port) < 65536:
        refuse(option, f"must look like HOST:PORT, not {text!r}")
    try:
        return socket.gethostbyname(host), int(port)
    except OSError:
        return refuse(option, f"names the unknown host {host!r}")


@contextlib.contextmanager
def refusing() -> Iterator[None]:
    """End the program where something that an option names cannot be used."""
    try:
        yield
    except tuple(_OPTION_OF) as error:
        refuse(_OPTION_OF[type(error)], str(error))


def refuse(option: str, reason: str) -> NoReturn:
    print(f"sidelong: {option} {reason}", file=sys.stderr)
    raise typer.Exit(2)

"""``sidelong init``: a configuration file to begin with, every key explained.

Presets are airframes by their published parameter files, and payloads by their factory addresses. Transitions between
circles need about ten radii to Dmax. Roll rate and height are the defaults: the aircraft's own figures come first.
"""

from __future__ import annotations

import json
import shlex
import textwrap
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal, get_args, get_origin

import typer
from pydantic.fields import FieldInfo

from sidelong.app.commands.output import checked_file, say, writing
from sidelong.app.config import MAX_AIRCRAFT, AircraftSection, Config
from sidelong.app.errors import InputError
from sidelong.app.fleet.fleet_file import LAYER_M, FleetAircraftSection, TargetSection
from sidelong.app.payload.registry import kind_by_name
from sidelong.app.process import program
from sidelong.app.records.text_file import write_text

Values = dict[str, dict[str, Any]]
"""Values of the configuration by section and key."""


@dataclass(frozen=True, slots=True)
class Preset:
    """about: what it is, in half a line. source: where the values are published."""

    about: str
    source: str
    values: Values


def _airframe(
    about: str, source: str, airspeed_m_s: float, radius_m: float, bank_max_deg: float, range_max_m: float = 500.0
) -> Preset:
    aircraft = {"airspeed_m_s": airspeed_m_s, "radius_m": radius_m, "bank_max_deg": bank_max_deg}
    return Preset(about, source, {"aircraft": aircraft, "requirement": {"range_max_m": range_max_m}})


_FRAMES = "ArduPilot Tools/Frame_params"

PRESETS = {
    "parrot-disco": _airframe("Parrot Disco, foam wing of 1.15 m", f"{_FRAMES}/Parrot_Disco", 14.0, 30.0, 55.0),
    "3dr-aero": _airframe("3DR Aero, foam pusher", f"{_FRAMES}/3DR_Aero_RTF.param", 15.0, 73.0, 50.0, 750.0),
    "skywalker-x8": _airframe("Skywalker X8, foam wing of 2.1 m", f"{_FRAMES}/SkyWalkerX8.param", 16.0, 50.0, 35.0),
    "arduplane-sitl": _airframe(
        "the stock ArduPlane simulation", "ArduPilot Tools/autotest/models/plane.parm", 22.0, 80.0, 65.0, 850.0
    ),
    "px4-sih": _airframe("the PX4 SIH fixed wing", "PX4 SIH rc_plane, unchanged", 15.5, 80.0, 50.0, 850.0),
}

_LASERLESS = "no laser: range from flat ground, or from elevation data (terrain.folder)"
_SERIAL = "serial:///dev/ttyUSB0:115200"


def _payload(
    about: str, kind: str, source: str, url: str = "", pan_limit_deg: float | None = None, has_laser: bool = True
) -> Preset:
    """Return a payload's protocol and factory address; pan_limit_deg: None if it pans all around or is unknown."""
    values: Values = {"payload": {"kind": kind, "url": url or kind_by_name(kind).url}}
    if not has_laser:
        values |= {"terrain": {"flat": True}, "simulation": {"laser": False}}
    if pan_limit_deg is not None:
        values["aircraft"] = {"pan_limit_deg": pan_limit_deg}
    return Preset(about, source, values)


PAYLOAD_PRESETS = {
    "siyi-zt30": _payload("SIYI ZT30, four sensors with laser", "siyi", "SIYI's manuals"),
    "siyi-zt6": _payload(f"SIYI ZT6, {_LASERLESS}", "siyi", "SIYI's manuals", has_laser=False),
    "siyi-a8-mini": _payload(f"SIYI A8 mini, {_LASERLESS}", "siyi", "A8 mini manual 1.5", "", 135.0, has_laser=False),
    "viewpro-tcp": _payload("Viewpro with a laser, by Ethernet", "viewpro", "Viewpro's TCP control document"),
    "viewpro-serial": _payload("Viewpro with a laser, serial", "viewpro", "ArduPilot AP_Mount_Viewpro", _SERIAL),
    "topotek-serial": _payload("Topotek with a laser, serial", "topotek", "ArduPilot AP_Mount_Topotek", _SERIAL),
    "gremsy-vio": _payload("Gremsy VIO, laser", "gremsy", "Gremsy PayloadSdk"),
    "gremsy-orus-l": _payload("Gremsy Orus-L, laser", "gremsy", "Gremsy PayloadSdk"),
}


_WIDTH = 112
_LIMITS = {"ge": "at least", "gt": "more than", "le": "at most", "lt": "less than"}
_FLEET_EXAMPLES = {
    "urls": '["serial:///dev/ttyUSB0:57600", "udpin://0.0.0.0:14550"]',
    "autopilot": '"px4"',
    "reserve": "true",
    "side": '"left"',
    "motion": '"walk"',
    "start_m": "[250.0, 300.0]",
    "target": '"target"',
    "route": '{ file = "ferry.gpx" }',
}


def init(
    file: Annotated[Path, typer.Argument(help="The file to write.")] = Path("sidelong.toml"),
    preset: Annotated[
        str | None,
        typer.Option(
            metavar="NAME[,NAME]",
            help=f"Begin with an airframe ({', '.join(PRESETS)}), a payload ({', '.join(PAYLOAD_PRESETS)}), or both.",
        ),
    ] = None,
    fleet: Annotated[int | None, typer.Option(min=2, max=MAX_AIRCRAFT, help="Number of aircraft.")] = None,
    force: Annotated[bool, typer.Option("--force", help="Write over a file that is there.")] = False,
) -> None:
    """Write a configuration file with every key, its unit, limits and default, to be changed as needed.

    For example:
      sidelong init
      sidelong init x8.toml --preset skywalker-x8,siyi-zt30
      sidelong init fleet.toml --fleet 2
    """
    _check_preset(preset, fleet)
    checked_file("init", file)
    if file.exists() and not force:
        raise InputError(f"{file} is there already; give another name, or --force to write over it.")
    with writing(file, "init"):
        write_text(file, config_text(preset, fleet))
    named = shlex.quote(str(file))
    say(f"wrote {file}; then: {program()} check {named}; {program()} launch {named}")


def _check_preset(preset: str | None, fleet: int | None) -> None:
    names = [] if preset is None else preset.split(",")
    for name in names:
        if name not in PRESETS and name not in PAYLOAD_PRESETS:
            known = "; ".join(f"{name} ({one.about})" for name, one in (PRESETS | PAYLOAD_PRESETS).items())
            raise InputError(f"--preset {name!r} is not known; there are: {known}.")
    for kind, known_names in (("airframe", PRESETS.keys()), ("payload", PAYLOAD_PRESETS.keys())):
        if sum(name in known_names for name in names) > 1:
            raise InputError(f"--preset {preset!r} names more than one {kind}; name one.")
    if fleet is not None and any(name in PAYLOAD_PRESETS for name in names):
        raise InputError("--preset: a fleet reads payloads by MAVLink; leave it out, see docs/payloads.md.")


def config_text(preset: str | None = None, fleet: int | None = None) -> str:
    """Return the file's text with presets, named with commas between them; fleet: number of aircraft, None: one."""
    presets = {name: (PRESETS | PAYLOAD_PRESETS)[name] for name in (preset.split(",") if preset is not None else ())}
    return "\n".join(_lines(presets, fleet)) + "\n"


def _lines(presets: Mapping[str, Preset], fleet: int | None) -> Iterator[str]:
    yield "# Configuration of sidelong. Every key may be left out; it then has the default that is written here."
    values: Values = {}
    for name, preset in presets.items():
        yield from _comment(f"Preset {name}: {preset.about}. Values from {preset.source}.")
        for section, own in preset.values.items():
            values[section] = values.get(section, {}) | own
    for section, about in Config.model_fields.items():
        kind: Any = about.annotation
        if section == "aircraft" and fleet is not None:
            yield from _fleet_lines(values.get(section, {}), fleet)
            continue
        yield ""
        yield from _comment(kind.__doc__ or "")
        yield f"[{section}]"
        for key, field in kind.model_fields.items():
            yield from _entry(key, field, values.get(section, {}).get(key))


def _fleet_lines(values: dict[str, float], count: int) -> Iterator[str]:
    """Write the aircraft: the first with every key explained, the others with their distinguishing keys only."""
    lowest_m = AircraftSection.model_fields["height_m"].default
    for number in range(count):
        own = values | {"height_m": lowest_m + number * LAYER_M}
        yield ""
        if number == 0:
            yield from _comment(f"{FleetAircraftSection.__doc__} One [[aircraft]] for each.")
        yield "[[aircraft]]"
        yield f'name = "aircraft-{number + 1}"'
        for key, field in AircraftSection.model_fields.items():
            if number == 0:
                yield from _entry(key, field, own.get(key))
            elif key in own:
                yield f"{key} = {toml(own[key])}"
        for key in ("url", "urls", "system_id", "autopilot", "reserve", "target"):
            if number == 0:
                yield from _comment(FleetAircraftSection.model_fields[key].description or "")
            example = f'"udpin://0.0.0.0:{14540 + number}"' if key == "url" else _FLEET_EXAMPLES.get(key, number + 1)
            yield f"# {key} = {example}"
    yield ""
    yield from _comment("A target that is watched. One [[target]] for each.")
    yield "[[target]]"
    for key, field in TargetSection.model_fields.items():
        yield from _comment(field.description or "")
        yield f"{key} = {toml(field.default)}" if field.default is not None else f"# {key} = {_FLEET_EXAMPLES[key]}"


def _entry(key: str, field: FieldInfo, chosen: Any) -> Iterator[str]:
    default = field.get_default(call_default_factory=True, validated_data={})
    parts = [field.description or "", limits_in_words(field)]
    if chosen is not None and default not in (None, chosen):
        parts.append(f"Default {toml(default)}.")
    yield from _comment(" ".join(filter(None, parts)))
    if chosen is None and default in (None, []):
        yield f"# {key} = {toml((field.examples or [None])[0])}"
    else:
        yield f"{key} = {toml(default if chosen is None else chosen)}"


def limits_in_words(field: FieldInfo) -> str:
    """Return the limits of a field in words, '' where it has none."""
    if get_origin(field.annotation) is Literal:
        return f"One of {', '.join(toml(value) for value in get_args(field.annotation))}."
    words = [
        f"{words} {getattr(limit, key):g}"
        for limit in field.metadata
        for key, words in _LIMITS.items()
        if hasattr(limit, key)
    ]
    return f"{', '.join(words).capitalize()}." if words else ""


def _comment(text: str) -> list[str]:
    return textwrap.wrap(text, _WIDTH, initial_indent="# ", subsequent_indent="# ", break_on_hyphens=False)


def toml(value: Any) -> str:
    """Return a plain value as TOML writes it: strings, numbers and booleans are the same as in JSON."""
    return json.dumps(value, allow_nan=False)

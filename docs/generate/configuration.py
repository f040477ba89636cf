"""The page of all configuration keys, from the models that read the file."""

from __future__ import annotations

import re
import types
from collections.abc import Iterator
from typing import Any, Literal, Union, get_args, get_origin

from pydantic import BaseModel

from sidelong.app.commands.init import limits_in_words, toml
from sidelong.app.config import Config
from sidelong.app.fleet.fleet_file import FleetAircraftSection, TargetSection

_UNITS = (
    ("_m_s", "m/s"),
    ("_deg_s", "degrees/s"),
    ("_deg", "degrees"),
    ("_percent", "%"),
    ("_min", "min"),
    ("_m", "m"),
    ("_s", "s"),
)
_TYPES = {float: "number", int: "integer", str: "text", bool: "true or false"}


def page() -> str:
    """Return the page in Markdown."""
    return "\n".join(_lines()) + "\n"


def _lines() -> Iterator[str]:
    yield "# Configuration\n"
    yield "Generated from the models that read the file. `sidelong init` writes the same keys to a file.\n"
    yield "A configuration is a TOML file. Every key may be left out; its default then applies.\n"
    for section, field in Config.model_fields.items():
        kind: Any = field.annotation
        yield from _table(f"[{section}]", kind, kind.model_fields)
    own = {key: one for key, one in FleetAircraftSection.model_fields.items() if key not in _aircraft_keys()}
    yield "\n## Fleet files\n"
    yield "A fleet file has one `[[aircraft]]` table for each aircraft instead of `[aircraft]`."
    yield "It may have `[[target]]` tables. `sidelong init --fleet 2` writes one.\n"
    yield from _table("[[aircraft]]: additional keys", FleetAircraftSection, own, 3)
    yield from _table("[[target]]", TargetSection, TargetSection.model_fields, 3)


def _aircraft_keys() -> set[str]:
    kind: Any = Config.model_fields["aircraft"].annotation
    return set(kind.model_fields)


def _table(title: str, kind: type[BaseModel], fields: dict[str, Any], level: int = 2) -> Iterator[str]:
    yield f"\n{'#' * level} {title}\n"
    yield f"{kind.__doc__}\n"
    yield "| key | type | unit | default | limits | meaning |\n| --- | --- | --- | --- | --- | --- |"
    for key, field in fields.items():
        default = "required" if field.is_required() else _default(field)
        unit = next((unit for end, unit in _UNITS if key.endswith(end)), "")
        limits = limits_in_words(field)
        yield (
            f"| `{key}` | {_type(field.annotation)} | {unit} | {default} | {_cell(limits)} | "
            f"{_cell(field.description or '')} |"
        )


def _default(field: Any) -> str:
    value = field.get_default(call_default_factory=True, validated_data={})
    if value is None or isinstance(value, BaseModel):
        return "none"
    return f"`{toml(value)}`"


def _type(annotation: Any) -> str:
    origin = get_origin(annotation)
    if origin in (Union, types.UnionType):
        return " or ".join(_type(one) for one in get_args(annotation) if one is not type(None))
    if origin is Literal:
        return "text"
    if origin is list:
        return f"list of {_type(get_args(annotation)[0])}"
    if origin is tuple:
        return f"list of {len(get_args(annotation))} numbers"
    if hasattr(annotation, "__metadata__"):
        return _type(get_args(annotation)[0])
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return "table"
    return _TYPES.get(annotation, "text")


def _cell(text: str) -> str:
    return re.sub(r"\s+", " ", text).replace("|", "\\|")

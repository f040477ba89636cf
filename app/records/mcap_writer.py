"""JSON messages in an MCAP file; each topic's schema follows from its first message."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

from sidelong.app.errors import missing_package

_UNSTAMPED = frozenset({"foxglove.GeoJSON", "foxglove.SceneUpdate"})


def mcap_writer_class() -> Any:
    """Return the writer of the package mcap, an optional extra. Raises InputError when it is not installed."""
    try:
        from mcap.writer import Writer  # noqa: PLC0415
    except ImportError as error:
        raise missing_package("MCAP", "mcap") from error
    return Writer


class McapWriter:
    """Replaces ``path``.

    Raises InputError when the package mcap is not installed, OSError when the file cannot be written.
    """

    def __init__(self, path: Path) -> None:
        writer = mcap_writer_class()
        self._file = path.open("wb")
        self._writer = writer(self._file)
        self._writer.start()
        self._channels: dict[str, int] = {}

    def write(self, topic: str, schema: str, time_ns: int, values: dict[str, Any]) -> None:
        """Add a message, with its time in it (ns since 1970) where the schema has one."""
        message = _without_nan(values if schema in _UNSTAMPED else {"timestamp": stamp(time_ns), **values})
        if topic not in self._channels:
            described = json.dumps(_schema(message)).encode()
            schema_id = self._writer.register_schema(schema, "jsonschema", described)
            self._channels[topic] = self._writer.register_channel(topic, "json", schema_id)
        data = json.dumps(message, separators=(",", ":")).encode()
        self._writer.add_message(self._channels[topic], time_ns, data, time_ns)

    def close(self) -> None:
        """Write the index and what is left."""
        self._writer.finish()
        self._file.close()


def stamp(time_ns: int) -> dict[str, int]:
    """Return a time as Foxglove's schemas have it."""
    return dict(zip(("sec", "nsec"), divmod(time_ns, 10**9), strict=True))


def _schema(value: Any) -> dict[str, Any]:
    """Return the JSON schema of a message like this one."""
    match value:
        case dict():
            return {"type": "object", "properties": {name: _schema(item) for name, item in value.items()}}
        case list():
            return {"type": "array", "items": _schema(value[0]) if value else {}}
        case bool():
            return {"type": "boolean"}
        case str():
            return {"type": "string"}
        case int():
            return {"type": "integer"}
        case _:
            return {"type": "number"}


def _without_nan(value: Any) -> Any:
    if isinstance(value, dict):
        return {name: _without_nan(item) for name, item in value.items()}
    return None if isinstance(value, float) and math.isnan(value) else value

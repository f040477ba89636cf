"""Journals of earlier formats, read as if they were written today.

Format 1 (to November 2026) named some types and units otherwise.
"""

from __future__ import annotations

import re
from typing import Any

OLDEST_FORMAT = 1

_NAMES_IN_1 = {
    "Engaged": "ControlAcquired",
    "Prepare": "UploadPlan",
    "Depart": "ActivatePlan",
    "SwapReported": "PlanStatus",
    "Decided": "DecisionRecord",
}
_UNIT_IN_1 = re.compile(r"_1_(m2|m|s)$")


def upgraded(name: str, fields: dict[str, Any], written_format: int) -> tuple[str, dict[str, Any]]:
    """Return a record's type name and fields as the present format spells them."""
    if name == "Announce" and fields.get("kind") == "swap":  # until late in format 2
        fields = fields | {"kind": "plan"}
    if written_format > OLDEST_FORMAT:
        return name, fields
    return _NAMES_IN_1.get(name, name), _with_units(fields)


def _with_units(value: Any) -> Any:
    if isinstance(value, dict):
        return {_UNIT_IN_1.sub(r"_per_\1", key): _with_units(item) for key, item in value.items()}
    if isinstance(value, list) and value and isinstance(value[0], dict):
        return [_with_units(item) for item in value]
    return value

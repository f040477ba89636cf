"""Directions and places in plain words. Source: docs/how-to/read-the-terminal.md."""

from __future__ import annotations

import math

from sidelong.mission.core.circle import Circle

_WINDS = ("north", "north-east", "east", "south-east", "south", "south-west", "west", "north-west")
_SAME_PLACE_M = 3.0


def describe_new_circle(old: Circle, new: Circle) -> str:
    """Return where one circle lies from another in words."""
    return describe_move(new.east_m - old.east_m, new.north_m - old.north_m)


def describe_move(east_m: float, north_m: float) -> str:
    """Return a shift in words: ``212 m east``."""
    if math.hypot(east_m, north_m) < _SAME_PLACE_M:
        return "on to the same circle"
    direction = _WINDS[round(math.atan2(east_m, north_m) / (math.pi / 4)) % 8]
    return f"{math.hypot(east_m, north_m):.0f} m {direction}"

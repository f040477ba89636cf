"""The radius as an option of commands, and the notes on a configuration."""

from __future__ import annotations

from typing import Annotated, Any

from sidelong.app.commands.options import AIRCRAFT
from sidelong.app.commands.output import say
from sidelong.app.config import Config, reach_warning, room_warning, setting_notes


def _parsed(words: str) -> float | str:
    try:
        return words if words == "auto" else float(words)
    except ValueError:
        raise ValueError(f"{words!r} is neither a number of metres nor auto.") from None


# A float, or "auto".
RadiusOption = Annotated[
    Any,
    AIRCRAFT(
        parser=_parsed,
        metavar="M|auto",
        help="Radius of the circle, m; auto: 3.5 s of flight, with room in the range band.",
    ),
]


def warn_of_band(config: Config) -> None:
    """Warn about a band that leaves too little margin for the circle, or is wider than the laser's reach."""
    for warning in (room_warning(config), reach_warning(config)):
        if warning is not None:
            say(f"note: {warning}")


def warn_of_settings(config: Config) -> None:
    """Print a note for each key that has no effect, or that contradicts another one."""
    for note in setting_notes(config):
        say(f"note: {note}")

"""The radius as an option of commands, and the warning of one that leaves no room."""

from __future__ import annotations

from typing import Annotated, Any

from sidelong.app.commands.options import AIRCRAFT
from sidelong.app.commands.output import console
from sidelong.app.config import Config, room_warning


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


def warn_of_little_room(config: Config) -> None:
    """Warn about a circle that leaves too little margin in the range band."""
    warning = room_warning(config)
    if warning is not None:
        console.print(f"note: {warning}", soft_wrap=True)

"""The supported autopilots: to add one, add a module to this folder and a line here.

Other distributions add theirs by the entry point group ``sidelong.autopilots``.
"""

from __future__ import annotations

from sidelong.app.autopilots.arduplane import ArduPlane
from sidelong.app.autopilots.autopilot import Autopilot
from sidelong.app.autopilots.px4 import Px4
from sidelong.app.errors import InputError
from sidelong.app.plugins import with_plugins

AUTOPILOTS: tuple[Autopilot, ...] = with_plugins(
    "sidelong.autopilots",
    (ArduPlane(), Px4()),
    ("mav_autopilot", "mission_mode", "mode_name", "required_parameters", "limits", "quirks", "circles_refused"),
)


def autopilot_by_mav_autopilot(number: int) -> Autopilot | None:
    """Return the autopilot that a heartbeat's MAV_AUTOPILOT names, None if it is not flown here."""
    return next((one for one in AUTOPILOTS if one.mav_autopilot == number), None)


def check_guidance(autopilot: Autopilot, guidance: str) -> None:
    """Raise InputError if an autopilot is not guided in this way (``planner.guidance``)."""
    if guidance == "command" and autopilot.circles_refused:
        raise InputError(f"{autopilot.circles_refused}; use mission.")


def autopilot_by_name(name: str) -> Autopilot | None:
    """Return the autopilot of a name, None if it is not flown here."""
    return next((one for one in AUTOPILOTS if one.name == name), None)

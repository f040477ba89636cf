"""The words of the health model: inputs, their states, and a change of one."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


class Input(StrEnum):
    """What the control step lives on, and what it stays within."""

    POSITION = "position"
    ATTITUDE = "attitude"
    HEARTBEAT = "heartbeat"
    LASER = "laser"
    GIMBAL = "gimbal"
    SIGHTINGS = "sightings"  # laser and gimbal together, against the track
    LINK = "link"
    CLOCK = "clock"  # the vehicle's, against its own earlier stamps
    TERRAIN = "terrain"  # the elevation data, against laser and gimbal
    NEIGHBOURS = "neighbours"  # what the coordinator of a fleet reports
    HEIGHT = "height"  # the own one, against plan, floor, ceiling and ground
    FENCE = "fence"  # the own position, against the fences
    PATH = "path"  # the own position, against the plan
    AIRCRAFT = "aircraft"  # what it reaches, against its limits as configured
    SPEED = "speed"  # the target's, against its limit
    HOME = "home"  # where the autopilot has it, against the one at the takeover
    ORDERS = "orders"  # what became of the plans sent


ENVELOPE = frozenset((Input.HEIGHT, Input.FENCE, Input.PATH, Input.AIRCRAFT, Input.SPEED, Input.HOME, Input.ORDERS))
"""What the flight itself is judged by: :mod:`sidelong.mission.control.envelope`."""
UNFULFILLED = frozenset((Input.HEIGHT, Input.FENCE, Input.PATH, Input.AIRCRAFT))
"""While one of these is inconsistent, time counts neither as in band nor as on side."""


class InputState(StrEnum):
    """How an input is.

    ``ok``: fresh and in agreement. ``stale``: it was received and no longer is. ``missing``: it was never received.
    ``inconsistent``: it contradicts the other inputs. ``switched``: fresh, from another device than before.
    """

    OK = "ok"
    STALE = "stale"
    MISSING = "missing"
    INCONSISTENT = "inconsistent"
    SWITCHED = "switched"


@dataclass(frozen=True, slots=True)
class InputReport:
    """The present state of one input, for displays: since when on the vehicle's clock, and why, in a sentence.

    rate_hz: readings per second of that clock over the last seconds; NaN before it is known.
    """

    input: Input
    state: InputState
    since_s: float
    rate_hz: float
    text: str

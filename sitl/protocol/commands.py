"""Commands: COMMAND_LONG and COMMAND_INT in one form, and those that every autopilot answers alike."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from pymavlink.dialects.v20 import all as mavlink

ACCEPTED: int = mavlink.MAV_RESULT_ACCEPTED
DENIED: int = mavlink.MAV_RESULT_DENIED
FAILED: int = mavlink.MAV_RESULT_FAILED
REJECTED: int = mavlink.MAV_RESULT_TEMPORARILY_REJECTED
UNSUPPORTED: int = mavlink.MAV_RESULT_UNSUPPORTED

_IGNORED_COORDINATE = 2**31 - 1


@dataclass(frozen=True, slots=True)
class Command:
    """params are 1 to 7; 5 and 6 are degrees for commands with a position, NaN when left out.

    frame is None for a COMMAND_LONG, which has none.
    """

    id: int
    params: tuple[float, float, float, float, float, float, float]
    frame: int | None
    sender: tuple[int, int]

    @staticmethod
    def from_message(message: Any) -> Command:
        """Return a COMMAND_LONG or COMMAND_INT; an unset coordinate is nan, others are degrees."""
        sender = (message.get_srcSystem(), message.get_srcComponent())
        head = (message.param1, message.param2, message.param3, message.param4)
        if message.get_type() == "COMMAND_LONG":
            return Command(message.command, (*head, message.param5, message.param6, message.param7), None, sender)
        x = math.nan if message.x == _IGNORED_COORDINATE else message.x / 1e7
        y = math.nan if message.y == _IGNORED_COORDINATE else message.y / 1e7
        return Command(message.command, (*head, x, y, message.z), message.frame, sender)

    def param(self, number: int) -> float:
        """Return param1 to param7 by its number."""
        return self.params[number - 1]

    def number(self, number: int) -> float:
        """Return a param, 0 where it is not a number."""
        value = self.params[number - 1]
        return value if math.isfinite(value) else 0.0

    def acknowledgement(self, result: int) -> Any:
        return mavlink.MAVLink_command_ack_message(self.id, result, 0, 0, *self.sender)


Handler = Callable[[Command], int]

"""The parameter protocol, with each autopilot's way of packing integers."""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any

from pymavlink.dialects.v20 import all as mavlink

from sidelong.sitl.protocol.radio import Radio, Station

INT8 = mavlink.MAV_PARAM_TYPE_INT8
INT16 = mavlink.MAV_PARAM_TYPE_INT16
INT32 = mavlink.MAV_PARAM_TYPE_INT32
REAL32 = mavlink.MAV_PARAM_TYPE_REAL32
_NO_INDEX = 65535
_TYPE_MISMATCH = 7  # MAV_PARAM_ERROR


class Parameters(dict[str, float]):
    """Values by name, each with the MAVLink type the real autopilot gives it.

    table: MAVLink type and value of each name. bytewise: PX4 sends an integer's bytes in the float field, ArduPilot
    its value as a float. reports_errors: whether PARAM_ERROR answers a request that is wrong. former: name and unit,
    in those of the newest release, of the parameters that this release names otherwise.
    """

    def __init__(
        self,
        table: dict[str, tuple[int, float]],
        bytewise: bool,
        reports_errors: bool = False,
        former: Mapping[str, tuple[str, float]] = MappingProxyType({}),
    ) -> None:
        super().__init__((name, value) for name, (_, value) in table.items())
        self._kinds = {name: kind for name, (kind, _) in table.items()}
        self.changes = 0  # how often a value was set
        self._names = sorted(table)
        self._bytewise, self._reports_errors, self._former = bytewise, reports_errors, former
        self.on_change: Callable[[str, float], None] = lambda _name, _value: None

    def __missing__(self, name: str) -> float:
        own, unit = self._former[name]
        return self[own] * unit

    def within(self, name: str, least: float, greatest: float) -> float:
        """Return a value as the airframe can bear it, whatever a station has set."""
        value = self[name]
        return least if value < least else greatest if value > greatest else value

    def set(self, name: str, value: float) -> None:
        """Set a known parameter, by its own name or by that of the newest release; KeyError if there is none."""
        name, unit = self._former.get(name, (name, 1.0))
        value /= unit
        if name not in self:
            raise KeyError(name)
        self[name] = value if self._kinds[name] == REAL32 else float(round(value))
        self.changes += 1
        self.on_change(name, self[name])

    def handle(self, station: Station, message: Any, radio: Radio) -> None:
        """Answer PARAM_REQUEST_LIST, PARAM_REQUEST_READ and PARAM_SET as the autopilot does."""
        match message.get_type():
            case "PARAM_REQUEST_LIST":
                for index, name in enumerate(self._names):
                    radio.send(station, self._value_message(name, index))
            case "PARAM_REQUEST_READ":
                index, name = message.param_index, message.param_id
                if 0 <= index < len(self._names):
                    radio.send(station, self._value_message(self._names[index], index))
                elif index < 0 and name in self:
                    radio.send(station, self._value_message(name, self._index(name)))
                else:
                    self._refuse(station, message, radio, index, mavlink.MAV_PARAM_ERROR_DOES_NOT_EXIST)
            case "PARAM_SET":
                name = message.param_id
                if name not in self or (self._bytewise and message.param_type != self._kinds[name]):
                    error = _TYPE_MISMATCH if name in self else mavlink.MAV_PARAM_ERROR_DOES_NOT_EXIST
                    self._refuse(station, message, radio, -1, error)
                    return
                value = self._decode(message.param_value, message.param_type)
                if math.isfinite(value):
                    self.set(name, value)
                if math.isfinite(value) or self._bytewise:  # PX4 sends the value it has stored
                    radio.broadcast(self._value_message(name, self._index(name)))

    def _refuse(self, station: Station, message: Any, radio: Radio, index: int, error: int) -> None:
        if self._reports_errors:
            asker = (message.get_srcSystem(), message.get_srcComponent())
            radio.send(station, mavlink.MAVLink_param_error_message(*asker, message.param_id.encode(), index, error))

    def _index(self, name: str) -> int:
        return self._names.index(name) if self._bytewise else _NO_INDEX

    def _value_message(self, name: str, index: int) -> Any:
        kind, value = self._kinds[name], self[name]
        if self._bytewise and kind != REAL32:
            value = struct.unpack("<f", struct.pack("<i", int(value)))[0]
        return mavlink.MAVLink_param_value_message(name.encode(), value, kind, len(self._names), index)

    def _decode(self, value: float, kind: int) -> float:
        if self._bytewise and kind != REAL32:
            return float(struct.unpack("<i", struct.pack("<f", value))[0])
        return float(value)

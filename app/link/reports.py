"""MAVLink messages into the reports of the exchange: from the autopilot only, answers only those that are for us."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

from sidelong.app.link.message import Message
from sidelong.app.link.telemetry import ARMED_FLAG, AUTOPILOT_COMPONENT, mode_name
from sidelong.app.link.vehicle import VehicleMessages
from sidelong.mission.core.events import ModeReported
from sidelong.mission.exchange import reports
from sidelong.mission.exchange.outbox import MISSION
from sidelong.mission.upload.mission_item import MissionItem

Fields = Mapping[str, Any]
_Decoder = Callable[[Fields, float, float], reports.VehicleReport | ModeReported | None]
# Reports of whole numbers alone: their fields, 0 for an extension that the sender does not have.
_NUMBERS: dict[str, tuple[Any, ...]] = {
    "MISSION_CURRENT": (reports.MissionCurrentReported, "seq", "total", "mission_id"),
    "MISSION_COUNT": (reports.MissionCountReported, "count", "opaque_id"),
    "MISSION_REQUEST": (reports.MissionItemRequested, "seq"),
    "MISSION_REQUEST_INT": (reports.MissionItemRequested, "seq"),
    "MISSION_ACK": (reports.MissionAcknowledged, "type", "opaque_id"),
    "COMMAND_ACK": (reports.CommandAcknowledged, "command", "result"),
    "POSITION_TARGET_GLOBAL_INT": (reports.PositionTargetReported, "lat_int", "lon_int"),
}
_UNASKED = {"MISSION_CURRENT", "POSITION_TARGET_GLOBAL_INT", "ORBIT_EXECUTION_STATUS", "CURRENT_MODE"}


class VehicleReports:
    def __init__(self, vehicle: VehicleMessages) -> None:
        self._vehicle = vehicle
        self._mode = ""
        self._decoders: dict[str, _Decoder] = {
            name: partial(_numbers, kind, names) for name, (kind, *names) in _NUMBERS.items()
        } | {
            "MISSION_ITEM_INT": _mission_item,
            "ORBIT_EXECUTION_STATUS": _orbit,
            "CURRENT_MODE": self._current_mode,
        }

    def report(self, message: Message, time_s: float, link_s: float) -> reports.VehicleReport | ModeReported | None:
        """Return what a message reports, None if nothing. time_s: the vehicle's clock, link_s: when it came."""
        decoder = self._decoders.get(message.name)
        if decoder is None or message.component_id != AUTOPILOT_COMPONENT or time_s == -math.inf:
            return None
        if message.name not in _UNASKED and not self._vehicle.is_for_us(message):
            return None
        if message.fields.get("mission_type", MISSION) != MISSION:
            return None
        return decoder(message.fields, time_s, link_s)

    def _current_mode(self, fields: Fields, time_s: float, link_s: float) -> ModeReported | None:
        heartbeat = self._vehicle.latest.get("HEARTBEAT")
        if heartbeat is None:
            return None
        base_mode = int(heartbeat.fields["base_mode"])
        mode = mode_name(int(heartbeat.fields["autopilot"]), base_mode, int(fields["custom_mode"]))
        if mode == self._mode:
            return None  # it is sent often, so that a change is seen at once
        self._mode = mode
        return ModeReported(time_s, mode, bool(base_mode & ARMED_FLAG))


def _numbers(
    kind: Callable[..., reports.VehicleReport], names: list[str], fields: Fields, time_s: float, link_s: float
) -> reports.VehicleReport:
    return kind(time_s, link_s, *(int(fields.get(name) or 0) for name in names))


def _mission_item(fields: Fields, time_s: float, link_s: float) -> reports.MissionItemReported:
    values: dict[str, Any] = {field.name: fields[field.name] for field in dataclasses.fields(MissionItem)}
    values.update({name: math.nan for name, value in values.items() if value is None})
    return reports.MissionItemReported(time_s, link_s, int(fields["seq"]), MissionItem(**values))


def _orbit(fields: Fields, time_s: float, link_s: float) -> reports.OrbitReported:
    return reports.OrbitReported(time_s, link_s, int(fields["x"]), int(fields["y"]), float(fields["radius"]))

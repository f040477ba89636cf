"""MAVLink messages into the reports of the exchange: from the autopilot only, answers only those that are for us."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping
from typing import Any

from sidelong.app.link.message import Message
from sidelong.app.link.modes import ARMED_FLAG, mode_name
from sidelong.app.link.telemetry import AUTOPILOT_COMPONENT
from sidelong.app.link.vehicle import Vehicle
from sidelong.mission.core.events import ModeReported
from sidelong.mission.exchange.outbox import MISSION
from sidelong.mission.exchange.reports import (
    CommandAcknowledged,
    MissionAcknowledged,
    MissionCountReported,
    MissionCurrentReported,
    MissionItemReported,
    MissionItemRequested,
    OrbitReported,
    PositionTargetReported,
    VehicleReport,
)
from sidelong.mission.upload.mission_item import MissionItem

Fields = Mapping[str, Any]
_ANSWERS = {
    "MISSION_COUNT",
    "MISSION_REQUEST",
    "MISSION_REQUEST_INT",
    "MISSION_ITEM_INT",
    "MISSION_ACK",
    "COMMAND_ACK",
}


class VehicleReports:
    """Decodes one vehicle's reports."""

    def __init__(self, vehicle: Vehicle) -> None:
        self._vehicle = vehicle
        self._mode = ""
        self._decoders: dict[str, Callable[[Fields, float, float], VehicleReport | ModeReported | None]] = {
            "MISSION_CURRENT": _mission_current,
            "MISSION_COUNT": _mission_count,
            "MISSION_REQUEST": _mission_request,
            "MISSION_REQUEST_INT": _mission_request,
            "MISSION_ITEM_INT": _mission_item,
            "MISSION_ACK": _mission_ack,
            "COMMAND_ACK": _command_ack,
            "POSITION_TARGET_GLOBAL_INT": _position_target,
            "ORBIT_EXECUTION_STATUS": _orbit,
            "CURRENT_MODE": self._current_mode,
        }

    def report(self, message: Message, time_s: float, link_s: float) -> VehicleReport | ModeReported | None:
        """Return what a message reports, None if nothing. time_s: the vehicle's clock, link_s: when it came."""
        decoder = self._decoders.get(message.name)
        if decoder is None or message.component_id != AUTOPILOT_COMPONENT or time_s == -math.inf:
            return None
        if message.name in _ANSWERS and not self._vehicle.is_for_us(message):
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


def _mission_current(fields: Fields, time_s: float, link_s: float) -> MissionCurrentReported:
    total, mission_id = int(fields.get("total") or 0), int(fields.get("mission_id") or 0)
    return MissionCurrentReported(time_s, link_s, int(fields["seq"]), total, mission_id)


def _mission_count(fields: Fields, time_s: float, link_s: float) -> MissionCountReported:
    return MissionCountReported(time_s, link_s, int(fields["count"]), int(fields.get("opaque_id") or 0))


def _mission_request(fields: Fields, time_s: float, link_s: float) -> MissionItemRequested:
    return MissionItemRequested(time_s, link_s, int(fields["seq"]))


def _mission_item(fields: Fields, time_s: float, link_s: float) -> MissionItemReported:
    values: dict[str, Any] = {field.name: fields[field.name] for field in dataclasses.fields(MissionItem)}
    values.update({name: math.nan for name, value in values.items() if value is None})
    return MissionItemReported(time_s, link_s, int(fields["seq"]), MissionItem(**values))


def _mission_ack(fields: Fields, time_s: float, link_s: float) -> MissionAcknowledged:
    return MissionAcknowledged(time_s, link_s, int(fields["type"]), int(fields.get("opaque_id") or 0))


def _command_ack(fields: Fields, time_s: float, link_s: float) -> CommandAcknowledged:
    return CommandAcknowledged(time_s, link_s, int(fields["command"]), int(fields["result"]))


def _position_target(fields: Fields, time_s: float, link_s: float) -> PositionTargetReported:
    return PositionTargetReported(time_s, link_s, int(fields["lat_int"]), int(fields["lon_int"]))


def _orbit(fields: Fields, time_s: float, link_s: float) -> OrbitReported:
    return OrbitReported(time_s, link_s, int(fields["x"]), int(fields["y"]), float(fields["radius"]))

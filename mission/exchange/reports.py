"""What the autopilot reports, as typed events of the exchange.

``time_s`` is the vehicle's clock, as everywhere in the core. ``link_s`` is the receiver's monotonic clock since the
start of the flight: retries run on it, because packets are lost and delayed by the link's time, not by the vehicle's.
"""

from __future__ import annotations

from dataclasses import dataclass

from sidelong.mission.upload.mission_item import MissionItem


@dataclass(frozen=True, slots=True)
class ExchangeInput:
    """What goes into the exchange, on both clocks."""

    time_s: float
    link_s: float


@dataclass(frozen=True, slots=True)
class MissionCurrentReported(ExchangeInput):
    """MISSION_CURRENT of the autopilot; total 0 and mission_id 0 where it does not report them."""

    seq: int
    total: int
    mission_id: int


@dataclass(frozen=True, slots=True)
class MissionCountReported(ExchangeInput):
    """MISSION_COUNT addressed to sidelong: the number of items on board."""

    count: int
    mission_id: int


@dataclass(frozen=True, slots=True)
class MissionItemRequested(ExchangeInput):
    """MISSION_REQUEST or MISSION_REQUEST_INT to us."""

    seq: int


@dataclass(frozen=True, slots=True)
class MissionItemReported(ExchangeInput):
    """MISSION_ITEM_INT to us: an item as it is on board."""

    seq: int
    item: MissionItem


@dataclass(frozen=True, slots=True)
class MissionAcknowledged(ExchangeInput):
    """MISSION_ACK to us: a MAV_MISSION_RESULT; mission_id 0 where it does not report one."""

    result: int
    mission_id: int


@dataclass(frozen=True, slots=True)
class CommandAcknowledged(ExchangeInput):
    """COMMAND_ACK of the autopilot to us: a MAV_RESULT."""

    command: int
    result: int


@dataclass(frozen=True, slots=True)
class PositionTargetReported(ExchangeInput):
    """POSITION_TARGET_GLOBAL_INT of the autopilot: where it flies to, 1e-7 degrees."""

    x: int
    y: int


@dataclass(frozen=True, slots=True)
class OrbitReported(ExchangeInput):
    """ORBIT_EXECUTION_STATUS of the autopilot: centre in 1e-7 degrees, a negative radius is counter-clockwise."""

    x: int
    y: int
    signed_radius_m: float


@dataclass(frozen=True, slots=True)
class TimerExpired(ExchangeInput):
    """The time that the exchange asked for has come."""


@dataclass(frozen=True, slots=True)
class TakeoverRequested(ExchangeInput):
    """Bring the aircraft onto a circle of ours: from the ground, or from ``mode``, in which it flies already.

    After a yield it resumes the watch: a person has asked for it, and the vehicle was checked again.
    arm_period_s: between two requests to arm; round_trip_s: as far as it is known. Both are of the link's clock.
    """

    flying: bool
    mode: str
    arm_period_s: float = 1.0
    round_trip_s: float = 0.0


@dataclass(frozen=True, slots=True)
class ShutdownRequested(ExchangeInput):
    """The program ends: start nothing new; an upload under way may end."""


VehicleReport = (
    MissionCurrentReported
    | MissionCountReported
    | MissionItemRequested
    | MissionItemReported
    | MissionAcknowledged
    | CommandAcknowledged
    | PositionTargetReported
    | OrbitReported
)
ExchangeEvent = VehicleReport | TimerExpired | TakeoverRequested | ShutdownRequested

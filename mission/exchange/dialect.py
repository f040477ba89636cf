"""What autopilots do differently, and the settings of the exchange. Source: docs/explanation/exchange.md."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from sidelong.estimators.frames import LocalPlane
from sidelong.mission.core.circle import Circle
from sidelong.mission.core.plan import Plan
from sidelong.mission.core.requirement import Aircraft, Wind
from sidelong.mission.exchange.reports import VehicleReport
from sidelong.mission.exchange.vehicle_command import VehicleCommand
from sidelong.mission.geometry.progress import STILL_AIR
from sidelong.mission.upload.line_tracking import LineTracking
from sidelong.mission.upload.mission_item import MissionItem, e7


@dataclass(frozen=True, slots=True)
class Home:
    """Where heights count from."""

    latitude_deg: float
    longitude_deg: float
    altitude_m: float


@dataclass(frozen=True, slots=True)
class CircleOrder:
    """A circle on the globe: centre in 1e-7 degrees; radius negative: counter-clockwise, 0: not reported."""

    x: int
    y: int
    height_m: float  # above home
    altitude_m: float  # above the sea
    signed_radius_m: float


@dataclass(frozen=True, slots=True)
class ExchangeSettings:
    """What is exchanged with the autopilot, and how the first circle is to be flown."""

    plane: LocalPlane
    home: Home
    aircraft: Aircraft
    height_m: float  # above home, of plans without heights of their own
    tolerance_m: float  # how far the flown line may leave the plan
    clockwise: bool  # sense of the first circle
    by_command: bool  # plans are flown by commands, else by mission items
    cleared: Callable[[Plan], Plan | str]  # gives a plan its heights, or names what is in its way

    def order(self, circle: Circle, plan: Plan, home_m: float = 0.0) -> CircleOrder:
        """Return a circle of the plane on the globe, at the height of a plan. home_m: see ``UploadPlan``."""
        height_m = plan.circle_height_m(self.height_m)
        radius_m = circle.radius_m if circle.clockwise else -circle.radius_m
        x, y = e7(self.plane.latitude_longitude_deg(circle.east_m, circle.north_m))
        return CircleOrder(x, y, height_m - home_m, self.home.altitude_m + height_m, radius_m)


@dataclass(frozen=True, slots=True)
class ProtocolQuirks:
    """How an autopilot treats the mission protocol.

    stores_items_one_by_one: each item is stored as it arrives, and MISSION_WRITE_PARTIAL_LIST is understood; else a
    list is taken whole or not at all, and a list on board is read in its order only.
    home_at_zero: item 0 is its home, whatever is sent, and MISSION_CURRENT's total does not count it.
    reports_target_at_once: its position target shows a switch before MISSION_CURRENT does.
    """

    stores_items_one_by_one: bool
    home_at_zero: bool
    reports_target_at_once: bool


class AutopilotDialect(Protocol):
    """One kind of autopilot, as far as the exchange knows it."""

    name: str  # what people call it, and a journal
    quirks: ProtocolQuirks  # how it treats the mission protocol
    mission_mode: str  # the flight mode, by name, in which it flies a mission
    circle_mode: str  # the flight mode, by name, in which it flies a circle given by one command
    min_items: int  # how long its mission is kept at least, see ``MissionLayout``

    def head(self, home: Home) -> tuple[MissionItem, ...]:
        """Return the items at the beginning of every mission."""

    def tail(self, home: Home) -> tuple[MissionItem, ...]:
        """Return the items that close every mission without ever being reached."""

    def tracking(self, airspeed_m_s: float, wind: Wind = STILL_AIR) -> LineTracking:
        """Return how the autopilot flies along waypoints, for laying them out."""

    def stored(self, item: MissionItem) -> MissionItem:
        """Return the item as this autopilot stores it."""

    def start_mission(self) -> VehicleCommand:
        """Return the command to fly the mission."""

    def return_home(self) -> VehicleCommand:
        """Return the command to fly home."""

    def fly_circle(self, order: CircleOrder, take_over: bool) -> VehicleCommand:
        """Return the command to fly a circle without a mission; take_over: also from another flight mode."""

    def reported_circle(self, report: VehicleReport) -> CircleOrder | None:
        """Return the circle that a report of ``circle_mode`` states, radius 0: none; None for other reports."""

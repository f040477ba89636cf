"""How plans reach the autopilot: as mission items or commands. Source: docs/explanation/exchange.md."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from sidelong.estimators.frames import LocalPlane
from sidelong.mission.core.circle import Circle
from sidelong.mission.core.events import ActivatePlan, UploadPlan
from sidelong.mission.core.plan import AircraftState, Plan
from sidelong.mission.exchange.dialect import CircleOrder, Home
from sidelong.mission.exchange.reports import VehicleReport
from sidelong.mission.upload.mission_item import e7


@dataclass(frozen=True, slots=True)
class BackendSettings:
    """tolerance_m: how far the flown line may leave the plan.

    height_m is above home, and that of a plan without heights of its own.
    """

    plane: LocalPlane
    home: Home
    airspeed_m_s: float
    height_m: float
    tolerance_m: float
    bank_max_rad: float

    def order(self, circle: Circle, plan: Plan) -> CircleOrder:
        """Return a circle of the plane on the globe, at the height of a plan.

        Args:
            circle: The circle.
            plan: The plan.
        """
        height_m = plan.circle_height_m(self.height_m)
        return CircleOrder(
            *e7(self.plane.latitude_longitude_deg(circle.east_m, circle.north_m)),
            height_m,
            self.home.altitude_m + height_m,
            circle.radius_m if circle.clockwise else -circle.radius_m,
        )


class PlanBackend(Protocol):
    """One way of flying plans. At any moment, whatever fails, the vehicle is left on a circle that needs no one.

    The outbox reports what becomes of a plan as ``PlanStatus``.
    """

    @property
    def mode(self) -> str:
        """The flight mode, by name, in which it flies."""

    @property
    def next_timer_s(self) -> float:
        """When ``expire`` is to be called, on the link's clock; -inf: at once."""

    @property
    def idle(self) -> bool:
        """Whether nothing is under way that should end before the program does."""

    def upload(self, command: UploadPlan) -> None:
        """Bring a plan to the autopilot without flying it yet.

        Args:
            command: The plan with its number.
        """

    def activate(self, command: ActivatePlan) -> None:
        """Fly a plan now.

        Args:
            command: Number of the plan.
        """

    def take_control(self) -> None:
        """Begin to detect other operators: sidelong has control of the vehicle now."""

    def receive(self, report: VehicleReport) -> None:
        """Process a report of the autopilot.

        Args:
            report: The report of the autopilot.
        """

    def observe(self, aircraft: AircraftState, mode: str) -> None:
        """Process the aircraft's position and flight mode.

        Args:
            aircraft: State of the aircraft.
            mode: Flight mode by the autopilot's name.
        """

    def expire(self) -> None:
        """Do what is due."""

    def close(self) -> None:
        """Start nothing new."""

"""How plans reach the autopilot: as mission items or commands.

At any moment, whatever fails, the vehicle is left on a circle that needs no one. The outbox reports what becomes of a
plan as ``PlanStatus``.

Source: docs/explanation/exchange.md.
"""

from __future__ import annotations

from dataclasses import dataclass

from sidelong.estimators.frames import LocalPlane
from sidelong.mission.core.circle import Circle
from sidelong.mission.core.plan import Plan
from sidelong.mission.exchange.dialect import CircleOrder, Home
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
        """Return a circle of the plane on the globe, at the height of a plan."""
        height_m = plan.circle_height_m(self.height_m)
        return CircleOrder(
            *e7(self.plane.latitude_longitude_deg(circle.east_m, circle.north_m)),
            height_m,
            self.home.altitude_m + height_m,
            circle.radius_m if circle.clockwise else -circle.radius_m,
        )

"""Fly a planner of your own against a moving target. Usage: python examples/own_planner.py [PICTURE.png]."""

import sys
from math import hypot, radians

import matplotlib.pyplot as plt
import numpy as np

from sidelong import Aircraft, AircraftState, Circle, Decision, Plan, Planner, Requirement, Side, TargetEstimate, Wind
from sidelong.estimators.estimate import TrackQuality
from sidelong.mission.geometry.approach import approach
from sidelong.mission.geometry.progress import point_at

AIRCRAFT = Aircraft(airspeed_m_s=15.0, radius_m=50.0, bank_max_rad=radians(45), roll_rate_max_rad_s=radians(30))
REQUIREMENT = Requirement(range_min_m=100.0, range_max_m=500.0, side=Side.LEFT, target_speed_max_m_s=3.0)


class FollowWhenFar:
    """Implements ``Planner``: fly to a new circle in mid-band when the centre is more than 350 m from the target."""

    def decide(
        self, aircraft: AircraftState, target: TargetEstimate, present: Plan, wind: Wind, latency_s: float
    ) -> Decision:
        """Return the decision at ``aircraft.time_s``."""
        distance_m = hypot(present.circle.east_m - target.east_m, present.circle.north_m - target.north_m)
        if distance_m < 350.0 or aircraft.time_s < present.departure_s + 30.0:
            return Decision(aircraft.time_s, None, f"near enough: {distance_m:.0f} m")
        move = approach(aircraft, target, AIRCRAFT, REQUIREMENT)
        return Decision(aircraft.time_s, Plan(move.circle, move.transition, aircraft.time_s), "the target is far")


def main() -> None:
    """Fly ten minutes next to a target that goes north at 2 m/s."""
    planner: Planner = FollowWhenFar()
    plan = Plan(Circle(-300.0, 0.0, 50.0, clockwise=True))
    start = AircraftState(0.0, -300.0, 50.0, 1.57, AIRCRAFT.airspeed_m_s, 0.02)
    flown_m, ranges_m, moves = [], [], 0
    for second in range(600):
        # The aircraft flies each plan exactly.
        point = point_at(plan, AIRCRAFT.airspeed_m_s * (second - start.time_s), start)
        place = point.east_m, point.north_m, point.course_rad
        now, north_m = AircraftState(second, *place, AIRCRAFT.airspeed_m_s, point.curvature_per_m), 2.0 * second
        target = TargetEstimate(now.time_s, 0.0, north_m, 0.0, 2.0, np.eye(4), TrackQuality.GOOD, now.time_s)
        decision = planner.decide(now, target, plan, Wind(), 0.5)
        if decision.plan is not None:
            plan, start, moves = decision.plan, now, moves + 1
        flown_m.append((now.east_m, now.north_m))
        ranges_m.append(hypot(now.east_m, now.north_m - north_m))
    print(f"{moves} moves, range {min(ranges_m):.0f} to {max(ranges_m):.0f} m")
    if len(sys.argv) > 1:
        plt.plot(*zip(*flown_m, strict=True), label="aircraft")
        plt.plot((0.0, 0.0), (0.0, 1200.0), label="target")
        plt.legend()
        plt.savefig(sys.argv[1])


if __name__ == "__main__":
    main()

"""Ask the default planner for one decision: whether the circle has to move, and where to.

Usage: python examples/planner_alone.py [PICTURE.png]
"""

import sys
from math import atan2, hypot, radians

import matplotlib.pyplot as plt

from sidelong import (
    Aircraft,
    AircraftState,
    Circle,
    Plan,
    PredictivePlanner,
    Requirement,
    Side,
    Sighting,
    Track,
    TrackerSettings,
    Wind,
)


def main() -> None:
    """Track a target that has walked north for two minutes, and decide about a circle that it has left behind."""
    track = Track(TrackerSettings())
    for second in range(120):
        north_m = 2.0 * second
        sigmas = (0.8, 0.006, 0.006)
        track.add(Sighting(float(second), hypot(300.0, north_m), atan2(-300.0, north_m), 0.0, *sigmas, 300.0, 0.0))
    estimate = track.estimate(120.0)
    aircraft = Aircraft(airspeed_m_s=15.0, radius_m=50.0, bank_max_rad=radians(45), roll_rate_max_rad_s=radians(30))
    requirement = Requirement(range_min_m=100.0, range_max_m=500.0, side=Side.RIGHT, target_speed_max_m_s=3.0)
    planner = PredictivePlanner.for_(aircraft, requirement)  # computes the value table, or reads it from the cache
    flown = Plan(Circle(east_m=300.0, north_m=-100.0, radius_m=50.0, clockwise=False))
    now = AircraftState(120.0, 350.0, -100.0, course_rad=0.0, ground_speed_m_s=15.0, curvature_per_m=-0.02)
    decision = planner.decide(now, estimate, flown, Wind(), latency_s=0.5)
    circle = (decision.plan or flown).circle
    print(f"target at {estimate.north_m:.0f} m north; {decision.reason}; circle at {circle.north_m:.0f} m north")
    if len(sys.argv) > 1:
        axes = plt.gca()
        axes.plot(estimate.east_m, estimate.north_m, "o", label="target")
        for plan in filter(None, (flown, decision.plan)):
            axes.add_patch(plt.Circle((plan.circle.east_m, plan.circle.north_m), plan.circle.radius_m, fill=False))
        if decision.plan and decision.plan.transition:
            axes.plot(decision.plan.transition.east_m, decision.plan.transition.north_m, label="transition")
        axes.axis("equal")
        axes.legend()
        plt.savefig(sys.argv[1])


if __name__ == "__main__":
    main()

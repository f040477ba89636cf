"""What is known at a decision, as the loops see it. Source: docs/explanation/planners.md#the-predictive-planner."""

from __future__ import annotations

from sidelong.estimators.estimate import TargetEstimate
from sidelong.mission.core.plan import AircraftState, Plan
from sidelong.mission.core.requirement import Wind
from sidelong.mission.geometry.progress import line_of
from sidelong.mission.predictive.scene_kernel import Situation
from sidelong.mission.viewpoint.course_hold import known


def situation(
    aircraft: AircraftState, target: TargetEstimate, present: Plan, wind: Wind, latency_s: float
) -> Situation:
    """Return what an aircraft on its present plan knows, with what :class:`mission.core.plan.Planner` is given.

    Args:
        aircraft: State of the aircraft.
        target: Estimate of the target.
        present: The plan that is flown.
        wind: Estimate of the wind.
        latency_s: Time until a new plan can depart, s.
    """
    return Situation(
        aircraft.time_s,
        aircraft.east_m,
        aircraft.north_m,
        aircraft.course_rad,
        aircraft.ground_speed_m_s,
        aircraft.curvature_per_m,
        known(target),
        *line_of(present),
        wind.east_m_s,
        wind.north_m_s,
        latency_s,
        aircraft.time_s - present.departure_s,
    )

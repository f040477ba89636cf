r"""The circle that leads an aircraft along its plan from where it is; commanding it every second flies the plan.

::

      plan  ____---- * a point of the plan ahead
       __---     . '
      '       . '        The circle touches the aircraft's course and passes through that point, so the autopilot is
    ->|   . '            on it already and only banks. If no command follows, it is flown indefinitely.
   aircraft

A nearly straight piece has no circle of a useful size: there the aircraft is sent to a circle of the plan's radius
around a point ahead, far enough to fly straight to it.

Source: Coulter, "Implementation of the pure pursuit path tracking algorithm", CMU-RI-TR-92-01, 1992.
"""

from __future__ import annotations

import math

from sidelong.mission.core.circle import Circle
from sidelong.mission.core.plan import AircraftState, Plan
from sidelong.mission.core.requirement import GRAVITY_M_S2
from sidelong.mission.geometry.progress import dead_reckoned, nearest_arc_m, point_at

_LOOK_AHEAD_S = 3.5
_RESPONSE_S = 0.6  # from a command to the bank it asks for
_STRAIGHT_RADII = 4.0  # a circle larger than this many of the plan's radii is flown as a straight line
_AHEAD_RADII = 4.0


def leading_circle(plan: Plan, aircraft: AircraftState, bank_max_rad: float) -> Circle | None:
    """Return the circle to command now.

    Returns:
        The circle; None if the plan's own circle is to be flown from now on.
    """
    radius_m, speed_m_s = plan.circle.radius_m, aircraft.ground_speed_m_s
    min_m = min(speed_m_s**2 / (GRAVITY_M_S2 * math.tan(bank_max_rad)), radius_m)
    state = dead_reckoned(aircraft, _RESPONSE_S, 1.0 / min_m)
    arc_m = nearest_arc_m(plan, state)
    if arc_m >= plan.transition_m:
        return None
    goal = point_at(plan, arc_m + speed_m_s * _LOOK_AHEAD_S, state)
    east_m, north_m = goal.east_m - state.east_m, goal.north_m - state.north_m
    course_rad = state.course_rad
    right_m = east_m * math.cos(course_rad) - north_m * math.sin(course_rad)
    ahead_m = east_m * math.sin(course_rad) + north_m * math.cos(course_rad)
    squared_m2 = right_m**2 + ahead_m**2
    curvature_per_m = 2.0 * right_m / squared_m2 if squared_m2 > 1.0 else 0.0
    if ahead_m < 0.0:  # it lies behind: turn round as tightly as may be
        curvature_per_m = math.copysign(1.0 / min_m, right_m)
    if abs(curvature_per_m) * radius_m * _STRAIGHT_RADII < 1.0:
        far = _AHEAD_RADII * radius_m / math.sqrt(squared_m2)
        return Circle(state.east_m + far * east_m, state.north_m + far * north_m, radius_m, plan.circle.clockwise)
    flown_m = max(1.0 / abs(curvature_per_m), min_m)
    return Circle.tangent_to(state.east_m, state.north_m, course_rad, flown_m, curvature_per_m > 0.0)

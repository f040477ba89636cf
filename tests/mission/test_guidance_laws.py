import math

import numpy as np
import pytest

from sidelong.estimators.estimate import TargetEstimate, TrackQuality
from sidelong.mission.core.plan import AircraftState
from sidelong.mission.laws.course_field import LateralGuidance, StandoffOrbit, VectorField

SPEED_M_S, STEP_S, STAND_OFF_M = 10.0, 0.1, 200.0


def fly(law, clockwise_start_rad, target_velocity, duration_s=400.0):
    """Return ranges (n,) and relative turns (n,) round the target, flown without limits on bank."""
    east, north, course = 350.0, 0.0, clockwise_start_rad
    ranges, bearings = [], []
    for k in range(int(duration_s / STEP_S)):
        target_east, target_north = (v * k * STEP_S for v in target_velocity)
        target = TargetEstimate(0.0, target_east, target_north, *target_velocity, np.eye(4), TrackQuality.GOOD, 0.0)
        curvature = law.curvature_per_m(AircraftState(0.0, east, north, course, SPEED_M_S, 0.0), target)
        course += curvature * SPEED_M_S * STEP_S
        east += SPEED_M_S * STEP_S * math.sin(course)
        north += SPEED_M_S * STEP_S * math.cos(course)
        ranges.append(math.hypot(east - target_east, north - target_north))
        bearings.append(math.atan2(east - target_east, north - target_north))
    return np.array(ranges), np.unwrap(bearings)


@pytest.mark.parametrize("clockwise", [True, False])
@pytest.mark.parametrize("target_velocity", [(0.0, 0.0), (3.0, 0.0), (-2.0, 4.0)])
@pytest.mark.parametrize(
    "make",
    [
        lambda clockwise: VectorField(STAND_OFF_M, clockwise, 0.5),
        lambda clockwise: LateralGuidance(STAND_OFF_M, clockwise, 80.0),
        lambda clockwise: StandoffOrbit(STAND_OFF_M, clockwise, 0.5, 0.02),
    ],
    ids=["vector field", "lateral guidance", "stand-off orbit"],
)
def test_settles_on_a_circle_round_the_target(make, target_velocity, clockwise):
    ranges, bearings = fly(make(clockwise), math.pi / 2, target_velocity)
    settled = ranges[ranges.size // 2 :]
    assert abs(settled - STAND_OFF_M).max() < 10.0
    turned = bearings[-1] - bearings[bearings.size // 2]
    assert turned > 1.0 if clockwise else turned < -1.0

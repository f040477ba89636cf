"""Which tracks of one target agree."""

from __future__ import annotations

import numpy as np

from sidelong.estimators.estimate import TargetEstimate, TrackQuality
from sidelong.estimators.tracking.joint_track import agreeing


def track(east_m: float, sigma_m: float = 2.0) -> TargetEstimate:
    covariance = np.diag([sigma_m**2, sigma_m**2, 0.25, 0.25])
    return TargetEstimate(10.0, east_m, 0.0, 1.0, 0.0, covariance, TrackQuality.GOOD, 10.0)


def test_the_largest_group_that_agrees_is_found_the_surest_first():
    assert agreeing({"a": track(0.0), "b": track(150.0, 0.5), "c": track(1.0, 1.0)}) == ["c", "a"]


def test_of_two_that_contradict_each_other_the_more_trusted_one_is():
    two = {"a": track(0.0, 3.0), "b": track(80.0, 1.0)}
    assert agreeing(two) == ["b"]
    assert agreeing(two, trust={"a": 1, "b": 0}.get) == ["a"]

"""Several tracks of one target."""

from __future__ import annotations

import numpy as np
import pytest

from estimators.estimate import TargetEstimate, TrackQuality
from estimators.fusion import fused


def track(east_m: float, north_m: float, sigma_m: float = 2.0, quality: TrackQuality = TrackQuality.GOOD):
    covariance = np.diag([sigma_m**2, sigma_m**2, 0.25, 0.25])
    return TargetEstimate(10.0, east_m, north_m, 1.0, 0.0, covariance, quality, 10.0)


def test_tracks_that_see_different_things_well_are_joined_to_what_both_see():
    a, b = track(0.0, 0.0), track(2.0, 3.0)
    a.covariance[0, 0], b.covariance[1, 1] = 0.04, 0.04
    joint = fused({"a": a, "b": b}).estimate
    assert joint.east_m == pytest.approx(0.0, abs=0.3)
    assert joint.north_m == pytest.approx(3.0, abs=0.3)
    assert joint.ellipse_95.semi_major_m < min(a.ellipse_95.semi_major_m, b.ellipse_95.semi_major_m)


def test_the_joint_estimate_is_never_surer_than_the_surest_direction_allows():
    rng = np.random.default_rng(1)
    inside = []
    for _ in range(400):  # both err alike: nothing is gained by a second look
        error = rng.normal(size=2) * 2.0
        joint = fused({"a": track(*error), "b": track(*error)}).estimate
        inside.append(joint.east_m**2 + joint.north_m**2 <= 5.99 * 4.0)
    assert 0.92 <= np.mean(inside) <= 0.98


def test_one_bad_payload_does_not_spoil_two_good_ones_and_is_named():
    fusion = fused({"a": track(0.0, 0.0), "b": track(150.0, 0.0, 1.0), "c": track(1.0, 0.0)})
    assert abs(fusion.estimate.east_m) < 2.0
    assert fusion.refused.keys() == {"b"}
    assert "149 m" in fusion.refused["b"] or "150 m" in fusion.refused["b"]


def test_of_two_that_disagree_the_surer_one_is_believed():
    fusion = fused({"a": track(0.0, 0.0, 1.0), "b": track(80.0, 0.0, 3.0)})
    assert fusion.estimate.east_m == 0.0
    assert fusion.refused.keys() == {"b"}


def test_a_lost_track_is_left_out_while_another_lives():
    fusion = fused({"a": track(0.0, 0.0, 1.0, TrackQuality.LOST), "b": track(80.0, 0.0, 3.0)})
    assert fusion.estimate.east_m == 80.0
    assert fused({}).estimate is None

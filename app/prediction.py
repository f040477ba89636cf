"""Where the target is now: estimates are made once a second, displays and pointing want it at any time."""

from __future__ import annotations

from estimators.estimate import TargetEstimate


def predicted_m(estimate: TargetEstimate, time_s: float) -> tuple[float, float]:
    """Return (east, north) of the target carried on at its velocity; never back in time."""
    ahead_s = max(time_s - estimate.time_s, 0.0)
    return (
        estimate.east_m + ahead_s * estimate.velocity_east_m_s,
        estimate.north_m + ahead_s * estimate.velocity_north_m_s,
    )

"""Which tracks of one target agree, each of another payload.

Tracks of the same target share its motion noise, how much is not known. They are compared as if they were
independent, which calls a few too many agreeing, and none wrong that is right.

Source: docs/explanation/filter.md#several-payloads; Singer and Kanyuck, "Computer control of multiple site track
correlation", Automatica 7(4), 1971.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TypeVar

import numpy as np

from sidelong.estimators.estimate import TargetEstimate

_GATE = 23.5  # chi-square with four degrees of freedom, one in ten thousand
# Payload errors that remain after a correction shift a track by this much (m, m/s): it turns with the aircraft.
_SHIFTS = np.diag((3.0, 3.0, 0.6, 0.6)) ** 2

Name = TypeVar("Name", int, str)


def agreeing(tracks: Mapping[Name, TargetEstimate], trust: Callable[[Name], int] = lambda _name: 0) -> list[Name]:
    """Return the largest group of tracks that agree with one of them.

    Args:
        tracks: Tracks by name.
        trust: How far a track is trusted: of equal groups the one with the most trusted track is chosen, then that
            around the track with the least covariance.

    Returns:
        Names of the group, by increasing covariance; without tracks none.
    """
    if not tracks:
        return []
    groups = {
        name: [other for other in tracks if other == name or _squared(track, tracks[other], _SHIFTS) <= _GATE]
        for name, track in tracks.items()
    }

    def rank(name: Name) -> tuple[int, int, float, Name]:
        group = groups[name]
        return -len(group), -max(map(trust, group)), spread_m2(tracks[name]), name

    return sorted(groups[min(groups, key=rank)], key=lambda name: spread_m2(tracks[name]))


def apart_m(a: TargetEstimate, b: TargetEstimate) -> float:
    """Return the horizontal distance of two tracks, m."""
    return float(np.hypot(a.east_m - b.east_m, a.north_m - b.north_m))


def squared_distance(a: TargetEstimate, b: TargetEstimate) -> float:
    """Return the squared Mahalanobis distance of two tracks, treated as independent."""
    return _squared(a, b, 1e-9 * np.eye(4))


def _squared(a: TargetEstimate, b: TargetEstimate, more: np.ndarray) -> float:
    off = state_of(a) - state_of(b)
    return float(off @ np.linalg.solve(a.covariance + b.covariance + more, off))


def spread_m2(track: TargetEstimate) -> float:
    """Return the sum of the position's variances of a track, m^2."""
    return float(track.covariance[0, 0] + track.covariance[1, 1])


def state_of(track: TargetEstimate) -> np.ndarray:
    """Return position (east, north), m, and velocity (east, north), m/s, of a track."""
    return np.array([track.east_m, track.north_m, track.velocity_east_m_s, track.velocity_north_m_s])

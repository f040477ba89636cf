"""Which tracks of one target agree, each of another payload.

Tracks of the same target share its motion noise, how much is not known. They are compared as if they were
independent, which calls a few too many agreeing, and none wrong that is right.

Source: docs/explanation/filter.md#several-payloads; Singer and Kanyuck, "Computer control of multiple site track
correlation", Automatica 7(4), 1971.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import TypeVar

import numpy as np

from sidelong.estimators.estimate import TargetEstimate

_GATE = 23.5  # chi-square with four degrees of freedom, one in ten thousand

Name = TypeVar("Name", int, str)


def agreeing(tracks: Mapping[Name, TargetEstimate], accepted: Collection[Name] = ()) -> list[Name]:
    """Return the largest group of tracks that agree with one of them.

    Args:
        tracks: Tracks by name.
        accepted: Names that were accepted before: of equal groups the one with more of them is chosen, then that
            around the track with the least covariance.

    Returns:
        Names of the group, by increasing covariance.
    """
    groups = {
        name: [other for other in tracks if other == name or squared_distance(track, tracks[other]) <= _GATE]
        for name, track in tracks.items()
    }

    def rank(name: Name) -> tuple[int, int, float, Name]:
        group = groups[name]
        return -len(group), -sum(one in accepted for one in group), _spread_m2(tracks[name]), name

    return sorted(groups[min(groups, key=rank)], key=lambda name: _spread_m2(tracks[name]))


def apart_m(a: TargetEstimate, b: TargetEstimate) -> float:
    """Return the horizontal distance of two tracks, m.

    Args:
        a: One track.
        b: Another track, at the same time.
    """
    return float(np.hypot(a.east_m - b.east_m, a.north_m - b.north_m))


def squared_distance(a: TargetEstimate, b: TargetEstimate) -> float:
    """Return the squared Mahalanobis distance of two tracks, treated as independent.

    Args:
        a: One track.
        b: Another track, at the same time.
    """
    off = _state(a) - _state(b)
    return float(off @ np.linalg.solve(a.covariance + b.covariance + 1e-9 * np.eye(4), off))


def _spread_m2(track: TargetEstimate) -> float:
    return float(track.covariance[0, 0] + track.covariance[1, 1])


def _state(track: TargetEstimate) -> np.ndarray:
    return np.array([track.east_m, track.north_m, track.velocity_east_m_s, track.velocity_north_m_s])

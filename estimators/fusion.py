"""One estimate of a target from several tracks, each of another payload.

Each payload has a track of its own, and with it its own constant errors. Tracks of the same target share its motion
noise, how much is not known, so they are joined by covariance intersection (Julier and Uhlmann, 1997), which is never
overconfident whatever they share::

    P^-1 = w A^-1 + (1 - w) B^-1,   x = P (w A^-1 a + (1 - w) B^-1 b),   w: the least determinant of P's position

A payload that contradicts the others must not spoil them: tracks that are further apart than chance allows are not
joined; the best of the largest group that agrees is believed, and who is left out is told.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from estimators.estimate import TargetEstimate, TrackQuality

_GATE = 23.5  # chi-square with four degrees of freedom, one in ten thousand
_WEIGHTS = np.linspace(0.0, 1.0, 11)


@dataclass(frozen=True, slots=True, eq=False)
class Fusion:
    """estimate: None where no track can be believed. refused: payloads left out, each with the reason in words."""

    estimate: TargetEstimate | None
    refused: Mapping[str, str]


def fused(tracks: Mapping[str, TargetEstimate]) -> Fusion:
    """Return the joint estimate at the tracks' own time, which has to be the same for all."""
    alive = {name: track for name, track in tracks.items() if track.quality is not TrackQuality.LOST}
    refused = {name: "its track is lost" for name in tracks if name not in alive}
    if not alive:
        best = min(tracks.values(), key=_spread_m2, default=None)
        return Fusion(best, refused)
    group = _agreeing(alive)
    for name, track in alive.items():
        if name not in group:
            apart_m = min(_apart_m(track, alive[other]) for other in group)
            refused[name] = f"it sees the target {apart_m:.0f} m from where the others do"
    good = [name for name in group if alive[name].quality is TrackQuality.GOOD] or group
    joint = alive[good[0]]
    for name in good[1:]:
        joint = _joined(joint, alive[name])
    return Fusion(joint, refused)


def _agreeing(tracks: Mapping[str, TargetEstimate]) -> list[str]:
    """Return the largest group around one track that agrees with it; of equal ones that around the surest track."""
    groups = {
        name: [other for other in tracks if other == name or _distance(track, tracks[other]) <= _GATE]
        for name, track in tracks.items()
    }
    centre = min(groups, key=lambda name: (-len(groups[name]), _spread_m2(tracks[name]), name))
    return sorted(groups[centre], key=lambda name: _spread_m2(tracks[name]))


def _spread_m2(track: TargetEstimate) -> float:
    return float(track.covariance[0, 0] + track.covariance[1, 1])


def _apart_m(a: TargetEstimate, b: TargetEstimate) -> float:
    return float(np.hypot(a.east_m - b.east_m, a.north_m - b.north_m))


def _state(track: TargetEstimate) -> np.ndarray:
    return np.array([track.east_m, track.north_m, track.velocity_east_m_s, track.velocity_north_m_s])


def _distance(a: TargetEstimate, b: TargetEstimate) -> float:
    """Return the squared Mahalanobis distance of two tracks, as if they were independent."""
    off = _state(a) - _state(b)
    return float(off @ np.linalg.solve(a.covariance + b.covariance + 1e-9 * np.eye(4), off))


def _joined(a: TargetEstimate, b: TargetEstimate) -> TargetEstimate:
    floor = 1e-9 * np.eye(4)
    information_a, information_b = np.linalg.inv(a.covariance + floor), np.linalg.inv(b.covariance + floor)
    joint = np.linalg.inv(_WEIGHTS[:, None, None] * information_a + (1.0 - _WEIGHTS)[:, None, None] * information_b)
    best = int(np.argmin(np.linalg.det(joint[:, :2, :2])))
    weight, covariance = _WEIGHTS[best], joint[best]
    state = covariance @ (weight * information_a @ _state(a) + (1.0 - weight) * information_b @ _state(b))
    east_m, north_m, velocity_east, velocity_north = state.tolist()
    return replace(
        a,
        east_m=east_m,
        north_m=north_m,
        velocity_east_m_s=velocity_east,
        velocity_north_m_s=velocity_north,
        covariance=(covariance + covariance.T) / 2.0,
        last_sighting_s=max(a.last_sighting_s, b.last_sighting_s),
    )

"""One track of a target from the detections of several payloads, with exclusion of faulty payloads.

All payloads feed one filter that estimates the errors of each. In addition each payload has its own track. A payload
whose track disagrees with the largest consistent group is excluded, with the reason in words. It is included again
after some seconds of agreement. Of two payloads that contradict each other, the one that its aircraft trusts more is
used: least one with a fault, most one whose errors are known. If both are trusted alike, none is used: the estimate
covers both.

Source: docs/explanation/filter.md#several-payloads.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from typing import TypeVar

import numpy as np

from sidelong.estimators.estimate import TargetEstimate, TrackQuality
from sidelong.estimators.filters.biases import Biases, Calibration
from sidelong.estimators.filters.imm import TargetImm, prior_of
from sidelong.estimators.filters.imm_kernel import ERRORS, ERRORS_AND_CLOCK
from sidelong.estimators.sensing.sighting import AnySighting, SightingOutcome
from sidelong.estimators.settings import TrackerSettings
from sidelong.estimators.tracking.track import Track

_GATE = 23.5  # chi-square with four degrees of freedom, one in ten thousand
# Payload errors that remain after a correction shift a track by this much (m, m/s): it turns with the aircraft.
_SHIFTS = np.diag((3.0, 3.0, 0.6, 0.6)) ** 2

Name = TypeVar("Name", int, str)


def agreeing(tracks: Mapping[Name, TargetEstimate], trust: Callable[[Name], int] = lambda _name: 0) -> list[Name]:
    """Return the largest group of tracks that agree with one of them, by increasing covariance.

    Tracks of one target share its motion noise to an unknown extent. Treated as independent, slightly too many agree.
    Of equal groups the one with the most trusted track is chosen, then that around the track with the least
    covariance.

    Source: Singer and Kanyuck, "Computer control of multiple site track correlation", Automatica 7(4), 1971.
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


def _squared(a: TargetEstimate, b: TargetEstimate, more: np.ndarray) -> float:
    """Return the squared Mahalanobis distance of two tracks, treated as independent; more: covariance added."""
    off = state_of(a) - state_of(b)
    return float(off @ np.linalg.solve(a.covariance + b.covariance + more, off))


def spread_m2(track: TargetEstimate) -> float:
    """Return the sum of the position's variances of a track, m^2."""
    return float(track.covariance[0, 0] + track.covariance[1, 1])


def state_of(track: TargetEstimate) -> np.ndarray:
    """Return position (east, north), m, and velocity (east, north), m/s, of a track."""
    return np.array([track.east_m, track.north_m, track.velocity_east_m_s, track.velocity_north_m_s])


_COMPARED_EVERY_S = 1.0
# A payload is excluded, or included again, only after this time of contradiction or agreement.
_REFUSED_AFTER_S, _ACCEPTED_AFTER_S = 3.0, 10.0
# Squared distance from the best accepted payload at which the filter restarts: it followed a faulty payload.
_REJECTED = 50.0
_CIRCLE_95 = 5.99  # chi-square with two degrees of freedom


class JointTrack:
    """Joint track of one target. All detections share one time base; the first settings apply to the track."""

    def __init__(self, settings: Mapping[str, TrackerSettings]) -> None:
        if not settings:
            raise ValueError("a joint track needs a payload")
        self._names = tuple(settings)
        self._settings = [replace(own, filter="imm") for own in settings.values()]
        self._own = [Track(own) for own in self._settings]
        self._clock_sigmas_s = [0.0] * len(self._names)
        self._track = self._new()
        self._faults = [""] * len(self._names)  # as the aircraft report them
        self._confirmed: set[int] = set()
        self._jumped: set[int] = set()  # payloads whose target has jumped lately
        self._together_s: dict[int, float] = {}  # since when a payload agrees with another one
        self._parted: set[int] = set()  # payloads that agreed for long, and do not now
        self._doubted: set[int] = set()  # parted by a jump, and neither corrected nor confirmed since
        self._since_s: dict[int, float] = {}  # when a payload in use began to contradict, or one left out to agree
        self._refused: dict[int, str] = {}
        self._alive: tuple[int, ...] = ()  # at the last comparison with any
        self.is_led = True  # else the estimate covers the places where the payloads see the target
        self._fed: set[int] = set()
        self._latest: dict[int, AnySighting] = {}
        self._compared_s = -float("inf")
        self._apart_m2 = 0.0  # by which the payloads in use differ, unexplained by their own covariances

    def _new(self) -> Track:
        def start(settings: TrackerSettings, sighting: AnySighting, biases: Biases, _ground: None) -> TargetImm:
            known = biases.mean.size == ERRORS_AND_CLOCK * len(self._names)
            return TargetImm(settings, sighting, biases if known else prior_of(self._settings, self._clock_sigmas_s))

        return Track(self._settings[0], start)

    def add(self, name: str, sighting: AnySighting, clock_sigma_s: float = 0.0) -> SightingOutcome:
        """Update the track with a sighting of an aircraft's payload; its first sighting sets the clock sigma, s."""
        payload = self._names.index(name)
        self._own[payload].add(sighting)
        self._latest[payload] = sighting if sighting.payload == payload else replace(sighting, payload=payload)
        if payload in self._refused:
            return SightingOutcome(sighting, False, float("nan"), self._refused[payload])
        if payload not in self._fed:
            self._fed.add(payload)
            self._clock_sigmas_s[payload] = clock_sigma_s
            last, _ = self._track.last
            if last is not None:
                last.widen_clock(payload, clock_sigma_s)
        return self._track.add(self._latest[payload])

    def judge(
        self,
        name: str,
        fault: str = "",
        *,
        jumped: bool = False,
        confirmed: bool = False,
        corrected: tuple[float, float] | None = None,
    ) -> None:
        """Process an aircraft's report on its own payload.

        Args:
            fault: Why its sightings are not to be trusted, in words; empty while they are.
            jumped: Whether the position at which it sees the target has jumped lately.
            confirmed: Whether the payload's errors are known.
            corrected: Standard deviations of the errors of yaw, rad, and range, m, from now on, if the sightings
                until now show another place.
        """
        payload = self._names.index(name)
        self._faults[payload] = fault
        for holds, payloads in ((jumped, self._jumped), (confirmed, self._confirmed)):
            (payloads.add if holds else payloads.discard)(payload)
        if confirmed or corrected is not None:
            self._doubted.discard(payload)
        if corrected is not None:
            self._parted.discard(payload)
            yaw_rad, range_m = corrected
            own = replace(self._settings[payload], yaw_bias_sigma_rad=yaw_rad, range_bias_sigma_m=range_m)
            self._settings[payload], self._own[payload] = own, Track(own)
            if payload in self._fed:
                self._begin([other for other in self._alive if other != payload and other not in self._refused])

    def estimate(self, time_s: float) -> TargetEstimate | None:
        """Return the estimate at a time; None before the first sighting."""
        if time_s - self._compared_s >= _COMPARED_EVERY_S:
            self._compared_s = time_s
            self._compare(time_s)
        if not self.is_led:
            return self._covering(time_s)
        joint = self._track.estimate(time_s)
        if joint is None or not self._apart_m2:
            return joint
        apart = np.diag((self._apart_m2, self._apart_m2, 0.0, 0.0))
        return replace(joint, covariance=joint.covariance + apart)

    @property
    def refused(self) -> Mapping[str, str]:
        """Payloads that are left out, each with the reason in words."""
        return {self._names[payload]: reason for payload, reason in self._refused.items()}

    def calibration(self, name: str) -> Calibration:
        """Return the estimated errors of a payload."""
        last, _ = self._track.last
        biases = last.biases() if last is not None else prior_of(self._settings, self._clock_sigmas_s)
        first = ERRORS_AND_CLOCK * self._names.index(name)
        own = slice(first, first + ERRORS)
        return Biases(biases.mean[own], biases.covariance[own, own]).calibration

    def _compare(self, time_s: float) -> None:
        alive = {
            payload: estimate
            for payload, track in enumerate(self._own)
            if (estimate := track.estimate(time_s)) is not None and estimate.quality is TrackQuality.GOOD
        }
        if not alive:
            return
        self._alive = tuple(alive)
        self._find_parted(alive, agreeing(alive), time_s)
        group = agreeing(alive, self._trust)
        outside = {payload: estimate for payload, estimate in alive.items() if payload not in group}
        rivals = agreeing(outside, self._trust)
        leads = self._weight(group) > self._weight(rivals)
        for payload in alive:
            agrees = leads and payload in group
            if agrees is (payload not in self._refused):
                self._since_s.pop(payload, None)
                continue
            lasted_s = time_s - self._since_s.setdefault(payload, time_s)
            if agrees and lasted_s >= _ACCEPTED_AFTER_S:
                del self._refused[payload]
                self._doubted.discard(payload)
            elif not agrees and (self._trust(payload) == 0 or lasted_s >= _REFUSED_AFTER_S):
                others = rivals if payload in group else group
                self._refused[payload] = self._contradiction(payload, others, alive, leads)
        used = [payload for payload in group if payload not in self._refused]
        was_led, self.is_led = self.is_led, bool(used) or (self.is_led and leads)
        joint = self._track.estimate(time_s)
        self._apart_m2 = self._unexplained_m2([alive[payload] for payload in used], joint)
        if not used:
            return
        off = 0.0 if joint is None else _squared(joint, alive[used[0]], 1e-9 * np.eye(4))
        if not was_led or (self._refused and off > _REJECTED):
            self._begin(used)

    def _unexplained_m2(self, used: Sequence[TargetEstimate], joint: TargetEstimate | None) -> float:
        """Return the greatest squared distance of a track from the joint one beyond its 95 % circle."""
        if joint is None or len(used) < 2:
            return 0.0
        return max(0.0, *(apart_m(own, joint) ** 2 - _CIRCLE_95 * spread_m2(own) / 2.0 for own in used))

    def _find_parted(self, alive: Iterable[int], group: Sequence[int], time_s: float) -> None:
        """Find the payloads that jumped away from others with which they had agreed: these are the wrong ones."""
        for payload in alive:
            if payload in group and len(group) > 1:
                self._together_s.setdefault(payload, time_s)
                self._parted.discard(payload)
            elif time_s - self._together_s.pop(payload, time_s) >= _ACCEPTED_AFTER_S:
                self._parted.add(payload)
        self._doubted |= self._parted & self._jumped

    def _trust(self, payload: int) -> int:
        if self._faults[payload] or payload in self._doubted:
            return 0
        return 2 if payload in self._confirmed else 1

    def _weight(self, group: Sequence[int]) -> tuple[int, int]:
        return len(group), max(map(self._trust, group), default=0)

    def _contradiction(
        self, payload: int, others: Sequence[int], alive: Mapping[int, TargetEstimate], leads: bool
    ) -> str:
        off_m = min(apart_m(alive[payload], alive[other]) for other in others)
        if leads and len(others) > 1:
            return f"it sees the target {off_m:.0f} m from where the others do"
        text = f"it sees the target {off_m:.0f} m from where {self._names[others[0]]} does"
        if not leads:
            return f"{text}; either may be wrong: check both payloads. Each aircraft watches by its own until then"
        jumped = "its target's position has jumped" if payload in self._doubted else ""
        return f"{text}: {self._faults[payload] or jumped or 'the other payload was confirmed in this flight'}"

    def _begin(self, used: Sequence[int]) -> None:
        """Restart the filter, with what the first of these payloads sees; without any, with the next sighting."""
        self._track, self._fed = self._new(), set(used[:1])
        for payload in used[:1]:
            self._track.add(self._latest[payload])

    def _covering(self, time_s: float) -> TargetEstimate | None:
        estimates = (track.estimate(time_s) for track in self._own)
        seen = [own for own in estimates if own is not None and own.quality is not TrackQuality.LOST]
        if not seen:
            return None
        states = np.array([state_of(estimate) for estimate in seen])
        spread = states.var(axis=0)
        spread[:2] = spread[:2].sum()  # a payload that errs may do so in every direction
        last = max(seen, key=lambda estimate: estimate.last_sighting_s)
        covariance = np.mean([estimate.covariance for estimate in seen], axis=0) + np.diag(spread)
        east_m, north_m, velocity_e, velocity_n = states.mean(axis=0).tolist()
        place = last.time_s, east_m, north_m, velocity_e, velocity_n
        return TargetEstimate(*place, covariance, last.quality, last.last_sighting_s, last.reason)

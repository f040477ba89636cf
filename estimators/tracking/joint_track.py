"""One track of a target from the detections of several payloads, with exclusion of faulty payloads.

All payloads feed one filter that estimates the errors of each. In addition each payload has its own track. A payload
whose track disagrees with the largest consistent group is excluded, with the reason in words. It is included again
after some seconds of agreement. If two payloads contradict each other, the one with the smaller sigma is used.

Source: docs/explanation/filter.md#several-payloads.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from sidelong.estimators.estimate import TargetEstimate, TrackQuality
from sidelong.estimators.filters.biases import Biases, Calibration
from sidelong.estimators.filters.imm import TargetImm, prior_of
from sidelong.estimators.filters.imm_kernel import ERRORS, ERRORS_AND_CLOCK
from sidelong.estimators.sensing.sighting import AnySighting, SightingOutcome
from sidelong.estimators.settings import TrackerSettings
from sidelong.estimators.tracking.fusion import agreeing, apart_m, squared_distance
from sidelong.estimators.tracking.track import Track

_COMPARED_EVERY_S = 1.0
# A payload is excluded, or included again, only after this time of contradiction or agreement.
_REFUSED_AFTER_S, _ACCEPTED_AFTER_S = 3.0, 10.0
# One that several others contradicted is not used in a short silence of all of them.
_ALONE_AFTER_S = 10.0
# Squared distance from the best accepted payload at which the filter restarts: it followed a faulty payload.
_REJECTED = 50.0


class JointTrack:
    """Joint track of one target. All detections share one time base.

    ``settings`` describe each payload; those of the first apply to the track: gates, losses, kind of target. Raises
    ValueError if there are none.
    """

    def __init__(self, settings: Mapping[str, TrackerSettings]) -> None:
        if not settings:
            raise ValueError("a joint track needs a payload")
        self._names = tuple(settings)
        self._settings = tuple(replace(one, filter="imm") for one in settings.values())
        self._own = [Track(one) for one in self._settings]
        self._clock_sigmas_s = [0.0] * len(self._names)
        self._track = self._new()
        self._wrong_s: dict[int, float] = {}  # since when a payload contradicts the others
        self._right_s: dict[int, float] = {}  # since when one that was left out agrees again
        self._refused: dict[int, str] = {}
        self._outvoted: set[int] = set()  # left out by several others
        self._trusted_s = -float("inf")  # when a payload in use was seen last
        self._fed: set[int] = set()
        self._latest: dict[int, AnySighting] = {}
        self._compared_s = -float("inf")

    def _new(self) -> Track:
        def start(settings: TrackerSettings, sighting: AnySighting, biases: Biases, _ground: None) -> TargetImm:
            known = biases.mean.size == ERRORS_AND_CLOCK * len(self._names)
            return TargetImm(settings, sighting, biases if known else prior_of(self._settings, self._clock_sigmas_s))

        return Track(self._settings[0], start)

    def add(self, name: str, sighting: AnySighting, clock_sigma_s: float = 0.0) -> SightingOutcome:
        """Update the track with a payload's sighting.

        Args:
            name: Name of the payload's aircraft.
            sighting: The sighting.
            clock_sigma_s: Standard deviation of its time, s; that of the payload's first sighting counts.
        """
        payload = self._names.index(name)
        self._own[payload].add(sighting)
        if payload in self._refused:
            return SightingOutcome(sighting, False, float("nan"), self._refused[payload])
        if payload not in self._fed:
            self._fed.add(payload)
            self._clock_sigmas_s[payload] = clock_sigma_s
            last, _ = self._track.last
            if last is not None:
                last.widen_clock(payload, clock_sigma_s)
        self._latest[payload] = replace(sighting, payload=payload)
        return self._track.add(self._latest[payload])

    def estimate(self, time_s: float) -> TargetEstimate | None:
        """Return the estimate at a time; None before the first sighting.

        Args:
            time_s: Time to predict to, s.
        """
        if time_s - self._compared_s >= _COMPARED_EVERY_S:
            self._compared_s = time_s
            self._compare(time_s)
        return self._track.estimate(time_s)

    @property
    def refused(self) -> Mapping[str, str]:
        """Payloads that are left out, each with the reason in words."""
        return {self._names[payload]: reason for payload, reason in self._refused.items()}

    def calibration(self, name: str) -> Calibration:
        """Return the estimated errors of a payload.

        Args:
            name: Name of the payload's aircraft.
        """
        last, _ = self._track.last
        biases = last.biases() if last is not None else prior_of(self._settings, self._clock_sigmas_s)
        first = ERRORS_AND_CLOCK * self._names.index(name)
        own = slice(first, first + ERRORS)
        return Biases(biases.mean[own], biases.covariance[own, own]).calibration

    # -- which payloads are used ------------------------------------------------------------------------------

    def _compare(self, time_s: float) -> None:
        """Hold the payloads' own tracks against one another."""
        alive = {
            payload: estimate
            for payload, track in enumerate(self._own)
            if (estimate := track.estimate(time_s)) is not None and estimate.quality is TrackQuality.GOOD
        }
        if any(payload not in self._refused for payload in alive):
            self._trusted_s = time_s
        if len(alive) < 2:
            if time_s - self._trusted_s >= _ALONE_AFTER_S:
                self._outvoted.clear()
            self._refused = {
                payload: self._refused[payload] for payload in self._refused if payload in self._outvoted
            }
            self._wrong_s.clear()
            return
        group = agreeing(alive, [payload for payload in alive if payload not in self._refused])
        for payload in alive:
            if payload in group:
                self._wrong_s.pop(payload, None)
                since_s = self._right_s.setdefault(payload, time_s)
                if payload in self._refused and time_s - since_s >= _ACCEPTED_AFTER_S:
                    del self._refused[payload]
                    self._outvoted.discard(payload)
                continue
            self._right_s.pop(payload, None)
            since_s = self._wrong_s.setdefault(payload, time_s)
            if payload not in self._refused and time_s - since_s >= _REFUSED_AFTER_S:
                self._refused[payload] = self._contradiction(payload, group, alive)
                if len(group) > 1:
                    self._outvoted.add(payload)
        self._follow(group, alive, time_s)

    def _contradiction(self, payload: int, group: Sequence[int], alive: Mapping[int, TargetEstimate]) -> str:
        off_m = min(apart_m(alive[payload], alive[other]) for other in group)
        if len(group) > 1:
            return f"it sees the target {off_m:.0f} m from where the others do"
        surer = self._names[group[0]]
        return f"it sees the target {off_m:.0f} m from where {surer} does; either may be wrong: check both payloads"

    def _follow(self, group: Sequence[int], alive: Mapping[int, TargetEstimate], time_s: float) -> None:
        """Restart the filter if it has followed a payload that is excluded now."""
        joint = self._track.estimate(time_s)
        trusted = [payload for payload in group if payload not in self._refused]
        if joint is None or not trusted or not self._refused:
            return
        surest = alive[trusted[0]]
        if squared_distance(joint, surest) > _REJECTED:
            self._track, self._fed = self._new(), {trusted[0]}
            self._track.add(self._latest[trusted[0]])

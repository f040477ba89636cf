"""From sightings to an estimate: gate, restart, late sightings, quality.

Each accepted sighting leaves a copy of the filter as it was before; a late one is taken in by going back to the copy
before its time and repeating what came after.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from estimators.biases import Biases, Calibration
from estimators.ekf import TargetEkf
from estimators.estimate import TargetEstimate, TrackQuality
from estimators.imm import TargetImm
from estimators.settings import TrackerSettings
from estimators.sighting import AnySighting, SightingOutcome
from estimators.target_filter import TargetFilter
from estimators.ukf import TargetUkf

_HISTORY_S = 3.0
_STEP_MAX_S = 1.0  # longer predictions go by steps, so that the motion models can mix on the way

FilterStart = Callable[[TrackerSettings, AnySighting, Biases], TargetFilter]
_FILTERS: dict[str, FilterStart] = {"ekf": TargetEkf, "imm": TargetImm, "ukf": TargetUkf}


@dataclass(frozen=True, slots=True, eq=False)
class _Step:
    sighting: AnySighting
    before: TargetFilter


class Track:
    """The target's track, from its first accepted sighting on."""

    def __init__(self, settings: TrackerSettings) -> None:
        self._settings = settings
        self._start = _FILTERS[settings.filter]
        self._filter: TargetFilter | None = None
        self._steps: list[_Step] = []
        self._rejected_in_a_row: list[AnySighting] = []
        self._last_reason = ""
        self._last_sighting_s = float("-inf")

    def add(self, sighting: AnySighting) -> SightingOutcome:
        """Take a sighting in, or reject it with a reason."""
        settings = self._settings
        if sighting.quality is not None and sighting.quality < settings.quality_min:
            return self._reject(
                sighting, math.nan, f"signal quality {sighting.quality:.2f} is below {settings.quality_min:.2f}"
            )
        if self._filter is None:
            self._restart_at(sighting, Biases.prior(settings))
            return SightingOutcome(sighting, True, math.nan, "first sighting")
        if sighting.time_s < self._filter.time_s:
            return self._add_late(sighting)
        before = self._filter
        ahead = before.copy()
        _predict(ahead, sighting.time_s)
        nis = ahead.update(sighting, settings.gate_nis)
        if nis > settings.gate_nis:
            self._rejected_in_a_row.append(sighting)
            if self._rejections_agree():
                self._restart_at(sighting, ahead.biases())
                return SightingOutcome(
                    sighting, True, nis, "restarted: the rejected sightings agree on another place"
                )
            return self._reject(
                sighting, nis, f"innovation squared {nis:.0f} is beyond the gate {settings.gate_nis:.0f}"
            )
        self._filter = ahead
        self._accepted(_Step(sighting, before))
        return SightingOutcome(sighting, True, nis)

    def _add_late(self, sighting: AnySighting) -> SightingOutcome:
        later: list[_Step] = []
        while self._steps and self._steps[-1].sighting.time_s > sighting.time_s:
            later.insert(0, self._steps.pop())
        if not later or later[0].before.time_s > sighting.time_s:
            self._steps += later
            return self._reject(sighting, math.nan, f"older than the {_HISTORY_S:.0f} s that are kept")
        newest = self._filter
        self._filter = later[0].before
        outcome = self.add(sighting)
        if not outcome.accepted:
            self._filter = newest
            self._steps += later
            return outcome
        for step in later:
            assert self._filter is not None
            before = self._filter
            ahead = before.copy()
            _predict(ahead, step.sighting.time_s)
            ahead.update(step.sighting, math.inf)
            self._filter = ahead
            self._accepted(_Step(step.sighting, before))
        return outcome

    def _accepted(self, step: _Step) -> None:
        self._steps.append(step)
        self._rejected_in_a_row.clear()
        self._last_reason = ""
        self._last_sighting_s = max(self._last_sighting_s, step.sighting.time_s)
        while self._steps[0].sighting.time_s < self._last_sighting_s - _HISTORY_S:
            del self._steps[0]

    def _reject(self, sighting: AnySighting, nis: float, reason: str) -> SightingOutcome:
        self._last_reason = reason
        return SightingOutcome(sighting, False, nis, reason)

    def _restart_at(self, sighting: AnySighting, biases: Biases) -> None:
        self._filter = self._start(self._settings, sighting, biases)
        self._steps.clear()
        self._rejected_in_a_row.clear()
        self._last_reason = ""
        self._last_sighting_s = sighting.time_s

    def _rejections_agree(self) -> bool:
        """Tell whether the last rejected sightings lie where one slow target would put them."""
        count = self._settings.reopen_after
        last = self._rejected_in_a_row[-count:]
        if len(last) < count:
            return False
        newest = last[-1]
        reach_m = 3 * math.sqrt(float(np.trace(newest.covariance)) * 2)
        return all(
            math.hypot(one.east_m - newest.east_m, one.north_m - newest.north_m)
            < reach_m + 2 * self._settings.target_speed_sigma_m_s * abs(newest.time_s - one.time_s)
            for one in last
        )

    def estimate(self, now_s: float) -> TargetEstimate | None:
        """Return the target predicted to ``now_s`` (never back in time); None before the first sighting."""
        if self._filter is None:
            return None
        ahead = self._filter
        if now_s > ahead.time_s:
            ahead = ahead.copy()
            _predict(ahead, now_s)
        mean, covariance = ahead.moments()
        quality, reason = self._quality(ahead.time_s, covariance)
        return TargetEstimate(
            ahead.time_s,
            float(mean[0]),
            float(mean[1]),
            float(mean[2]),
            float(mean[3]),
            covariance,
            quality,
            self._last_sighting_s,
            reason,
        )

    def _quality(self, time_s: float, covariance: np.ndarray) -> tuple[TrackQuality, str]:
        settings = self._settings
        age_s = time_s - self._last_sighting_s
        sigma_m = math.sqrt(max(float(covariance[0, 0]), float(covariance[1, 1])))
        why = f"; last one rejected: {self._last_reason}" if self._last_reason else ""
        if age_s > settings.lost_after_s:
            return TrackQuality.LOST, f"no sighting for {age_s:.0f} s{why}"
        if sigma_m > settings.lost_sigma_m:
            return TrackQuality.LOST, f"position known to {sigma_m:.0f} m only{why}"
        if age_s > settings.coasting_after_s:
            return TrackQuality.COASTING, f"no sighting for {age_s:.1f} s{why}"
        return TrackQuality.GOOD, ""

    @property
    def calibration(self) -> Calibration:
        return (self._filter.biases() if self._filter else Biases.prior(self._settings)).calibration


def _predict(target: TargetFilter, time_s: float) -> None:
    while time_s - target.time_s > _STEP_MAX_S:
        target.predict(target.time_s + _STEP_MAX_S)
    target.predict(time_s)

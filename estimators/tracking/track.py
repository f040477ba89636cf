"""From sightings to an estimate: gate, restart, late sightings, quality.

Each accepted sighting leaves the filter as it was before it; a late one is taken in by going back to the filter
before its time and repeating what came after.

Source: docs/explanation/filter.md#gate-and-loss; Bar-Shalom, Li, Kirubarajan, *Estimation with Applications to
Tracking and Navigation*, 2001, section 5.4.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, NamedTuple

from sidelong.estimators.estimate import TargetEstimate, TrackQuality
from sidelong.estimators.filters.biases import Biases, Calibration, FloatArray
from sidelong.estimators.sensing.sighting import AnySighting, SightingOutcome
from sidelong.estimators.settings import TrackerSettings

if TYPE_CHECKING:
    from sidelong.estimators.filters.imm import TargetImm
    from sidelong.estimators.terrain.ground import Ground

_HISTORY_S, _REPEATED_MAX = 5.0, 60
_AGREEING_UNSEEN = 3  # rejected sightings that restart a track that was coasting
_KEPT, _KEPT_EVERY_S = 40, 1.0  # filters to go back to when sightings turn out to have been wrong
# Longer predictions go by steps, so that the motion models can mix on the way; the longest take this many steps.
_STEP_MAX_S, _STEPS_MAX = 1.0, 60

RESTARTED = "restarted where the rejected sightings agree"  # reason of one with which the track has moved

FilterStart = Callable[..., "TargetImm"]  # makes a filter from (settings, first sighting, biases, ground or None)


def _filter_start(name: str) -> FilterStart:
    # Compiled code takes a second to load: only a program that tracks waits for it.
    if name == "ekf":
        from sidelong.estimators.filters.ekf import TargetEkf  # noqa: PLC0415

        return TargetEkf
    from sidelong.estimators.filters.imm import TargetImm  # noqa: PLC0415

    return TargetImm


class _Step(NamedTuple):
    sighting: AnySighting
    before: TargetImm


class Track:
    """The target's track, from its first sighting on."""

    def __init__(self, settings: TrackerSettings, start: FilterStart | None = None) -> None:
        """start: makes the filter, in place of the one that the settings name."""
        self._settings = settings
        self._start = start or _filter_start(settings.filter)
        self._prior = Biases.prior(settings)
        self._ground: Ground | None = None
        self._filter: TargetImm | None = None
        self._coasted: TargetImm | None = None  # moved on from the last sighting by whole steps
        self._steps: list[_Step] = []
        self._gated_out: list[AnySighting] = []  # beyond the gate, since the last one within
        self._last_rejection = ""
        self._last_sighting_s = -math.inf
        self._begins_again = False
        self._kept: deque[tuple[float, TargetImm]] = deque(maxlen=_KEPT)

    def forget_since(self, time_s: float) -> None:
        """Undo all detections since a time; without an earlier one the track restarts."""
        while self._kept and self._kept[-1][0] > time_s:
            self._kept.pop()
        if self._kept:
            kept_s, kept = self._kept[-1]
            self.resume(kept, kept_s, [])
        else:
            self._filter = self._coasted = None
            self._steps.clear()
            self._gated_out.clear()

    def begin_again(self) -> None:
        """Restart position and motion with the next sighting; the payload's errors are kept."""
        self._begins_again = True

    def restart(self, biases: Biases, sightings: Sequence[AnySighting]) -> None:
        """Restart with other errors of the payload and with sightings that replace all earlier ones."""
        self._filter = self._coasted = None
        self._steps.clear()
        self._gated_out.clear()
        self._kept.clear()
        self._prior = biases
        for sighting in sightings:
            self.add(sighting)

    def stand_on(self, ground: Ground) -> None:
        """Assume from now on that the target stands on a ground."""
        self._ground = ground

    def resume(self, last: TargetImm, last_sighting_s: float, gated_out: list[AnySighting]) -> None:
        """Continue from the filter as of the last sighting, without history; gated_out: sightings beyond the gate."""
        self._filter, self._coasted = last, None
        self._steps.clear()
        self._last_sighting_s, self._gated_out = last_sighting_s, gated_out

    @property
    def last(self) -> tuple[TargetImm | None, float]:
        """The filter as of the last sighting, and the time of that."""
        return self._filter, self._last_sighting_s

    def add(self, sighting: AnySighting) -> SightingOutcome:
        """Update the track with a sighting, or reject it with a reason."""
        settings = self._settings
        if sighting.quality is not None and sighting.quality < settings.quality_min:
            reason = f"signal quality {sighting.quality:.2f} is below {settings.quality_min:.2f}"
            return self._rejected(sighting, math.nan, reason)
        if self._filter is None:
            self._restart([sighting], self._prior)
            return SightingOutcome(sighting, True, math.nan, "first sighting")
        if self._begins_again or sighting.time_s - self._last_sighting_s > settings.lost_after_s:
            self._begins_again = False
            self._restart([sighting], self._filter.biases())
            return SightingOutcome(sighting, True, math.nan, "first sighting after the track was lost")
        if sighting.time_s < self._filter.time_s:
            return self._add_late(sighting)
        before = self._filter
        ahead = _predicted(before, sighting.time_s)
        nis = ahead.update(sighting, settings.gate_nis)
        if nis <= settings.gate_nis:
            self._accept(sighting, before, ahead)
            return SightingOutcome(sighting, True, nis)
        needed = settings.reacquire_after
        if self._may_have_moved_to(sighting, before):
            needed = min(needed, _AGREEING_UNSEEN)
        agreeing = self._gated_out = [*self._gated_out, sighting][-needed:]
        if len(agreeing) == needed and self._one_target_explains(ahead.without_errors(agreeing)):
            self._restart(agreeing, ahead.biases())
            return SightingOutcome(sighting, True, nis, RESTARTED)
        reason = f"innovation squared {nis:.0f} is beyond the gate of {settings.gate_nis:.0f}"
        return self._rejected(sighting, nis, reason)

    def _add_late(self, sighting: AnySighting) -> SightingOutcome:
        at = len(self._steps)
        while at > 0 and self._steps[at - 1].sighting.time_s > sighting.time_s:
            at -= 1
        later = self._steps[at:]
        if not later or later[0].before.time_s > sighting.time_s or len(later) > _REPEATED_MAX:
            return self._rejected(sighting, math.nan, f"older than the {_HISTORY_S:.0f} s that can be gone back")
        before = later[0].before
        ahead = _predicted(before, sighting.time_s)
        nis = ahead.update(sighting, self._settings.gate_nis)
        if nis > self._settings.gate_nis:
            return self._rejected(sighting, nis, f"late, and innovation squared {nis:.0f} is beyond the gate")
        del self._steps[at:]
        self._accept(sighting, before, ahead)
        for step in later:
            before = ahead
            ahead = _predicted(before, step.sighting.time_s)
            ahead.update(step.sighting, math.inf)
            self._accept(step.sighting, before, ahead)
        return SightingOutcome(sighting, True, nis, "late")

    def _accept(self, sighting: AnySighting, before: TargetImm, after: TargetImm) -> None:
        self._filter, self._coasted = after, None
        self._steps.append(_Step(sighting, before))
        self._gated_out.clear()
        self._last_rejection = ""
        last_s, time_s = self._last_sighting_s, sighting.time_s
        self._last_sighting_s = time_s if time_s > last_s else last_s
        if not self._kept or after.time_s - self._kept[-1][0] >= _KEPT_EVERY_S:
            self._kept.append((after.time_s, after))
        if self._steps[0].sighting.time_s < self._last_sighting_s - 2 * _HISTORY_S:
            keep_s = self._last_sighting_s - _HISTORY_S
            self._steps = [step for step in self._steps if step.sighting.time_s >= keep_s]

    def _rejected(self, sighting: AnySighting, nis: float, reason: str) -> SightingOutcome:
        self._last_rejection = reason
        return SightingOutcome(sighting, False, nis, reason)

    def _restart(self, sightings: list[AnySighting], biases: Biases) -> None:
        """Forget place and motion, not the payload's errors, and begin with these sightings."""
        self._steps.clear()
        after = self._start(self._settings, sightings[0], biases, self._ground)
        self._accept(sightings[0], after, after)
        self._steps.clear()
        for sighting in sightings[1:]:
            before, after = after, _predicted(after, sighting.time_s)
            after.update(sighting, math.inf)
            self._accept(sighting, before, after)

    @property
    def _speed_max_m_s(self) -> float:
        return 2.0 * self._settings.target_speed_sigma_m_s

    def _may_have_moved_to(self, sighting: AnySighting, before: TargetImm) -> bool:
        """Return whether the target was unseen, and can have driven there since."""
        unseen_s = sighting.time_s - self._last_sighting_s
        if unseen_s <= self._settings.coasting_after_s:
            return False
        east_m, north_m = before.moments()[0].tolist()[:2]
        (sighting,) = before.without_errors([sighting])
        return math.hypot(sighting.east_m - east_m, sighting.north_m - north_m) < self._speed_max_m_s * unseen_s

    def _one_target_explains(self, sightings: list[AnySighting]) -> bool:
        """Return whether these are as close as detections of one target: outliers scatter, a jump does not."""
        last = sightings[-1]
        # Three sigma of a difference of two, along the longer axis.
        reach_m = 3.0 * math.sqrt(2.0 * float(last.covariance.trace()))
        return all(
            math.hypot(sighting.east_m - last.east_m, sighting.north_m - last.north_m)
            < reach_m + self._speed_max_m_s * abs(last.time_s - sighting.time_s)
            for sighting in sightings
        )

    def estimate(self, now_s: float) -> TargetEstimate | None:
        """Return the target as predicted, or as of the last sighting if that is later; None before the first one."""
        if self._filter is None:
            return None
        ahead = self._filter if now_s <= self._filter.time_s else self._coasted_to(self._filter, now_s)
        mean, covariance = ahead.moments()
        east_m, north_m, velocity_east_m_s, velocity_north_m_s = mean.tolist()
        quality, reason = self._quality(ahead.time_s, covariance)
        state = ahead.time_s, east_m, north_m, velocity_east_m_s, velocity_north_m_s
        return TargetEstimate(*state, covariance, quality, self._last_sighting_s, reason)

    @property
    def last_seen(self) -> TargetEstimate | None:
        """The estimate as of the last sighting; None before the first."""
        return None if self._filter is None else self.estimate(self._filter.time_s)

    def drop_m(self, height_m: float) -> float:
        """Return how far the ground at the target is below a height above home, m; 0 before the first sighting."""
        return 0.0 if self._filter is None else height_m - self._filter.height_m

    def _coasted_to(self, last: TargetImm, now_s: float) -> TargetImm:
        """Return the filter moved on to ``now_s``, the same whenever it was asked for before."""
        start = self._coasted if self._coasted and self._coasted.time_s <= now_s else last
        steps = math.floor((now_s - start.time_s) / _STEP_MAX_S)
        if steps > 0:
            start = self._coasted = _predicted(start, start.time_s + steps * _STEP_MAX_S)
        return _predicted(start, now_s)

    def _quality(self, time_s: float, covariance: FloatArray) -> tuple[TrackQuality, str]:
        settings = self._settings
        age_s = time_s - self._last_sighting_s
        sigma_m = math.sqrt(float(covariance[0, 0] + covariance[1, 1]))
        why = f"; the last one was rejected: {self._last_rejection}" if self._last_rejection else ""
        if age_s > settings.lost_after_s:
            return TrackQuality.LOST, f"no sighting for {age_s:.0f} s{why}"
        if sigma_m > settings.lost_sigma_m:
            return TrackQuality.LOST, f"position known to {sigma_m:.0f} m only{why}"
        if age_s > settings.coasting_after_s:
            return TrackQuality.COASTING, f"no sighting for {age_s:.1f} s{why}"
        return TrackQuality.GOOD, ""

    @property
    def calibration(self) -> Calibration:
        """The estimated errors of the payload."""
        return (self._filter.biases() if self._filter else self._prior).calibration


def _predicted(start: TargetImm, time_s: float) -> TargetImm:
    """Return a copy of the filter, moved on to ``time_s``."""
    ahead = start.copy()
    if time_s - start.time_s <= _STEP_MAX_S:  # as nearly always
        ahead.predict(time_s)
        return ahead
    step_s = max(_STEP_MAX_S, (time_s - start.time_s) / _STEPS_MAX)
    for _ in range(_STEPS_MAX):
        if time_s - ahead.time_s <= step_s:
            break
        ahead.predict(ahead.time_s + step_s)
    ahead.predict(time_s)
    return ahead

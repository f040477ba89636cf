"""The payloads of all aircraft of a run, feeding one joint filter."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from sidelong.app.simulation.airframe_kernel import Body
from sidelong.app.study import fleet_kernel as kernel
from sidelong.app.study.flight import filtering_in, payload_in, sighted
from sidelong.app.study.flight_kernel import Target
from sidelong.app.study.run import Scene, payload_of
from sidelong.app.study.settings import StudySettings
from sidelong.estimators.estimate import TargetEstimate, TrackQuality
from sidelong.estimators.filters.biases import Biases
from sidelong.estimators.filters.imm import TargetImm, prior_of
from sidelong.estimators.filters.imm_kernel import TARGET, combine, predict
from sidelong.estimators.sensing.sighting import Sighting
from sidelong.mission.core.path import FloatArray


class JointSight:
    """Sees the target from all aircraft for a given number of steps. heights_m: of each aircraft."""

    def __init__(self, settings: StudySettings, flown: Scene, heights_m: Sequence[float], steps: int) -> None:
        errors, assumed = payload_of(settings)
        self._assumed, count = assumed, len(heights_m)
        self._noise = np.stack([rng.normal(size=(steps, 3)) for rng in flown.sensor_rng.spawn(count)])
        self._heights_m = np.array(heights_m)
        self._payload = payload_in(errors, assumed)
        self._filtering = filtering_in(assumed)
        self._prior = prior_of([assumed] * count, [0.0] * count)
        self._state: FloatArray | None = None
        self._clock, self._rejections = np.zeros(2), np.zeros(1, np.int64)

    def see(self, logs: FloatArray, seeing: Sequence[bool], target: Target, at: int, until: int) -> None:
        """Take in what is seen from step ``at`` on. logs (aircraft, until - at, 6); seeing: whose payloads work."""
        working = np.array(seeing, np.int64)
        window = Target(target.sampled[at:until], target.noise)
        noise = np.ascontiguousarray(self._noise[:, at:until])
        step, last = 0, until - at
        while step < last:
            if self._state is None:
                one = int(np.argmax(working))
                self._state = self._begun(one, logs[one, step], window.sampled[step], noise[one, step])
                self._clock[:], self._rejections[0] = logs[one, step, 0], 0
            step = kernel.see(
                self._state,
                np.empty_like(self._state),
                self._clock,
                logs,
                window,
                noise,
                self._heights_m,
                self._payload,
                self._filtering,
                working,
                self._rejections,
                step,
                last,
            )
            if self._rejections[0] >= self._filtering.reacquire_after * len(logs):
                mean, covariance = self._moments(self._state, TARGET + self._prior.mean.size)
                self._prior, self._state = Biases(mean[TARGET:], covariance[TARGET:, TARGET:]), None

    @staticmethod
    def _moments(state: FloatArray, size: int) -> tuple[FloatArray, FloatArray]:
        mean, covariance = np.empty(size), np.empty((size, size))
        combine(state, mean, covariance)
        return mean, covariance

    def _begun(self, payload: int, row: FloatArray, truth: FloatArray, noise: FloatArray) -> FloatArray:
        """Return the filter begun with what one payload sees."""
        p, height_m = self._payload, float(self._heights_m[payload])
        time_s, east_m, north_m = row[:3].tolist()
        body = Body(time_s, east_m, north_m, 0.0, 0.0, 0.0, 0.0)
        slant_m, yaw_rad, pitch_rad = sighted(body, height_m, truth, noise, p)
        sigmas = p.told_range_sigma_m, p.told_yaw_sigma_rad, p.told_pitch_sigma_rad
        place = east_m, north_m, height_m
        sighting = Sighting(time_s, slant_m, yaw_rad, -pitch_rad, *sigmas, *place, payload=payload)
        return TargetImm(self._assumed, sighting, self._prior).state

    def estimate(self, time_s: float) -> TargetEstimate | None:
        """Return the joint estimate; None before the first sighting."""
        if self._state is None:
            return None
        ahead, step_s = self._state, time_s - float(self._clock[0])
        if step_s > 1e-6:
            ahead, f = np.empty_like(self._state), self._filtering
            predict(self._state, min(step_s, 1.0), f.densities, ahead)
        mean, covariance = self._moments(ahead, 4)
        sigma_m, seen_s = math.sqrt(covariance[0, 0] + covariance[1, 1]), float(self._clock[1])
        lost = time_s - seen_s > self._filtering.lost_after_s or sigma_m > self._filtering.lost_sigma_m
        quality = TrackQuality.LOST if lost else TrackQuality.GOOD
        east, north, velocity_e, velocity_n = mean.tolist()
        return TargetEstimate(time_s, east, north, velocity_e, velocity_n, covariance, quality, seen_s)

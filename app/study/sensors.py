"""Sensor input of a study's tracker: laser, gimbal and autopilot with noise."""

from __future__ import annotations

import math

import numpy as np

from sidelong.app.simulation.payload import PayloadErrors, sight_quaternion
from sidelong.app.simulation.target import TargetTruth
from sidelong.estimators.estimate import TargetEstimate
from sidelong.estimators.sensing.readings import AttitudeReading, GimbalReading, PositionReading, RangeReading, Source
from sidelong.estimators.tracking.tracker import Tracker, TrackerSettings
from sidelong.mission.core.plan import AircraftState

_LASER = Source("DISTANCE_SENSOR", 154, 1, 100)
_GIMBAL = Source("GIMBAL_DEVICE_ATTITUDE_STATUS", 154)


class PayloadSensing:
    """Laser and gimbal with noise, through the real tracker."""

    def __init__(self, rng: np.random.Generator, errors: PayloadErrors, assumed: TrackerSettings) -> None:
        self._rng, self._errors = rng, errors
        self.tracker = Tracker(assumed)

    def observe(
        self,
        aircraft: AircraftState,
        height_m: float,
        bank_rad: float,
        target: TargetTruth,
        target_height_m: float,
        in_sight: bool,
    ) -> None:
        """Take one sighting's worth of truth."""
        time_s = aircraft.time_s
        velocity_east = aircraft.ground_speed_m_s * math.sin(aircraft.course_rad)
        velocity_north = aircraft.ground_speed_m_s * math.cos(aircraft.course_rad)
        self.tracker.add(
            PositionReading(time_s, aircraft.east_m, aircraft.north_m, height_m, velocity_east, velocity_north, 0.0)
        )
        self.tracker.add(AttitudeReading(time_s, bank_rad, 0.0, aircraft.course_rad))
        east_m, north_m = target.east_m - aircraft.east_m, target.north_m - aircraft.north_m
        horizontal_m = math.hypot(east_m, north_m)
        range_noise, yaw_noise, pitch_noise = self._rng.normal(size=3)
        if not in_sight:
            return
        drop_m = height_m - target_height_m
        yaw_rad = math.atan2(east_m, north_m) + self._errors.yaw_bias_rad + self._errors.angle_sigma_rad * yaw_noise
        pitch_rad = -math.atan2(drop_m, horizontal_m) + self._errors.angle_sigma_rad * pitch_noise
        self.tracker.add(GimbalReading(time_s, sight_quaternion(yaw_rad, pitch_rad), "earth", _GIMBAL))
        slant_m = math.hypot(horizontal_m, drop_m) + self._errors.range_sigma_m * range_noise
        self.tracker.add(RangeReading(time_s, slant_m, _LASER, quality=0.9))

    def estimate(self, time_s: float) -> TargetEstimate | None:
        """Return the estimate at a time no earlier than the last sighting."""
        return self.tracker.estimate(time_s)

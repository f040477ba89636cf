"""A target, an aircraft circling next to it, and a payload that measures with noise: all exact but for the noise."""

from __future__ import annotations

import csv
import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from sidelong.app.link.telemetry import Telemetry
from sidelong.app.records.tlog import read_tlog
from sidelong.estimators.sensing.readings import AttitudeReading, GimbalReading, PositionReading, RangeReading, Source
from sidelong.estimators.sensing.sighting import Sighting

DATA = Path(__file__).resolve().parent.parent / "data"
STEP_S = 0.1
HEIGHT_M = 120.0
RANGE_SIGMA_M = 0.8
ANGLE_SIGMA_RAD = math.radians(0.35)
LASER = Source("DISTANCE_SENSOR", 154, 1, 100)
GIMBAL = Source("GIMBAL_DEVICE_ATTITUDE_STATUS", 154)


@dataclass(frozen=True)
class Scene:
    """target (n, 4): east, north, velocity east and north, every STEP_S; aircraft (n, 4) likewise."""

    target: np.ndarray
    aircraft: np.ndarray

    @staticmethod
    def of(velocity: Callable[[float], tuple[float, float]], duration_s: float, phase_rad: float = 0.0) -> Scene:
        """A target of this velocity; an aircraft at 15 m/s on a circle of 80 m, centred 300 m south of the target."""
        count = round(duration_s / STEP_S)
        velocities = np.array([velocity(k * STEP_S) for k in range(count)])
        places = np.vstack(([0.0, 0.0], np.cumsum((velocities[1:] + velocities[:-1]) / 2 * STEP_S, axis=0)))
        angle = phase_rad + np.arange(count) * STEP_S * 15.0 / 80.0
        around = 80.0 * np.stack((np.sin(angle), np.cos(angle)), axis=1)
        aircraft = places + around + (0.0, -300.0)
        return Scene(np.hstack((places, velocities)), np.hstack((aircraft, np.gradient(aircraft, STEP_S, axis=0))))

    def sightings(
        self, rng: np.random.Generator, *, yaw_rad: float = 0.0, pitch_rad: float = 0.0, range_m: float = 0.0
    ) -> list[Sighting]:
        """What laser and gimbal with these errors see at 10 Hz."""
        made = []
        for k, (target, aircraft) in enumerate(zip(self.target, self.aircraft, strict=True)):
            east, north = target[:2] - aircraft[:2]
            horizontal_m = math.hypot(east, north)
            made.append(
                Sighting(
                    time_s=k * STEP_S,
                    slant_range_m=math.hypot(horizontal_m, HEIGHT_M)
                    + range_m
                    + RANGE_SIGMA_M * rng.standard_normal(),
                    bearing_rad=math.atan2(east, north) + yaw_rad + ANGLE_SIGMA_RAD * rng.standard_normal(),
                    depression_rad=math.atan2(HEIGHT_M, horizontal_m)
                    - pitch_rad
                    + ANGLE_SIGMA_RAD * rng.standard_normal(),
                    range_sigma_m=RANGE_SIGMA_M,
                    bearing_sigma_rad=ANGLE_SIGMA_RAD,
                    depression_sigma_rad=ANGLE_SIGMA_RAD,
                    aircraft_east_m=float(aircraft[0]),
                    aircraft_north_m=float(aircraft[1]),
                    aircraft_height_m=HEIGHT_M,
                )
            )
        return made

    def readings(self, rng: np.random.Generator, *, range_every: int = 1, gimbal_every: int = 1) -> list[Any]:
        """The same as a vehicle reports it: poses at 10 Hz, earth-frame gimbal, each kind at its own rate."""
        made: list[Any] = []
        for k, sighting in enumerate(self.sightings(rng)):
            time_s, aircraft = sighting.time_s, self.aircraft[k]
            place = PositionReading(time_s, aircraft[0], aircraft[1], HEIGHT_M, aircraft[2], aircraft[3], 0.0)
            made += [place, AttitudeReading(time_s, 0.0, 0.0, math.atan2(aircraft[2], aircraft[3]))]
            if k % gimbal_every == 0:
                made.append(
                    GimbalReading(time_s, looking(sighting.bearing_rad, sighting.depression_rad), "earth", GIMBAL)
                )
            if k % range_every == 0:
                made.append(RangeReading(time_s, sighting.slant_range_m, LASER))
        return made


def looking(yaw_rad: float, depression_rad: float) -> tuple[float, float, float, float]:
    """The quaternion of yaw then pitch, written out by hand."""
    cy, sy = math.cos(yaw_rad / 2), math.sin(yaw_rad / 2)
    cp, sp = math.cos(-depression_rad / 2), math.sin(-depression_rad / 2)
    return cp * cy, -sp * sy, sp * cy, cp * sy


@dataclass(frozen=True)
class Flown:
    """A flown log as the telemetry decodes it, and the true track of the target in the same plane."""

    readings: list[Any]
    truth_s: np.ndarray
    truth_m: np.ndarray  # (n, 2)


def _flown(name: str) -> Flown:
    telemetry = Telemetry(system_id=1)
    events = [telemetry.event(message) for message in read_tlog(DATA / f"{name}.tlog", telemetry.wanted)]
    kinds = (PositionReading, AttitudeReading, RangeReading, GimbalReading)
    with (DATA / f"{name}.truth.csv").open() as file:
        rows = [[float(value) for value in row.values()] for row in csv.DictReader(file)]
    assert telemetry.plane is not None
    places = [
        telemetry.plane.east_north_m(latitude_deg, longitude_deg) for _, latitude_deg, longitude_deg, _, _ in rows
    ]
    return Flown([event for event in events if isinstance(event, kinds)], np.array(rows)[:, 0], np.array(places))


@pytest.fixture(scope="session")
def scene() -> type[Scene]:
    return Scene


@pytest.fixture(scope="session")
def looking_at() -> Callable[[float, float], tuple[float, float, float, float]]:
    return looking


@pytest.fixture(scope="session")
def bike() -> Flown:
    """ArduPlane: 0.4 degrees of yaw error, 2 % outliers, drop-outs."""
    return _flown("arduplane-follow-bike")


@pytest.fixture(scope="session")
def walk_and_drive() -> Flown:
    """PX4: the same payload, its range repeated by the autopilot, and a downward range sensor."""
    return _flown("px4-follow-walk-and-drive")


@pytest.fixture
def moved() -> Callable[..., Sighting]:
    """A sighting with some of its numbers shifted."""

    def shift(sighting: Sighting, **by: float) -> Sighting:
        return replace(sighting, **{name: getattr(sighting, name) + value for name, value in by.items()})

    return shift

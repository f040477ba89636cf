"""A camera that tracks the target, without a laser: compared with laser and gimbal over the same ground.

``python -m pytest tests/bench/test_camera_flights.py -s`` flies the same targets with each, over flat ground and over
hills. What the filter does not know differs from flight to flight as much as its settings say: the biases of the
gimbal's yaw and pitch and of the laser's range, and by how much the ground is off its data.

Further flights have an error of the gimbal beyond its settings, by yaw or by a late stamp.

CAMERA_FLIGHTS: targets over each ground. CAMERA_FLIGHT_S: length of each flight, s. SIDELONG_TARGETS: a folder of
recorded tracks; without it targets are random.
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from statistics import NormalDist

import numpy as np
import pytest

from sidelong.app.study.recorded import RecordedTarget, recorded_targets
from sidelong.app.terrain.elevation_data import ElevationData
from sidelong.estimators.settings import TrackerSettings
from sidelong.estimators.terrain.ground import Ground, flat_ground
from tests.bench.size import SMOKE, size
from tests.faults import flight as faults
from tests.faults.flight import HOME_DEG, FaultedFlight, Scenario
from tests.faulty_payload import FaultyPayload, PayloadFaults
from tests.payload.test_camera import CAMERA
from tests.payload.test_flight import error_m, shares
from tests.terrain.conftest import SIDE, hills

FLIGHTS, DURATION_S = size(24, 1, "CAMERA_FLIGHTS"), float(size(600, 60, "CAMERA_FLIGHT_S"))
_CHI2_95 = 5.991
_SIGMA_M = {"flat": 2.0, "hills": 4.0}  # of the ground
_TRACK_SPEED_MAX_M_S = 3.5
_FLATTER = 4  # than the real hills: the aircraft flies 100 m above home


@dataclass(frozen=True)
class World:
    """The ground that the target stands on, and what is wrong with the data of it, the gimbal and the laser."""

    terrain: dict[str, object]
    ground: Ground
    off_m: float
    yaw_bias_rad: float
    pitch_bias_rad: float
    range_bias_m: float


class _OnGround(FaultyPayload):
    """Sees a target whose ground is not at the height of home."""

    def __init__(self, errors: PayloadFaults, rng: np.random.Generator, target, world: World) -> None:
        super().__init__(replace(errors, yaw_bias_rad=world.yaw_bias_rad), rng)
        self._target, self._world = target, world

    def measure(self, time_s, boot_ms, east_m, north_m, up_m, **how):
        at = self._target.at(time_s)
        up_m += self._world.ground.height_m(at.east_m, at.north_m) + self._world.off_m
        level_m, range_m = math.hypot(east_m, north_m), math.hypot(east_m, north_m, up_m)
        pitch_rad = math.atan2(up_m, level_m) + self._world.pitch_bias_rad
        share = range_m * math.cos(pitch_rad) / level_m
        longer = 1.0 + self._world.range_bias_m / range_m  # no camera sees that
        line_m = share * east_m, share * north_m, range_m * math.sin(pitch_rad)
        return super().measure(time_s, boot_ms, *(longer * one for one in line_m), **how)


class _Flight(FaultedFlight):
    """A flight that compares the estimate with its 95 % ellipse."""

    def __init__(self, scenario: Scenario, errors: PayloadFaults, world: World) -> None:
        self._errors, self._world = errors, world
        self.inside: list[bool] = []
        super().__init__(scenario, configured={"terrain": world.terrain})

    def payload(self, rng):
        return _OnGround(self._errors, rng, self._target, self._world)

    def _relative_to_truth(self, now_s, moved):
        estimate = self.controller.estimate
        if estimate is not None:
            truth = self._target.at(min(max(estimate.time_s - self._boot_s, 0.0), self._scenario.duration_s))
            off_m = np.array([estimate.east_m - truth.east_m, estimate.north_m - truth.north_m])
            self.inside.append(bool(off_m @ np.linalg.solve(estimate.covariance[:2, :2], off_m) <= _CHI2_95))
        return super()._relative_to_truth(now_s, moved)


def write_low_hills(folder: Path) -> None:
    """Write elevation data into a folder whose hills are around home."""
    tile, heights = np.zeros((SIDE, SIDE), np.int16), hills()[0] // _FLATTER
    row, column = (
        round((SIDE - 1) * part - size / 2)
        for part, size in zip((1.0 - HOME_DEG[0] % 1.0, HOME_DEG[1] % 1.0), heights.shape, strict=True)
    )
    tile[row : row + heights.shape[0], column : column + heights.shape[1]] = heights
    tile.astype(">i2").tofile(folder / "N47E008.hgt")


def worlds(kind: str, folder) -> list[World]:
    """Return one world for each flight; their errors are spread as a normal distribution is."""
    sigma_m = _SIGMA_M[kind]
    if kind == "flat":
        terrain, ground = {"flat": True, "sigma_m": sigma_m}, flat_ground(sigma_m)
    else:
        write_low_hills(folder)
        terrain = {"folder": str(folder), "sigma_m": sigma_m}
        ground = ElevationData(folder).ground(faults._PLANE, HOME_DEG, sigma_m)
    spread = [NormalDist().inv_cdf((k + 0.5) / FLIGHTS) for k in range(FLIGHTS)]
    rng, settings = np.random.default_rng(1), TrackerSettings()
    sigmas = sigma_m, settings.yaw_bias_sigma_rad, settings.pitch_bias_sigma_rad, settings.range_bias_sigma_m
    drawn = zip(*(sigma * rng.permutation(spread) for sigma in sigmas), strict=True)
    return [World(terrain, ground, *map(float, one)) for one in drawn]


def tracks() -> list[RecordedTarget] | None:
    """Return one recorded track for each flight, of all those in the folder; None: targets are random."""
    folder = os.environ.get("SIDELONG_TARGETS")
    if folder is None:
        return None
    flown = recorded_targets([Path(folder)], _TRACK_SPEED_MAX_M_S).flown
    return [flown[k] for k in np.linspace(0, len(flown) - 1, FLIGHTS).astype(int)]


def flights(kind: str, folder: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[tuple[Scenario, World]]:
    """Yield scenario and world of each flight, whose target is then that of the flight."""
    recorded = tracks()
    for k, world in enumerate(worlds(kind, folder)):
        if recorded is not None:
            monkeypatch.setattr(faults, "RandomTarget", lambda *_drawn, track=recorded[k]: track)
        yield Scenario(seed=1 + k, flavour="arduplane" if k % 2 else "px4", duration_s=DURATION_S), world


@pytest.mark.timeout(7200)
@pytest.mark.parametrize("kind", _SIGMA_M)
def test_side_without_a_laser_is_within_three_points_of_the_lasers(kind, tmp_path, monkeypatch):
    rows = []
    for scenario, world in flights(kind, tmp_path, monkeypatch):
        for errors in (CAMERA, faults.ERRORS):
            flight = _Flight(scenario, errors, world)
            flown = flight.fly()
            rows.append((error_m(flown), 100.0 * np.mean(flight.inside), *shares(flown), min(flown.range_m)))
    camera, laser = np.array(rows[::2]), np.array(rows[1::2])
    lost = laser[:, 2] - camera[:, 2]
    for name, one in (("camera", camera), ("laser", laser)):
        rms_m, inside, side, band, _ = one.mean(axis=0)
        print(f"\n{kind}, {name}: error {rms_m:.2f} m, in the 95 % ellipse {inside:.1f} %, side {side:.1f} %", end="")
        print(f", band {band:.1f} %, least range {one[:, 4].min():.0f} m", end="")
    print(f"\nwithout the laser {lost.mean():.1f} +- {lost.std() / np.sqrt(len(lost)):.1f} points of side less")
    assert 92.0 <= camera[:, 1].mean() <= 98.0
    assert lost.mean() <= 3.0


@pytest.mark.timeout(7200)
@pytest.mark.parametrize("kind", _SIGMA_M)
@pytest.mark.parametrize(("yaw_deg", "delay_s"), [(20.0, 0.0), (-20.0, 0.0), (0.0, 0.5), (0.0, 1.0)])
def test_large_error_of_the_gimbal_is_found_without_a_laser(yaw_deg, delay_s, kind, tmp_path, monkeypatch):
    rows, camera = [], replace(CAMERA, gimbal_delay_s=delay_s)
    for scenario, world in flights(kind, tmp_path, monkeypatch):
        flight = _Flight(scenario, camera, replace(world, yaw_bias_rad=world.yaw_bias_rad + math.radians(yaw_deg)))
        flown, tracker = flight.fly(), flight.controller.tracker
        found_deg = math.degrees(tracker.calibration.yaw_bias_rad - world.yaw_bias_rad)
        found_s = 0.0 if tracker.delays is None else tracker.delays.gimbal_s
        errors = abs(found_deg - yaw_deg), abs(found_s - delay_s), float(np.median(flown_late_m(flown)))
        rows.append((*shares(flown), *errors, min(flown.range_m)))
    side, band, *_ = np.mean(rows, axis=0)
    yaw_off_deg, delay_off_s, off_m = np.median(rows, axis=0)[2:5]
    print(
        f"\n{kind}, yaw {yaw_deg:+.0f} degrees, delay {delay_s} s: side {side:.1f} %, band {band:.1f} %, least range "
        f"{min(one[-1] for one in rows):.0f} m; at the end off by {yaw_off_deg:.1f} degrees, {delay_off_s:.2f} s, "
        f"{off_m:.1f} m (medians)",
        end="",
    )
    if not SMOKE:
        assert off_m <= 20.0


def flown_late_m(flown: faults.Flown) -> list[float]:
    """Return the errors of the estimate in the last quarter of a flight, m."""
    return [one.target_error_m for one in flown.decided[-len(flown.decided) // 4 :]]

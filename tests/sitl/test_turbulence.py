"""Dryden gusts: as large and as long as MIL-F-8785C states, the same again for a seed, and felt by the payload."""

from __future__ import annotations

import math

import numpy as np
import pytest
from pymavlink.dialects.v20 import all as mavlink

from sidelong.sitl.settings import Flavour, PayloadSettings, Settings, TargetSettings
from sidelong.sitl.simulation import Simulation
from sidelong.sitl.world.airframe import AirframeParameters, SimulatedAirframe, WindVector
from sidelong.sitl.world.turbulence import Level, Turbulence

FT_M, KN_M_S = 0.3048, 0.514444
W20_KN = {Level.LIGHT: 15.0, Level.MODERATE: 30.0, Level.SEVERE: 45.0}


def flown(level: Level, height_m: float, step_m: float, steps: int = 60_000, seed: int = 1) -> np.ndarray:
    """Return the gusts (n, 6), m/s and rad/s, in steps of this length at 20 m/s."""
    gusts = Turbulence(level, np.random.default_rng(seed))
    rows = []
    for _ in range(steps):
        gusts.step(step_m / 20.0, 20.0, height_m)
        rows.append((*gusts.velocity_m_s, *gusts.rates_rad_s))
    return np.array(rows)


def stated(level: Level, height_m: float) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return length and standard deviation of the velocities ahead and to the right, and of those up."""
    height_ft, sigma_w_m_s = height_m / FT_M, 0.1 * W20_KN[level] * KN_M_S
    shear = 0.177 + 0.000823 * height_ft
    return (height_m / shear**1.2, sigma_w_m_s / shear**0.4), (height_m, sigma_w_m_s)


@pytest.mark.parametrize(("level", "height_m"), [(Level.LIGHT, 100.0), (Level.MODERATE, 40.0), (Level.SEVERE, 250.0)])
def test_variance_and_correlation_of_the_velocities_are_as_stated(level, height_m):
    level_scale, up_scale = stated(level, height_m)
    step_m = level_scale[0] / 20.0
    gusts = flown(level, height_m, step_m)
    for k, (length_m, sigma_m_s) in enumerate((level_scale, level_scale, up_scale)):
        one = gusts[:, k]
        assert one.std() == pytest.approx(sigma_m_s, rel=0.06)
        for lengths in (0.5, 1.0, 2.0):
            lag = round(lengths * length_m / step_m)
            way = lag * step_m / length_m
            expected = math.exp(-way) * (1.0 if k == 0 else 1.0 - 0.5 * way)
            assert np.corrcoef(one[:-lag], one[lag:])[0, 1] == pytest.approx(expected, abs=0.07)


def test_variance_of_the_rates_is_the_integral_of_their_spectra():
    height_m, span_m = 70.0, 2.0
    (length_m, sigma_m_s), (up_m, sigma_w_m_s) = stated(Level.MODERATE, height_m)
    per_m = np.linspace(1e-4, 400.0, 2_000_000)  # omega / V

    def integral(values: np.ndarray) -> float:
        return float(np.trapezoid(values, per_m))

    def lateral(sigma: float, scale_m: float) -> np.ndarray:
        way = (scale_m * per_m) ** 2
        return sigma**2 * scale_m / math.pi * (1.0 + 3.0 * way) / (1.0 + way) ** 2

    rolled = 0.8 * (math.pi * up_m / (4.0 * span_m)) ** (1.0 / 3.0) / (1.0 + (4.0 * span_m / math.pi * per_m) ** 2)
    pitched = per_m**2 / (1.0 + (4.0 * span_m / math.pi * per_m) ** 2) * lateral(sigma_w_m_s, up_m)
    yawed = per_m**2 / (1.0 + (3.0 * span_m / math.pi * per_m) ** 2) * lateral(sigma_m_s, length_m)
    variances = integral(sigma_w_m_s**2 / up_m * rolled), integral(pitched), integral(yawed)
    rates = flown(Level.MODERATE, height_m, step_m=0.05, steps=200_000)[:, 3:]
    assert rates.std(axis=0) == pytest.approx(np.sqrt(variances), rel=0.08)


def test_gusts_are_the_same_for_a_seed_and_others_for_another():
    one, again, other = (flown(Level.MODERATE, 70.0, 2.0, 50, seed) for seed in (1, 1, 2))
    assert (one == again).all()
    assert (one != other).all()


def airframe(level: Level | None) -> np.ndarray:
    """Return roll, height, east and airspeed of ten minutes that are to be flown level and straight to the north."""
    craft = SimulatedAirframe(AirframeParameters(), WindVector())
    craft.flying, craft.airspeed_m_s, craft.height_m = True, 20.0, 70.0
    craft.turbulence = None if level is None else Turbulence(level, np.random.default_rng(3))
    rows = []
    for _ in range(6000):
        craft.fly(0.1, 0.0, 20.0, 0.4 * (70.0 - craft.height_m))
        rows.append((craft.roll_rad, craft.height_m, craft.velocity_east_m_s, craft.measured_airspeed_m_s))
    return np.array(rows)


def test_gusts_move_the_airframe_in_proportion_to_their_level_and_calm_air_does_not():
    assert (np.ptp(airframe(None), axis=0) == 0.0).all()
    light, moderate, severe = (airframe(level).std(axis=0) for level in W20_KN)
    assert (light > (0.01, 0.2, 0.3, 0.3)).all()
    assert (moderate > 1.5 * light).all()
    assert (severe > 1.3 * moderate).all()


def simulated(flavour: str, level: Level, seed: int = 4) -> list[tuple[float, ...]]:
    """Return (gimbal's error across the sight in degrees, range's error, roll rate) of a minute in the air."""
    exact = PayloadSettings(0.0, 0.0, 0.0, 0.0, 0.0, latency_s=0.0)
    simulation = Simulation(
        Settings(Flavour(flavour), seed=seed, turbulence=level, payload=exact, targets=(TargetSettings("still"),))
    )
    vehicle, rows, rows_of_truth = simulation.vehicle, [], []
    simulation.connect("ground")
    simulation.on_truth = rows_of_truth.append
    vehicle.craft.flying, vehicle.craft.airspeed_m_s, vehicle.craft.height_m, vehicle.armed = True, 15.0, 80.0, True
    vehicle.set_mode(12 if flavour == "arduplane" else 0x03040000)
    vehicle.height_goal_m = 80.0
    parser = mavlink.MAVLink(None)
    while simulation.time_s < 60.0:
        simulation.advance(simulation.time_s + 0.1)
        measured = [m for _, data in simulation.take() for m in parser.parse_buffer(data) or ()]
        ranges = [m.current_distance / 100.0 for m in measured if m.get_type() == "DISTANCE_SENSOR" and m.id == 1]
        lines = [m.q for m in measured if m.get_type() == "GIMBAL_DEVICE_ATTITUDE_STATUS"]
        if ranges and lines:
            (w, x, y, z), row = lines[-1], rows_of_truth[-1]
            yaw_rad = math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
            pitch_rad = math.asin(2.0 * (w * y - z * x))
            off_rad = math.remainder(yaw_rad - row.bearing_rad, math.tau)
            rise_rad = pitch_rad - math.asin((row.target_m[2] - row.aircraft_m[2]) / row.slant_range_m)
            off_deg = math.degrees(math.hypot(off_rad * math.cos(pitch_rad), rise_rad))
            rows.append((off_deg, ranges[-1] - row.slant_range_m, vehicle.craft.roll_rate_rad_s))
    return rows


@pytest.mark.parametrize("flavour", ["arduplane", "px4"])
def test_gimbal_and_laser_lag_in_gusts(flavour):
    calm, gusty = (np.array(simulated(flavour, level)) for level in (Level.NONE, Level.SEVERE))
    assert np.abs(calm[:, 0]).max() < 0.01
    assert np.abs(calm[:, 1]).max() < 0.02
    assert 0.03 < gusty[:, 0].mean() < 1.0
    assert np.abs(gusty[:, 1]).max() > 1.0
    assert gusty[100:, 2].std() > 3.0 * calm[100:, 2].std()


def test_a_flight_in_gusts_is_repeated_to_the_last_bit():
    assert simulated("arduplane", Level.MODERATE) == simulated("arduplane", Level.MODERATE)
    assert simulated("arduplane", Level.MODERATE) != simulated("arduplane", Level.MODERATE, seed=5)

"""Dryden turbulence at low altitude: the air's velocity and rotation at an aircraft that flies through it.

Source: MIL-F-8785C (1980), section 3.7, Dryden form, for heights of 10 to 1000 ft. With the height h in feet, the
wind at 20 ft W20, the airspeed V and the wing span b:

- scale lengths: Lw = h, Lu = Lv = h / (0.177 + 0.000823 h)^1.2
- intensities: sigma_w = 0.1 W20, sigma_u = sigma_v = sigma_w / (0.177 + 0.000823 h)^0.4
- velocity ahead: sigma_u sqrt(2 Lu / (pi V)) / (1 + Lu/V s); correlation over a distance x: exp(-x/L)
- to the right and up: sigma sqrt(L / (pi V)) (1 + sqrt(3) L/V s) / (1 + L/V s)^2; exp(-x/L) (1 - x/(2 L))
- roll rate: 1 / (1 + 4 b / (pi V) s), of variance 0.8 sigma_w^2 (pi Lw / (4 b))^(1/3) pi^2 / (8 b Lw)
- pitch rate: the velocity up times s/V / (1 + 4 b / (pi V) s)
- yaw rate: the velocity to the right times s/V / (1 + 3 b / (pi V) s)
"""

from __future__ import annotations

import math
from enum import StrEnum

import numpy as np


class Level(StrEnum):
    NONE = "none"
    LIGHT = "light"
    MODERATE = "moderate"
    SEVERE = "severe"


_W20_KN = {Level.LIGHT: 15.0, Level.MODERATE: 30.0, Level.SEVERE: 45.0}
_KN_M_S, _FT_M = 0.514444, 0.3048
_HEIGHTS_FT = (10.0, 1000.0)


class Turbulence:
    """A gust that is stepped along with the aircraft, exactly for any step.

    velocity_m_s: of the air ahead, to the right and up. rates_rad_s: of its roll, pitch and yaw.
    """

    def __init__(self, level: Level, rng: np.random.Generator, span_m: float = 2.0) -> None:
        self._sigma_w_m_s, self._rng, self._span_m = 0.1 * _W20_KN[level] * _KN_M_S, rng, span_m
        self.velocity_m_s = self.rates_rad_s = (0.0, 0.0, 0.0)
        # With unit variance: the velocity ahead, the roll rate, and the two states of the velocities right and up.
        self._ahead, self._roll, *drawn = rng.standard_normal(6).tolist()
        self._right, self._up = (
            (math.sqrt(0.5) * one, 0.5 * math.sqrt(0.5) * one + math.sqrt(0.125) * other)
            for one, other in (drawn[:2], drawn[2:])
        )
        self._smooth_right_m_s = self._smooth_up_m_s = 0.0

    def scales(self, height_m: float) -> tuple[float, float, float, float]:
        """Return Lu = Lv and Lw, in metres, and sigma_u = sigma_v and sigma_w, in m/s, at this height."""
        height_ft = min(max(height_m / _FT_M, _HEIGHTS_FT[0]), _HEIGHTS_FT[1])
        shear = 0.177 + 0.000823 * height_ft
        level_m, up_m = height_ft * _FT_M / shear**1.2, height_ft * _FT_M
        return level_m, up_m, self._sigma_w_m_s / shear**0.4, self._sigma_w_m_s

    def step(self, dt_s: float, airspeed_m_s: float, height_m: float) -> None:
        """Fly on by ``airspeed_m_s * dt_s``."""
        level_m, up_m, sigma_m_s, sigma_up_m_s = self.scales(height_m)
        way_m = airspeed_m_s * dt_s
        n = self._rng.standard_normal(6).tolist()
        self._ahead = _first_order(self._ahead, way_m / level_m, n[0])
        self._right = _second_order(self._right, way_m / level_m, n[1], n[2])
        self._up = _second_order(self._up, way_m / up_m, n[3], n[4])
        right_m_s, up_m_s = (
            sigma * (math.sqrt(3.0) * first + (1.0 - math.sqrt(3.0)) * second)
            for sigma, (first, second) in ((sigma_m_s, self._right), (sigma_up_m_s, self._up))
        )
        self.velocity_m_s = sigma_m_s * self._ahead, right_m_s, up_m_s
        span_m = 4.0 * self._span_m / math.pi
        self._roll = _first_order(self._roll, way_m / span_m, n[5])
        wide = 0.8 * (up_m / span_m) ** (1.0 / 3.0) * math.pi**2 / (8.0 * self._span_m * up_m)
        pitch_m_s = (up_m_s - self._smooth_up_m_s) * -math.expm1(-way_m / span_m)
        yaw_m_s = (right_m_s - self._smooth_right_m_s) * -math.expm1(-way_m / (0.75 * span_m))
        self._smooth_up_m_s += pitch_m_s
        self._smooth_right_m_s += yaw_m_s
        self.rates_rad_s = self._roll * sigma_up_m_s * math.sqrt(wide), pitch_m_s / way_m, yaw_m_s / way_m


def turbulence(level: str, rng: np.random.Generator) -> Turbulence | None:
    """Return turbulence of a level with its own random stream, a child of ``rng``; None for "none"."""
    return None if level == Level.NONE else Turbulence(Level(level), rng.spawn(1)[0])


def _first_order(state: float, way: float, noise: float) -> float:
    """Return a state of unit variance after a distance in scale lengths."""
    return math.exp(-way) * state + math.sqrt(-math.expm1(-2.0 * way)) * noise


def _second_order(state: tuple[float, float], way: float, one: float, other: float) -> tuple[float, float]:
    """Return two states in a row, x1' = -x1 + n and x2' = x1 - x2, of variances 1/2 and 1/4, covariance 1/4."""
    kept = math.exp(-2.0 * way)
    first = math.sqrt(-0.5 * math.expm1(-2.0 * way))
    both = (0.25 - kept * (0.5 * way + 0.25)) / first
    second = math.sqrt(max(0.0, 0.25 - kept * (0.5 * way**2 + 0.5 * way + 0.25) - both**2))
    decay = math.exp(-way)
    return decay * state[0] + first * one, decay * (way * state[0] + state[1]) + both * one + second * other

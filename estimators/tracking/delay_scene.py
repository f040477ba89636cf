"""The least-squares fit of delays: it finds the target's path together with the payload's errors.

Unknown are the path (knots, with a white acceleration whose size is found with it) and four shared numbers: the
delay of the gimbal, the delay of the laser, the yaw bias of the gimbal and the bias of the level range. The normal
equations of the path are banded; the shared numbers are a border. Errors follow Student's distribution, so that
outliers of the readings and sudden turns of the target have little weight.

Source: docs/explanation/filter.md#delays; Lange, Little, Taylor, "Robust statistical modeling using the t
distribution", Journal of the American Statistical Association 84(408), 1989.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from sidelong.estimators.tracking.band_kernel import (
    FloatArray,
    add_readings,
    add_turns,
    aircraft_at,
    solve_banded,
    way_at,
)

_Knots = tuple[npt.NDArray[np.intp], FloatArray]  # the knot before each reading, and the share of the one after it

MIN_DELAY_S, MAX_DELAY_S = -1.0, 3.0
STIFF_M = 0.1
"""Size of the target's turns (second difference of the knots) in a path that is nearly straight."""

_KNOT_S = 2.0
_NEAR_M = 0.01  # no direction is known of a nearer target
_SINE_MIN = 0.02  # of the depression of a line of sight that ends on the ground
_FREEDOM = 4.0  # of Student's distribution
_STIFFEST_M, _STIFF_ITERATIONS = 0.02, 3
_ITERATIONS_MAX, _SETTLED_S = 12, 0.002


class Fit(NamedTuple):
    """What a fit has come to.

    Attributes:
        shared: gimbal delay s, laser delay s, yaw bias rad, range bias m, (4,).
        scale_m: size of the target's turns.
        information: inverse of their covariance by the readings alone, without the priors, (4, 4).
        cost: negative logarithm of the likelihood, less a constant.
    """

    shared: FloatArray
    scale_m: float
    information: FloatArray
    cost: float


class _Normal:
    """Normal equations of the path's knots (banded) and the shared numbers (a border)."""

    def __init__(self, knots: int, shared: FloatArray, sigmas: FloatArray, *, erring: bool) -> None:
        size = 2 * knots
        self.band, self.border = np.zeros((5, size)), np.zeros((size, 4))
        self.prior, costs = sigmas**-2, (shared / sigmas) ** 2
        if erring:
            biases = costs[2:] / _FREEDOM
            self.prior[2:] /= 1.0 + biases
            costs[2:] = _FREEDOM * np.log1p(biases)
        self.corner, self.right_shared = np.diag(self.prior), -shared * self.prior
        self.right = np.zeros(size)
        self.cost = 0.5 * float(costs.sum())

    def add(
        self,
        at: _Knots,
        by_place: FloatArray,
        device: int,
        by_shared: FloatArray,
        residual: FloatArray,
        sigma: FloatArray,
    ) -> None:
        """Take in readings.

        Args:
            at: the knots between which each is.
            by_place: derivative by the target's place, (n, 2).
            device: 0 for the gimbal, 1 for the laser.
            by_shared: derivatives by the device's delay and by its bias, (n, 2).
            residual: of each, m.
            sigma: noise of each, m.
        """
        own = slice(device, None, 2)
        border, corner, right_shared = self.border[:, own], self.corner[own, own], self.right_shared[own]
        self.cost += add_readings(
            *at, by_place, by_shared, residual, sigma, _FREEDOM, self.band, border, self.right, corner, right_shared
        )

    def hold_straight(self, path: FloatArray, scale_m2: float, robust: bool) -> None:
        """Take in that the target's velocity seldom changes."""
        self.cost += add_turns(path, scale_m2, _FREEDOM, robust, self.band, self.right)

    def solved(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the steps of the knots (n, 2) and of the shared numbers (4,), and these' information (4, 4)."""
        self.band[4] += 1e-9
        found = solve_banded(self.band, np.column_stack([self.right, self.border]))
        information = self.corner - self.border.T @ found[:, 1:]
        step = np.linalg.solve(information, self.right_shared - self.border.T @ found[:, 0]).astype(float, copy=False)
        return (found[:, 0] - found[:, 1:] @ step).reshape(-1, 2), step, information


class Scene:
    """The readings of one fit."""

    def __init__(
        self,
        positions: FloatArray,
        attitudes: FloatArray,
        gimbals: FloatArray,
        ranges: FloatArray,
        frame: str,
        noise: tuple[float, float],
        on_ground: tuple[float, float] | None = None,
    ) -> None:
        """on_ground: what is unknown of the pitch, rad, and of the ground's height, m; None: they are a laser's."""
        self._on_ground = on_ground
        self._positions, self._frame = positions, frame
        self._yaw_sigma_rad, self._range_sigma_m = noise
        self._angles, self._attitude_s, self._yaw_rate = np.zeros((0, 3)), np.zeros(0), np.zeros(0)
        if frame != "earth":
            self._attitude_s = attitudes[:, 0]
            self._angles = np.unwrap(attitudes[:, 1:], axis=0)
            self._yaw_rate = np.gradient(self._angles[:, 2], self._attitude_s)
        self._sight_s, self._sights = gimbals[:, 0], gimbals[:, 1:]
        self._azimuth = np.arctan2(gimbals[:, 2], gimbals[:, 1])
        self._range_s, self._slant_m = ranges.T
        self._begin_s = min(self._sight_s[0], self._range_s[0]) - MAX_DELAY_S
        end_s = max(self._sight_s[-1], self._range_s[-1]) - MIN_DELAY_S
        self._knots = math.ceil((end_s - self._begin_s) / _KNOT_S) + 2

    def solve(
        self, sigmas: FloatArray, start: FloatArray, scale_m: float = STIFF_M, *, settled: bool, erring: bool = False
    ) -> Fit:
        """Return the best fit near a start.

        Args:
            sigmas: of the priors, (4,).
            start: shared numbers to start from, (4,).
            scale_m: size of the target's turns to start from.
            settled: whether that is known. If not, the path is held nearly straight at first: a path free to bend
                would circle with the aircraft and leave the delays nothing to explain.
            erring: whether the biases may be far beyond their priors, which then follow Student's distribution.
        """
        shared, scale_m2 = start.copy(), scale_m**2
        path = self._first_path(shared)
        step, information, cost = np.zeros(4), np.zeros((4, 4)), math.inf
        for iteration in range(_ITERATIONS_MAX):
            free = settled or iteration >= _STIFF_ITERATIONS
            if free:
                scale_m2 = _scale_m2(path, scale_m2)
            normal = _Normal(self._knots, shared, sigmas, erring=erring)
            self._add_sights(normal, shared, path)
            self._add_ranges(normal, shared, path)
            normal.hold_straight(path, scale_m2, free)
            cost = normal.cost
            if free and iteration and abs(step[:2]).max() < _SETTLED_S:
                break
            moved, step, information = normal.solved()
            information -= np.diag(normal.prior)
            path = path + moved
            shared = shared + step
            shared[:2] = np.clip(shared[:2], MIN_DELAY_S, MAX_DELAY_S)
        return Fit(shared, math.sqrt(scale_m2), information, cost)

    def _add_sights(self, normal: _Normal, shared: FloatArray, path: FloatArray) -> None:
        time_s = self._sight_s - shared[0]
        bearing, _ = self._directions(time_s)
        east, north = np.sin(bearing), np.cos(bearing)
        way, speed, at = self._way(path, time_s)
        ahead_m = way[:, 0] * east + way[:, 1] * north
        turning = speed[:, 1] * east - speed[:, 0] * north
        if self._frame != "earth":
            turning += ahead_m * np.interp(time_s, self._attitude_s, self._yaw_rate)
        residual = way[:, 0] * north - way[:, 1] * east + ahead_m * shared[2]
        across, by_shared = np.column_stack([north, -east]), np.column_stack([turning, ahead_m])
        sigma = self._yaw_sigma_rad * np.where(abs(ahead_m) < _NEAR_M, _NEAR_M, ahead_m)
        normal.add(at, across, 0, by_shared, residual, sigma)

    def _add_ranges(self, normal: _Normal, shared: FloatArray, path: FloatArray) -> None:
        time_s = self._range_s - shared[1]
        sine = np.interp(time_s, self._sight_s - shared[0], self._directions(self._sight_s - shared[0])[1])
        way, speed, at = self._way(path, time_s)
        distance_m = np.hypot(way[:, 0], way[:, 1])
        toward = way / np.maximum(distance_m, _NEAR_M)[:, None]
        residual = distance_m - self._slant_m * np.sqrt(np.maximum(1.0 - sine * sine, 0.0)) + shared[3]
        closing = -(toward * speed).sum(axis=1)
        if self._on_ground is not None:
            pitch_sigma_rad, height_sigma_m = self._on_ground
            sigma = np.hypot(self._slant_m * pitch_sigma_rad, height_sigma_m) / np.maximum(sine, _SINE_MIN)
        else:
            sigma = np.hypot(self._range_sigma_m, self._slant_m * sine * self._yaw_sigma_rad)
        by_shared = np.column_stack([closing, np.ones_like(closing)])
        normal.add(at, toward, 1, by_shared, residual, sigma)

    def _way(self, path: FloatArray, time_s: FloatArray) -> tuple[FloatArray, FloatArray, _Knots]:
        """Return way and relative velocity (n, 2) from the aircraft to the target, and the knots between which."""
        way, speed, knot, past = way_at(self._positions, path, self._begin_s, _KNOT_S, time_s)
        return way, speed, (knot, past)

    def _directions(self, time_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return bearing and sine of the depression, (n,) each, of the lines of sight if they were made at times."""
        x, y, z = self._sights.T
        if self._frame == "earth":
            return self._azimuth, z
        roll, pitch, yaw = (np.interp(time_s, self._attitude_s, angle) for angle in self._angles.T)
        if self._frame == "vehicle":
            return yaw + self._azimuth, z
        y, z = np.cos(roll) * y - np.sin(roll) * z, np.sin(roll) * y + np.cos(roll) * z
        x, z = np.cos(pitch) * x + np.sin(pitch) * z, np.cos(pitch) * z - np.sin(pitch) * x
        return yaw + np.arctan2(y, x), z

    def _first_path(self, shared: FloatArray) -> FloatArray:
        """Return the path (n, 2) through the places that the readings give."""
        time_s, sight_s = self._range_s - shared[1], self._sight_s - shared[0]
        bearing, sine = self._directions(sight_s)
        bearing, sine = np.interp(time_s, sight_s, np.unwrap(bearing)), np.interp(time_s, sight_s, sine)
        level_m = self._slant_m * np.sqrt(np.maximum(1.0 - sine * sine, 0.0))
        aircraft, _ = aircraft_at(self._positions, time_s)
        place = aircraft + level_m[:, None] * np.stack([np.sin(bearing), np.cos(bearing)], axis=1)
        knots_s = self._begin_s + _KNOT_S * np.arange(self._knots)
        return np.stack([np.interp(knots_s, time_s, axis) for axis in place.T], axis=1)


def _scale_m2(path: FloatArray, scale_m2: float) -> float:
    """Return the variance of the path's turns on each axis, by one step from the last."""
    turns = path[2:] - 2 * path[1:-1] + path[:-2]
    squared = (turns * turns).sum(axis=1)
    weight = (_FREEDOM + 2) / (_FREEDOM + squared / scale_m2)
    return max(float((weight * squared).mean()) / 2, _STIFFEST_M**2)

"""The worth of a place and heading beside the target: expected future cost of going on as well as can be.

V(class, heading, x, y) is the discounted cost of flying on from there, from the clockwise circle, by the best moves,
in the watch frame of :mod:`mission.cost`. A class is a velocity of the target in that frame. The target keeps its
velocity until it turns (a Poisson event); the value after a turn averages over where it may go then. One table
serves both sides, by mirroring. :mod:`mission.value_iteration` computes it once per configuration; the shell keeps
it in a file named by ``configuration.key()``.
"""

from __future__ import annotations

import hashlib
import math
from dataclasses import asdict, dataclass, field

import numpy as np
import numpy.typing as npt

from mission.cost import WatchCost
from mission.path import FloatArray

Float32 = npt.NDArray[np.float32]

HEADINGS = 24
HEADING_STEP_RAD = 2.0 * math.pi / HEADINGS
_BEYOND_BAND_M = 75.0  # the grid reaches this far past the far edge
_SPEEDS = (0.0, 0.5, 1.0)  # rings of classes, as shares of the target's greatest speed
_DIRECTIONS = 8  # classes on each ring where the frame does not turn with the target
_VERSION = "1"  # of the way the table is computed; part of its key


@dataclass(frozen=True, slots=True)
class TargetHabits:
    """How a target moves: about every mean_leg_s it stops (chance ``stop``), or turns and draws another speed.

    Half of the moving legs are at its greatest speed, the others uniform between least_speed (a share of the
    greatest) and that.
    """

    mean_leg_s: float = 120.0
    stop: float = 1.0 / 3.0
    least_speed: float = 0.2
    turns_deg: tuple[float, ...] = (-90.0, -45.0, -20.0, 0.0, 20.0, 45.0, 90.0, 180.0)
    chances: tuple[float, ...] = (0.12, 0.15, 0.15, 0.10, 0.15, 0.15, 0.12, 0.06)

    def speed_weights(self) -> Float32:
        """Return the chances of the rings in a moving leg, (3,), by linear interpolation between them."""
        speeds = np.append(np.linspace(self.least_speed, 1.0, 101), np.ones(101))
        return np.stack([np.interp(speeds, _SPEEDS, row).mean() for row in np.eye(3)]).astype(np.float32)


@dataclass(frozen=True, slots=True)
class TableConfiguration:
    """All that the table depends on. follows_course: the frame turns with the target (a side, not a sector).

    ramp_1_m2 is that of the transitions in still air. cells: of the grid, from the target to its edge (even).
    improvements: of the policy, on the coarse grid and on the fine one.
    """

    airspeed_m_s: float
    radius_m: float
    ramp_1_m2: float
    target_speed_max_m_s: float
    cost: WatchCost
    follows_course: bool = True
    habits: TargetHabits = field(default_factory=TargetHabits)
    discount_1_s: float = 0.005
    leave_cost: float = 0.5
    cells: int = 28
    improvements: tuple[int, int] = (8, 5)

    def key(self) -> str:
        """Return a hash of everything that shapes the table."""
        return hashlib.sha256(f"{_VERSION} {sorted(asdict(self).items())}".encode()).hexdigest()[:24]

    @property
    def half_width_m(self) -> float:
        """Half the side of the square that the grid covers."""
        return self.cost.far_m + _BEYOND_BAND_M

    def velocities_m_s(self) -> FloatArray:
        """Return the classes' target velocities (classes, 2) in the watch frame: x right, y ahead."""
        speeds = np.array(_SPEEDS) * self.target_speed_max_m_s
        if self.follows_course:
            return np.stack([np.zeros(3), speeds], axis=1)
        angle = np.arange(_DIRECTIONS) * 2.0 * math.pi / _DIRECTIONS
        ring = np.stack([np.sin(angle), np.cos(angle)], axis=1)
        return np.concatenate([np.zeros((1, 2)), speeds[1] * ring, speeds[2] * ring])


@dataclass(frozen=True, slots=True, eq=False)
class ValueTable:
    """values, after_turn: (classes, headings, n, n), axes x then y. after_turn is the expectation at a turn."""

    configuration: TableConfiguration
    values: Float32
    after_turn: Float32

    def for_velocity(self, velocity_x_m_s: float, velocity_y_m_s: float) -> MotionTable:
        """Return the table of a target's velocity in the watch frame, interpolated between the classes."""
        c = self.configuration
        values, after_turn = np.zeros_like(self.values[0]), np.zeros_like(self.values[0])
        for which, weight in self._class_weights(velocity_x_m_s, velocity_y_m_s).items():
            values += np.float32(weight) * self.values[which]
            after_turn += np.float32(weight) * self.after_turn[which]
        cell_m = 2.0 * c.half_width_m / (self.values.shape[-1] - 1)
        return MotionTable(cell_m, values, after_turn, c.discount_1_s, c.habits.mean_leg_s)

    def _class_weights(self, velocity_x_m_s: float, velocity_y_m_s: float) -> dict[int, float]:
        share = min(math.hypot(velocity_x_m_s, velocity_y_m_s) / self.configuration.target_speed_max_m_s, 1.0)
        ring = 0 if share < _SPEEDS[1] else 1
        outer = (share - _SPEEDS[ring]) / (_SPEEDS[ring + 1] - _SPEEDS[ring])
        if self.configuration.follows_course:
            return {ring: 1.0 - outer, ring + 1: outer}
        direction = math.atan2(velocity_x_m_s, velocity_y_m_s) / (2.0 * math.pi) * _DIRECTIONS % _DIRECTIONS
        first, past = int(direction) % _DIRECTIONS, direction - int(direction)
        weights: dict[int, float] = {}
        for which, weight in ((ring, 1.0 - outer), (ring + 1, outer)):
            if which == 0:
                weights[0] = weight
            else:
                weights[_class(which, first)] = weight * (1.0 - past)
                weights[_class(which, first + 1)] = weight * past
        return weights


def _class(ring: int, direction: int) -> int:
    return 1 + (ring - 1) * _DIRECTIONS + direction % _DIRECTIONS


@dataclass(frozen=True, slots=True, eq=False)
class MotionTable:
    """The table for one velocity of the target: arrays (headings, n, n)."""

    cell_m: float
    values: Float32
    after_turn: Float32
    discount_1_s: float
    mean_leg_s: float

    def value(self, x_m: npt.ArrayLike, y_m: npt.ArrayLike, heading_rad: npt.ArrayLike) -> Float32:
        """Return V at places and headings of the watch frame; beyond the grid that of its edge."""
        return _looked_up(self.values, self.cell_m, x_m, y_m, heading_rad)

    def expected_after_turn(self, x_m: npt.ArrayLike, y_m: npt.ArrayLike, heading_rad: npt.ArrayLike) -> Float32:
        """Return the expected V if the target turned now."""
        return _looked_up(self.after_turn, self.cell_m, x_m, y_m, heading_rad)


def _looked_up(
    table: Float32, cell_m: float, x_m: npt.ArrayLike, y_m: npt.ArrayLike, heading_rad: npt.ArrayLike
) -> Float32:
    n = table.shape[-1]
    x = np.clip(np.asarray(x_m, np.float32) / np.float32(cell_m) + (n - 1) / 2, 0.0, n - 1.001)
    y = np.clip(np.asarray(y_m, np.float32) / np.float32(cell_m) + (n - 1) / 2, 0.0, n - 1.001)
    heading = (np.asarray(heading_rad) / HEADING_STEP_RAD % HEADINGS).astype(np.float32)
    i, j, k = x.astype(np.int64), y.astype(np.int64), heading.astype(np.int64)
    across, along, turn = x - i, y - j, heading - k
    flat = table.ravel()
    total = np.zeros(np.broadcast_shapes(x.shape, y.shape, heading.shape), np.float32)
    for plane, weight in ((k % HEADINGS, 1.0 - turn), ((k + 1) % HEADINGS, turn)):
        base = plane * (n * n) + i * n + j
        low = flat[base] * (1.0 - along) + flat[base + 1] * along
        high = flat[base + n] * (1.0 - along) + flat[base + n + 1] * along
        total += weight * (low * (1.0 - across) + high * across)
    return total


def completed(configuration: TableConfiguration, values: Float32) -> ValueTable:
    """Return the table of stored values. Raises ValueError when they are not of this configuration."""
    n = 2 * configuration.cells + 1
    shape = (len(configuration.velocities_m_s()), HEADINGS, n, n)
    if values.shape != shape or not np.isfinite(values).all():
        raise ValueError(f"values: expected finite numbers of shape {shape}, found shape {values.shape}")
    return ValueTable(configuration, values, expected_after_turn(configuration, values))


def expected_after_turn(configuration: TableConfiguration, values: Float32) -> Float32:
    """Return the expectation of V over the target's next leg, for each class: same shape as ``values``."""
    habits = configuration.habits
    weights = habits.speed_weights()
    out = np.empty_like(values)
    if configuration.follows_course:
        # A stop leaves the course, and with it the side, as it was.
        out[:] = habits.stop * values[0] + (1.0 - habits.stop) * _turned_frame(
            habits, np.tensordot(weights, values, 1)
        )
        return out
    rings = values[1:].reshape(2, _DIRECTIONS, *values.shape[1:])
    moving = weights[0] * values[0] + weights[1] * rings[0] + weights[2] * rings[1]
    out[0] = habits.stop * values[0] + (1.0 - habits.stop) * moving.mean(axis=0)
    out[1:] = np.tile(habits.stop * values[0] + (1.0 - habits.stop) * _turned_class(habits, moving), (2, 1, 1, 1))
    return out


def _turned_frame(habits: TargetHabits, moving: Float32) -> Float32:
    """Return V (headings, n, n) averaged over turns of a frame that follows the target's course."""
    n = moving.shape[-1]
    axis = np.arange(n) - (n - 1) / 2
    x, y = axis[:, None], axis[None, :]
    heading = np.arange(HEADINGS)[:, None, None] * HEADING_STEP_RAD
    total = np.zeros_like(moving)
    for turn_deg, chance in zip(habits.turns_deg, habits.chances, strict=True):
        sin_t, cos_t = math.sin(math.radians(turn_deg)), math.cos(math.radians(turn_deg))
        # The frame turns clockwise: what is seen from it turns the other way.
        total += np.float32(chance) * _looked_up(
            moving, 1.0, x * cos_t - y * sin_t, x * sin_t + y * cos_t, heading - math.radians(turn_deg)
        )
    return total


def _turned_class(habits: TargetHabits, moving: Float32) -> Float32:
    """Return V (directions, headings, n, n) averaged over turns of a target in a frame that stays."""
    total = np.zeros_like(moving)
    for turn_deg, chance in zip(habits.turns_deg, habits.chances, strict=True):
        steps = turn_deg / 360.0 * _DIRECTIONS
        whole = math.floor(steps)
        total += np.float32(chance * (1.0 - steps + whole)) * np.roll(moving, -whole, axis=0)
        total += np.float32(chance * (steps - whole)) * np.roll(moving, -whole - 1, axis=0)
    return total

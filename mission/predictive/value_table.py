"""The value of a position and heading next to the target: expected future cost of going on as well as can be.

V(class, heading, x, y) is the discounted cost of flying on from there, from the clockwise circle, by the best moves,
in the watch frame of :mod:`sidelong.mission.predictive.cost`. A class is velocities of target and wind in that frame.
The target keeps its velocity until it turns (a Poisson event); the value after a turn averages over where it may go
then. One table serves both sides, by mirroring. :mod:`sidelong.mission.predictive.value_iteration` computes it once
per configuration; the shell keeps it in a file named by ``configuration.key()``.

Source: docs/explanation/planners.md#the-predictive-planner; docs/decisions/0009-value-table.md.
"""

from __future__ import annotations

import hashlib
import math
from dataclasses import asdict, dataclass, field

import numpy as np
import numpy.typing as npt

from sidelong.mission.core.path import FloatArray
from sidelong.mission.predictive.cost import WatchCost
from sidelong.mission.predictive.cost_kernel import Table
from sidelong.mission.predictive.scene_kernel import Motions
from sidelong.mission.predictive.value_kernel import add_turned

Float32 = npt.NDArray[np.float32]

HEADINGS = 24
HEADING_STEP_RAD = 2.0 * math.pi / HEADINGS
_BEYOND_BAND_M = 75.0  # the grid reaches this far past the far edge
_SPEEDS = (0.0, 0.5, 1.0)  # rings of classes, as shares of the target's greatest speed
# Classes on each ring: of the target's motion where the frame does not turn with it, else of the wind, if any.
_TARGET_DIRECTIONS, _WIND_DIRECTIONS = 8, 4
_VERSION = "2"  # of the way the table is computed; part of its key


@dataclass(frozen=True, slots=True)
class TargetHabits:
    """How a target moves: about every mean_leg_s it stops (chance ``stop``), or turns and draws another speed.

    Half of the moving legs are at its greatest speed, the others uniform between least_speed (a share of the
    greatest) and that.
    """

    mean_leg_s: float = 120.0
    stop: float = 1.0 / 3.0
    min_speed: float = 0.2
    turns_deg: tuple[float, ...] = (-90.0, -45.0, -20.0, 0.0, 20.0, 45.0, 90.0, 180.0)
    chances: tuple[float, ...] = (0.12, 0.15, 0.15, 0.10, 0.15, 0.15, 0.12, 0.06)

    def speed_weights(self) -> Float32:
        """Return the chances of the rings in a moving leg, (3,), by linear interpolation between them."""
        speeds = np.append(np.linspace(self.min_speed, 1.0, 101), np.ones(101))
        return np.stack([np.interp(speeds, _SPEEDS, row).mean() for row in np.eye(3)]).astype(np.float32)


@dataclass(frozen=True, slots=True)
class TableConfiguration:
    """All that the table depends on. follows_course: the frame turns with the target (a side, not a sector).

    turn_radius_m and sharpness_per_m2 are those of the transitions, in still air. cells: of the grid, from the target
    to its edge (even). improvements: of the policy, on the coarse grid and on the fine one.
    """

    airspeed_m_s: float
    radius_m: float
    turn_radius_m: float
    sharpness_per_m2: float
    target_speed_max_m_s: float
    cost: WatchCost
    follows_course: bool = True
    habits: TargetHabits = field(default_factory=TargetHabits)
    wind_speed_m_s: float = 0.0
    discount_per_s: float = 0.005
    leave_cost: float = 4.0
    cells: int = 28
    improvements: tuple[int, int] = (8, 5)

    def key(self) -> str:
        """Return a hash of everything that shapes the table."""
        return hashlib.sha256(f"{_VERSION} {sorted(asdict(self).items())}".encode()).hexdigest()[:24]

    @property
    def shape(self) -> tuple[int, int, int, int]:
        """Shape of the table: classes, headings, and the square grid."""
        n = 2 * self.cells + 1
        return len(self.classes()[0]), HEADINGS, n, n

    @property
    def half_width_m(self) -> float:
        """Half the side of the square that the grid covers."""
        return self.cost.far_m + _BEYOND_BAND_M

    def classes(self) -> tuple[FloatArray, FloatArray]:
        """Return the classes' velocities of target and wind, (classes, 2) each, in the watch frame: x right, y ahead.

        Where the frame turns with the target the wind has every direction in it; else the target has.
        """
        speeds = np.array(_SPEEDS) * self.target_speed_max_m_s
        if not self.follows_course:
            ring = _ring(_TARGET_DIRECTIONS)
            targets = np.concatenate([np.zeros((1, 2)), speeds[1] * ring, speeds[2] * ring])
            return targets, np.zeros_like(targets)
        targets = np.stack([np.zeros(3), speeds], axis=1)
        if self.wind_speed_m_s == 0.0:
            return targets, np.zeros_like(targets)
        winds = self.wind_speed_m_s * _ring(_WIND_DIRECTIONS)
        return np.repeat(targets, _WIND_DIRECTIONS, axis=0), np.tile(winds, (3, 1))


def _ring(directions: int) -> FloatArray:
    """Return unit vectors (directions, 2), the first one ahead, the others clockwise."""
    angle = np.arange(directions) * 2.0 * math.pi / directions
    return np.stack([np.sin(angle), np.cos(angle)], axis=1)


@dataclass(frozen=True, slots=True, eq=False)
class ValueTable:
    """values, after_turn: (classes, headings, n, n), axes x then y. after_turn is the expectation at a turn."""

    configuration: TableConfiguration
    values: Float32
    after_turn: Float32

    @property
    def arrays(self) -> Table:
        """The table as the loops see it."""
        c = self.configuration
        cell_m = 2.0 * c.half_width_m / (self.values.shape[-1] - 1)
        return Table(self.values, self.after_turn, cell_m, c.discount_per_s, c.habits.mean_leg_s)

    @property
    def motions(self) -> Motions:
        """How its classes are arranged."""
        c = self.configuration
        return Motions(
            c.follows_course, c.wind_speed_m_s, c.target_speed_max_m_s, _WIND_DIRECTIONS, _TARGET_DIRECTIONS
        )


def completed(configuration: TableConfiguration, values: Float32) -> ValueTable:
    """Return the table of stored values.

    Raises:
        ValueError: The values are not of this configuration.
    """
    shape = configuration.shape
    if values.shape != shape or not np.isfinite(values).all():
        raise ValueError(f"values: expected finite numbers of shape {shape}, found shape {values.shape}")
    return ValueTable(configuration, values, expected_after_turn(configuration, values))


def expected_after_turn(configuration: TableConfiguration, values: Float32) -> Float32:
    """Return the expectation of V over the target's next leg, for each class: same shape as ``values``.

    Args:
        values: Values, one array for each class of motion.
    """
    habits = configuration.habits
    weights = habits.speed_weights()
    if configuration.follows_course:
        # Rings first, then directions of the wind. A stop leaves the course, and with it the side, as it was.
        rings = values.reshape(len(_SPEEDS), -1, *values.shape[1:])
        turned = _turned_frame(habits, np.tensordot(weights, rings, axes=1))
        expected = habits.stop * rings[0] + (1.0 - habits.stop) * turned
        return np.tile(expected, (len(_SPEEDS), 1, 1, 1))
    outer = values[1:].reshape(2, _TARGET_DIRECTIONS, *values.shape[1:])
    moving = weights[0] * values[0] + weights[1] * outer[0] + weights[2] * outer[1]
    standing = habits.stop * values[0] + (1.0 - habits.stop) * moving.mean(axis=0)
    turned = np.zeros_like(moving)
    for turn_deg, chance in zip(habits.turns_deg, habits.chances, strict=True):
        turned += np.float32(chance) * _rolled(moving, -turn_deg / 360.0 * _TARGET_DIRECTIONS)
    turned = habits.stop * values[0] + (1.0 - habits.stop) * turned
    return np.concatenate([standing[None], np.tile(turned, (2, 1, 1, 1))])


def _turned_frame(habits: TargetHabits, moving: Float32) -> Float32:
    """Return V (directions of the wind, headings, n, n) averaged over turns of a frame that follows the course."""
    total = np.zeros_like(moving)
    for turn_deg, chance in zip(habits.turns_deg, habits.chances, strict=True):
        # The frame turns clockwise: places, headings and the wind, as seen from it, turn the other way.
        seen = _rolled(moving, turn_deg / 360.0 * _WIND_DIRECTIONS) if len(moving) > 1 else moving
        for direction, values in enumerate(seen):
            add_turned(total[direction], values, chance, math.radians(turn_deg), HEADING_STEP_RAD)
    return total


def _rolled(classes: Float32, steps: float) -> Float32:
    """Return classes (directions, ...) moved on by a number of directions: at d what was at d - steps."""
    whole = math.floor(steps)
    past, before = np.float32(steps - whole), np.roll(classes, whole, axis=0)
    if past == 0.0:
        return before
    return (np.float32(1.0) - past) * before + past * np.roll(classes, whole + 1, axis=0)

"""The value of a position and heading next to the target: expected future cost of going on as well as can be.

The cost is counted in seconds off the chosen side, in the watch frame: origin at the target, x to the right of the
watch course, y ahead. The watch course is the target's (held through stops), mirrored for the right side, so that the
side to be on is always the left one, x < 0. For a compass sector it is the course whose left normal is the middle of
the sector.

V(class, heading, x, y) is the discounted cost of flying on from there, from the clockwise circle, by the best moves.
A class is velocities of target and wind in that frame. The target keeps its velocity until it turns (a Poisson
event); the value after a turn averages over where it may go then. One table serves both sides, by mirroring. It is
computed once per configuration; the shell keeps it in a file named by ``configuration.key()``.

Value iteration improves the policy, then evaluates it several times, cheaply. On a grid of places every move
displaces all places alike, so its backup is a shifted copy of the table: one improvement costs a few slices for each
(class, heading, move). An evaluation is one gather. A coarse grid first, then the fine one; see ``value_kernel``.

Source: docs/explanation/planners.md#cost, #the-predictive-planner; docs/decisions/0009-value-table.md; Puterman and
Shin, "Modified policy iteration algorithms for discounted Markov decision problems", Management Science 24(11), 1978;
Chow and Tsitsiklis, "An optimal one-way multigrid algorithm for discrete-time stochastic control", IEEE Transactions
on Automatic Control 36(8), 1991.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable
from dataclasses import asdict, dataclass, field

import numpy as np
import numpy.typing as npt

from sidelong.mission.core.path import FloatArray
from sidelong.mission.core.requirement import Wind
from sidelong.mission.geometry.line_kernel import ARC, LinePoint, circle_after, displaced_m, line_at, trapezoid
from sidelong.mission.geometry.progress import ground_speeds_m_s
from sidelong.mission.predictive import value_kernel as kernel
from sidelong.mission.predictive.moves_kernel import EIGHTS, MOVES, STAY_LENGTHS, eight_line, move_from
from sidelong.mission.predictive.rollout_kernel import CostTerms, Table, blind_rates, cost_rates
from sidelong.mission.predictive.scene_kernel import Motions

Float32 = npt.NDArray[np.float32]
# Outside the band one second costs as much as this many off the side, and more the further out.
_OUTSIDE, _OUTSIDE_PER_M = 20.0, 0.5
# Inside the band the cost rises towards its edges over this width, to _WALL at the edge.
_WALL_WIDTH_M, _WALL = 20.0, 2.0
# The planner keeps this far inside the required band: the aircraft's own error and what it learns too late.
_MARGIN_M = 15.0
# In wind the ground speed differs from the plan's: this much more margin for each m/s, up to twice the margin.
_MARGIN_IN_WIND_S = 3.0
# A target may turn towards the aircraft: the margin at the near edge is what the fastest one covers in this time.
_MARGIN_OF_TARGET_S = 1.8

# The planner keeps the target this far inside the pan limits. Just beyond them, a second costs as much as _BLIND
# seconds off the side. Far beyond them, where the payload's tracker loses the target, _LOST is added: its values are
# for circles of these shares of the band, because a figure of eight with wide circles takes more side and room.
_PAN_MARGIN_RAD, _BLIND = math.radians(2.0), 2.5
_LOST, _LOST_SHARES = (20.0, 0.0), (0.1, 1.0 / 3.8)


@dataclass(frozen=True, slots=True)
class WatchCost:
    """What a position next to the target costs: the planner's one measure.

    near_m..far_m: the band to keep. half_width_rad: of the watched sector about the normal; pi/2 is a side.
    pan_limit_rad: of the gimbal, to each side of the nose; pi: it looks all around. lost: what a second far beyond
    costs more than one just beyond.
    """

    near_m: float
    far_m: float
    half_width_rad: float = math.pi / 2
    pan_limit_rad: float = math.pi
    lost: float = 0.0

    @staticmethod
    def inside(
        range_min_m: float,
        range_max_m: float,
        half_width_rad: float = math.pi / 2,
        wind_speed_m_s: float = 0.0,
        target_speed_max_m_s: float = 0.0,
        pan_limit_rad: float = math.pi,
        radius_m: float = 0.0,
    ) -> WatchCost:
        """Return the cost of a required band, with the planner's margins: wider in wind, and near a fast target.

        radius_m: of the circles; needed with a pan limit.
        """
        margin_m = _MARGIN_M + min(_MARGIN_IN_WIND_S * wind_speed_m_s, _MARGIN_M)
        near_m = range_min_m + max(margin_m, _MARGIN_OF_TARGET_S * target_speed_max_m_s)
        far_m = range_max_m - margin_m
        if pan_limit_rad >= math.pi:
            return WatchCost(near_m, far_m, half_width_rad)
        lost = float(np.interp(radius_m / (range_max_m - range_min_m), _LOST_SHARES, _LOST))
        return WatchCost(near_m, far_m, half_width_rad, pan_limit_rad - _PAN_MARGIN_RAD, lost)

    def rate(
        self, x_m: FloatArray, y_m: FloatArray, widened_m: npt.ArrayLike = 0.0, side_blur_m: npt.ArrayLike = 1.0
    ) -> FloatArray:
        """Return the cost per second at places of the watch frame.

        It is the chance of being off the side, 0..1, and the walls at the edges of the band. widened_m moves both
        edges inwards, never beyond a half of the band's width; the sides' border is blurred over +-side_blur_m (> 0).
        """
        arrays = np.broadcast_arrays(x_m, y_m, widened_m, side_blur_m)
        rate = np.empty(arrays[0].shape)
        x, y, widened, blur = (a.astype(np.float64).ravel() for a in arrays)
        cost_rates(x, y, widened, blur, self.terms, rate.ravel())
        return rate

    @property
    def terms(self) -> CostTerms:
        """The cost as the compiled functions take it."""
        walls = _OUTSIDE, _OUTSIDE_PER_M, _WALL_WIDTH_M, _WALL
        blind = _BLIND if self.pan_limit_rad < math.pi else 0.0
        side, pan = math.cos(self.half_width_rad), math.cos(self.pan_limit_rad)
        return CostTerms(self.near_m, self.far_m, side, *walls, pan, blind, self.lost)


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
        """The table as the compiled functions take it."""
        c = self.configuration
        cell_m = 2.0 * c.half_width_m / (self.values.shape[-1] - 1)
        return Table(self.values, self.after_turn, cell_m, c.discount_per_s, c.habits.mean_leg_s)

    @property
    def motions(self) -> Motions:
        """The arrangement of the table's classes by the motions of target and wind."""
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
    """Return the expectation of V over the target's next leg, for each class: same shape as ``values``."""
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
            kernel.add_turned(total[direction], values, chance, math.radians(turn_deg), HEADING_STEP_RAD)
    return total


def _rolled(classes: Float32, steps: float) -> Float32:
    """Return classes (directions, ...) moved on by a number of directions: at d what was at d - steps."""
    whole = math.floor(steps)
    past, before = np.float32(steps - whole), np.roll(classes, whole, axis=0)
    if past == 0.0:
        return before
    return (np.float32(1.0) - past) * before + past * np.roll(classes, whole + 1, axis=0)


Progress = Callable[[float], None]

_EVALUATIONS = 9  # after each improvement
_TURN_EVERY = 3  # evaluations between two updates of the expectation after a turn
_COST_PER_CELL = 4  # the running cost has a finer grid of its own
_COST_HEADINGS = 36  # of the running cost, where it depends on them
_SAMPLES_PER_CELL = 2  # of a move's running cost
# Turns of the target on the way count at the Gauss nodes of each move.
_NODES = np.array([0.5 - math.sqrt(0.15), 0.5, 0.5 + math.sqrt(0.15)])
_NODE_WEIGHTS = np.array([5.0, 8.0, 5.0]) / 18.0


def compute(configuration: TableConfiguration, progress: Progress = lambda _share: None) -> ValueTable:
    """Return the table.

    Args:
        progress: Called with the share 0..1 of the work that is done.
    """
    half_m, cells, (coarse, fine) = configuration.half_width_m, configuration.cells, configuration.improvements
    share = (coarse + 2.0) / (coarse + 2.0 + 5.0 * (fine + 2.0))
    values = np.zeros((*configuration.shape[:2], cells + 1, cells + 1), np.float32)
    values = _solved(configuration, half_m / (cells // 2), values, coarse, lambda part: progress(part * share))
    values = _halved_cells(values)
    values = _solved(configuration, half_m / cells, values, fine, lambda part: progress(share + part * (1.0 - share)))
    return completed(configuration, values)


def _halved_cells(values: Float32) -> Float32:
    """Interpolate linearly onto a grid of half the cell size."""
    for axis in (2, 3):
        n = values.shape[axis]
        middle = 0.5 * (values.take(range(n - 1), axis) + values.take(range(1, n), axis))
        values = np.insert(values, range(1, n), middle, axis=axis)
    return values


def _moves(c: TableConfiguration, step_m: float) -> tuple[list[float], list[FloatArray]]:
    """Return the prices of the moves from the circle, and each as flown from heading 0.

    Rows (4, 2 k + 1) of arc, east, north and course turned, at the ends and middles of k samples.
    """
    curvature_per_m, ramp_per_m2 = 1.0 / c.radius_m, c.sharpness_per_m2
    prices, moves = [], []
    # "Back to the circle at once", the last of the moves, is none when flown from the circle.
    leaving = [move_from(curvature_per_m, k, c.radius_m, c.turn_radius_m, ramp_per_m2) for k in range(MOVES - 1)]
    lengths_m = (STAY_LENGTHS * c.radius_m).tolist()
    staying = [trapezoid(curvature_per_m, curvature_per_m, m, curvature_per_m, ramp_per_m2) for m in lengths_m]
    for shapes, price in ((leaving, c.leave_cost), (staying, 0.0)):
        for shape in shapes:
            arc = np.linspace(0.0, shape.end_m, 2 * max(1, round(shape.end_m / step_m)) + 1)
            moves.append(np.vstack((arc, displaced_m(shape, arc))))
            prices.append(price)
    for eight in range(EIGHTS if c.cost.terms.blind > 0.0 else 0):
        line = eight_line(LinePoint(0.0, 0.0, 0.0, curvature_per_m), eight, c.radius_m, ramp_per_m2)
        length_m = float(line[ARC, -1])
        arc = np.linspace(0.0, length_m, 2 * max(1, round(length_m / step_m)) + 1)
        found = np.empty((3, arc.size))
        line_at(line, circle_after(line, c.radius_m), arc, 0.0, 0.0, found)
        moves.append(np.vstack((arc, found)))
        prices.append(c.leave_cost)
    return prices, moves


def _solved(c: TableConfiguration, cell_m: float, values: Float32, improvements: int, progress: Progress) -> Float32:
    """Return what value iteration makes of values on a grid of n x n places ``cell_m`` apart, about the target."""
    n, mean_leg_s = values.shape[-1], c.habits.mean_leg_s
    prices, moves = _moves(c, cell_m / _SAMPLES_PER_CELL)
    targets, winds = c.classes()
    headings_rad = HEADING_STEP_RAD * np.arange(HEADINGS, dtype=np.float64)
    for wind in winds:  # reports it where the wind is too strong
        ground_speeds_m_s(headings_rad, c.airspeed_m_s, Wind(*wind))
    ahead = 1.0 + c.target_speed_max_m_s / (c.airspeed_m_s - c.wind_speed_m_s)
    pad = math.ceil(max(float(move[0, -1]) for move in moves) * ahead / cell_m) + 2
    # Where each move leads, in cells and steps of heading, and what counts there: at three nodes and at its end.
    places = (len(targets), HEADINGS, len(moves))
    to_x, to_y, weight = (np.empty((*places, kernel.NODES)) for _ in range(3))
    own = np.empty((*places, n, n), np.float32)
    transitions = kernel.Transitions(to_x, to_y, np.empty((*places[1:], kernel.NODES)), weight, own)
    firsts = np.cumsum([0, *(move.shape[1] for move in moves)])
    samples = np.concatenate(moves, axis=1)
    rate_per_s = c.discount_per_s + 1.0 / mean_leg_s
    kernel.lay_out(
        kernel.MoveSamples(firsts, np.array(prices), samples, np.append(_NODES, 1.0), _NODE_WEIGHTS),
        kernel.FlightConditions(targets, winds, c.airspeed_m_s, HEADING_STEP_RAD, rate_per_s, mean_leg_s),
        kernel.CostGrid(_cost_grids(c.cost, cell_m, (n - 1) // 2 + pad), cell_m, _COST_PER_CELL, pad),
        transitions,
    )
    policy = np.empty(values.shape, np.int32)
    for k in range(improvements):
        progress((k + 1.0) / (improvements + 2.0))
        kernel.improve(values, expected_after_turn(c, values), transitions, pad, policy)
        values = _evaluated(c, values, transitions, policy)
    return values


def _cost_grids(cost: WatchCost, cell_m: float, cells: int) -> Float32:
    """Return the running cost on its finer grid, a part (k, k) for each heading and offset within a cell."""
    half = _COST_PER_CELL * cells
    axis = np.arange(-half, half + _COST_PER_CELL, dtype=np.float64) * (cell_m / _COST_PER_CELL)
    rate = cost.rate(axis[:, None], axis[None, :], 0.0, 0.5 * cell_m).astype(np.float32)
    rates, offsets = [rate], range(_COST_PER_CELL)
    if cost.terms.blind > 0.0:
        blind = np.empty((_COST_HEADINGS, *rate.shape))
        for k in range(_COST_HEADINGS):
            blind_rates(axis, math.tau / _COST_HEADINGS * k, cost.terms, blind[k])
        rates = list(rate + blind.astype(np.float32))
    parts = [[[one[a::_COST_PER_CELL, b::_COST_PER_CELL] for b in offsets] for a in offsets] for one in rates]
    return np.array(parts)


def _evaluated(
    c: TableConfiguration, values: Float32, transitions: kernel.Transitions, policy: npt.NDArray[np.int32]
) -> Float32:
    """Return the values after following the policy for some more moves."""
    led_to, parts = np.empty((values.size, 5), np.int32), np.empty((values.size, 7), np.float32)
    cost, fixed = np.empty(values.size, np.float32), np.empty(values.size, np.float32)
    kernel.follow(policy, transitions, led_to, parts, cost)
    found, classes, n = np.empty_like(values), len(values), values.shape[-1]
    for k in range(_EVALUATIONS):
        if k % _TURN_EVERY == 0:
            after = expected_after_turn(c, values)
            kernel.turns_cost(after.reshape(classes, -1), led_to, parts, cost, fixed)
        kernel.evaluate(values.reshape(classes, -1), n, led_to, parts, fixed, found.reshape(classes, -1))
        values, found = found, values
    return values

"""The inner loops of :mod:`mission.predictive.planner`: a look ahead from a scene, and the move that comes of it."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from estimators.compiled import compiled
from mission.core.path import FloatArray
from mission.core.requirement import GRAVITY_M_S2
from mission.geometry._line_kernel import (
    ARC,
    OFF_TRACK_M,
    OFF_TRACK_RAD,
    Circling,
    Craft,
    LinePoint,
    Trapezoid,
    arc_point,
    ground_speed_m_s,
    laid_out,
    line_at,
    nearest_arc_m,
    point_at,
    remainder,
    sharpness_per_m2,
    trapezoid,
    turned_rad,
    with_last_ramp,
)
from mission.predictive._cost_kernel import CostTerms, IntArray, Table
from mission.predictive._rollout_kernel import (
    Air,
    Doubt,
    Futures,
    Lines,
    line_cost,
    lines_costs,
    spread,
    times_s,
)
from mission.viewpoint._viewpoint_kernel import Known, Wish, velocity_sigma_m_s, viewpoint

STEP_S = 1.0
UNCERTAIN_M = 10.0
OTHER_WIND = 0.15  # of the airspeed
MIN_MOVE = 0.4  # of the radius: the length of a transition
# A ramp turns the aircraft by less than this either way.
RAMP_TURNS_RAD = (-0.5, -0.25, 0.0, 0.25, 0.5)
# A transition within this of its end counts as flown.
NEARLY_FLOWN_S = 0.2
# The moves, in units of the circle's radius, for a circle flown clockwise; mirrored for the other way round. Holds of
# curvature -1 turn the other way: that is how the aircraft gets round a target that turned back. "Back to the circle
# at once" is the last.
HOLD_CURVATURES = np.array([-1.0, -0.5, 0.0, 0.33, 0.66])
HOLD_LENGTHS = np.array([0.0, 0.2, 0.4, 0.6, 0.9, 1.2, 1.6, 2.1, 2.7, 3.4, 4.2, 5.2, 6.4, 8.0])
# How long the circle may be flown on before the next move.
STAY_LENGTHS = np.array([0.2, 0.6, 1.2, 2.0, 3.2, 4.8, 2.0 * math.pi])
MOVES = HOLD_CURVATURES.size * HOLD_LENGTHS.size + 1

_SPEED_RINGS = 3  # of the table's classes: standing, half and full speed


class Motions(NamedTuple):
    """How the table's classes are arranged: see :meth:`mission.predictive.value_table.TableConfiguration.classes`."""

    follows_course: bool
    wind_speed_m_s: float
    target_speed_max_m_s: float
    wind_directions: int
    target_directions: int


class Prices(NamedTuple):
    """In seconds off side: of leaving the circle, and of changing a plan under way."""

    leave: float
    change: float


class Scene(NamedTuple):
    """What one decision looks at: where the present plan will have led by the departure, and the target from there.

    The frame has its origin at the target and its y axis along the watch course; mirror is -1 where left and right
    are swapped. velocity and air are in the frame, start is in the plane. arc_m counts along the present plan as
    :mod:`mission.geometry.progress` does.
    """

    departure_s: float
    arc_m: float
    start: LinePoint
    frame_east_m: float
    frame_north_m: float
    course_rad: float
    mirror: float
    velocity_x_m_s: float
    velocity_y_m_s: float
    air: Air
    doubt: Doubt
    radius_m: float


class Kept(NamedTuple):
    """Sets of lines for still air, as many as there are slots, by what they depend on.

    used (slots + 1,): when each was asked for last, then the clock. Arrays (slots, ...) of the fields of Lines.
    """

    key: FloatArray
    used: IntArray
    size: IntArray
    samples: FloatArray
    trunk_first: IntArray
    own_first: IntArray
    trunk: IntArray
    on_trunk: IntArray
    end_m: FloatArray


_SLOTS, _SAMPLES_MAX = 12, 4096


def nothing_kept() -> Kept:
    """Return empty slots."""
    return Kept(
        np.zeros((_SLOTS, 7)),
        np.zeros(_SLOTS + 1, np.int64),
        np.zeros(_SLOTS, np.int64),
        np.zeros((_SLOTS, 5, _SAMPLES_MAX)),
        np.zeros((_SLOTS, HOLD_CURVATURES.size + 2), np.int64),
        np.zeros((_SLOTS, MOVES + 1), np.int64),
        np.zeros((_SLOTS, MOVES), np.int64),
        np.zeros((_SLOTS, MOVES), np.int64),
        np.zeros((_SLOTS, MOVES)),
    )


@compiled
def _ramp_on(heading_rad: float, air: Air, craft: Craft) -> float:
    """Return the ramp for the greatest ground speed met on one that begins on a heading."""
    if air.wind_x_m_s == 0.0 and air.wind_y_m_s == 0.0:
        return sharpness_per_m2(air.airspeed_m_s, craft)
    fastest_m_s = 0.0
    for turn_rad in RAMP_TURNS_RAD:
        fastest_m_s = max(
            fastest_m_s,
            ground_speed_m_s(heading_rad + turn_rad, air.airspeed_m_s, air.wind_x_m_s, air.wind_y_m_s),
        )
    return sharpness_per_m2(fastest_m_s, craft)


@compiled
def scene_of(
    time_s: float,
    east_m: float,
    north_m: float,
    course_rad: float,
    speed_m_s: float,
    curvature_per_m: float,
    target: Known,
    line: FloatArray,
    circle: Circling,
    wind_east_m_s: float,
    wind_north_m_s: float,
    latency_s: float,
    target_speed_max_m_s: float,
    craft: Craft,
    wish: Wish,
    memory: FloatArray,
) -> Scene:
    """Return what an aircraft at a place, on the plan of ``line`` and ``circle``, decides about."""
    wind_m_s = math.hypot(wind_east_m_s, wind_north_m_s)
    fastest_m_s = craft.airspeed_m_s + wind_m_s
    # The tightest circle over the ground whose bank stays within the limit where the wind is astern.
    radius_m = max(craft.radius_m, fastest_m_s * fastest_m_s / (GRAVITY_M_S2 * math.tan(craft.bank_max_rad)))
    arc_m = nearest_arc_m(line, circle, east_m, north_m, course_rad)
    start = point_at(line, circle, arc_m, east_m, north_m)
    off_m = math.hypot(east_m - start.east_m, north_m - start.north_m)
    if off_m > OFF_TRACK_M or abs(remainder(course_rad - start.course_rad)) > OFF_TRACK_RAD:
        tight_per_m = min(max(curvature_per_m, -1.0 / radius_m), 1.0 / radius_m)
        start = arc_point(LinePoint(east_m, north_m, course_rad, tight_per_m), 0.0, speed_m_s * latency_s)
    else:
        arc_m += speed_m_s * latency_s
        start = point_at(line, circle, arc_m, east_m, north_m)
    departure_s = time_s + latency_s
    view = viewpoint(start.east_m, start.north_m, target, wish, memory)
    # An estimate overshoots when the target turns: it is not believed to be faster than the target can be, unless it
    # is sure of it.
    sigma_m_s = velocity_sigma_m_s(target)
    target_m_s = math.hypot(target.velocity_east_m_s, target.velocity_north_m_s)
    share = min(1.0, max(target_speed_max_m_s, target_m_s - 2.0 * sigma_m_s) / max(target_m_s, 1e-6))
    east_m_s, north_m_s = share * target.velocity_east_m_s, share * target.velocity_north_m_s
    lead_s = departure_s - target.time_s
    sin_c, cos_c = math.sin(view.course_rad), math.cos(view.course_rad)
    mirror = view.side
    return Scene(
        departure_s,
        arc_m,
        start,
        target.east_m + east_m_s * lead_s,
        target.north_m + north_m_s * lead_s,
        view.course_rad,
        mirror,
        mirror * (east_m_s * cos_c - north_m_s * sin_c),
        east_m_s * sin_c + north_m_s * cos_c,
        Air(
            craft.airspeed_m_s,
            mirror * (wind_east_m_s * cos_c - wind_north_m_s * sin_c),
            wind_east_m_s * sin_c + wind_north_m_s * cos_c,
        ),
        Doubt(
            math.sqrt(max(target.covariance[0, 0], target.covariance[1, 1], 0.0)), sigma_m_s, view.course_sigma_rad
        ),
        radius_m,
    )


@compiled
def in_frame(scene: Scene, east_m: float, north_m: float) -> tuple[float, float]:
    """Return a place of the plane as (x, y)."""
    sin_c, cos_c = math.sin(scene.course_rad), math.cos(scene.course_rad)
    east_m, north_m = east_m - scene.frame_east_m, north_m - scene.frame_north_m
    return scene.mirror * (east_m * cos_c - north_m * sin_c), east_m * sin_c + north_m * cos_c


@compiled
def fill_classes(
    motions: Motions,
    velocity_x_m_s: float,
    velocity_y_m_s: float,
    wind_x_m_s: float,
    wind_y_m_s: float,
    classes: IntArray,
    share: FloatArray,
    turn_share: FloatArray,
) -> None:
    """Fill in the table's classes (4,) about velocities of target and wind, and their shares in V and after a turn.

    Of the wind only the direction counts: its speed is the table's. After a turn the speed before it is forgotten,
    but for that of a target that stood in a sector's table: it has no direction to turn from.
    """
    speed = min(math.hypot(velocity_x_m_s, velocity_y_m_s) / motions.target_speed_max_m_s, 1.0) * (_SPEED_RINGS - 1)
    ring = min(int(speed), _SPEED_RINGS - 2)
    outer = speed - ring
    classes[:], share[:], turn_share[:] = 0, 0.0, 0.0
    if motions.follows_course and motions.wind_speed_m_s == 0.0:
        classes[0], classes[1] = ring, ring + 1
        share[0], share[1], turn_share[0] = 1.0 - outer, outer, 1.0
        return
    if motions.follows_course:
        directions, angle_rad = motions.wind_directions, math.atan2(wind_x_m_s, wind_y_m_s)
    else:
        directions, angle_rad = motions.target_directions, math.atan2(velocity_x_m_s, velocity_y_m_s)
    direction = angle_rad / (2.0 * math.pi) * directions
    direction -= directions * math.floor(direction / directions)
    first = int(direction)
    past = direction - first
    for i in range(4):
        a, b = ring + i // 2, (first + i % 2) % directions
        ring_share, part = outer if i // 2 else 1.0 - outer, past if i % 2 else 1.0 - past
        share[i] = ring_share * part
        if motions.follows_course:
            classes[i] = a * directions + b
            turn_share[i] = 0.0 if i // 2 else part
        else:
            classes[i] = 1 + (a - 1) * directions + b if a else 0
            turn_share[i] = share[i] if ring == 0 else 0.0 if i // 2 else part


@compiled
def going_straight(scene: Scene, motions: Motions) -> Futures:
    """Return the one future in which the target keeps its velocity."""
    place, facing, course = np.zeros((1, 1, 4)), np.zeros((1, 1, 2)), np.zeros((1, 1, 3))
    classes, share, turn_share = np.zeros((1, 1, 4), np.int64), np.zeros((1, 1, 4)), np.zeros((1, 1, 4))
    place[0, 0, 2], place[0, 0, 3] = scene.velocity_x_m_s, scene.velocity_y_m_s
    facing[0, 0, 1] = course[0, 0, 1] = 1.0
    fill_classes(
        motions,
        scene.velocity_x_m_s,
        scene.velocity_y_m_s,
        scene.air.wind_x_m_s,
        scene.air.wind_y_m_s,
        classes[0, 0],
        share[0, 0],
        turn_share[0, 0],
    )
    return Futures(np.ones(1), STEP_S, place, facing, course, classes, share, turn_share)


@compiled
def flown_on(
    scene: Scene, line: FloatArray, circle: Circling, east_m: float, north_m: float, length_m: float
) -> tuple[FloatArray, FloatArray]:
    """Return (x, y, heading) (3, k) in the frame and the times (k,) of flying on along the present plan.

    The aircraft decides at (east, north).
    """
    size = max(2, math.ceil(length_m / (scene.air.airspeed_m_s * STEP_S)) + 1)
    arc = np.empty(size)
    for k in range(size):
        arc[k] = scene.arc_m + k * (length_m / (size - 1))
    found = np.empty((3, size))
    line_at(line, circle, arc, east_m, north_m, found)
    for k in range(size):
        found[0, k], found[1, k] = in_frame(scene, found[0, k], found[1, k])
        found[2, k] = scene.mirror * (found[2, k] - scene.course_rad)
    return found, times_s(found[2], arc, scene.air)


@compiled
def move_from(start_per_m: float, move: int, radius_m: float, ramp: float) -> Trapezoid:
    """Return one of the moves from a curvature, ending on the clockwise circle."""
    if move == MOVES - 1:
        return trapezoid(start_per_m, start_per_m, 0.0, 1.0 / radius_m, ramp)
    hold = HOLD_CURVATURES[move // HOLD_LENGTHS.size] / radius_m
    return trapezoid(start_per_m, hold, HOLD_LENGTHS[move % HOLD_LENGTHS.size] * radius_m, 1.0 / radius_m, ramp)


@compiled
def _moves(
    scene: Scene,
    start_per_m: float,
    ramp: float,
    beyond_m: float,
    craft: Craft,
    heading_rad: float,
    rate_per_s: float,
) -> Lines:
    """Return the lines of all moves."""
    holds_per_m = np.empty(HOLD_CURVATURES.size + 1)
    holds_per_m[:-1] = HOLD_CURVATURES / scene.radius_m
    holds_per_m[-1] = start_per_m
    hold, lengths_m, last_ramps = np.empty(MOVES, np.int64), np.empty(MOVES), np.empty(MOVES)
    for move in range(MOVES):
        hold[move] = move // HOLD_LENGTHS.size
        lengths_m[move] = HOLD_LENGTHS[move % HOLD_LENGTHS.size] * scene.radius_m
        one = move_from(start_per_m, move, scene.radius_m, ramp)
        last_ramps[move] = _ramp_on(heading_rad + turned_rad(one, one[4]), scene.air, craft)
    lengths_m[MOVES - 1] = 0.0
    return spread(
        start_per_m,
        holds_per_m,
        hold,
        lengths_m,
        1.0 / scene.radius_m,
        ramp,
        last_ramps,
        scene.air.airspeed_m_s * STEP_S,
        beyond_m,
        heading_rad,
        scene.air,
        rate_per_s,
    )


@compiled
def _stays(
    scene: Scene, start_per_m: float, ramp: float, beyond_m: float, heading_rad: float, rate_per_s: float
) -> Lines:
    """Return stretches of a present circle, in the form of moves: each ends on the clockwise circle.

    They are plain arcs where the present circle is that circle; from another one they ramp over at their end.
    """
    return spread(
        start_per_m,
        np.full(1, start_per_m),
        np.zeros(STAY_LENGTHS.size, np.int64),
        STAY_LENGTHS * scene.radius_m,
        1.0 / scene.radius_m,
        ramp,
        np.full(STAY_LENGTHS.size, ramp),
        scene.air.airspeed_m_s * STEP_S,
        beyond_m,
        heading_rad,
        scene.air,
        rate_per_s,
    )


@compiled
def _lines(
    family: float,
    scene: Scene,
    start_per_m: float,
    ramp: float,
    beyond_m: float,
    craft: Craft,
    heading_rad: float,
    rate_per_s: float,
    kept: Kept,
) -> Lines:
    """Return the moves (family 0) or the stays (1) from a curvature, from those kept where they can be."""
    slots = len(kept.size)
    calm = scene.air.wind_x_m_s == 0.0 and scene.air.wind_y_m_s == 0.0
    kept.used[slots] += 1
    oldest = 0
    if calm:
        for i in range(slots):
            key = kept.key[i]
            if (
                kept.used[i] > 0
                and key[0] == family
                and key[1] == start_per_m
                and key[2] == scene.radius_m
                and key[3] == ramp
                and key[4] == beyond_m
                and key[5] == rate_per_s
                and key[6] == scene.air.airspeed_m_s
            ):
                kept.used[i] = kept.used[slots]
                n, lines, trunks = kept.size[i], MOVES, HOLD_CURVATURES.size + 1
                if family > 0.0:
                    lines, trunks = STAY_LENGTHS.size, 1
                return Lines(
                    kept.samples[i, 0, :n],
                    kept.samples[i, 1, :n],
                    kept.samples[i, 2, :n],
                    kept.samples[i, 3, :n],
                    kept.samples[i, 4, :n],
                    kept.trunk_first[i, : trunks + 1],
                    kept.own_first[i, : lines + 1],
                    kept.trunk[i, :lines],
                    kept.on_trunk[i, :lines],
                    kept.end_m[i, :lines],
                )
            if kept.used[i] < kept.used[oldest]:
                oldest = i
    if family > 0.0:
        made = _stays(scene, start_per_m, ramp, beyond_m, heading_rad, rate_per_s)
    else:
        made = _moves(scene, start_per_m, ramp, beyond_m, craft, heading_rad, rate_per_s)
    n = len(made.x_m)
    if calm and n <= kept.samples.shape[2]:
        key = kept.key[oldest]
        key[0], key[1], key[2], key[3], key[4] = family, start_per_m, scene.radius_m, ramp, beyond_m
        key[5], key[6] = rate_per_s, scene.air.airspeed_m_s
        kept.used[oldest], kept.size[oldest] = kept.used[slots], n
        for row, values in enumerate((made.x_m, made.y_m, made.turned_rad, made.time_s, made.weight)):
            kept.samples[oldest, row, :n] = values
        kept.trunk_first[oldest, : len(made.trunk_first)] = made.trunk_first
        kept.own_first[oldest, : len(made.own_first)] = made.own_first
        lines = len(made.trunk)
        kept.trunk[oldest, :lines], kept.on_trunk[oldest, :lines] = made.trunk, made.on_trunk
        kept.end_m[oldest, :lines] = made.end_m
    return made


@compiled
def look_ahead(
    scene: Scene,
    east_m: float,
    north_m: float,
    line: FloatArray,
    circle: Circling,
    futures: Futures,
    craft: Craft,
    terms: CostTerms,
    table: Table,
    motions: Motions,
    prices: Prices,
    kept: Kept,
    costs: FloatArray,
) -> float:
    """Fill in what each move costs (MOVES,), its price included, and return what going on as planned costs.

    The aircraft decides at (east, north). A move that hardly leaves the circle is infinitely dear.
    """
    air, radius_m = scene.air, scene.radius_m
    # The table knows nothing of uncertainty, nor of another wind than its own. Where there is much of either, all
    # lines are followed for a lap more: else moves seem cheaper later than they ever turn out.
    wind_m_s = math.hypot(air.wind_x_m_s, air.wind_y_m_s)
    other_wind = abs(wind_m_s - motions.wind_speed_m_s) > OTHER_WIND * air.airspeed_m_s
    doubtful = other_wind or scene.doubt.position_m > UNCERTAIN_M
    beyond_m = 2.0 * math.pi * radius_m if doubtful else 0.0
    rate_per_s = table.discount_per_s + 1.0 / table.mean_leg_s
    x_m, y_m = in_frame(scene, scene.start.east_m, scene.start.north_m)
    heading_rad = scene.mirror * (scene.start.course_rad - scene.course_rad)
    ramp = _ramp_on(heading_rad, air, craft)
    start_per_m = scene.mirror * scene.start.curvature_per_m
    lines = _lines(0.0, scene, start_per_m, ramp, beyond_m, craft, heading_rad, rate_per_s, kept)
    lines_costs(lines, x_m, y_m, heading_rad, futures, scene.doubt, terms, table, costs)
    left_m = line[ARC, line.shape[1] - 1] - scene.arc_m if line.shape[1] > 0 else 0.0
    if left_m > NEARLY_FLOWN_S * air.airspeed_m_s:
        ahead, time_s = flown_on(scene, line, circle, east_m, north_m, left_m + beyond_m)
        costs += prices.change
        return line_cost(ahead[0], ahead[1], ahead[2], time_s, futures, scene.doubt, terms, table)
    for i in range(MOVES):
        # "Back to the circle" is staying, and so is hardly leaving it: the table is not that fine.
        costs[i] = np.inf if lines.end_m[i] < MIN_MOVE * radius_m else costs[i] + prices.leave
    stays = _lines(1.0, scene, scene.mirror / circle.radius_m, ramp, beyond_m, craft, heading_rad, rate_per_s, kept)
    stay_costs = np.empty(STAY_LENGTHS.size)
    lines_costs(stays, x_m, y_m, heading_rad, futures, scene.doubt, terms, table, stay_costs)
    return float(stay_costs.min())


@compiled
def move_line(scene: Scene, craft: Craft, move: int) -> FloatArray:
    """Return the line (5, n) of a move, in the plane."""
    heading_rad = scene.mirror * (scene.start.course_rad - scene.course_rad)
    ramp = _ramp_on(heading_rad, scene.air, craft)
    one = move_from(scene.mirror * scene.start.curvature_per_m, move, scene.radius_m, ramp)
    one = with_last_ramp(one, _ramp_on(heading_rad + turned_rad(one, one[4]), scene.air, craft))
    m = scene.mirror
    one = (m * one[0], m * one[1], one[2], m * one[3], one[4], one[5])
    return laid_out(one, scene.start.east_m, scene.start.north_m, scene.start.course_rad)

"""A run of a study in one compiled loop: target, payload, filter, decisions, path following and airframe.

It calls the same compiled functions as the classes that fly, in the same order:
:class:`sidelong.estimators.tracking.track.Track`, :class:`sidelong.app.study.pilots.PlanPilot` and
:class:`sidelong.app.simulation.airframe.KinematicAircraft`. What is rare is left to them: the loop pauses where the
track may have to begin again, and where a decision is not its own or is to be timed.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from sidelong.app.simulation.airframe_kernel import Airframe, Body, stepped
from sidelong.estimators.compiled import compiled
from sidelong.estimators.filters.imm_kernel import Densities, combine, predict, update
from sidelong.estimators.filters.measurement_kernel import Seen
from sidelong.estimators.filters.standing_kernel import predict_standing
from sidelong.estimators.terrain.ground_kernel import Grid, height_and_slope, sight_clearance_m, sight_step_m
from sidelong.mission.core.path import FloatArray
from sidelong.mission.geometry.line_kernel import Circling, LinePoint, circle_after, following_per_m
from sidelong.mission.predictive.decision_kernel import Looker
from sidelong.mission.predictive.foresight_kernel import decide
from sidelong.mission.predictive.scene_kernel import scene_of
from sidelong.mission.viewpoint.viewpoint_kernel import Estimates, Known

IntArray = npt.NDArray[np.int64]

STEP_S = 0.1

# Why the loop pauses.
ENDED, MEASURE, REJECTED, DECIDE = range(4)
# What comes next in a step.
SEE, CHOOSE, FLY = range(3)

# Numbers of a flight.
NEXT_S, COMMAND_PER_M, FILTER_S, SEEN_S, DEPARTURE_S = range(5)
HEIGHT_M, PLAN_HEIGHT_M, COMING_HEIGHT_M = range(5, 8)  # flown, and that of the circle of each plan
CIRCLES = 8  # east, north, signed radius: of the present plan and of the coming one
NUMBERS = CIRCLES + 6
# Its counts.
STEP, STAGE, PRESENT, COMING, CHANGES, DECISIONS, REJECTIONS = range(7)
SAMPLES = 7  # of the lines of both plans
COUNTS = SAMPLES + 2
_LINE_MAX = 16_384  # samples of a line
TARGET_M = 1.0  # of a target stands above the ground


class Target(NamedTuple):
    """sampled (steps, 5): east, north, velocity east, velocity north, course. noise (steps, 3): standard normal."""

    sampled: FloatArray
    noise: FloatArray


class Hills(NamedTuple):
    """What is flown over: an elevation grid without rows is flat ground, of height 0.

    sigma_m: of its heights. known: whether the filter stands on it. climb_m, descent_m: in a step.
    """

    grid: Grid
    sigma_m: float
    known: bool
    climb_m: float
    descent_m: float


FLAT = Hills((np.zeros((0, 0), np.float32), 0.0, 0.0, 1.0, 1.0), 0.0, False, 0.0, 0.0)


class Payload(NamedTuple):
    """Errors of laser and gimbal, and those that the filter assumes; perfect: the truth is known.

    apart: it is measured with outside of the loop. cos_pan_limit: cosine of the gimbal's pan limit; -1: none.
    """

    perfect: bool
    apart: bool
    range_sigma_m: float
    angle_sigma_rad: float
    yaw_bias_rad: float
    told_range_sigma_m: float
    told_yaw_sigma_rad: float
    told_pitch_sigma_rad: float
    told_position_sigma_m: float
    cos_pan_limit: float


class Filtering(NamedTuple):
    """The settings of the track that matter here."""

    gate_nis: float
    soft_nis: float
    densities: Densities
    reacquire_after: int
    lost_after_s: float
    lost_sigma_m: float


class Steering(NamedTuple):
    """own_decisions: decide here, pausing at one in timed_every. follows: a plan, else a commanded curvature."""

    own_decisions: bool
    timed_every: int
    follows: bool
    period_s: float
    latency_s: float
    unseen_max_s: float


class Flight(NamedTuple):
    """The state of a run, arrays that change. body is of :class:`Body`; models, ahead: filter states.

    lines (2, k): both plans' lines (5, n), flat. changed_s (steps,): when plans were departed to. rejected
    (reacquire_after, 10): the last sightings beyond the gate since the last one within, and their times. log
    (steps, 6): time, aircraft and target (east, north), course of the target. over (steps, 2): height, and 1 where
    the target was in sight.
    """

    body: FloatArray
    numbers: FloatArray
    counts: IntArray
    models: FloatArray
    ahead: FloatArray
    lines: FloatArray
    changed_s: FloatArray
    rejected: FloatArray
    log: FloatArray
    over: FloatArray


def new_flight(
    body: Body, circle: Circling, height_m: float, models: tuple[int, int], steps: int, reacquire_after: int
) -> Flight:
    """Return a flight that begins on a circle, with a track that has not begun. models: the shape of their array."""
    numbers, counts = np.zeros(NUMBERS), np.zeros(COUNTS, np.int64)
    numbers[COMMAND_PER_M], numbers[SEEN_S] = np.nan, -np.inf
    numbers[HEIGHT_M] = numbers[PLAN_HEIGHT_M] = numbers[COMING_HEIGHT_M] = height_m
    numbers[CIRCLES : CIRCLES + 3] = circle
    return Flight(
        np.array(body),
        numbers,
        counts,
        np.zeros(models),
        np.zeros(models),
        np.zeros((2, 5 * _LINE_MAX)),
        np.empty(steps),
        np.zeros((reacquire_after, 10)),
        np.empty((steps, 6)),
        np.empty((steps, 2)),
    )


@compiled
def body_of(f: Flight) -> Body:
    """Return where the aircraft is."""
    b = f.body
    return Body(b[0], b[1], b[2], b[3], b[4], b[5], b[6])


@compiled
def plan_of(f: Flight, which: int) -> tuple[FloatArray, Circling]:
    """Return line and circle of a plan."""
    n, c = f.counts[SAMPLES + which], CIRCLES + 3 * which
    return f.lines[which, : 5 * n].reshape(5, n), Circling(f.numbers[c], f.numbers[c + 1], f.numbers[c + 2])


@compiled
def along_plan_per_m(f: Flight, body: Body) -> float:
    """Return the curvature that follows the present plan."""
    which = f.counts[PRESENT]
    n, c = f.counts[SAMPLES + which], CIRCLES + 3 * which
    line, circle = f.lines[which, : 5 * n].reshape(5, n), Circling(f.numbers[c], f.numbers[c + 1], f.numbers[c + 2])
    return following_per_m(line, circle, body.east_m, body.north_m, body.course_rad)


@compiled
def take_plan(f: Flight, departure_s: float, line: FloatArray, circle: Circling) -> None:
    """Take a plan as the coming one."""
    which, n = 1 - f.counts[PRESENT], line.shape[1]
    if n > _LINE_MAX:
        raise ValueError("a line of a plan is longer than a study can fly")
    f.counts[COMING], f.counts[SAMPLES + which], f.numbers[DEPARTURE_S] = 1, n, departure_s
    c = CIRCLES + 3 * which
    f.numbers[c], f.numbers[c + 1], f.numbers[c + 2] = circle.east_m, circle.north_m, circle.radius_m
    taken = f.lines[which, : 5 * n].reshape(5, n)
    for i in range(n):
        for row in range(5):
            taken[row, i] = line[row, i]


@compiled
def sighted(
    body: Body, drop_m: float, target: FloatArray, noise: FloatArray, p: Payload
) -> tuple[float, float, float]:
    """Return slant range, and yaw and pitch of the line of sight, as measured so far above the target."""
    east_m, north_m = target[0] - body.east_m, target[1] - body.north_m
    horizontal_m = math.hypot(east_m, north_m)
    return (
        math.hypot(horizontal_m, drop_m) + p.range_sigma_m * noise[0],
        math.atan2(east_m, north_m) + p.yaw_bias_rad + p.angle_sigma_rad * noise[1],
        -math.atan2(drop_m, horizontal_m) + p.angle_sigma_rad * noise[2],
    )


@compiled
def seen_from(
    body: Body, height_m: float, target: FloatArray, target_m: float, noise: FloatArray, p: Payload
) -> Seen:
    """Return the sighting that the pairing makes of it: all is measured at one time. target_m: its height."""
    slant_m, yaw_rad, pitch_rad = sighted(body, height_m - target_m, target, noise, p)
    along_m = p.told_position_sigma_m / slant_m
    across_m = p.told_position_sigma_m / (slant_m * max(math.cos(pitch_rad), 0.01))
    return Seen(
        False,
        slant_m,
        yaw_rad,
        -pitch_rad,
        p.told_range_sigma_m**2 + p.told_position_sigma_m**2,
        p.told_yaw_sigma_rad**2 + across_m**2,
        p.told_pitch_sigma_rad**2 + along_m**2,
        body.east_m,
        body.north_m,
        height_m,
    )


@compiled
def ground_and_sight(
    hills: Hills, east_m: float, north_m: float, height_m: float, target_east_m: float, target_north_m: float
) -> tuple[float, bool]:
    """Return the height of the target's ground, 0 where not known, and whether it is in sight from a place."""
    if hills.grid[0].shape[0] == 0:
        return 0.0, True
    target_m = height_and_slope(hills.grid, target_east_m, target_north_m)[0]
    target_m = 0.0 if math.isnan(target_m) else target_m
    from_m, to_m = (east_m, north_m, height_m), (target_east_m, target_north_m, target_m + TARGET_M)
    step_m = sight_step_m(hills.grid)
    return target_m, sight_clearance_m(hills.grid, from_m, to_m, step_m) >= 0.0


@compiled
def within_pan(body: Body, frame: Airframe, east_m: float, north_m: float, cos_pan_limit: float) -> bool:
    """Return whether the gimbal can look at a place: the nose points along the velocity through the air."""
    if cos_pan_limit <= -1.0:
        return True
    nose_east = body.speed_m_s * math.sin(body.course_rad) - frame.wind_east_m_s
    nose_north = body.speed_m_s * math.cos(body.course_rad) - frame.wind_north_m_s
    to_east_m, to_north_m = east_m - body.east_m, north_m - body.north_m
    ahead = nose_east * to_east_m + nose_north * to_north_m
    return ahead >= cos_pan_limit * math.hypot(nose_east, nose_north) * math.hypot(to_east_m, to_north_m)


@compiled
def _predict(state: FloatArray, step_s: float, filtering: Filtering, hills: Hills, found: FloatArray) -> None:
    """Fill in the filter's state a step later, on known ground or on none."""
    if hills.known:
        predict_standing(state, step_s, filtering.densities, hills.grid, hills.sigma_m, found)
    else:
        predict(state, step_s, filtering.densities, found)


@compiled
def copy_state(values: FloatArray, found: FloatArray) -> None:
    """Fill in the values of another state (n, k): an assignment would buffer them."""
    for i in range(found.shape[0]):
        for k in range(found.shape[1]):
            found[i, k] = values[i, k]


@compiled
def _carry_on(f: Flight, filtering: Filtering, hills: Hills, time_s: float) -> None:
    """Fill in the filter's state ahead, at a time: in steps of a second at most."""
    before, ahead, at_s = f.models, f.ahead, f.numbers[FILTER_S]
    while time_s - at_s > 1.0:
        _predict(before, 1.0, filtering, hills, ahead)
        before = ahead.copy()
        at_s += 1.0
    step_s = round((time_s - at_s) * 1e6) / 1e6
    if step_s > 0.0:
        _predict(before, step_s, filtering, hills, ahead)
    else:
        copy_state(before, ahead)


@compiled
def _see(
    f: Flight, body: Body, target: Target, target_m: float, payload: Payload, filtering: Filtering, hills: Hills
) -> bool:
    """Process a sighting. Return False if it is outside the gate; the track may then have to start or restart."""
    step, height_m = f.counts[STEP], f.numbers[HEIGHT_M]
    seen = seen_from(body, height_m, target.sampled[step], target_m, target.noise[step], payload)
    unseen_s, nis = body.time_s - f.numbers[SEEN_S], np.inf
    if unseen_s <= filtering.lost_after_s:
        _carry_on(f, filtering, hills, body.time_s)
        nis = update(f.ahead, 0, seen, filtering.gate_nis, filtering.soft_nis)
    if nis <= filtering.gate_nis:
        copy_state(f.ahead, f.models)
        f.numbers[FILTER_S] = f.numbers[SEEN_S] = body.time_s
        f.counts[REJECTIONS] = 0
        return True
    copy_state(f.rejected[1:], f.rejected[:-1])
    last = f.rejected[-1]
    last[0], last[1], last[2], last[3] = body.time_s, seen.slant_range_m, seen.bearing_rad, seen.depression_rad
    last[4], last[5], last[6] = seen.range_variance_m2, seen.bearing_variance_rad2, seen.depression_variance_rad2
    last[7], last[8], last[9] = body.east_m, body.north_m, height_m
    f.counts[REJECTIONS] += 1
    return bool(f.counts[REJECTIONS] < filtering.reacquire_after and unseen_s <= filtering.lost_after_s)


@compiled
def known_at(
    f: Flight, time_s: float, target: Target, payload: Payload, filtering: Filtering, hills: Hills
) -> tuple[Known, bool]:
    """Return the estimate at a time, and whether the track is not lost."""
    mean, covariance = np.empty(4), np.zeros((4, 4))
    if payload.perfect:
        mean[:] = target.sampled[f.counts[STEP], :4]
        return Known(time_s, mean[0], mean[1], mean[2], mean[3], covariance), True
    if time_s > f.numbers[FILTER_S]:
        _carry_on(f, filtering, hills, time_s)
        combine(f.ahead, mean, covariance)
    else:
        combine(f.models, mean, covariance)
    sigma_m = math.sqrt(covariance[0, 0] + covariance[1, 1])
    good = time_s - f.numbers[SEEN_S] <= filtering.lost_after_s and sigma_m <= filtering.lost_sigma_m
    return Known(time_s, mean[0], mean[1], mean[2], mean[3], covariance), good


@compiled
def choose(
    f: Flight,
    target: Target,
    payload: Payload,
    filtering: Filtering,
    hills: Hills,
    steering: Steering,
    frame: Airframe,
    looker: Looker,
) -> None:
    """Decide as the predictive planner does, and take the plan if there is one."""
    body = body_of(f)
    known, good = known_at(f, body.time_s, target, payload, filtering, hills)
    seen_s = body.time_s if payload.perfect else f.numbers[SEEN_S]
    if not good or body.time_s - seen_s > steering.unseen_max_s:
        return
    present, circle = plan_of(f, f.counts[PRESENT])
    scene = scene_of(
        body.time_s,
        LinePoint(body.east_m, body.north_m, body.course_rad, body.curvature_per_m),
        body.speed_m_s,
        Estimates(known, known),
        present,
        circle,
        frame.wind_east_m_s,
        frame.wind_north_m_s,
        steering.latency_s,
        body.time_s - f.numbers[DEPARTURE_S],
        looker.target_speed_max_m_s,
        looker.craft,
        looker.wish,
        looker.memory,
    )
    departure_s, radius_m, line = decide(scene, looker)
    if line.shape[1] > 0:
        take_plan(f, departure_s, line, circle_after(line, radius_m))


@compiled
def advance(
    f: Flight,
    target: Target,
    payload: Payload,
    filtering: Filtering,
    hills: Hills,
    steering: Steering,
    frame: Airframe,
    looker: Looker,
) -> int:
    """Fly on until there is a reason to pause, and return it."""
    steps = len(f.log)
    while f.counts[STEP] < steps:
        step, body = f.counts[STEP], body_of(f)
        if f.counts[STAGE] == SEE:
            truth, row = target.sampled[step], f.log[step]
            row[0], row[1], row[2] = body.time_s, body.east_m, body.north_m
            row[3], row[4], row[5] = truth[0], truth[1], truth[4]
            height_m = f.numbers[HEIGHT_M]
            target_m, in_sight = ground_and_sight(hills, body.east_m, body.north_m, height_m, truth[0], truth[1])
            f.over[step, 0], f.over[step, 1] = height_m, 1.0 if in_sight else 0.0
            f.counts[STAGE] = CHOOSE
            if payload.apart:
                return MEASURE
            measured = in_sight and not payload.perfect
            measured = measured and within_pan(body, frame, truth[0], truth[1], payload.cos_pan_limit)
            if measured and not _see(f, body, target, target_m, payload, filtering, hills):
                return REJECTED
        if f.counts[STAGE] == CHOOSE:
            f.counts[STAGE] = FLY
            if f.counts[COMING] == 0 and body.time_s >= f.numbers[NEXT_S] - 1e-6:
                f.numbers[NEXT_S] = body.time_s + steering.period_s
                f.counts[DECISIONS] += 1
                if not steering.own_decisions or (f.counts[DECISIONS] - 1) % steering.timed_every == 0:
                    return DECIDE
                choose(f, target, payload, filtering, hills, steering, frame, looker)
        if f.counts[COMING] > 0 and body.time_s >= f.numbers[DEPARTURE_S] - 1e-6:
            f.counts[PRESENT], f.counts[COMING] = 1 - f.counts[PRESENT], 0
            f.numbers[PLAN_HEIGHT_M] = f.numbers[COMING_HEIGHT_M]
            f.changed_s[f.counts[CHANGES]] = body.time_s
            f.counts[CHANGES] += 1
        if steering.follows:
            command_per_m = along_plan_per_m(f, body)
        else:
            command_per_m = f.numbers[COMMAND_PER_M]
            command_per_m = body.curvature_per_m if math.isnan(command_per_m) else command_per_m
        body = stepped(body, frame, command_per_m, STEP_S)
        b = f.body
        b[0], b[1], b[2], b[3] = body.time_s, body.east_m, body.north_m, body.course_rad
        b[4], b[5], b[6] = body.speed_m_s, body.curvature_per_m, body.bank_rad
        to_climb_m = f.numbers[PLAN_HEIGHT_M] - f.numbers[HEIGHT_M]
        f.numbers[HEIGHT_M] += min(max(to_climb_m, -hills.descent_m), hills.climb_m)
        f.counts[STEP], f.counts[STAGE] = step + 1, SEE
    return ENDED

"""The inner loops of second moves: laid out once from each level of curvature, and placed where one begins."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from sidelong.estimators.compiled import compiled, inlined
from sidelong.mission.core.path import FloatArray
from sidelong.mission.geometry.line_kernel import ground_speed_m_s, moved_m, trapezoid, turned_rad
from sidelong.mission.predictive.cost_kernel import IntArray
from sidelong.mission.predictive.moves_kernel import HOLD_CURVATURES, HOLD_LENGTHS, unit_m
from sidelong.mission.predictive.rollout_kernel import Air, Pose

BoolArray = npt.NDArray[np.bool_]

LEVELS = np.array([-2.0, -1.5, -1.0, -0.75, -0.5, -0.25, 0.0, 0.165, 0.33, 0.5, 0.66, 0.83, 1.0])
SECOND_LENGTHS = HOLD_LENGTHS[::3].copy()
SECONDS = HOLD_CURVATURES.size * SECOND_LENGTHS.size + 1
SAMPLES = 64  # of a second move; longer ones are left out
_HEADINGS = 48


class Seconds(NamedTuple):
    """Second moves from each level of curvature, from the origin along y: arrays (levels, lines, samples).

    key (4,): radius, tightest turn's radius, ramp and step that they were laid out for. end (levels, lines): the
    sample from which they are on the circle, 0 for a line that is too long. placed (3, lines, samples), flown
    (samples, lines): room to work in.
    """

    key: FloatArray
    x_m: FloatArray
    y_m: FloatArray
    turned_rad: FloatArray
    end: IntArray
    placed: FloatArray
    flown: FloatArray


def no_seconds() -> Seconds:
    """Return room for second moves."""
    shape = len(LEVELS), SECONDS, SAMPLES
    laid_out = np.zeros(shape), np.zeros(shape), np.zeros(shape), np.zeros(shape[:2], np.int64)
    return Seconds(np.zeros(4), *laid_out, np.zeros((3, SECONDS, SAMPLES)), np.zeros((SAMPLES, SECONDS)))


@compiled
def lay_out_seconds(s: Seconds, radius_m: float, turn_radius_m: float, ramp: float, step_m: float) -> None:
    """Fill in the second moves, unless they are there."""
    if s.key[0] == radius_m and s.key[1] == turn_radius_m and s.key[2] == ramp and s.key[3] == step_m:
        return
    s.key[0], s.key[1], s.key[2], s.key[3] = radius_m, turn_radius_m, ramp, step_m
    lengths = len(SECOND_LENGTHS)
    for level in range(len(LEVELS)):
        start_per_m = LEVELS[level] / radius_m
        for j in range(SECONDS):
            hold_per_m, length_m = start_per_m, 0.0
            if j < SECONDS - 1:
                unit = unit_m(j // lengths, radius_m, turn_radius_m)
                hold_per_m, length_m = HOLD_CURVATURES[j // lengths] / unit, SECOND_LENGTHS[j % lengths] * unit
            one = trapezoid(start_per_m, hold_per_m, length_m, 1.0 / radius_m, ramp)
            end = max(1, math.ceil(one[5] / step_m - 1e-9))
            s.end[level, j] = end if end < SAMPLES else 0
            for k in range(1, SAMPLES):
                across_m, along_m = moved_m(one, 0.0, step_m * (k - 1), step_m * k)
                s.x_m[level, j, k] = s.x_m[level, j, k - 1] + across_m
                s.y_m[level, j, k] = s.y_m[level, j, k - 1] + along_m
                s.turned_rad[level, j, k] = turned_rad(one, step_m * k)


@compiled
def speeds_over_ground(air: Air) -> FloatArray:
    """Return the speed over the ground on evenly spaced headings from 0 to a whole turn, in airspeeds.

    The wind triangle takes too long for each sample.
    """
    speeds = np.empty(_HEADINGS + 1)
    for h in range(_HEADINGS + 1):
        ground_m_s = ground_speed_m_s(h * 2.0 * math.pi / _HEADINGS, air.airspeed_m_s, air.wind_x_m_s, air.wind_y_m_s)
        speeds[h] = ground_m_s / air.airspeed_m_s
    return speeds


class Fan(NamedTuple):
    """Second moves from one start, of a level of curvature; sin_h, cos_h: of the heading there.

    flown (k, lines): as :func:`stretch` has it, of no length in still air. placed (3, lines, k): x, y, heading: all
    of a line that is laid (lines,), else its end alone. last (lines,): number of seconds of each, 0 for none.
    """

    start: Pose
    sin_h: float
    cos_h: float
    level: int
    flown: FloatArray
    placed: FloatArray
    laid: BoolArray
    last: IntArray


@compiled
def stretch(s: Seconds, level: int, heading_rad: float, speeds: FloatArray, last: int, flown: FloatArray) -> None:
    """Fill in how far along each second move (k, lines) the aircraft is in wind, in samples, each second up to last.

    speeds: see speeds_over_ground. A line is stretched along itself.
    """
    turned, count = s.turned_rad[level], flown.shape[1]
    for j in range(count):
        flown[0, j] = 0.0
    for k in range(last):
        for j in range(count):
            i = min(int(flown[k, j]), SAMPLES - 2)
            past = flown[k, j] - i
            at = heading_rad + (turned[j, i] + past * (turned[j, i + 1] - turned[j, i]))
            at *= _HEADINGS / (2.0 * math.pi)
            at -= _HEADINGS * math.floor(at / _HEADINGS)
            h = min(int(at), _HEADINGS - 1)
            flown[k + 1, j] = flown[k, j] + speeds[h] + (at - h) * (speeds[h + 1] - speeds[h])


@inlined
def placed_at(s: Seconds, fan: Fan, j: int, k: int) -> tuple[float, float, float]:
    """Return place and heading (x, y, heading) of second move j of a fan at second k of it."""
    own_x, own_y, turned, level, flown = s.x_m, s.y_m, s.turned_rad, fan.level, fan.flown
    if len(flown) == 0:
        across_m, along_m, turned_rad = own_x[level, j, k], own_y[level, j, k], turned[level, j, k]
    else:
        i = min(int(flown[k, j]), SAMPLES - 2)
        past = flown[k, j] - i
        across_m = own_x[level, j, i] + past * (own_x[level, j, i + 1] - own_x[level, j, i])
        along_m = own_y[level, j, i] + past * (own_y[level, j, i + 1] - own_y[level, j, i])
        turned_rad = turned[level, j, i] + past * (turned[level, j, i + 1] - turned[level, j, i])
    return (
        fan.start.x_m + across_m * fan.cos_h + along_m * fan.sin_h,
        fan.start.y_m - across_m * fan.sin_h + along_m * fan.cos_h,
        fan.start.heading_rad + turned_rad,
    )


@inlined
def lay(s: Seconds, fan: Fan, j: int, last: int) -> None:
    """Fill in second move j of a fan, up to second ``last`` of it."""
    placed = fan.placed
    for k in range(last + 1):
        placed[0, j, k], placed[1, j, k], placed[2, j, k] = placed_at(s, fan, j, k)

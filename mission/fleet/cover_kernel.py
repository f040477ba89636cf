"""The inner loops of what the others see: the chance that one of them watches, now and after turns of the target.

Frames are those of :mod:`sidelong.mission.predictive.scene_kernel`; the wanted frame is mirrored for the
aircraft on the opposite side.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from sidelong.estimators.compiled import compiled
from sidelong.mission.core.path import FloatArray
from sidelong.mission.predictive.cost_kernel import IntArray, table_value
from sidelong.mission.predictive.decision_kernel import Looker
from sidelong.mission.predictive.future_kernel import classes_about
from sidelong.mission.predictive.moves_kernel import STEP_S
from sidelong.mission.predictive.rollout_kernel import Futures, from_target
from sidelong.mission.predictive.scene_kernel import Scene, in_frame

FORESEEN = 111  # seconds, as far as any line leads
BACK_SHARE = 0.6  # of the airspeed, at which an aircraft comes back over the edge of the side
IN_BAND_M = 15.0  # outside the band that is planned for, still in the required one
_OFF_MAX_S = 60.0


class Team(NamedTuple):
    """What joint decisions are made with.

    wanted: the side, 1 left, -1 right. turns_rad, chances (t,): the turns that the target may make. alone_running,
    alone_end: shares of what an aircraft alone would pay on the way, and from the end of its line on. opposite: per
    second, of the share of courses that no aircraft would cover. turn: weight of what turns would cost. margin: of
    the side, in radii of the circle. price: share of what changes cost alone. own: weight of what the moves of the
    primary are worth to it alone.
    """

    wanted: float
    turns_rad: FloatArray
    chances: FloatArray
    alone_running: float
    alone_end: float
    price: float
    opposite: float
    turn: float
    margin: float
    own: float


class Cover(NamedTuple):
    """What the others will cover, in the departure's frame of one aircraft every STEP_S from its departure on.

    off (f, FORESEEN): the chance that none of them is on the wanted side; now (f, FORESEEN): what the best
    placed one would pay if the target goes on as it does. after (f, FORESEEN, t): the shortest time that any of them
    would be off the side after each turn. Infinite where there are none. bearings (f, FORESEEN, m): of each from
    the target. turned (f, k, t, 2): sine and cosine of the target's course in the wanted frame after each turn.
    """

    off: FloatArray
    now: FloatArray
    after: FloatArray
    bearings: FloatArray
    turned: FloatArray


@compiled
def off_after_turns(team: Team, scene: Scene, x_m: float, y_m: float, turned: FloatArray, found: FloatArray) -> None:
    """Fill in for how long a place of the wanted frame would be off the side after each turn (t,); turned (t, 2).

    The target goes on along the new course, so the way back is across it alone; the margin stands for the circle that
    leads to and fro over the edge.
    """
    for i in range(len(team.turns_rad)):
        across_m = x_m * turned[i, 1] - y_m * turned[i, 0]
        off_s = (across_m + team.margin * scene.radius_m) / (BACK_SHARE * scene.air.airspeed_m_s)
        found[i] = min(max(off_s, 0.0), _OFF_MAX_S)


@compiled
def asking_room() -> tuple[IntArray, FloatArray]:
    """Return room to ask tables with: classes (1, 1, 4) of the first only, and their shares."""
    share = np.zeros((1, 1, 4))
    share[0, 0, 0] = 1.0
    return np.zeros((1, 1, 4), np.int64), share


@compiled
def blurred_m(scene: Scene, sigma_rad: float, along_m: float, time_s: float) -> float:
    """Return the standard deviation of the distance across the side's limit, after ``time_s``."""
    velocity_m = scene.doubt.velocity_m_s * time_s
    place_m = scene.doubt.position_m
    return 1.0 + math.sqrt(
        place_m * place_m + velocity_m * velocity_m + (sigma_rad * along_m) * (sigma_rad * along_m)
    )


@compiled
def off_side(across_m: float, blur_m: float) -> float:
    """Return the probability 0..1 of being off the required side."""
    return min(max(0.5 + 0.5 * across_m / blur_m, 0.0), 1.0)


@compiled
def wanted_value(
    scene: Scene,
    f: Futures,
    looker: Looker,
    s: float,
    one: int,
    p: int,
    off_x: float,
    off_y: float,
    heading_rad: float,
    classes: IntArray,
    share: FloatArray,
) -> float:
    """Return what an aircraft alone would pay on the wanted side, from a place relative to the target on.

    s: 1 where the departure's frame is the wanted one, -1 where it is mirrored. classes, share: to be filled in.
    """
    sin_t, cos_t = f.course[one, p, 0], f.course[one, p, 1]
    vx, vy, air = f.place[one, p, 2], f.place[one, p, 3], scene.air
    which, shares, _ = classes_about(
        looker.motions,
        s * (vx * cos_t - vy * sin_t),
        vx * sin_t + vy * cos_t,
        s * (air.wind_x_m_s * cos_t - air.wind_y_m_s * sin_t),
        air.wind_x_m_s * sin_t + air.wind_y_m_s * cos_t,
    )
    for c in range(4):
        classes[0, 0, c], share[0, 0, c] = which[c], shares[c]
    across_m, along_m = s * (off_x * cos_t - off_y * sin_t), off_x * sin_t + off_y * cos_t
    heading_rad = s * (heading_rad - f.course[one, p, 2])
    table = looker.table
    value = table_value(table.values, table.cell_m, across_m, along_m, heading_rad, classes, share, 0, 0)
    classes[:], share[:] = 0, 0.0
    share[0, 0, 0] = 1.0
    return value


@compiled
def cover_of(scene: Scene, f: Futures, others: FloatArray, first_s: FloatArray, looker: Looker, team: Team) -> Cover:
    """Return what the others cover. others (m, 3, n): east, north, course every STEP_S from first_s (m,) on."""
    futures, turns, m = len(f.weight), len(team.turns_rad), len(others)
    off, now = np.ones((futures, FORESEEN)), np.full((futures, FORESEEN), np.inf)
    after = np.full((futures, FORESEEN, turns), np.inf)
    bearings, found = np.empty((futures, FORESEEN, m)), np.empty(turns)
    classes, share = asking_room()
    s = scene.mirror * team.wanted
    near_m, far_m = looker.terms.near_m, looker.terms.far_m
    n = others.shape[2]
    turned = np.empty((futures, f.course.shape[1], turns, 2))
    for one in range(futures):
        for p in range(turned.shape[1]):
            for t in range(turns):
                angle_rad = s * f.course[one, p, 2] + team.turns_rad[t]
                turned[one, p, t, 0], turned[one, p, t, 1] = math.sin(angle_rad), math.cos(angle_rad)
    for k in range(FORESEEN):
        time_s = k * STEP_S
        for j in range(m):
            at = (scene.departure_s - first_s[j]) / STEP_S + k
            i = min(max(int(at), 0), n - 2)
            past = min(max(at - i, 0.0), 1.0)
            east_m = others[j, 0, i] + past * (others[j, 0, i + 1] - others[j, 0, i])
            north_m = others[j, 1, i] + past * (others[j, 1, i + 1] - others[j, 1, i])
            x_m, y_m = in_frame(scene, east_m, north_m)
            heading_rad = scene.mirror * (others[j, 2, i] - scene.course_rad)
            for one in range(futures):
                p, off_x, off_y = from_target(f.place, f.step_s, one, x_m, y_m, time_s)
                sin_t, cos_t = f.facing[one, p, 0], f.facing[one, p, 1]
                across_m, along_m = s * (off_x * cos_t - off_y * sin_t), off_x * sin_t + off_y * cos_t
                bearings[one, k, j] = math.atan2(off_x, off_y)
                range_m = math.hypot(off_x, off_y)
                if near_m - IN_BAND_M < range_m < far_m + IN_BAND_M:
                    off[one, k] *= off_side(across_m, blurred_m(scene, f.facing[one, p, 2], along_m, time_s))
                value = wanted_value(scene, f, looker, s, one, p, off_x, off_y, heading_rad, classes, share)
                now[one, k] = min(now[one, k], value)
                off_after_turns(team, scene, s * off_x, off_y, turned[one, p], found)
                for t in range(turns):
                    after[one, k, t] = min(after[one, k, t], found[t])
    return Cover(off, now, after, bearings, turned)


@compiled
def uncovered(bearing_rad: float, others_rad: FloatArray) -> float:
    """Return the share of the target's courses, 0..0.5, for which none of all aircraft would be on one side of it.

    It is what the widest gap between their bearings (others: (m,)) is wider than half a turn.
    """
    widest_rad, m = 0.0, len(others_rad)
    for i in range(m + 1):
        from_rad = bearing_rad if i == m else others_rad[i]
        gap_rad = 2.0 * math.pi
        for j in range(m + 1):
            if i != j:
                to_rad = bearing_rad if j == m else others_rad[j]
                ahead_rad = to_rad - from_rad
                gap_rad = min(gap_rad, ahead_rad - 2.0 * math.pi * math.floor(ahead_rad / (2.0 * math.pi)))
        widest_rad = max(widest_rad, gap_rad)
    return max(widest_rad - math.pi, 0.0) / (2.0 * math.pi)

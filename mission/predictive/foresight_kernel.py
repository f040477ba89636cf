"""The planner's look ahead with a known route: futures along it, and the value table in layers of time.

Without a route, or off it, everything is as :func:`sidelong.mission.predictive.future_kernel.winding` leaves it. On
the route one more future follows it. Futures in which the target turns keep a fifth of the probability at least: a
route does not exclude that the target leaves it.
"""

from __future__ import annotations

import math

import numpy as np

from sidelong.estimators.compiled import compiled
from sidelong.mission.core.path import FloatArray
from sidelong.mission.core.sight import Sight
from sidelong.mission.predictive.cost_kernel import Table
from sidelong.mission.predictive.decision_kernel import (
    Depth,
    Looker,
    Prices,
    best_line,
    choices,
    commitment,
    look_deeper,
    with_table,
)
from sidelong.mission.predictive.future_kernel import classes_about, watched, winding
from sidelong.mission.predictive.programme_kernel import (
    COMPUTED_S,
    FOLLOWED,
    HEADINGS,
    KNOWN,
    MIRROR,
    WIND_RAD,
    course_index,
    fill_layers,
    layer_s,
    least_of,
    resample,
)
from sidelong.mission.predictive.rollout_kernel import Futures
from sidelong.mission.predictive.scene_kernel import Scene, in_frame
from sidelong.mission.route.progress_kernel import CHANCE, OF_USE, ON_ROUTE, PART, forecast, update_progress
from sidelong.mission.viewpoint.viewpoint_kernel import STANDING

_ROUTE = 0  # the future along the route is the first one
_TRUST = 0.8  # the most that it counts
_LEAST_TRUST = 0.3  # a less probable route is not planned along
_RENEW_S = 2.5  # how long the layers are used
_OTHER_WIND_RAD = 0.3
_PRICE_SHARE = 0.7  # of what moves cost without a route: along one fewer are needed, and they gain more


@compiled
def along_route(scene: Scene, looker: Looker, every: Futures) -> tuple[Futures, bool]:
    """Return futures of which the first follows the route, and True; the same and False off the route, or of no use.

    The route replaces the future along the target's own trail.
    """
    way, progress = looker.foresight.way, looker.foresight.progress
    if len(way.points) == 0 or progress[ON_ROUTE] == 0.0 or progress[OF_USE] == 0.0:
        return every, False
    chance, turns, k = _TRUST * progress[CHANCE], len(looker.turns.rate_rad_s), every.place.shape[1]
    if chance < _LEAST_TRUST:
        return every, False
    weight, place = np.full(turns + 1, (1.0 - chance) / turns), np.empty((turns + 1, k, 4))
    weight[_ROUTE] = chance
    place[1], place[2:] = every.place[0], every.place[len(every.weight) - turns + 1 :]
    points = np.empty((k + 1, 2))
    forecast(way, progress, scene.departure_s, points)
    off_e, off_n = scene.frame_east_m - points[0, 0], scene.frame_north_m - points[0, 1]
    for i in range(k + 1):
        points[i, 0], points[i, 1] = in_frame(scene, points[i, 0] + off_e, points[i, 1] + off_n)
    for i in range(k):
        place[_ROUTE, i, 0], place[_ROUTE, i, 1] = points[i, 0], points[i, 1]
        place[_ROUTE, i, 2], place[_ROUTE, i, 3] = points[i + 1, 0] - points[i, 0], points[i + 1, 1] - points[i, 1]
    moving = looker.memory[STANDING] == 0.0
    return watched(scene, looker.motions, looker.wish, looker.memory, moving, weight, place), True


@compiled
def _fill_after_turn(f: Futures, turn_rad: float, scene: Scene, looker: Looker) -> None:
    """Compute the values after a turn for the courses that the route takes, and for this wind, unless they are."""
    s, motions, table = looker.foresight, looker.motions, looker.table
    wind_m_s = math.hypot(scene.air.wind_x_m_s, scene.air.wind_y_m_s)
    wind_rad = math.atan2(scene.air.wind_x_m_s, scene.air.wind_y_m_s) - turn_rad if wind_m_s > 0.0 else 0.0
    changed_rad = wind_rad - s.state[WIND_RAD]
    changed_rad -= 2.0 * math.pi * round(changed_rad / (2.0 * math.pi))
    # The frame of a sector is fixed: its angle in the plane does not change.
    if motions.wind_speed_m_s > 0.0 and abs(changed_rad) > _OTHER_WIND_RAD:
        s.state[KNOWN:] = 0.0
        s.state[WIND_RAD] = wind_rad
    classes, turn_share = np.empty((1, 1, 4), np.int64), np.empty((1, 1, 4))
    for k in range(f.place.shape[1]):
        course = course_index(f, _ROUTE, k, turn_rad)
        if s.state[KNOWN + course] > 0.0:
            continue
        s.state[KNOWN + course] = 1.0
        course_rad = course * 2.0 * math.pi / HEADINGS
        table_rad = course_rad if motions.follows_course else f.course[_ROUTE, k, 2] - turn_rad
        to_rad, from_rad = course_rad - table_rad, s.state[WIND_RAD] - table_rad
        fastest = motions.target_speed_max_m_s
        vx, vy = fastest * math.sin(to_rad), fastest * math.cos(to_rad)
        wx, wy = motions.wind_speed_m_s * math.sin(from_rad), motions.wind_speed_m_s * math.cos(from_rad)
        which, _, shares = classes_about(motions, vx, vy, wx, wy)
        for c in range(4):
            classes[0, 0, c], turn_share[0, 0, c] = which[c], shares[c]
        found = s.after_turn[len(table.values) + course]
        resample(table.after_turn, table.cell_m, classes, turn_share, 0, 0, s.cell_m, table_rad, found)


@compiled
def foresee(scene: Scene, looker: Looker) -> tuple[Futures, Looker]:
    """Return what the target may do, and the looker to judge it by.

    Processes the target's estimate: call it once for each, in order of time.
    """
    every, s, table = (
        winding(scene, looker.motions, looker.wish, looker.memory, looker.turns),
        looker.foresight,
        looker.table,
    )
    if len(s.way.points) == 0:
        return every, looker
    update_progress(s.way, scene.target, s.progress)
    f, on_route = along_route(scene, looker, every)
    part, state = s.progress[PART], s.state
    if not on_route:
        state[COMPUTED_S] = -np.inf
        return f, looker
    p = looker.prices
    prices = Prices(_PRICE_SHARE * p.leave, _PRICE_SHARE * p.change, p.commit, p.commit_s, p.threat_s)
    turn_rad, count = -scene.mirror * scene.course_rad, len(table.values)
    layers, dt_s = len(s.values) - count, layer_s(scene.air.airspeed_m_s, scene.radius_m)
    since_s = scene.departure_s - state[COMPUTED_S]
    if not 0.0 <= since_s <= _RENEW_S or state[MIRROR] != scene.mirror or state[FOLLOWED] != part:
        _fill_after_turn(f, turn_rad, scene, looker)
        fill_layers(
            f,
            _ROUTE,
            turn_rad,
            scene.doubt,
            looker.terms,
            table,
            scene.air,
            scene.radius_m,
            prices.leave,
            prices.change,
            s.cell_m,
            s.after_turn[count:],
            s.values[count:],
        )
        least_of(s.values[count:], s.least[count:])
        state[COMPUTED_S], state[MIRROR], state[FOLLOWED], since_s = scene.departure_s, scene.mirror, part, 0.0
    sin_t, cos_t = math.sin(turn_rad), math.cos(turn_rad)
    for k in range(f.place.shape[1]):
        at = min((k * f.step_s + since_s) / dt_s, layers - 1.001)
        layer, past = int(at), at - int(at)
        f.classes[_ROUTE, k, 0], f.classes[_ROUTE, k, 1] = count + layer, count + layer + 1
        f.share[_ROUTE, k, 0], f.share[_ROUTE, k, 1] = 1.0 - past, past
        f.share[_ROUTE, k, 2:] = 0.0
        f.classes[_ROUTE, k, 2] = count + course_index(f, _ROUTE, k, turn_rad)
        f.turn_share[_ROUTE, k, :] = 0.0
        f.turn_share[_ROUTE, k, 2] = 1.0
        f.course[_ROUTE, k, 0], f.course[_ROUTE, k, 1], f.course[_ROUTE, k, 2] = sin_t, cos_t, turn_rad
    timed = Table(s.values, s.after_turn, s.cell_m, table.discount_per_s, table.mean_leg_s)
    # Figures of eight have no second look, and the route alone would lead too near to a target that leaves it.
    every_future = looker.terms.blind > 0.0
    depth = Depth(looker.depth.beam, looker.depth.horizon_s, s.least, looker.depth.min_after_turn, every_future)
    return f, with_table(looker, timed, prices, depth)


@compiled
def weigh(scene: Scene, looker: Looker, sight: Sight) -> tuple[float, float, FloatArray]:
    """Return what staying costs, what a move must gain beyond its price, and what each move costs (choices,).

    Processes the target's estimate, as :func:`foresee` does.
    """
    futures, judged_by = foresee(scene, looker)
    min_gain, costs = commitment(scene, futures, judged_by), np.empty(choices(looker))
    return look_deeper(scene, futures, judged_by, sight, min_gain, costs), min_gain, costs


@compiled
def decide(scene: Scene, looker: Looker) -> tuple[float, float, FloatArray]:
    """Return (departure, radius, line (5, n)) of the best move where it is cheaper than staying, else n = 0.

    The ground hides nothing.
    """
    flat = Sight(np.zeros((0, 1, 1), np.float32), 1.0, 1.0, 0.0, 1.0, 0.0)
    stay_cost, min_gain, costs = weigh(scene, looker, flat)
    line = best_line(scene, looker.craft, costs, stay_cost - min_gain)
    return scene.departure_s, scene.radius_m, line

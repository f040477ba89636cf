"""The inner loops of :mod:`mission.fleet.team`: what a move is worth when others watch the same target.

Each line of an aircraft costs, beside the walls of the band:

- the time in which nobody watches from the wanted side: the chances of all to be off it, multiplied;
- the same after each turn that the target may make on the way: of all aircraft the one that would be off the wanted
  side for the shortest time counts. So two aircraft stand opposite each other, and not on the line in which a
  likely turn would put both ahead and astern;
- the courses of the target for which nobody would be on the wanted side: none while the aircraft stand opposite;
- a share of what the line would cost the aircraft alone on the side of its role, so that it stays near to that.

Frames are those of :mod:`mission.predictive._scene_kernel`; the wanted frame is mirrored for who is opposite.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from estimators.compiled import compiled
from mission.core.path import FloatArray
from mission.geometry._line_kernel import ARC, Circling, nearest_arc_m, point_at
from mission.geometry._line_kernel import ground_speed_m_s as ground_speed
from mission.predictive._cost_kernel import Float32, IntArray, cost_rate, table_value
from mission.predictive._decision_kernel import (
    MIN_MOVE,
    NEARLY_FLOWN_S,
    Looker,
    commitment,
    flown_on,
)
from mission.predictive._future_kernel import fill_classes, first_of, winding
from mission.predictive._moves_kernel import MOVES, STAY_LENGTHS, STEP_S, lines_from, move_line, ramp_on
from mission.predictive._rollout_kernel import TURN_STRIDE, Futures, Lines
from mission.predictive._scene_kernel import Scene, in_frame, scene_of
from mission.viewpoint._viewpoint_kernel import SIDE, Known

FORESEEN = 111  # seconds, as far as any line leads
_TAIL_S = 30.0  # how they stand at the end of a line lasts for so long


class Team(NamedTuple):
    """What joint decisions are made with.

    wanted: the side, 1 left, -1 right. moving, stood (directions of the wind, headings, n, n): value tables after a
    turn, by the mean over speeds, and after a stop. turns_rad, chances (t,): of a turn's angle; stop: chance of none.
    alone_running, alone_end: shares of what an aircraft alone would pay on the way, and from the end of its line on.
    opposite: per second, of the share of courses that nobody would cover. price: share of what changes cost alone.
    futures: 1 for the target's velocity kept alone.
    """

    wanted: float
    moving: Float32
    stood: Float32
    turns_rad: FloatArray
    chances: FloatArray
    stop: float
    alone_running: float
    alone_end: float
    together: float
    price: float
    opposite: float
    futures: int


class Cover(NamedTuple):
    """What the others cover, foretold in the departure's frame of one aircraft every STEP_S from its departure on.

    off (f, FORESEEN): the chance that none of them is on the wanted side. after (f, FORESEEN, t + 1): the least
    value of theirs after each turn, last after a stop; now (f, FORESEEN): if the target goes on as it does. Infinite
    where there are none. bearings (f, FORESEEN, m): of each from the target.
    """

    off: FloatArray
    after: FloatArray
    now: FloatArray
    bearings: FloatArray


@compiled
def foretold(
    now_s: float,
    east_m: float,
    north_m: float,
    course_rad: float,
    present: FloatArray,
    present_circle: Circling,
    coming: FloatArray,
    coming_circle: Circling,
    departure_s: float,
    airspeed_m_s: float,
    wind_east_m_s: float,
    wind_north_m_s: float,
    found: FloatArray,
) -> None:
    """Fill in (east, north, course) (3, n) every STEP_S from now on; departure_s is inf where no plan is coming."""
    arc_m = nearest_arc_m(present, present_circle, east_m, north_m, course_rad)
    line, circle, departed = present, present_circle, False
    for k in range(found.shape[1]):
        if not departed and now_s + k * STEP_S >= departure_s:
            line, circle, arc_m, departed = coming, coming_circle, 0.0, True
        point = point_at(line, circle, arc_m, east_m, north_m)
        found[0, k], found[1, k], found[2, k] = point.east_m, point.north_m, point.course_rad
        arc_m += STEP_S * ground_speed(point.course_rad, airspeed_m_s, wind_east_m_s, wind_north_m_s)


@compiled
def _after_turns(
    team: Team,
    cell_m: float,
    x_m: float,
    y_m: float,
    heading_rad: float,
    frame_rad: float,
    wind_rad: float,
    classes: IntArray,
    share: FloatArray,
    found: FloatArray,
) -> None:
    """Fill in the values (t + 1,) of a place of the wanted frame, whose target then goes on at frame_rad + a turn."""
    turns = len(team.turns_rad)
    directions = team.moving.shape[0]
    for i in range(turns + 1):
        angle_rad = frame_rad + (team.turns_rad[i] if i < turns else 0.0)
        if directions > 1:
            direction = (wind_rad - angle_rad) / (2.0 * math.pi) * directions
            direction -= directions * math.floor(direction / directions)
            first = min(int(direction), directions - 1)
            classes[0, 0, 0], classes[0, 0, 1] = first, (first + 1) % directions
            share[0, 0, 0], share[0, 0, 1] = 1.0 - (direction - first), direction - first
        sin_a, cos_a = math.sin(angle_rad), math.cos(angle_rad)
        across_m, along_m = x_m * cos_a - y_m * sin_a, x_m * sin_a + y_m * cos_a
        values = team.moving if i < turns else team.stood
        found[i] = table_value(values, cell_m, across_m, along_m, heading_rad - angle_rad, classes, share, 0, 0)


@compiled
def _blur_m(scene: Scene, sigma_rad: float, along_m: float, time_s: float) -> float:
    velocity_m = scene.doubt.velocity_m_s * time_s
    place_m = scene.doubt.position_m
    return 1.0 + math.sqrt(
        place_m * place_m + velocity_m * velocity_m + (sigma_rad * along_m) * (sigma_rad * along_m)
    )


@compiled
def _off(across_m: float, blur_m: float) -> float:
    return min(max(0.5 + 0.5 * across_m / blur_m, 0.0), 1.0)


@compiled
def _wanted_value(
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
    sin_t, cos_t, spare = f.course[one, p, 0], f.course[one, p, 1], np.empty(4)
    vx, vy, air = f.place[one, p, 2], f.place[one, p, 3], scene.air
    fill_classes(
        looker.motions,
        s * (vx * cos_t - vy * sin_t),
        vx * sin_t + vy * cos_t,
        s * (air.wind_x_m_s * cos_t - air.wind_y_m_s * sin_t),
        air.wind_x_m_s * sin_t + air.wind_y_m_s * cos_t,
        classes[0, 0],
        share[0, 0],
        spare,
    )
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
    futures, turns = len(f.weight), len(team.turns_rad)
    off, after = np.ones((futures, FORESEEN)), np.full((futures, FORESEEN, turns + 1), np.inf)
    now, bearings = np.full((futures, FORESEEN), np.inf), np.empty((futures, FORESEEN, len(others)))
    classes, share, found = np.zeros((1, 1, 4), np.int64), np.zeros((1, 1, 4)), np.empty(turns + 1)
    share[0, 0, 0] = 1.0
    s = scene.mirror * team.wanted
    wind_rad = math.atan2(s * scene.air.wind_x_m_s, scene.air.wind_y_m_s)
    last_k, near_m, far_m = f.place.shape[1] - 1, looker.terms.near_m, looker.terms.far_m
    n = others.shape[2]
    for k in range(FORESEEN):
        time_s = k * STEP_S
        for j in range(len(others)):
            at = (scene.departure_s - first_s[j]) / STEP_S + k
            i = min(max(int(at), 0), n - 2)
            past = min(max(at - i, 0.0), 1.0)
            east_m = others[j, 0, i] + past * (others[j, 0, i + 1] - others[j, 0, i])
            north_m = others[j, 1, i] + past * (others[j, 1, i + 1] - others[j, 1, i])
            x_m, y_m = in_frame(scene, east_m, north_m)
            heading_rad = scene.mirror * (others[j, 2, i] - scene.course_rad)
            for one in range(futures):
                p = min(int(time_s / f.step_s), last_k)
                since_s = time_s - p * f.step_s
                off_x = x_m - (f.place[one, p, 0] + f.place[one, p, 2] * since_s)
                off_y = y_m - (f.place[one, p, 1] + f.place[one, p, 3] * since_s)
                sin_t, cos_t = f.facing[one, p, 0], f.facing[one, p, 1]
                across_m, along_m = s * (off_x * cos_t - off_y * sin_t), off_x * sin_t + off_y * cos_t
                bearings[one, k, j] = math.atan2(off_x, off_y)
                range_m = math.hypot(off_x, off_y)
                if near_m - 15.0 < range_m < far_m + 15.0:
                    off[one, k] *= _off(across_m, _blur_m(scene, f.facing[one, p, 2], along_m, time_s))
                value = _wanted_value(scene, f, looker, s, one, p, off_x, off_y, heading_rad, classes, share)
                now[one, k] = min(now[one, k], value)
                if k % TURN_STRIDE == 0:
                    frame_rad = s * f.course[one, p, 2]
                    _after_turns(
                        team, looker.table.cell_m, s * off_x, off_y, s * heading_rad, frame_rad,
                        wind_rad, classes, share, found,
                    )  # fmt: skip
                    for t in range(turns + 1):
                        after[one, k, t] = min(after[one, k, t], found[t])
    return Cover(off, after, now, bearings)


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


@compiled
def _team_rate(
    scene: Scene,
    f: Futures,
    cover: Cover,
    looker: Looker,
    team: Team,
    x_m: float,
    y_m: float,
    time_s: float,
) -> float:
    """Return the running cost at a place of the departure's frame, over all futures, without discount."""
    c, d, s = looker.terms, scene.doubt, scene.mirror * team.wanted
    k = min(int(time_s / STEP_S), FORESEEN - 1)
    total = 0.0
    for one in range(len(f.weight)):
        p = min(int(time_s / f.step_s), f.place.shape[1] - 1)
        since_s = time_s - p * f.step_s
        off_x = x_m - (f.place[one, p, 0] + f.place[one, p, 2] * since_s)
        off_y = y_m - (f.place[one, p, 1] + f.place[one, p, 3] * since_s)
        sin_t, cos_t = f.facing[one, p, 0], f.facing[one, p, 1]
        across_m, along_m = off_x * cos_t - off_y * sin_t, off_x * sin_t + off_y * cos_t
        blur_m = _blur_m(scene, f.facing[one, p, 2], along_m, time_s)
        widened_m = math.hypot(d.position_m, d.velocity_m_s * time_s)
        alone = _off(across_m, blur_m)
        walls = cost_rate(across_m, along_m, widened_m, blur_m, c) - alone
        missing = _off(s * across_m, blur_m) * cover.off[one, k]
        gap = uncovered(math.atan2(off_x, off_y), cover.bearings[one, k])
        total += f.weight[one] * (walls + team.alone_running * alone + team.together * missing + team.opposite * gap)
    return total


@compiled
def _turn_rate(
    scene: Scene,
    f: Futures,
    cover: Cover,
    looker: Looker,
    team: Team,
    x_m: float,
    y_m: float,
    heading_rad: float,
    time_s: float,
    classes: IntArray,
    share: FloatArray,
    found: FloatArray,
) -> float:
    """Return what the target's turning now would cost all together, over all futures and turns."""
    s, turns = scene.mirror * team.wanted, len(team.turns_rad)
    wind_rad = math.atan2(s * scene.air.wind_x_m_s, scene.air.wind_y_m_s)
    k = min(int(time_s / STEP_S), FORESEEN - 1) // TURN_STRIDE * TURN_STRIDE
    total = 0.0
    for one in range(len(f.weight)):
        p = min(int(time_s / f.step_s), f.place.shape[1] - 1)
        since_s = time_s - p * f.step_s
        off_x = x_m - (f.place[one, p, 0] + f.place[one, p, 2] * since_s)
        off_y = y_m - (f.place[one, p, 1] + f.place[one, p, 3] * since_s)
        _after_turns(
            team, looker.table.cell_m, s * off_x, off_y, s * heading_rad, s * f.course[one, p, 2],
            wind_rad, classes, share, found,
        )  # fmt: skip
        expected = 0.0
        for t in range(turns + 1):
            chance = (1.0 - team.stop) * team.chances[t] if t < turns else team.stop
            expected += chance * min(found[t], cover.after[one, k, t])
        total += f.weight[one] * expected
    return team.together * total


@compiled
def _role_value(f: Futures, looker: Looker, x_m: float, y_m: float, heading_rad: float, time_s: float) -> float:
    """Return what an aircraft alone would pay from a place of the departure's frame on, on the side of its role."""
    table, total = looker.table, 0.0
    for one in range(len(f.weight)):
        p = min(int(time_s / f.step_s), f.place.shape[1] - 1)
        since_s = time_s - p * f.step_s
        off_x = x_m - (f.place[one, p, 0] + f.place[one, p, 2] * since_s)
        off_y = y_m - (f.place[one, p, 1] + f.place[one, p, 3] * since_s)
        sin_t, cos_t = f.course[one, p, 0], f.course[one, p, 1]
        across_m, along_m = off_x * cos_t - off_y * sin_t, off_x * sin_t + off_y * cos_t
        heading = heading_rad - f.course[one, p, 2]
        value = table_value(table.values, table.cell_m, across_m, along_m, heading, f.classes, f.share, one, p)
        total += f.weight[one] * value
    return total


@compiled
def _end_value(
    scene: Scene,
    f: Futures,
    cover: Cover,
    looker: Looker,
    team: Team,
    x_m: float,
    y_m: float,
    heading_rad: float,
    time_s: float,
    classes: IntArray,
    share: FloatArray,
) -> float:
    """Return what is to be paid from the end of a line on: its share alone, and together."""
    k, s, total = min(int(time_s / STEP_S), FORESEEN - 1), scene.mirror * team.wanted, 0.0
    for one in range(len(f.weight)):
        p = min(int(time_s / f.step_s), f.place.shape[1] - 1)
        since_s = time_s - p * f.step_s
        off_x = x_m - (f.place[one, p, 0] + f.place[one, p, 2] * since_s)
        off_y = y_m - (f.place[one, p, 1] + f.place[one, p, 3] * since_s)
        value = _wanted_value(scene, f, looker, s, one, p, off_x, off_y, heading_rad, classes, share)
        gap = uncovered(math.atan2(off_x, off_y), cover.bearings[one, k])
        total += f.weight[one] * (min(value, cover.now[one, k]) + _TAIL_S * team.opposite / team.together * gap)
    return team.together * total + team.alone_end * _role_value(f, looker, x_m, y_m, heading_rad, time_s)


@compiled
def team_lines_costs(
    lines: Lines,
    x_m: float,
    y_m: float,
    heading_rad: float,
    scene: Scene,
    f: Futures,
    cover: Cover,
    looker: Looker,
    team: Team,
    costs: FloatArray,
) -> None:
    """Fill in what each line costs all together, as :func:`mission.predictive._rollout_kernel.lines_costs` does."""
    own_x, own_y, turned, time_s, weight = lines.x_m, lines.y_m, lines.turned_rad, lines.time_s, lines.weight
    trunk_first, own_first, trunk, on_trunk = lines.trunk_first, lines.own_first, lines.trunk, lines.on_trunk
    hazard_per_s = 1.0 / looker.table.mean_leg_s
    n, h0 = len(own_x), heading_rad
    sin_h, cos_h = math.sin(heading_rad), math.cos(heading_rad)
    x, y, rates = np.empty(n), np.empty(n), np.empty(n)
    sums, turns, turn_rates = np.zeros(n), np.zeros(n), np.zeros(n)
    classes, share, found = np.zeros((1, 1, 4), np.int64), np.zeros((1, 1, 4)), np.empty(len(team.turns_rad) + 1)
    share[0, 0, 0] = 1.0
    for s in range(n):
        x[s] = x_m + own_x[s] * cos_h + own_y[s] * sin_h
        y[s] = y_m - own_x[s] * sin_h + own_y[s] * cos_h
        rates[s] = weight[s] * _team_rate(scene, f, cover, looker, team, x[s], y[s], time_s[s])
    for h in range(len(trunk_first) - 1):
        first = trunk_first[h]
        for s in range(first, trunk_first[h + 1]):
            if s > first:
                sums[s] = sums[s - 1] + 0.5 * (rates[s - 1] + rates[s]) * (time_s[s] - time_s[s - 1])
            if (s - first) % TURN_STRIDE == 0:
                turn_rates[s] = hazard_per_s * weight[s] * _turn_rate(
                    scene, f, cover, looker, team, x[s], y[s], h0 + turned[s], time_s[s], classes, share, found
                )  # fmt: skip
                if s > first:
                    held_s = time_s[s] - time_s[s - TURN_STRIDE]
                    turns[s] = turns[s - TURN_STRIDE] + turn_rates[s - TURN_STRIDE] * held_s
    for i in range(len(trunk)):
        first = trunk_first[trunk[i]]
        before = first + on_trunk[i] - 1
        leaving = first + (on_trunk[i] - 1) // TURN_STRIDE * TURN_STRIDE
        total = sums[before] + turns[leaving]
        turn_rate, turn_s = turn_rates[leaving], time_s[leaving]
        last = own_first[i + 1] - 1
        for s in range(own_first[i], last + 1):
            total += 0.5 * (rates[before] + rates[s]) * (time_s[s] - time_s[before])
            before = s
            if (on_trunk[i] + s - own_first[i]) % TURN_STRIDE == 0 and s < last:
                total += turn_rate * (time_s[s] - turn_s)
                turn_s = time_s[s]
                turn_rate = hazard_per_s * weight[s] * _turn_rate(
                    scene, f, cover, looker, team, x[s], y[s], h0 + turned[s], time_s[s], classes, share, found
                )  # fmt: skip
        total += turn_rate * (time_s[last] - turn_s)
        end = _end_value(
            scene, f, cover, looker, team, x[last], y[last], h0 + turned[last], time_s[last], classes, share
        )
        costs[i] = total + weight[last] * end


@compiled
def team_line_cost(
    ahead: FloatArray, time_s: FloatArray, scene: Scene, f: Futures, cover: Cover, looker: Looker, team: Team
) -> float:
    """Return the same of one line (3, k) in the departure's frame."""
    n, table = len(time_s), looker.table
    hazard_per_s = 1.0 / table.mean_leg_s
    classes, share, found = np.zeros((1, 1, 4), np.int64), np.zeros((1, 1, 4)), np.empty(len(team.turns_rad) + 1)
    share[0, 0, 0] = 1.0
    total, before = 0.0, 0.0
    for s in range(n):
        weight = math.exp(-(table.discount_per_s + hazard_per_s) * time_s[s])
        rate = weight * _team_rate(scene, f, cover, looker, team, ahead[0, s], ahead[1, s], time_s[s])
        if s > 0:
            total += 0.5 * (before + rate) * (time_s[s] - time_s[s - 1])
        before = rate
        if s % TURN_STRIDE == 0:
            turn = _turn_rate(
                scene, f, cover, looker, team, ahead[0, s], ahead[1, s], ahead[2, s], time_s[s], classes, share, found
            )
            total += hazard_per_s * weight * turn * (time_s[min(s + TURN_STRIDE, n - 1)] - time_s[s])
    last_x, last_y, last_rad, last_s = ahead[0, n - 1], ahead[1, n - 1], ahead[2, n - 1], time_s[n - 1]
    end = _end_value(scene, f, cover, looker, team, last_x, last_y, last_rad, last_s, classes, share)
    return total + math.exp(-(table.discount_per_s + hazard_per_s) * last_s) * end


@compiled
def team_look_ahead(
    scene: Scene,
    east_m: float,
    north_m: float,
    line: FloatArray,
    circle: Circling,
    f: Futures,
    cover: Cover,
    looker: Looker,
    team: Team,
    costs: FloatArray,
) -> float:
    """Fill in what each move costs (MOVES,), its price included, and return what going on as planned costs."""
    craft, kept, prices, air, radius_m = looker.craft, looker.kept, looker.prices, scene.air, scene.radius_m
    rate_per_s = looker.table.discount_per_s + 1.0 / looker.table.mean_leg_s
    x_m, y_m = in_frame(scene, scene.start.east_m, scene.start.north_m)
    heading_rad = scene.mirror * (scene.start.course_rad - scene.course_rad)
    ramp = ramp_on(heading_rad, air, craft)
    start_per_m = scene.mirror * scene.start.curvature_per_m
    lines = lines_from(0.0, scene, start_per_m, ramp, 0.0, craft, heading_rad, rate_per_s, kept)
    team_lines_costs(lines, x_m, y_m, heading_rad, scene, f, cover, looker, team, costs)
    left_m = line[ARC, line.shape[1] - 1] - scene.arc_m if line.shape[1] > 0 else 0.0
    if left_m > NEARLY_FLOWN_S * air.airspeed_m_s:
        ahead, time_s = flown_on(scene, line, circle, east_m, north_m, left_m)
        costs += team.price * prices.change
        return team_line_cost(ahead, time_s, scene, f, cover, looker, team)
    for i in range(MOVES):
        costs[i] = np.inf if lines.end_m[i] < MIN_MOVE * radius_m else costs[i] + team.price * prices.leave
    stays = lines_from(1.0, scene, scene.mirror / circle.radius_m, ramp, 0.0, craft, heading_rad, rate_per_s, kept)
    stay_costs = np.empty(STAY_LENGTHS.size)
    team_lines_costs(stays, x_m, y_m, heading_rad, scene, f, cover, looker, team, stay_costs)
    return float(stay_costs.min())


@compiled
def role_values(
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
    looker: Looker,
    team: Team,
) -> tuple[float, float]:
    """Return what an aircraft would pay alone, from its next departure on: on the wanted side, and opposite."""
    held = looker.memory[SIDE]
    looker.memory[SIDE] = team.wanted
    wanted = _value_at(time_s, east_m, north_m, course_rad, speed_m_s, curvature_per_m, target, line, circle,
                       wind_east_m_s, wind_north_m_s, latency_s, looker)  # fmt: skip
    looker.memory[SIDE] = -team.wanted
    opposite = _value_at(time_s, east_m, north_m, course_rad, speed_m_s, curvature_per_m, target, line, circle,
                         wind_east_m_s, wind_north_m_s, latency_s, looker)  # fmt: skip
    looker.memory[SIDE] = held
    return wanted, opposite


@compiled
def _value_at(
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
    looker: Looker,
) -> float:
    scene = scene_of(
        time_s, east_m, north_m, course_rad, speed_m_s, curvature_per_m, target, line, circle, wind_east_m_s,
        wind_north_m_s, latency_s, looker.target_speed_max_m_s, looker.craft, looker.wish, looker.memory,
    )  # fmt: skip
    f = first_of(winding(scene, looker.motions, looker.wish, looker.memory, looker.turns))
    x_m, y_m = in_frame(scene, scene.start.east_m, scene.start.north_m)
    heading_rad = scene.mirror * (scene.start.course_rad - scene.course_rad)
    return _role_value(f, looker, x_m, y_m, heading_rad, 0.0)


@compiled
def team_decide(
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
    age_s: float,
    others: FloatArray,
    first_s: FloatArray,
    looker: Looker,
    team: Team,
    costs: FloatArray,
) -> tuple[Scene, float, float]:
    """Fill in what each move costs (MOVES,); return the scene, what staying costs, and what a move has to beat."""
    scene = scene_of(
        time_s, east_m, north_m, course_rad, speed_m_s, curvature_per_m, target, line, circle, wind_east_m_s,
        wind_north_m_s, latency_s, looker.target_speed_max_m_s, looker.craft, looker.wish, looker.memory,
    )  # fmt: skip
    f = winding(scene, looker.motions, looker.wish, looker.memory, looker.turns)
    if team.futures < 2:
        f = first_of(f)
    cover = cover_of(scene, f, others, first_s, looker, team)
    stay_cost = team_look_ahead(scene, east_m, north_m, line, circle, f, cover, looker, team, costs)
    bar = stay_cost - team.price * commitment(scene, east_m, north_m, line, circle, age_s, f, looker)
    return scene, stay_cost, bar


@compiled
def best_line(scene: Scene, looker: Looker, costs: FloatArray, bar: float) -> FloatArray:
    """Return the line (5, n) of the cheapest move where it is below the bar, else n = 0."""
    best = int(np.argmin(costs))
    if costs[best] < bar:
        return move_line(scene, looker.craft, best)
    return np.empty((5, 0))

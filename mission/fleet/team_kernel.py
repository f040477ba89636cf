"""The inner loops of :mod:`sidelong.mission.fleet.team_planner`: values of moves when others watch the same target.

Each line of an aircraft costs, in addition to the walls of the band:

- the time in which no aircraft watches from the required side: the chances of all to be off it, multiplied;
- the same after each turn that the target may make on the way, and while the aircraft circles after it: of all
  aircraft the one that would be off the wanted side for the shortest time counts. So two aircraft stand opposite each
  other, and not on the line in which a likely turn would put both ahead and astern;
- the courses of the target for which no aircraft would be on the required side: none while they stand opposite;
- a share of what the line would cost the aircraft alone on the side of its role, so that it stays near to that;
- the edges of the band after the line's end, on the cheapest of a few continuations: a share of them is too little;
- for the primary, what the move costs it more than staying where it looks two moves ahead, alone: what the others
  see is predicted along the lines that they have, and a target that winds leaves those behind.

The two that follow a line's end, turns and courses, are averaged over the lap on the circle after it: two circles in
step cover each other's swings, two that are not open a gap with every lap.

Frames are those of :mod:`sidelong.mission.predictive.scene_kernel`; the wanted frame is mirrored for the aircraft on
the opposite side.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from sidelong.estimators.compiled import compiled, inner, inner_inlined
from sidelong.mission.core.path import FloatArray
from sidelong.mission.geometry.line_kernel import speed_m_s
from sidelong.mission.predictive.decision_kernel import (
    Question,
    add_prices,
    along_route,
    alternatives,
    commitment,
)
from sidelong.mission.predictive.moves_kernel import ramp_on
from sidelong.mission.predictive.rollout_kernel import (
    STEP_S,
    IntArray,
    Lines,
    Pose,
    Scenarios,
    add_up,
    cost_rate,
    from_target,
    least,
    placed,
    table_value,
    turn_samples,
)
from sidelong.mission.predictive.scene_kernel import Scene, Turns, classes_about, first_of, in_frame, winding

FORESEEN = 111  # seconds, as far as any line leads
BACK_SHARE = 0.6  # of the airspeed, at which an aircraft comes back over the edge of the side
IN_BAND_M = 15.0  # outside the band that is planned for, still in the required one
_OFF_MAX_S = 60.0
_ALONE = 0.2  # of what an aircraft would pay alone
_TURN_WEIGHT, _MARGIN = 2.0, 0.5  # of what turns would cost; of the side, in radii of the circle


class Team(NamedTuple):
    """What joint decisions are made with.

    wanted: the side, 1 left, -1 right. turns_rad, chances (t,): the turns that the target may make. price: share of
    what changes cost alone. opposite: per second, of the share of courses that no aircraft would cover. own: weight
    of what the moves of the primary are worth to it alone.
    """

    wanted: float
    turns_rad: FloatArray
    chances: FloatArray
    price: float
    opposite: float
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


@inner
def off_after_turns(team: Team, scene: Scene, x_m: float, y_m: float, turned: FloatArray, found: FloatArray) -> None:
    """Fill in for how long, s, a place of the required side's frame would be off the side after each turn (t,).

    turned (t, 2): sine and cosine of each turn. The target goes on along the new course, so the way back is across it
    alone; the margin stands for the circle that leads to and fro over the edge.
    """
    for i in range(len(team.turns_rad)):
        across_m = x_m * turned[i, 1] - y_m * turned[i, 0]
        off_s = (across_m + _MARGIN * scene.radius_m) / (BACK_SHARE * scene.air.airspeed_m_s)
        found[i] = min(max(off_s, 0.0), _OFF_MAX_S)


class Scratch(NamedTuple):
    """Arrays to work in.

    classes, share (1, 1, 4): to look up one value with. off_s (t,): time off the side after each turn. places
    (4, 2, k): of four continuations.
    """

    classes: IntArray
    share: FloatArray
    off_s: FloatArray
    places: FloatArray


@inner
def new_scratch(turns: int) -> Scratch:
    """Return arrays to work in."""
    classes, share = np.empty((1, 1, 4), np.int64), np.empty((1, 1, 4))
    return Scratch(classes, share, np.empty(turns), np.empty((4, 2, _CONTINUED)))


@inner
def blurred_m(scene: Scene, sigma_rad: float, along_m: float, time_s: float) -> float:
    """Return the standard deviation of the distance across the side's limit, after ``time_s``."""
    place_m, velocity_m, aside_m = scene.doubt.position_m, scene.doubt.velocity_m_s * time_s, sigma_rad * along_m
    return 1.0 + math.sqrt(place_m * place_m + velocity_m * velocity_m + aside_m * aside_m)


@inner
def off_side(across_m: float, blur_m: float) -> float:
    """Return the probability 0..1 of being off the required side."""
    return min(max(0.5 + 0.5 * across_m / blur_m, 0.0), 1.0)


@inner_inlined
def turned_to(turn: FloatArray, one: int, p: int, x_m: float, y_m: float) -> tuple[float, float]:
    """Return a place or velocity (x, y) as (across, along) a course; ``turn[one, p]``: its sine and cosine."""
    sin_t, cos_t = turn[one, p, 0], turn[one, p, 1]
    return x_m * cos_t - y_m * sin_t, x_m * sin_t + y_m * cos_t


@inner
def wanted_value(
    scene: Scene, f: Scenarios, question: Question, s: float, one: int, p: int, off: Pose, scratch: Scratch
) -> float:
    """Return the cost to go of an aircraft alone, s off its side, from a place relative to the target at a sample.

    Args:
        s: 1 on the side of its role, which the departure's frame is for; -1 on the other one.
        one, p: Future and sample.
        off: Place and heading in the departure's frame, relative to the target.
    """
    classes, share, air, table = scratch.classes, scratch.share, scene.air, question.table
    vx, vy = turned_to(f.course, one, p, f.place[one, p, 2], f.place[one, p, 3])
    wind_x, wind_y = turned_to(f.course, one, p, air.wind_x_m_s, air.wind_y_m_s)
    which, shares, _ = classes_about(question.context.motions, s * vx, vy, s * wind_x, wind_y)
    for c in range(4):
        classes[0, 0, c], share[0, 0, c] = which[c], shares[c]
    across_m, along_m = turned_to(f.course, one, p, off.x_m, off.y_m)
    heading_rad = s * (off.heading_rad - f.course[one, p, 2])
    return table_value(table.values, table.cell_m, s * across_m, along_m, heading_rad, classes, share, 0, 0)


@inner
def cover_of(
    scene: Scene, f: Scenarios, others: FloatArray, first_s: FloatArray, question: Question, team: Team
) -> Cover:
    """Return what the others cover. others (m, 3, n): east, north, course every STEP_S from first_s (m,) on."""
    futures, turns, m = len(f.weight), len(team.turns_rad), len(others)
    off, now = np.ones((futures, FORESEEN)), np.full((futures, FORESEEN), np.inf)
    after = np.full((futures, FORESEEN, turns), np.inf)
    bearings, scratch = np.empty((futures, FORESEEN, m)), new_scratch(turns)
    found = scratch.off_s
    s = scene.mirror * team.wanted
    near_m, far_m = question.context.terms.near_m, question.context.terms.far_m
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
                across_m, along_m = turned_to(f.facing, one, p, off_x, off_y)
                bearings[one, k, j] = math.atan2(off_x, off_y)
                range_m = math.hypot(off_x, off_y)
                if near_m - IN_BAND_M < range_m < far_m + IN_BAND_M:
                    off[one, k] *= off_side(s * across_m, blurred_m(scene, f.facing[one, p, 2], along_m, time_s))
                value = wanted_value(scene, f, question, s, one, p, Pose(off_x, off_y, heading_rad), scratch)
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


_TAIL_S = 30.0  # duration for which the positions at the end of a line count
_CIRCLING_S = 60.0  # and the circle that it ends in
_LAP = 4  # places of a lap
_CONTINUED = 12  # seconds after the end of a line in which the edges of the band count
_QUICK_S = 1.0  # an upload that takes no longer is over by the end of any line


class Joint(NamedTuple):
    """What the lines of one aircraft are judged by next to the others; question: what it decides with alone."""

    scene: Scene
    scenarios: Scenarios
    cover: Cover
    question: Question
    team: Team
    scratch: Scratch


@inner
def _team_rate(joint: Joint, x_m: float, y_m: float, time_s: float) -> float:
    """Return the running cost at a place of the departure's frame, over all scenarios, without discount."""
    scene, f, cover, question, team, _ = joint
    c, d, s = question.context.terms, scene.doubt, scene.mirror * team.wanted
    k = min(int(time_s / STEP_S), FORESEEN - 1)
    total = 0.0
    for one in range(len(f.weight)):
        p, off_x, off_y = from_target(f.place, f.step_s, one, x_m, y_m, time_s)
        across_m, along_m = turned_to(f.facing, one, p, off_x, off_y)
        blur_m = blurred_m(scene, f.facing[one, p, 2], along_m, time_s)
        widened_m = math.hypot(d.position_m, d.velocity_m_s * time_s)
        alone = off_side(across_m, blur_m)
        walls = cost_rate(across_m, along_m, widened_m, blur_m, c) - alone
        missing = off_side(s * across_m, blur_m) * cover.off[one, k]
        gap = uncovered(math.atan2(off_x, off_y), cover.bearings[one, k])
        total += f.weight[one] * (walls + _ALONE * alone + missing + team.opposite * gap)
    return total


@inner
def _turn_cost(joint: Joint, x_m: float, y_m: float, time_s: float) -> float:
    """Return for how long the target's turning now would leave all off the side, over all scenarios and turns."""
    scene, f, cover, _, team, scratch = joint
    s, off_s = scene.mirror * team.wanted, scratch.off_s
    k = min(int(time_s / STEP_S), FORESEEN - 1)
    total = 0.0
    for one in range(len(f.weight)):
        p, off_x, off_y = from_target(f.place, f.step_s, one, x_m, y_m, time_s)
        off_after_turns(team, scene, s * off_x, off_y, cover.turned[one, p], off_s)
        for t in range(len(team.turns_rad)):
            total += f.weight[one] * team.chances[t] * min(off_s[t], cover.after[one, k, t])
    return _TURN_WEIGHT * total


@inner
def _way_back(scene: Scene, question: Question, range_m: float) -> float:
    """Return what the way back into the band costs.

    What the others see bounds what an end costs together: without this the shortest line would be the cheapest one
    outside the band, and an aircraft that got there would stay.
    """
    c = question.context.terms
    outside_m = max(c.near_m - range_m, range_m - c.far_m) - IN_BAND_M
    if outside_m <= 0.0:
        return 0.0
    return outside_m / (BACK_SHARE * scene.air.airspeed_m_s) * (c.outside + 0.5 * c.outside_per_m * outside_m)


@inner
def _continued(
    scene: Scene, question: Question, end: Pose, from_per_m: float, to_per_m: float, at: FloatArray
) -> None:
    """Fill in the places (2, n) of flying on from the end of a line for 1..n seconds.

    The curvature changes from one to the other as fast as the aircraft rolls.
    """
    air, x_m, y_m, heading_rad, per_m = scene.air, end.x_m, end.y_m, end.heading_rad, from_per_m
    ramp_per_m2 = ramp_on(heading_rad, air, question.context.watcher.craft)
    for k in range(at.shape[1]):
        way_m = STEP_S * speed_m_s(heading_rad, air)
        change = min(max(to_per_m - per_m, -ramp_per_m2 * way_m), ramp_per_m2 * way_m)
        middle_rad = heading_rad + 0.5 * (per_m + 0.5 * change) * way_m
        x_m, y_m = x_m + way_m * math.sin(middle_rad), y_m + way_m * math.cos(middle_rad)
        heading_rad, per_m = heading_rad + (per_m + 0.5 * change) * way_m, per_m + change
        at[0, k], at[1, k] = x_m, y_m


@inner
def _edges_after(joint: Joint, end: Pose, time_s: float, curvature_per_m: float) -> float:
    """Return what the edges of the band cost after the end of a line, on the cheapest continuation of each scenario.

    The aircraft stays on the circle, flies straight on, or turns as tightly as it can, either way.
    """
    scene, f, question, places = joint.scene, joint.scenarios, joint.question, joint.scratch.places
    c, d, total, tight_per_m, made = question.context.terms, scene.doubt, 0.0, 1.0 / scene.turn_radius_m, 0
    to_per_m = (curvature_per_m, 0.0, -tight_per_m, tight_per_m)
    for one in range(len(f.weight)):
        cheapest = np.inf
        for e in range(len(places)):
            if e == made:  # the circle alone nearly always costs nothing
                _continued(scene, question, end, curvature_per_m, to_per_m[e], places[e])
                made += 1
            cost = 0.0
            for k in range(_CONTINUED):
                at_s = time_s + (k + 1) * STEP_S
                _, off_x, off_y = from_target(f.place, f.step_s, one, places[e, 0, k], places[e, 1, k], at_s)
                widened_m = math.hypot(d.position_m, d.velocity_m_s * at_s)
                # On the watched side, so that only the edges count.
                cost += STEP_S * cost_rate(-math.hypot(off_x, off_y), 0.0, widened_m, 1.0, c)
                if cost >= cheapest:
                    break
            cheapest = min(cheapest, cost)
            if cheapest == 0.0:
                break
        total += f.weight[one] * cheapest
    return total


@inner
def _end_value(joint: Joint, end: Pose, time_s: float, curvature_per_m: float) -> float:
    """Return what is to be paid from the end of a line on: its share alone, and together.

    There it circles with that curvature.
    """
    scene, f, cover, question, team, scratch = joint
    k, s, total, back, role = min(int(time_s / STEP_S), FORESEEN - 1), scene.mirror * team.wanted, 0.0, 0.0, 0.0
    for one in range(len(f.weight)):
        p, off_x, off_y = from_target(f.place, f.step_s, one, end.x_m, end.y_m, time_s)
        off = Pose(off_x, off_y, end.heading_rad)
        total += f.weight[one] * min(wanted_value(scene, f, question, s, one, p, off, scratch), cover.now[one, k])
        back += f.weight[one] * _way_back(scene, question, math.hypot(off_x, off_y))
        role += f.weight[one] * wanted_value(scene, f, question, 1.0, one, p, off, scratch)
    turn, gap = _circling_cost(joint, end, time_s, curvature_per_m)
    return (
        total
        + _TAIL_S * team.opposite * gap
        + _ALONE * role
        + _CIRCLING_S / question.table.mean_leg_s * turn
        + back
        + _edges_after(joint, end, time_s, curvature_per_m)
    )


@inner
def _circling_cost(joint: Joint, end: Pose, time_s: float, curvature_per_m: float) -> tuple[float, float]:
    """Return what turns of the target cost, and the share of its courses that no aircraft covers, over a lap."""
    scene, f, cover = joint.scene, joint.scenarios, joint.cover
    x_m, y_m, heading_rad = end
    middle_x = x_m + math.cos(heading_rad) / curvature_per_m
    middle_y = y_m - math.sin(heading_rad) / curvature_per_m
    lap_s = 2.0 * math.pi / (abs(curvature_per_m) * scene.air.airspeed_m_s)
    turn, gap = 0.0, 0.0
    for q in range(_LAP):
        at_s = time_s + lap_s * q / _LAP
        at_rad = heading_rad + math.copysign(2.0 * math.pi * q / _LAP, curvature_per_m)
        at_x = middle_x - math.cos(at_rad) / curvature_per_m
        at_y = middle_y + math.sin(at_rad) / curvature_per_m
        turn += _turn_cost(joint, at_x, at_y, at_s)
        k = min(int(at_s / STEP_S), FORESEEN - 1)
        for one in range(len(f.weight)):
            _, off_x, off_y = from_target(f.place, f.step_s, one, at_x, at_y, at_s)
            gap += f.weight[one] * uncovered(math.atan2(off_x, off_y), cover.bearings[one, k])
    return turn / _LAP, gap / _LAP


@inner
def team_lines_costs(lines: Lines, start: Pose, joint: Joint, end_per_m: float, costs: FloatArray) -> None:
    """Fill in the team's cost (lines,), s, as :func:`mission.predictive.rollout_kernel.lines_costs` does.

    end_per_m: the curvature of the circles that they end in.
    """
    time_s, weight, hazard_per_s = lines.time_s, lines.weight, 1.0 / joint.question.table.mean_leg_s
    n, lines_count = len(time_s), len(lines.trunk)
    x, y = placed(lines, start)
    heading_rad = start.heading_rad + lines.turned_rad
    rates, turn_rates, ends = np.empty(n), np.empty(n), np.empty(lines_count)
    for s in range(n):
        rates[s] = weight[s] * _team_rate(joint, x[s], y[s], time_s[s])
    for s in turn_samples(lines):
        turn_rates[s] = hazard_per_s * weight[s] * _turn_cost(joint, x[s], y[s], time_s[s])
    for i in range(lines_count):
        s = lines.own_first[i + 1] - 1
        ends[i] = weight[s] * _end_value(joint, Pose(x[s], y[s], heading_rad[s]), time_s[s], end_per_m)
    costs[:lines_count] = 0.0
    add_up(lines, rates, turn_rates, ends, 1.0, costs)


@inner
def team_look_ahead(joint: Joint, costs: FloatArray) -> float:
    """Fill in the team's cost of each move (MOVES,), s, its price included; return that of going on as planned."""
    scene, question, team = joint.scene, joint.question, joint.team
    # No other plan departs before it was uploaded: until then the circle is flown that a line ends in. Whole seconds,
    # because lines of the same length are kept.
    beyond_m = scene.air.airspeed_m_s * math.ceil(max(scene.latency_s - _QUICK_S, 0.0))
    among, prices = alternatives(scene, question, beyond_m), question.prices
    stay_costs = np.empty(len(among.stays.trunk))
    stay_per_m = scene.mirror / scene.present.circle.radius_m
    team_lines_costs(among.moves, among.start, joint, 1.0 / scene.radius_m, costs)
    team_lines_costs(among.stays, among.stays_start, joint, stay_per_m, stay_costs)
    add_prices(among, scene.radius_m, team.price * prices.leave, team.price * prices.change, costs)
    return least(stay_costs)


@compiled
def role_value(scene: Scene, question: Question) -> float:
    """Return the cost to go of an aircraft alone, s off the side of the memory, from its next departure on."""
    turns, routed = question.context.turns, len(question.context.route.way.points) > 0
    if not routed:  # only the first future counts
        turns = Turns(turns.rate_rad_s[:1], turns.fades_s, turns.stands)
    every = winding(scene, question.context.motions, question.context.watcher, turns)
    if routed:
        every, _ = along_route(scene, question, every)
    x_m, y_m = in_frame(scene, scene.start.east_m, scene.start.north_m)
    p, off_x, off_y = from_target(every.place, every.step_s, 0, x_m, y_m, 0.0)
    off = Pose(off_x, off_y, scene.mirror * (scene.start.course_rad - scene.course_rad))
    return wanted_value(scene, every, question, 1.0, 0, p, off, new_scratch(0))


@compiled
def team_decide(
    scene: Scene,
    futures: Scenarios,
    others: FloatArray,
    first_s: FloatArray,
    question: Question,
    team: Team,
    costs: FloatArray,
) -> tuple[float, float]:
    """Fill in the team's cost of each move (MOVES,), s; return that of staying, and what a move must be below.

    futures: what the target may do, of the same estimate. others, first_s: see :func:`cover_of`.
    """
    every = futures
    if len(question.context.route.way.points) > 0:  # without the layers of time
        every = winding(scene, question.context.motions, question.context.watcher, question.context.turns)
        every, _ = along_route(scene, question, every)
    f = first_of(every, 1)
    cover, scratch = cover_of(scene, f, others, first_s, question, team), new_scratch(len(team.turns_rad))
    stay_cost = team_look_ahead(Joint(scene, f, cover, question, team, scratch), costs)
    return stay_cost, stay_cost - team.price * commitment(scene, f, question)

"""The inner loops of :mod:`app.study.fleet`: stretches of flight between decisions, and what is seen on them."""

from __future__ import annotations

import math

from sidelong.app.simulation.airframe_kernel import Airframe, Body, stepped
from sidelong.app.study.flight_kernel import (
    CHANGES,
    COMING,
    COMMAND_PER_M,
    DEPARTURE_S,
    PRESENT,
    STEP,
    STEP_S,
    Filtering,
    Flight,
    Payload,
    Target,
    along_plan_per_m,
    body_of,
    copy_state,
    seen_from,
)
from sidelong.estimators.compiled import compiled
from sidelong.estimators.filters.imm_kernel import predict, update
from sidelong.mission.core.path import FloatArray
from sidelong.mission.predictive.cost_kernel import IntArray


@compiled
def fly_on(f: Flight, target: Target, frame: Airframe, steps: int) -> None:
    """Follow the plan, or the commanded curvature if any, for ``steps`` steps, or to the end; log them."""
    for _ in range(min(steps, len(f.log) - f.counts[STEP])):
        step, body = f.counts[STEP], body_of(f)
        truth, row = target.sampled[step], f.log[step]
        row[0], row[1], row[2] = body.time_s, body.east_m, body.north_m
        row[3], row[4], row[5] = truth[0], truth[1], truth[4]
        if f.counts[COMING] > 0 and body.time_s >= f.numbers[DEPARTURE_S] - 1e-6:
            f.counts[PRESENT], f.counts[COMING] = 1 - f.counts[PRESENT], 0
            f.changed_s[f.counts[CHANGES]] = body.time_s
            f.counts[CHANGES] += 1
        command_per_m = f.numbers[COMMAND_PER_M]
        if math.isnan(command_per_m):
            command_per_m = along_plan_per_m(f, body)
        body = stepped(body, frame, command_per_m, STEP_S)
        b = f.body
        b[0], b[1], b[2], b[3] = body.time_s, body.east_m, body.north_m, body.course_rad
        b[4], b[5], b[6] = body.speed_m_s, body.curvature_per_m, body.bank_rad
        f.counts[STEP] = step + 1


@compiled
def see(
    state: FloatArray,
    spare: FloatArray,
    clock: FloatArray,
    logs: FloatArray,
    target: Target,
    noise: FloatArray,
    heights_m: FloatArray,
    payload: Payload,
    filtering: Filtering,
    seeing: IntArray,
    rejections: IntArray,
    from_step: int,
    until_step: int,
) -> int:
    """Take in what all payloads see on a stretch; return the step to continue from, earlier if all are rejected.

    state, spare: of the joint filter; clock (2,): its time, and that of the last accepted sighting. logs (m, steps,
    6) of the aircraft; noise (m, steps, 3); seeing (m,): whose payloads work. rejections (1,): in a row, of all.
    """
    for step in range(from_step, until_step):
        time_s = logs[0, step, 0]
        step_s = round((time_s - clock[0]) * 1e6) / 1e6
        if step_s > 0.0:
            predict(state, step_s, filtering.densities, spare)
            copy_state(spare, state)
            clock[0] = time_s
        for one in range(len(logs)):
            if seeing[one] == 0:
                continue
            row = logs[one, step]
            body = Body(time_s, row[1], row[2], 0.0, 0.0, 0.0, 0.0)
            seen = seen_from(body, heights_m[one], target.sampled[step], 0.0, noise[one, step], payload)
            if update(state, one, seen, filtering.gate_nis, filtering.soft_nis) <= filtering.gate_nis:
                clock[1], rejections[0] = time_s, 0
            else:
                rejections[0] += 1
        if rejections[0] >= filtering.reacquire_after * len(logs):
            return step + 1
    return until_step

"""The inner loops of :mod:`estimators.filters.joint`: one target, several payloads, each with its constant errors.

The state is that of :mod:`sidelong.estimators.filters.mixture_kernel`. The first NUMBERS of each model's numbers are
the target's; then come BLOCK for each payload: its yaw, pitch and range errors, and by how much its clock is ahead.
An error without variance keeps its value.
"""

from __future__ import annotations

import numpy as np

from sidelong.estimators.compiled import compiled
from sidelong.estimators.filters.imm_kernel import N as _SINGLE
from sidelong.estimators.filters.imm_kernel import Seen, linearized
from sidelong.estimators.filters.mixture_kernel import (
    EAST,
    HEIGHT,
    NORTH,
    VELOCITY_E,
    VELOCITY_N,
    Densities,
    FloatArray,
    middle_of,
    mix,
    move,
    numbers_of,
    take_in,
)

TURN = 5
NUMBERS, BLOCK = 6, 4


@compiled
def predict(
    state: FloatArray, step_s: float, densities: Densities, drift_per_s: tuple[float, float, float], found: FloatArray
) -> None:
    """Fill in the state step_s (<= 1) later. drift_per_s: what the variances of yaw, pitch and range errors gain."""
    n = numbers_of(state)
    mix(state, n, step_s, found)
    for model in range(len(found)):
        p = found[model, 1 + n :].reshape(n, n)
        move(model, found[model, 1 : 1 + n], p, TURN, step_s, densities)
        for first in range(NUMBERS, n, BLOCK):
            for i in range(3):
                if p[first + i, first + i] > 0.0:
                    p[first + i, first + i] += drift_per_s[i] * step_s


@compiled
def update(state: FloatArray, payload: int, seen: Seen, gate_nis: float, soft_nis: float) -> float:
    """Take a payload's sighting into the state unless it is beyond the gate; see :func:`take_in`. Return its NIS."""
    first = NUMBERS + BLOCK * payload
    middle, place_variance_m2 = middle_of(state, numbers_of(state))
    residual, jacobian = _held_against(seen, middle, first, place_variance_m2)
    columns = (EAST, NORTH, HEIGHT, first, first + 1, first + 2, first + 3)
    noise = (seen.range_variance_m2, seen.bearing_variance_rad2, seen.depression_variance_rad2)
    return take_in(state, middle, residual, jacobian, columns, noise, gate_nis, soft_nis)


@compiled
def _held_against(
    seen: Seen, middle: FloatArray, first: int, place_variance_m2: float
) -> tuple[FloatArray, FloatArray]:
    """Return measured minus expected (3,) and the derivative (3, 7) by place, errors and clock of the payload.

    A payload whose clock is ahead stamps a sighting later than it was: the target was where it comes from.
    """
    ahead_s = middle[first + 3]
    one = np.zeros(_SINGLE)
    one[0] = middle[EAST] - ahead_s * middle[VELOCITY_E]
    one[1] = middle[NORTH] - ahead_s * middle[VELOCITY_N]
    one[2], one[3], one[4] = middle[VELOCITY_E], middle[VELOCITY_N], middle[HEIGHT]
    for i in range(3):
        one[5 + i] = middle[first + i]
    residual, six, jacobian = np.empty(3), np.empty((3, 6)), np.zeros((3, 7))
    linearized(seen, one, place_variance_m2, residual, six)
    for i in range(3):
        for k in range(6):
            jacobian[i, k] = six[i, k]
        jacobian[i, 6] = -(six[i, 0] * middle[VELOCITY_E] + six[i, 1] * middle[VELOCITY_N])
    return residual, jacobian

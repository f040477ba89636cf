"""Solve banded normal equations by Cholesky's factors."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from sidelong.estimators.compiled import compiled

FloatArray = npt.NDArray[np.float64]


@compiled
def solve_banded(band: FloatArray, right: FloatArray) -> FloatArray:
    """Return the solution of a symmetric, positive definite system; NaN where it is not positive definite.

    Args:
        band: the upper diagonals, (width + 1, n): element (i, j) of the matrix is in row width + i - j, column j.
        right: right-hand sides, (n, m).

    """
    width, n = band.shape[0] - 1, band.shape[1]
    factor, x = band.copy(), right.copy()
    for j in range(n):
        for i in range(max(0, j - width), j + 1):
            left = factor[width + i - j, j]
            for k in range(max(0, j - width), i):
                left -= factor[width + k - i, i] * factor[width + k - j, j]
            factor[width + i - j, j] = math.sqrt(left) if i == j else left / factor[width, i]
    for column in range(x.shape[1]):
        for j in range(n):
            for i in range(max(0, j - width), j):
                x[j, column] -= factor[width + i - j, j] * x[i, column]
            x[j, column] /= factor[width, j]
        for j in range(n - 1, -1, -1):
            x[j, column] /= factor[width, j]
            for i in range(max(0, j - width), j):
                x[i, column] -= factor[width + i - j, j] * x[j, column]
    return x

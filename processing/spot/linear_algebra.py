"""Cholesky factor of a small matrix, solution of its equations and diagonal of its inverse."""

import math

import numpy as np

from processing.arrays import Floats
from processing.kernel import kernel


@kernel
def cholesky(matrix: Floats, size: int, factor: Floats) -> bool:
    """Lower factor L, L L^T = matrix, of the first `size` rows; False if it is not positive definite."""
    for k in range(size):
        for m in range(k + 1):
            total = matrix[k, m]
            for n in range(m):
                total -= factor[k, n] * factor[m, n]
            if k == m:
                if not total > 1e-14 * matrix[k, k]:
                    return False
                factor[k, k] = math.sqrt(total)
            else:
                factor[k, m] = total / factor[m, m]
    return True


@kernel
def solve(factor: Floats, size: int, right: Floats, solution: Floats) -> None:
    """Solution of (L L^T) x = right: forward, then backward substitution."""
    for k in range(size):
        total = right[k]
        for n in range(k):
            total -= factor[k, n] * solution[n]
        solution[k] = total / factor[k, k]
    for k in range(size - 1, -1, -1):
        total = solution[k]
        for n in range(k + 1, size):
            total -= factor[n, k] * solution[n]
        solution[k] = total / factor[k, k]


@kernel
def inverse_diagonal(factor: Floats, size: int, index: int) -> float:
    """Element (index, index) of the inverse matrix: the squared norm of column `index` of L^-1."""
    column = np.zeros(size)
    total = 0.0
    for k in range(index, size):
        value = 1.0 if k == index else 0.0
        for n in range(index, k):
            value -= factor[k, n] * column[n]
        column[k] = value / factor[k, k]
        total += column[k] * column[k]
    return total

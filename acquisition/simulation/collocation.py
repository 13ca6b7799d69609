"""Gauss collocation of a step, and the motion within steps that were made."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from processing.kernel import kernel

STAGES = 6
START, LENGTH, POLYNOMIAL = 0, 1, 2
COLUMNS = POLYNOMIAL + STAGES + 2
"""A row, one step of the motion: start time in s, length in s, then from `POLYNOMIAL` on the coefficients of
phi, in rad, as a polynomial in (t - start)/length."""


class Collocation(NamedTuple):
    """Gauss nodes on (0, 1), and the matrices that convert accelerations at the nodes to velocities and
    angles.
    """

    nodes: NDArray[np.float64]
    weights: NDArray[np.float64]
    to_rate: NDArray[np.float64]
    to_angle: NDArray[np.float64]
    to_polynomial: NDArray[np.float64]


def collocation() -> Collocation:
    """Nodes and matrices for `STAGES` stages."""
    u, w = np.polynomial.legendre.leggauss(STAGES)
    nodes = 0.5 * (u + 1.0)
    values = np.polynomial.legendre.legvander(u, STAGES)
    integrals = np.empty((STAGES, STAGES))
    integrals[:, 0] = nodes
    for k in range(1, STAGES):
        integrals[:, k] = (values[:, k + 1] - values[:, k - 1]) / (2.0 * (2 * k + 1))
    to_rate = integrals @ np.linalg.inv(values[:, :STAGES])
    to_polynomial = np.linalg.inv(np.vander(nodes, STAGES, increasing=True)).astype(np.float64)
    return Collocation(nodes, 0.5 * w, to_rate, to_rate @ to_rate, to_polynomial)


@kernel
def sample(
    rows: NDArray[np.float64],
    first_row: int,
    n_rows: int,
    times_s: NDArray[np.float64],
    first: int,
    angles: NDArray[np.float64],
    rates: NDArray[np.float64],
) -> tuple[int, int]:
    """Angles (rad) and rates (rad/s) at rising times, from `times_s[first]` on, as far as the rows reach.

    Returns the last row used and the index of the first time that is beyond the rows.
    """
    row = first_row
    for i in range(first, times_s.shape[0]):
        t = times_s[i]
        while row < n_rows and t > rows[row, START] + rows[row, LENGTH]:
            row += 1
        if row == n_rows:
            return row, i
        theta = (t - rows[row, START]) / rows[row, LENGTH] if rows[row, LENGTH] > 0.0 else 0.0
        angle = 0.0
        rate = 0.0
        # Horner's rule for the polynomial and its derivative together
        for k in range(COLUMNS - 1, POLYNOMIAL - 1, -1):
            rate = rate * theta + angle
            angle = angle * theta + rows[row, k]
        angles[i] = angle
        rates[i] = rate / rows[row, LENGTH] if rows[row, LENGTH] > 0.0 else 0.0
    return row, times_s.shape[0]

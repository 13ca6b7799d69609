"""Coordinates that separate friction from a linear drag.

For p near 1, b x^p = b x [1 + (p-1) ln x + ...] is nearly linear in x, and b is strongly correlated with a
drag. The data then determine the factor of the logarithm, ``omega = b (p-1)/(p+1)``, and the total linear
loss, ``linear = b/(p+1) + drag``. In the coordinates ln b, omega, linear the valley of chi-square is
straight and runs along ln b.
"""

import numpy as np
from numpy.typing import NDArray


def from_straight(log_b: float, omega: float, linear: float) -> tuple[float, float, NDArray[np.float64]]:
    """p and drag (in the unit of the linear loss), and the derivatives of both by the coordinates.

    NaN if no p corresponds to the coordinates.
    """
    b = float(np.exp(log_b))
    if not abs(b - omega) > 1e-12 * b:
        return float("nan"), float("nan"), np.full((2, 3), np.nan)
    p = (b + omega) / (b - omega)
    by = np.array(
        [
            [-2 * (omega / (b - omega)) * (b / (b - omega)), 2 * b / (b - omega) / (b - omega), 0.0],
            [-b / 2, 0.5, 1.0],
        ]
    )
    return p, linear - (b - omega) / 2, by


def to_straight(log_b: float, p: float, drag: float) -> tuple[float, float]:
    """The coordinates omega and linear; the inverse of `from_straight`."""
    b = float(np.exp(log_b))
    return b * (p - 1) / (p + 1), b / (p + 1) + drag

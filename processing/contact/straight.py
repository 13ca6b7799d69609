"""Coordinates in which friction and a linear drag do not hide in each other.

b x^p is b x [1 + (p-1) ln x + ...]: with a drag in the fit, data determine the logarithm's factor
``omega = b (p-1)/(p+1)`` and the whole linear loss ``linear = b/(p+1) + drag``, while b itself
runs along a valley that is straight if ln b, omega and linear are the coordinates.
"""

import numpy as np
from numpy.typing import NDArray


def from_straight(log_b: float, omega: float, linear: float) -> tuple[float, float, NDArray[np.float64]]:
    """p, drag (as a share of the linear loss), and the derivatives of both by the coordinates.

    NaN where no p belongs to them.
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
    """omega and linear."""
    b = float(np.exp(log_b))
    return b * (p - 1) / (p + 1), b / (p + 1) + drag

"""Decay of the amplitude in the first approximation of the asymptotic theory (Eq. 5).

    d alpha/dt = -(4/T) (c + b alpha^p/(p+1) + d alpha)

Without the linear term d this is Eq. 5 of the paper; the tests compare with its closed-form solution.
"""

from functools import lru_cache

import numpy as np

from processing.arrays import Floats
from processing.kernel import kernel

_LONGEST_STEP = 0.25
"""Largest fraction of the amplitude lost in one step of `decay_path`; 8 nodes then give an error of 1e-13."""


@kernel
def decay_path(
    rate_time: Floats, start: float, b: float, p: float, c: float, d: float, nodes: Floats, weights: Floats
) -> tuple[Floats, Floats]:
    """Solve ``dx/ds = -(c + b x^p + d x)`` at rising s >= s_0, with derivatives.

    Eq. 5 with a linear term, for which no closed form exists. The variables are separated,
    s = integral dx/(c + b x^p + d x), and the integral is taken from one point to the next, so that each is
    short. `b` stands for b/(p+1). Returns x and its derivatives by (start, b, p, c, d, s), shape (len, 6);
    NaN after x has reached zero.
    """
    count = len(rate_time)
    path = np.full(count, np.nan)
    gradient = np.full((count, 6), np.nan)
    x = start
    if not x > 0:
        return path, gradient
    rate_start = c + b * x**p + d * x
    # integrals of (dr/dparameter)/r^2 over the amplitudes passed, for the four parameters of the rate r
    passed = np.zeros(4)
    s = rate_time[0]
    for i in range(count):
        while True:
            remaining = rate_time[i] - s
            if remaining <= 0:
                break
            rate = c + b * x**p + d * x
            if not rate > 0:
                return path, gradient
            step = min(remaining, _LONGEST_STEP * x / rate)
            low = x - step * rate * 0.999
            done = False
            integral = 0.0
            for _ in range(50):
                if not 0 < low < x:
                    low = min(max(low, 0.5 * x), x * (1 - 1e-12))
                integral = 0.0
                half = 0.5 * (x - low)
                for k in range(len(nodes)):
                    y = low + half * (1 + nodes[k])
                    integral += weights[k] * half / (c + b * y**p + d * y)
                rate_low = c + b * low**p + d * low
                change = (integral - step) * rate_low
                if not np.isfinite(change) or not rate_low > 0:
                    return path, gradient
                low += change
                if abs(change) < 1e-15 * x:
                    done = True
                    break
            if not done or not 0 < low < x:
                return path, gradient
            half = 0.5 * (x - low)
            for k in range(len(nodes)):
                y = low + half * (1 + nodes[k])
                power = y**p
                r = c + b * power + d * y
                w = weights[k] * half / (r * r)
                passed[0] += w * power
                passed[1] += w * b * power * np.log(y)
                passed[2] += w
                passed[3] += w * y
            x = low
            s = rate_time[i] if step == remaining else s + step
        rate = c + b * x**p + d * x
        path[i] = x
        gradient[i, 0] = rate / rate_start
        for j in range(4):
            gradient[i, 1 + j] = -rate * passed[j]
        gradient[i, 5] = -rate
    return path, gradient


@lru_cache(maxsize=1)
def path_nodes() -> tuple[Floats, Floats]:
    """Nodes and weights for `decay_path`."""
    return np.polynomial.legendre.leggauss(8)

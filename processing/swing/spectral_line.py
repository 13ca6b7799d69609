"""Least-squares fit of one sinusoid of a given frequency."""

import math

from processing.arrays import Vector
from processing.kernel import kernel


@kernel
def line(rate: float, time_s: Vector, value: Vector, weight: Vector) -> tuple[float, float, float]:
    """Fit ``c cos(rate t) + s sin(rate t)``.

    Returns the reduction of chi-square, c and s; zeros if the samples do not determine them.
    """
    cc = cs = ss = c_value = s_value = 0.0
    for i in range(len(time_s)):
        c, s = math.cos(rate * time_s[i]), math.sin(rate * time_s[i])
        cc += weight[i] * c * c
        cs += weight[i] * c * s
        ss += weight[i] * s * s
        c_value += weight[i] * c * value[i]
        s_value += weight[i] * s * value[i]
    determinant = cc * ss - cs * cs
    if not determinant > 1e-6 * cc * ss:
        return 0.0, 0.0, 0.0
    cosine = (ss * c_value - cs * s_value) / determinant
    sine = (cc * s_value - cs * c_value) / determinant
    return cosine * c_value + sine * s_value, cosine, sine

"""Period as a function of the amplitude in the second approximation of the asymptotic theory (Eq. 6)."""

from math import pi, sqrt
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from processing.arrays import Floats
from processing.contact.parameters import ContactParameters, PendulumOnBall, stiffness_ratio

PRINTED_CURVATURE = 0.55
"""The number printed in Eq. 6; averaging Eq. 3 gives `curvature(n)` instead."""


def cosine_moment(exponent: Any) -> Any:
    """integral_0^(pi/2) cos(theta)^exponent dtheta, for real or complex exponents above -1."""
    from scipy.special import loggamma  # here, because it would slow down every command

    return sqrt(pi) / 2 * np.exp(loggamma((exponent + 1) / 2) - loggamma(exponent / 2 + 1))


def curvature(n: float) -> float:
    """Factor for which Eq. 6 prints 0.55: 0.540 at n = 0, 0.583 at n = 1."""
    return float(2 / pi * cosine_moment(n + 3) / cosine_moment(n + 2))


def frequency_drop(
    amplitude: ArrayLike, n: float, kappa: float, rho: float, *, printed_curvature: bool = False
) -> Floats:
    """Relative decrease of the frequency with the amplitude, which Eq. 6 subtracts from 1.

    `amplitude` has any shape; `kappa` is 2 gamma a^2/(m g) and `rho` is R/a, both for the unit of
    `amplitude`.
    """
    alpha = np.asarray(amplitude, dtype=np.float64)
    factor = PRINTED_CURVATURE if printed_curvature else curvature(n)
    drop = kappa * cosine_moment(n + 2) * alpha**n * (1 - factor * rho * alpha)
    return np.asarray(drop, dtype=np.float64)


def period(
    amplitude_rad: ArrayLike,
    parameters: ContactParameters,
    pendulum: PendulumOnBall,
    *,
    printed_curvature: bool = False,
) -> Floats:
    """T(alpha) of Eq. 6 in seconds; the period rises with the amplitude.

    `printed_curvature` uses 0.55 as printed instead of `curvature(n)`.
    """
    drop = frequency_drop(
        amplitude_rad,
        parameters.n,
        stiffness_ratio(parameters.gamma_pa, pendulum),
        pendulum.ball_radius_m / pendulum.contact_radius_m,
        printed_curvature=printed_curvature,
    )
    return parameters.period0_s / (1 - drop)

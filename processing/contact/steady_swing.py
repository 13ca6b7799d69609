"""A law's moments over a full swing: hysteresis loops (Eq. 7)."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from processing.arrays import Floats
from processing.contact.law import Law
from processing.contact.laws import DEFAULT_LAW
from processing.contact.parameters import PendulumOnBall
from processing.errors import DataError


@dataclass(frozen=True)
class MomentLoop:
    """One full swing, from +alpha to -alpha and back, as a closed curve of twice `points` points.

    `phi_rad` falls first, then rises. The friction moment jumps at both turning points, which therefore
    appear twice.
    """

    phi_rad: Floats
    friction_n_m: Floats
    elastic_n_m: Floats
    total_n_m: Floats


def moment_loop(
    amplitude_rad: float,
    values: Mapping[str, float],
    pendulum: PendulumOnBall,
    *,
    law: Law = DEFAULT_LAW,
    points: int = 201,
) -> MomentLoop:
    """The three loops of Table 4 at a given amplitude, neglecting its change within the cycle.

    `values` are the law's parameters by key, in SI units.
    """
    if not amplitude_rad > 0:
        raise DataError(f"amplitude {amplitude_rad} rad: a loop needs a positive one")
    down = np.linspace(amplitude_rad, -amplitude_rad, points)
    phi = np.concatenate([down, down[::-1]])
    direction = np.repeat([-1.0, 1.0], points)
    moments = law.branch_moments(phi, direction, values, pendulum)
    return MomentLoop(phi, *moments, moments.friction_n_m + moments.elastic_n_m)

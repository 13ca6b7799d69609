"""A law's moments over a full swing: hysteresis loops (Eq. 7), harmonics of the displacement."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from processing.arrays import Complexes, Floats
from processing.contact.law import Law
from processing.contact.laws import DEFAULT_LAW
from processing.contact.moments import weight_moment
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


# Harmonics of the displacement that a law's moments make in a steady swing.
#
# With the moments over m g R as a function of the phase s, ``phi = A cos s``, and their Fourier components
# m_k, the equation of motion ``phi'' + phi = m`` gives ``X_k = m_k / (1 - k^2)`` to first order in the
# moments. The next order, below 1 %, is left out but for the stiffness ``1 - Re(m_1)/A``, which scales the
# rest.

_PHASES = 720
"""The third harmonic is right within 4e-6 of itself, the fifth within 1.4e-4 (against 11,520 phases)."""


def law_harmonics(
    law: Law,
    values: Mapping[str, float],
    pendulum: PendulumOnBall,
    amplitudes_rad: Floats,
    orders: Sequence[int],
) -> Complexes:
    """Complex harmonics (rad) of the given orders, all above 1, shape (amplitudes, orders).

    A drag is linear and makes none. They are computed at a few amplitudes and interpolated.
    """
    phase = (np.arange(_PHASES) + 0.5) * (2 * np.pi / _PHASES)
    direction = -np.sign(np.sin(phase))
    k = np.array([1, *orders])
    turned = np.exp(-1j * np.outer(phase, k)) * (2 / _PHASES) / weight_moment(pendulum)
    nodes = np.geomspace(amplitudes_rad.min(), amplitudes_rad.max(), 12)
    found = []
    for amplitude in nodes.tolist():
        friction, elastic = law.branch_moments(amplitude * np.cos(phase), direction, values, pendulum)
        moment = (friction + elastic) @ turned
        found.append(moment[1:] / ((1 - k[1:] ** 2) * (1 - moment[0].real / amplitude)))
    per_order = np.array(found).T
    at, x = np.log(nodes), np.log(amplitudes_rad)
    return np.array([np.interp(x, at, one.real) + 1j * np.interp(x, at, one.imag) for one in per_order]).T

"""Example of a law: Coulomb friction.

    M = -m g R c sign(phi')

Each half-swing takes 2 c from the amplitude and lasts T0/2, at every amplitude.
"""

import numpy as np
from numpy.typing import NDArray

from processing.contact.asymptotic import StartValues
from processing.contact.coordinates import Scaling, logarithms_of
from processing.contact.law import CONSTANT, FREE_PERIOD, PERIOD
from processing.contact.memoryless import NO_MOMENT, Moment, Moments, memoryless_law
from processing.swing import TurningPoints

Array = NDArray[np.float64]


def _moments(parameters: Array, _: float, __: float) -> Moments:
    c = float(parameters[0])
    constant = Moment((0,), lambda x: np.full_like(x, c), lambda x: np.array([c * x, x]))
    return Moments(constant, NO_MOMENT)


def _likely(found: StartValues, _: float) -> list[dict[str, float]]:
    return [{"c": found.decay.c + max(found.decay.b, 0.0), PERIOD: found.mean_period_s}]


CONSTANT_MOMENT = memoryless_law(
    "constant-moment",
    "constant moment",
    "Coulomb",
    (CONSTANT, FREE_PERIOD),
    _moments,
    {"c": Scaling(1.0)},
    lambda _: logarithms_of(),
    _likely,
)


def constant_moment_decay(
    c: float, period0_s: float, initial_rad: float, count: int, u_rad: float, seed: int
) -> TurningPoints:
    """Turning points of the equation of motion itself, with noise: arcs of a harmonic oscillation.

    About the shifted rest positions +c and -c, half a period each; nothing of the map is used.
    """
    rng = np.random.default_rng(seed)
    phi = [initial_rad]
    for _ in range(count - 1):
        rest = c if phi[-1] > 0 else -c
        phi.append(2 * rest - phi[-1])
    amplitude = np.abs(np.array(phi))
    u_time = u_rad / (amplitude * 2 * np.pi / period0_s)
    return TurningPoints(
        np.arange(count, dtype=np.int64),
        0.25 + 0.5 * period0_s * np.arange(count) + u_time * rng.standard_normal(count),
        u_time,
        amplitude + u_rad * rng.standard_normal(count),
        np.full(count, u_rad),
    )

"""The exact map from one turning point to the next (half-swing map), with its derivatives.

In Eq. 4 with Eqs. 1 and 3 and a linear drag, divided by m g R, energy is conserved except for the work of
friction. Between a turning point at the amplitude A and the zero crossing the kinetic term is

    phi'^2 / (2 w0^2) = (A^2/2) sin^2(theta) g(theta),      phi = A cos(theta)

with g close to 1. The motion away from a turning point and the motion towards one differ only in the sign
of the work of friction. A half-cycle therefore consists of two quarters, each a function of the amplitude of
its own turning point only. The kinetic energies of both at the zero crossing must be equal, which gives the
next amplitude; the times of both add up.

The map (`half_swing_kernel`) is dimensionless: angles in units of a reference amplitude, times in units of
T0.
"""

from typing import NamedTuple

import numpy as np

from processing.arrays import Floats, Ints
from processing.contact.half_swing_kernel import half_swing_map
from processing.contact.law import HalfSwings
from processing.contact.parameters import ContactParameters, PendulumOnBall
from processing.contact.quadrature import quarter_nodes
from processing.errors import DataError


class ScaledContact(NamedTuple):
    """Dimensionless parameters of the map, with ``x = phi / reference``; in terms of the SI parameters:

    ``b = b reference^(p-1)``, ``c = c / reference``, ``kappa = 2 gamma a^2/(m g) reference^n``,
    ``drag = drag_s w0``, ``rho = R reference / a``.
    """

    b: float
    p: float
    c: float
    n: float
    kappa: float
    drag: float
    rho: float


def stiffness_ratio(gamma_pa: float, pendulum: PendulumOnBall) -> float:
    """Factor of the adhesive moment divided by m g R, in rad^-n: ``kappa = 2 gamma a^2 / (m g)``."""
    return 2 * gamma_pa * pendulum.contact_radius_m**2 / (pendulum.mass_kg * pendulum.gravity_m_per_s2)


def relative_curvature(pendulum: PendulumOnBall | None) -> float:
    """R/a of Eq. 3 in rad^-1; 0 without a calibration (None), because angles are not known in rad then."""
    return 0.0 if pendulum is None else pendulum.ball_radius_m / pendulum.contact_radius_m


def scaled_contact(
    parameters: ContactParameters, pendulum: PendulumOnBall, reference_rad: float
) -> ScaledContact:
    """The map's parameters for SI parameters and a reference amplitude."""
    return ScaledContact(
        b=parameters.b * reference_rad ** (parameters.p - 1),
        p=parameters.p,
        c=parameters.c / reference_rad,
        n=parameters.n,
        kappa=stiffness_ratio(parameters.gamma_pa, pendulum) * reference_rad**parameters.n,
        drag=parameters.drag_s * 2 * np.pi / parameters.period0_s,
        rho=pendulum.ball_radius_m * reference_rad / pendulum.contact_radius_m,
    )


def half_swings(parameters: Floats, index: Ints) -> HalfSwings:
    """`half_swing_map` for the fields of `ScaledContact` and the first amplitude, in one array."""
    return HalfSwings(*half_swing_map(parameters, index, *quarter_nodes()))


def turning_points_of(
    parameters: ContactParameters,
    pendulum: PendulumOnBall,
    initial_amplitude_rad: float,
    half_cycles: int,
) -> tuple[Floats, Floats]:
    """Amplitudes (rad) and times (s) of the first turning points of a free decay.

    Parameters
    ----------
    initial_amplitude_rad
        The first turning point, at time 0; positive.
    half_cycles
        Number of half-cycles after it; the arrays have one element more.

    Returns
    -------
    amplitude_rad, time_s
        Shape ``(half_cycles + 1,)``. NaN from the turning point at which the pendulum sticks
        (friction holds it) onwards.
    """
    if not initial_amplitude_rad > 0:
        raise DataError(f"initial amplitude {initial_amplitude_rad} rad: it must be positive")
    scaled = np.array([*scaled_contact(parameters, pendulum, initial_amplitude_rad), 1.0], dtype=np.float64)
    index = np.arange(half_cycles + 1, dtype=np.int64)
    found = half_swings(scaled, index)
    return found.amplitude * initial_amplitude_rad, found.time * parameters.period0_s

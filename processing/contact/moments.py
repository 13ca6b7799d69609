"""Moments of the paper's law (Eqs. 1 and 3), the work that they do, and the surface energy."""

from dataclasses import dataclass
from math import pi
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike

from processing.arrays import Floats
from processing.contact.parameters import (
    ContactParameters,
    PendulumOnBall,
    stiffness_ratio,
    weight_moment,
)
from processing.estimate import Estimate
from processing.quantity import PART


def friction_moment(
    phi_rad: ArrayLike, direction: ArrayLike, parameters: ContactParameters, pendulum: PendulumOnBall
) -> Floats:
    """M_fr of Eq. 1 in N m, without drag, for angles of any shape; `direction` is the sign of phi'."""
    phi = np.abs(np.asarray(phi_rad, dtype=np.float64))
    friction = parameters.c + parameters.b * phi**parameters.p
    return np.asarray(-weight_moment(pendulum) * friction * np.sign(direction), dtype=np.float64)


def elastic_moment(phi_rad: ArrayLike, parameters: ContactParameters, pendulum: PendulumOnBall) -> Floats:
    """M_el of Eq. 3 in N m (skeletal curve), for angles of any shape.

    It has the sign of phi and opposes the moment of gravity.
    """
    phi = np.asarray(phi_rad, dtype=np.float64)
    size = np.abs(phi)
    rho = pendulum.ball_radius_m / pendulum.contact_radius_m
    ratio = (
        stiffness_ratio(parameters.gamma_pa, pendulum) * size ** (parameters.n + 1) * (pi / 2 - rho * size)
    )
    return np.asarray(weight_moment(pendulum) * ratio * np.sign(phi), dtype=np.float64)


@dataclass(frozen=True, slots=True)
class CycleWork:
    """Work of one cycle (four deviations from the equilibrium) in J.

    `dissipated_j` is 4A, the area of the loop. `adhesive_j` is 4A_t, the contribution of c (the dashed
    rectangle of Table 4). `drag_j` is the work of a linear drag, which is not contained in 4A.
    """

    dissipated_j: float
    adhesive_j: float
    drag_j: float


def cycle_work(amplitude_rad: float, parameters: ContactParameters, pendulum: PendulumOnBall) -> CycleWork:
    """4A = 4 m g R (c alpha + b alpha^(p+1)/(p+1)) and 4A_t = 4 m g R c alpha."""
    moment = weight_moment(pendulum)
    adhesive = 4 * moment * parameters.c * amplitude_rad
    internal = 4 * moment * parameters.b * amplitude_rad ** (parameters.p + 1) / (parameters.p + 1)
    drag = moment * parameters.drag_s * pi * (2 * pi / parameters.period0_s) * amplitude_rad**2
    return CycleWork(adhesive + internal, adhesive, drag)


@dataclass(frozen=True, slots=True)
class SurfaceEnergy:
    """Specific surface energy in J/m^2, in the paper's two forms.

    `table2` is m g R c/(2 a^2), the work divided by the area 2 a^2 phi that the contact spot sweeps; it
    reproduces the values of Table 2. `eq2` is m g c/(2 a), Eq. 2 as printed.
    """

    table2: Annotated[Estimate, PART]
    eq2: Annotated[Estimate, PART]


def surface_energy(c: Estimate, pendulum: PendulumOnBall) -> SurfaceEnergy:
    """Both forms of sigma for an adhesion coefficient c of Eq. 1; each is proportional to c."""
    force = pendulum.mass_kg * pendulum.gravity_m_per_s2
    a = pendulum.contact_radius_m
    return SurfaceEnergy(
        Estimate(*(force * pendulum.ball_radius_m * part / (2 * a**2) for part in c)),
        Estimate(*(force * part / (2 * a) for part in c)),
    )

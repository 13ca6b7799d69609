"""Moments of the paper's law (Eqs. 1 and 3), loops and work of a swing, losses of a decay, surface energy."""

from collections.abc import Mapping
from dataclasses import dataclass
from math import pi
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike

from processing.arrays import Floats
from processing.contact.law import Law
from processing.contact.laws import DEFAULT_LAW, turning_points_of
from processing.contact.parameters import (
    ContactParameters,
    PendulumOnBall,
    stiffness_ratio,
    weight_moment,
)
from processing.errors import DataError
from processing.estimate import Estimate
from processing.quantity import PART
from processing.swing import TurningPoints


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


@dataclass(frozen=True)
class CycleLosses:
    """Losses over whole cycles as a function of the amplitude in the middle of each (rad).

    `log_decrement` is ln(A_i/A_(i+2)), `quality` is pi divided by it.
    The `u_` are standard uncertainties. For a decrement comparable to its uncertainty, that of Q has no
    meaning; it is infinite if the decrement is not positive.
    """

    amplitude_rad: Floats
    log_decrement: Floats
    u_log_decrement: Floats
    quality: Floats
    u_quality: Floats


def _losses(middle: Floats, decrement: Floats, u_decrement: Floats) -> CycleLosses:
    lossy = decrement > 0
    safe = np.where(lossy, decrement, 1.0)
    return CycleLosses(
        middle,
        decrement,
        u_decrement,
        np.where(lossy, np.pi / safe, np.nan),
        np.where(lossy, np.pi * u_decrement / safe**2, np.inf),
    )


def measured_losses(points: TurningPoints, *, cycles: int = 1) -> CycleLosses:
    """Losses from the turning points without a model.

    The decrement is averaged over windows of `cycles` whole cycles; its noise is inversely proportional to
    their number. Windows do not overlap; those with a missing end are left out.
    """
    if cycles < 1:
        raise DataError(f"cycles = {cycles}: at least one")
    step = 2 * cycles
    position = {int(index): i for i, index in enumerate(points.index)}
    first, last = [], []
    for index in range(int(points.index[0]), int(points.index[-1]) - step + 1, step):
        if index in position and index + step in position:
            first.append(position[index])
            last.append(position[index + step])
    if not first:
        raise DataError(f"no two turning points {cycles} whole cycles apart")
    a, b = points.amplitude[first], points.amplitude[last]
    u = np.hypot(points.u_amplitude[first] / a, points.u_amplitude[last] / b)
    return _losses(np.sqrt(a * b), np.log(a / b) / cycles, u / cycles)


def model_losses(
    amplitude_rad: Floats, parameters: ContactParameters, pendulum: PendulumOnBall
) -> CycleLosses:
    """Losses by the exact half-swing map for a cycle that starts at each amplitude (n,); uncertainties are 0.

    NaN if friction stops the pendulum before the end of the cycle.
    """
    ends = np.array(
        [turning_points_of(parameters, pendulum, float(a), 2)[0][2] for a in np.atleast_1d(amplitude_rad)]
    )
    start = np.atleast_1d(np.asarray(amplitude_rad, dtype=np.float64))
    return _losses(np.sqrt(start * ends), np.log(start / ends), np.zeros_like(start))

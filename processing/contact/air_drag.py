"""The linear drag that air is expected to exert on the pendulum: the order of magnitude.

The pendulum is taken for a bar that swings about its middle; its length L and diameter 2 r follow from the
inertia if they are not known. Every part of it moves as a cylinder across its axis does in air at rest, with
Stokes' force per length (in the form of Sader 1998)

    pi rho omega r^2 Im(Gamma) v,    Gamma = 1 + 4 i K1(z) / (sqrt(i Re) K0(z)),
    Re = rho omega r^2 / eta,        z = -i sqrt(i Re)

whose moment over the bar is that force at v = 1 times L^3/12. Ends, mirror and weights are left out: a factor
of two is to be expected.
"""

from dataclasses import dataclass
from math import pi, sqrt
from typing import NamedTuple

import numpy as np

from processing.contact.law import PendulumOnBall, weight_moment
from processing.surroundings import Air

_PERIOD_RATIO = 5.0
"""Slow over fast period of the paper's pendulum, and so length over width."""


class Bar(NamedTuple):
    """A bar that swings about its middle, across its length."""

    length_m: float
    width_m: float


def bar_of(
    pendulum: PendulumOnBall, period_s: float, length_m: float | None = None, width_m: float | None = None
) -> Bar:
    """The bar of even mass that swings so slowly, where its length is not stated; a fifth as wide as long.

    Its moment of inertia is ``m L^2/12 = m g R T^2/(4 pi^2)``.
    """
    inertia = weight_moment(pendulum) * (period_s / (2 * pi)) ** 2
    length = length_m or sqrt(12 * inertia / pendulum.mass_kg)
    return Bar(length, width_m or length / _PERIOD_RATIO)


@dataclass(frozen=True, slots=True, kw_only=True)
class ExpectedDrag:
    """Order of magnitude of the air's drag on a bar of the pendulum's size.

    `assumed` names what was neither measured nor stated: usual air (20 degrees Celsius, 50 %, 101325 Pa), and
    a bar that follows from the pendulum's inertia.
    """

    drag_s: float
    air_density_kg_per_m3: float
    air_viscosity_pa_s: float
    length_m: float
    width_m: float
    assumed: tuple[str, ...] = ()


def expected_drag_s(air: Air, bar: Bar, pendulum: PendulumOnBall, period_s: float) -> float:
    """The coefficient of `ContactParameters.drag_s` that air gives a bar."""
    # scaled by an exponential, which cancels; here, because it would slow down every command
    from scipy.special import kve

    omega, radius = 2 * pi / period_s, 0.5 * bar.width_m
    root = np.sqrt(1j * air.density_kg_per_m3 * omega * radius**2 / air.viscosity_pa_s)
    gamma = 1 + 4j * kve(1, -1j * root) / (root * kve(0, -1j * root))
    per_length = pi * air.density_kg_per_m3 * omega * radius**2 * gamma.imag
    return float(per_length * bar.length_m**3 / 12 / weight_moment(pendulum))


def vane_drag_s_per_m2(air: Air, distance_m: float, pendulum: PendulumOnBall, period_s: float) -> float:
    """What a thin vane that moves in its own plane adds to the drag, per area of one of its faces.

    Both faces rub as walls that swing in still air do (Stokes 1851): ``sqrt(omega rho eta/2)`` of force per
    area and velocity; edges add to that. `distance_m` is that of the vane's middle from the axis.
    """
    omega = 2 * pi / period_s
    per_area = 2 * sqrt(0.5 * omega * air.density_kg_per_m3 * air.viscosity_pa_s)
    return per_area * distance_m**2 / weight_moment(pendulum)

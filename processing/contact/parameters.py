"""Parameters of a contact and of the pendulum on it, and the factors that turn them into moments."""

from dataclasses import dataclass

STANDARD_GRAVITY_M_PER_S2 = 9.80665  # third CGPM, 1901


@dataclass(frozen=True, slots=True)
class ContactParameters:
    """The six parameters of Eqs. 1, 3 and 6, angles in rad.

    b (rad^-p), p, c (dimensionless moment over m g R): friction, Eq. 1. n, gamma_pa: elastic
    adhesion, Eq. 3. period0_s: period at vanishing amplitude. drag_s: optional linear drag; the
    moment is ``-m g R drag_s phi'``.
    """

    b: float
    p: float
    c: float
    n: float
    period0_s: float
    gamma_pa: float
    drag_s: float = 0.0


@dataclass(frozen=True, slots=True)
class PendulumOnBall:
    """Mass, ball radius and contact spot used by the fits. `contact_radius_m` is Hertz's radius a."""

    mass_kg: float
    ball_radius_m: float
    contact_radius_m: float
    gravity_m_per_s2: float = STANDARD_GRAVITY_M_PER_S2


def stiffness_ratio(gamma_pa: float, pendulum: PendulumOnBall) -> float:
    """Factor of the adhesive moment divided by m g R, in rad^-n: ``kappa = 2 gamma a^2 / (m g)``."""
    return 2 * gamma_pa * pendulum.contact_radius_m**2 / (pendulum.mass_kg * pendulum.gravity_m_per_s2)


def relative_curvature(pendulum: PendulumOnBall | None) -> float:
    """R/a of Eq. 3 in rad^-1; 0 without a calibration (None), because angles are not known in rad then."""
    return 0.0 if pendulum is None else pendulum.ball_radius_m / pendulum.contact_radius_m


def weight_moment(pendulum: PendulumOnBall) -> float:
    """m g R in N m, the unit of the coefficients of Eq. 1."""
    return pendulum.mass_kg * pendulum.gravity_m_per_s2 * pendulum.ball_radius_m

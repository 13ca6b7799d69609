"""Parameters of a contact and of the pendulum on it."""

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

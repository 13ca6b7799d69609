"""Elastic contact of a ball and a flat (Hertz 1882), and the materials of the paper.

a = (3 F R / (4 E*))^(1/3)      1/E* = sum (1 - nu^2)/E      depth = a^2/R      angle = a/R
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType

from processing.contact.law import STANDARD_GRAVITY_M_PER_S2, PendulumOnBall
from processing.errors import ConfigurationError


@dataclass(frozen=True, slots=True)
class Material:
    """Elastic constants of one body of the contact, with standard uncertainties."""

    youngs_modulus_pa: float = field(metadata={"gt": 1e6})
    poisson_ratio: float = field(metadata={"gt": -1, "lt": 0.5})
    u_youngs_modulus_pa: float = field(default=0.0, metadata={"ge": 0})
    u_poisson_ratio: float = field(default=0.0, metadata={"ge": 0})

    @property
    def compliance_per_pa(self) -> float:
        """(1 - nu^2)/E, this body's contribution to 1/E*."""
        return (1 - self.poisson_ratio**2) / self.youngs_modulus_pa


MATERIALS: Mapping[str, Material] = MappingProxyType(
    {
        "steel": Material(2.11e11, 0.28),
        "silicon": Material(1.31e11, 0.266),
        "glass_k8": Material(0.82e11, 0.206),
    }
)
"""The three materials of the paper, which states no uncertainties."""


def material(name: str, others: Mapping[str, Material] = MappingProxyType({})) -> Material:
    """A material by its name; `others`, defined by the user, take precedence over the paper's.

    Raises ConfigurationError for an unknown name.
    """
    known = {**MATERIALS, **others}
    if name not in known:
        raise ConfigurationError(
            f"unknown material {name!r}: take one of {', '.join(sorted(known))}, or define it with its "
            "elastic constants"
        )
    return known[name]


def contact_radius(force_n: float, ball_radius_m: float, ball: Material, flat: Material) -> float:
    """Radius a of the contact spot in m."""
    compliance = ball.compliance_per_pa + flat.compliance_per_pa
    return float((0.75 * force_n * ball_radius_m * compliance) ** (1 / 3))


def pendulum_on_ball(
    mass_kg: float,
    ball_radius_m: float,
    ball: Material,
    flat: Material,
    *,
    gravity_m_per_s2: float = STANDARD_GRAVITY_M_PER_S2,
) -> PendulumOnBall:
    """The pendulum with its contact radius from Hertz's theory; for two balls with half the mass.

    The moments of Eqs. 1 and 3 are then those of one ball; their ratio to m g R, on which alone the motion
    depends, is the same.
    """
    radius_m = contact_radius(mass_kg * gravity_m_per_s2, ball_radius_m, ball, flat)
    return PendulumOnBall(mass_kg, ball_radius_m, radius_m, gravity_m_per_s2)

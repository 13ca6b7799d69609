"""The contact spot with adhesion: JKR, DMT and Maugis-Dugdale beside Hertz.

Hertz leaves adhesion out. The adhesion that resists rolling (c of Eq. 1) also pulls the surfaces together, so
that the spot is larger and the surface energy that follows from c, which is divided by the spot's area, is
smaller. Both are found together, by iteration. With the work of adhesion w = 2 sigma (two equal surfaces are
parted), the reduced modulus K = 4/3 / (sum of (1 - nu^2)/E) and the load F:

    Hertz             a^3 = F R / K
    DMT               a^3 = (F + 2 pi w R) R / K
    JKR               a^3 = (F + 3 pi w R + sqrt(6 pi w R F + (3 pi w R)^2)) R / K
    Maugis-Dugdale    between these, for the Tabor parameter mu = (R w^2 / (E*^2 z0^3))^(1/3), E* = 3 K / 4

Sources: Johnson, Kendall & Roberts 1971; Derjaguin, Muller & Toporov 1975; Tabor 1977; Maugis 1992.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from math import acos, isfinite, nan, pi, sqrt

from processing.contact.moments import surface_energy
from processing.contact.parameters import PendulumOnBall
from processing.errors import DataError
from processing.estimate import Estimate

ATOMIC_DISTANCE_M = 0.3e-9
"""z0, the distance of the surfaces' atoms in contact, on which the Tabor parameter depends: 0.2 to 0.4 nm."""
_MAUGIS_PER_TABOR = 1.157
"""Maugis' parameter lambda over Tabor's mu: the step of Dugdale's force with the work and the peak force of
Lennard-Jones'."""
_JKR_FROM = 5.0
"""Tabor parameter above which JKR is meant to hold; DMT below 0.1 (Johnson & Greenwood 1997)."""
_DMT_UP_TO = 0.1


@dataclass(frozen=True, slots=True)
class AdhesiveContact:
    """A contact spot with adhesion, and the surface energy (Table 2's form) that belongs to its radius."""

    radius_m: float
    surface_energy_j_per_m2: float


@dataclass(frozen=True, slots=True)
class AdhesiveContacts:
    """The spot after each theory; `tabor` says which of them holds."""

    tabor: float
    jkr: AdhesiveContact
    dmt: AdhesiveContact
    maugis: AdhesiveContact

    @property
    def holds(self) -> str:
        """Name of the theory that the Tabor parameter asks for."""
        if self.tabor > _JKR_FROM:
            return "JKR"
        return "DMT" if self.tabor < _DMT_UP_TO else "Maugis-Dugdale"


def adhesive_contacts(c: float, pendulum: PendulumOnBall) -> AdhesiveContacts:
    """Contact spots and surface energies for an adhesion coefficient c of Eq. 1.

    Parameters
    ----------
    c
        Positive.
    pendulum
        With Hertz's contact radius, from which the reduced modulus follows.

    Raises
    ------
    DataError
        c is not positive: there is no adhesion to account for.
    """
    if not (isfinite(c) and c > 0):
        raise DataError(f"c = {c}: without adhesion the contact is Hertz's")
    force = pendulum.mass_kg * pendulum.gravity_m_per_s2
    radius = pendulum.ball_radius_m
    stiffness = force * radius / pendulum.contact_radius_m**3

    def jkr(work: float) -> float:
        pull = 3 * pi * work * radius
        return float(((force + pull + sqrt(2 * pull * force + pull**2)) * radius / stiffness) ** (1 / 3))

    def dmt(work: float) -> float:
        return float(((force + 2 * pi * work * radius) * radius / stiffness) ** (1 / 3))

    def maugis(work: float) -> float:
        tabor = tabor_parameter(work, radius, stiffness)
        return maugis_radius(force, work, radius, stiffness, _MAUGIS_PER_TABOR * tabor)

    found = {theory.__name__: _with_adhesion(theory, c, pendulum) for theory in (jkr, dmt, maugis)}
    work = 2 * found["maugis"].surface_energy_j_per_m2
    return AdhesiveContacts(tabor_parameter(work, radius, stiffness), **found)


def tabor_parameter(work_j_per_m2: float, ball_radius_m: float, stiffness_pa: float) -> float:
    """How far surface forces reach, over the deformation that they cause."""
    reduced_pa = 0.75 * stiffness_pa
    return float((ball_radius_m * work_j_per_m2**2 / (reduced_pa**2 * ATOMIC_DISTANCE_M**3)) ** (1 / 3))


def _with_adhesion(
    radius_of: Callable[[float], float], c: float, pendulum: PendulumOnBall
) -> AdhesiveContact:
    """Radius and surface energy that belong together; the radius changes by per cents, so this converges."""
    a = pendulum.contact_radius_m
    for _ in range(200):
        sigma = surface_energy(Estimate(c, 0.0), replace(pendulum, contact_radius_m=a)).table2.value
        following = radius_of(2 * sigma)
        if abs(following - a) < 1e-12 * a:
            return AdhesiveContact(following, sigma)
        a = following
    return AdhesiveContact(nan, nan)


def maugis_radius(
    force_n: float, work_j_per_m2: float, ball_radius_m: float, stiffness_pa: float, transition: float
) -> float:
    """Contact radius after Maugis (1992) for his parameter lambda; NaN where the load cannot be borne.

    Surfaces attract each other with a constant stress up to the radius m a. In units of
    ``(pi w R^2/K)^(1/3)`` for a and ``pi w R`` for the load P,

        lambda a^2/2 [s + (m^2 - 2) t] + 4/3 lambda^2 a [s t - m + 1] = 1
        P = a^3 - lambda a^2 [s + m^2 t],      s = sqrt(m^2 - 1), t = arcsec(m)
    """
    load = force_n / (pi * work_j_per_m2 * ball_radius_m)

    def at(m: float) -> tuple[float, float]:
        """a and P for the ratio m; a solves a quadratic equation."""
        s, t = sqrt(m * m - 1), acos(1 / m)
        half = 0.5 * transition * (s + (m * m - 2) * t)
        whole = 4 / 3 * transition**2 * (s * t - m + 1)
        a = 2 / (whole + sqrt(whole**2 + 4 * half))
        return a, a**3 - transition * a * a * (s + m * m * t)

    # the load falls as the ring of attraction grows; close to m = 1 it exceeds any
    near, far = 1.0 + 1e-12, 2.0
    while at(far)[1] > load:
        far *= 2
        if far > 1e9:
            return nan
    for _ in range(200):
        middle = 1 + sqrt((near - 1) * (far - 1))
        near, far = (middle, far) if at(middle)[1] > load else (near, middle)
        if far - near < 1e-15 * far:
            break
    scale = (pi * work_j_per_m2 * ball_radius_m**2 / stiffness_pa) ** (1 / 3)
    return float(at(far)[0] * scale)

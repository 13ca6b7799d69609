"""Moment loops, losses of a decay, surface energy, and the contact spot with adhesion.

Hertz leaves adhesion out. The adhesion that resists rolling (c of Eq. 1) also pulls the surfaces together, so
that the spot is larger and the surface energy, which is c over the spot's area, is smaller. Both are computed
together, by iteration, with the work of adhesion w = 2 sigma: two equal surfaces are separated.
Sources: Johnson, Kendall & Roberts 1971; Derjaguin, Muller & Toporov 1975; Tabor 1977; Maugis 1992.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from math import acos, isfinite, nan, pi, sqrt
from typing import Annotated

import numpy as np

from processing.arrays import Floats
from processing.contact.law import ContactParameters, PendulumOnBall
from processing.contact.laws import PAPER, turning_points_of
from processing.errors import DataError
from processing.estimate import Estimate
from processing.quantity import PART
from processing.swing import TurningPoints


@dataclass(frozen=True, slots=True)
class SurfaceEnergy:
    """Specific surface energy in J/m^2, in the paper's two forms."""

    table2: Annotated[Estimate, PART]
    """m g R c/(2 a^2), the work divided by the area 2 a^2 phi that the contact spot sweeps, as in Table 2."""
    eq2: Annotated[Estimate, PART]
    """m g c/(2 a), Eq. 2 as printed."""


def surface_energy(c: Estimate, pendulum: PendulumOnBall) -> SurfaceEnergy:
    """Both forms of sigma for a coefficient c of Eq. 1, to which they are proportional."""
    force = pendulum.mass_kg * pendulum.gravity_m_per_s2
    a = pendulum.contact_radius_m
    return SurfaceEnergy(
        Estimate(*(force * pendulum.ball_radius_m * number / (2 * a**2) for number in c)),
        Estimate(*(force * number / (2 * a) for number in c)),
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
    points: int = 201,
) -> MomentLoop:
    """The three loops of Table 4 at a given amplitude, neglecting its change within the cycle.

    `values` are the parameters of the paper's law by key, in SI units.
    """
    if not amplitude_rad > 0:
        raise DataError(f"amplitude {amplitude_rad} rad: a loop needs a positive one")
    down = np.linspace(amplitude_rad, -amplitude_rad, points)
    phi = np.concatenate([down, down[::-1]])
    direction = np.repeat([-1.0, 1.0], points)
    moments = PAPER.branch_moments(phi, direction, values, pendulum)
    return MomentLoop(phi, *moments, moments.friction_n_m + moments.elastic_n_m)


@dataclass(frozen=True)
class CycleLosses:
    """Losses over whole cycles, arrays (cycles,). The `u_` are standard uncertainties."""

    amplitude_rad: Floats
    """Amplitude in the middle of each cycle."""
    log_decrement: Floats
    """ln(A_i/A_(i+2))."""
    u_log_decrement: Floats
    quality: Floats
    """pi over the decrement."""
    u_quality: Floats
    """Infinite if the decrement is not positive; without meaning if it is comparable to its uncertainty."""


def _losses(amplitude_rad: Floats, decrement: Floats, u_decrement: Floats) -> CycleLosses:
    positive = np.where(decrement > 0, decrement, np.nan)
    u_quality = np.where(decrement > 0, np.pi * u_decrement / positive**2, np.inf)
    return CycleLosses(amplitude_rad, decrement, u_decrement, np.pi / positive, u_quality)


def measured_losses(points: TurningPoints, *, cycles: int = 1) -> CycleLosses:
    """Losses from the turning points without a model.

    The decrement is averaged over windows of `cycles` whole cycles; its noise is inversely proportional to
    their number. Windows do not overlap; those with a missing end are left out.
    """
    if cycles < 1:
        raise DataError(f"cycles = {cycles}: at least one")
    step = 2 * cycles
    begins = np.arange(points.index[0], points.index[-1] - step + 1, step)
    begins = begins[np.isin(begins, points.index) & np.isin(begins + step, points.index)]
    if not len(begins):
        raise DataError(f"no two turning points {cycles} whole cycles apart")
    first, last = np.searchsorted(points.index, begins), np.searchsorted(points.index, begins + step)
    a, b = points.amplitude[first], points.amplitude[last]
    u = np.hypot(points.u_amplitude[first] / a, points.u_amplitude[last] / b)
    return _losses(np.sqrt(a * b), np.log(a / b) / cycles, u / cycles)


def model_losses(
    amplitude_rad: Floats, parameters: ContactParameters, pendulum: PendulumOnBall
) -> CycleLosses:
    """Losses by the exact half-cycle map for a cycle that starts at each amplitude (n,); uncertainties are 0.

    NaN if friction stops the pendulum before the end of the cycle.
    """
    end_rad = np.array(
        [turning_points_of(parameters, pendulum, float(a), 2)[0][2] for a in amplitude_rad], dtype=np.float64
    )
    return _losses(
        np.sqrt(amplitude_rad * end_rad), np.log(amplitude_rad / end_rad), np.zeros_like(amplitude_rad)
    )


ATOMIC_DISTANCE_M = 0.3e-9
"""z0, the distance of the surfaces' atoms in contact, on which the Tabor parameter depends: 0.2 to 0.4 nm."""
_MAUGIS_PER_TABOR = 1.157
"""Maugis' parameter lambda over Tabor's mu, if Dugdale's step of the force has the work and the peak force of
Lennard-Jones'."""
_MIN_TABOR_JKR = 5.0
_MAX_TABOR_DMT = 0.1
"""Tabor parameters above which JKR, and below which DMT holds (Johnson & Greenwood 1997)."""


@dataclass(frozen=True, slots=True)
class AdhesiveContact:
    """A contact spot with adhesion, and the surface energy (Table 2's form) that belongs to its radius."""

    radius_m: float
    surface_energy_j_per_m2: float


@dataclass(frozen=True, slots=True)
class AdhesiveContacts:
    """The contact spot by each theory. With Hertz's stiffness K = F R/a^3 and the work of adhesion w,

        DMT    a^3 = (F + 2 pi w R) R / K
        JKR    a^3 = (F + 3 pi w R + sqrt(6 pi w R F + (3 pi w R)^2)) R / K

    and Maugis-Dugdale between both, for the Tabor parameter ``(R w^2 / (E*^2 z0^3))^(1/3)``, E* = 3 K / 4.
    """

    tabor: float
    """The Tabor parameter, which decides which theory holds."""
    jkr: AdhesiveContact
    dmt: AdhesiveContact
    maugis: AdhesiveContact

    @property
    def holds(self) -> str:
        """Name of the theory that holds at the Tabor parameter."""
        if self.tabor > _MIN_TABOR_JKR:
            return "JKR"
        return "DMT" if self.tabor < _MAX_TABOR_DMT else "Maugis-Dugdale"


def adhesive_contacts(c: float, pendulum: PendulumOnBall) -> AdhesiveContacts:
    """Contact spots and surface energies for an adhesion coefficient c of Eq. 1.

    The reduced modulus follows from the pendulum's contact radius, Hertz's. Raises DataError for a c that is
    not positive.
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

    contacts = {theory.__name__: _with_adhesion(theory, c, pendulum) for theory in (jkr, dmt, maugis)}
    work = 2 * contacts["maugis"].surface_energy_j_per_m2
    return AdhesiveContacts(tabor_parameter(work, radius, stiffness), **contacts)


def tabor_parameter(work_j_per_m2: float, ball_radius_m: float, stiffness_pa: float) -> float:
    """Tabor's mu: the deformation by surface forces over their range."""
    reduced_pa = 0.75 * stiffness_pa
    return float((ball_radius_m * work_j_per_m2**2 / (reduced_pa**2 * ATOMIC_DISTANCE_M**3)) ** (1 / 3))


def _with_adhesion(
    radius_of: Callable[[float], float], c: float, pendulum: PendulumOnBall
) -> AdhesiveContact:
    """Radius and surface energy that belong together; the radius changes by per cents, so this converges."""
    a = pendulum.contact_radius_m
    for _ in range(200):
        sigma = surface_energy(Estimate(c, 0.0), replace(pendulum, contact_radius_m=a)).table2.value
        last_a, a = a, radius_of(2 * sigma)
        if abs(a - last_a) < 1e-12 * last_a:
            return AdhesiveContact(a, sigma)
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

    def radius_and_load(m: float) -> tuple[float, float]:
        """a and P for the ratio m; a is the root of a quadratic equation."""
        s, t = sqrt(m * m - 1), acos(1 / m)
        square_term = 0.5 * transition * (s + (m * m - 2) * t)
        linear_term = 4 / 3 * transition**2 * (s * t - m + 1)
        a = 2 / (linear_term + sqrt(linear_term**2 + 4 * square_term))
        return a, a**3 - transition * a * a * (s + m * m * t)

    # the load falls as the ring of attraction grows; close to m = 1 it is larger than any given one
    low, high = 1.0 + 1e-12, 2.0
    while radius_and_load(high)[1] > load:
        high *= 2
        if high > 1e9:
            return nan
    for _ in range(200):
        middle = 1 + sqrt((low - 1) * (high - 1))
        low, high = (middle, high) if radius_and_load(middle)[1] > load else (low, middle)
        if high - low < 1e-15 * high:
            break
    scale = (pi * work_j_per_m2 * ball_radius_m**2 / stiffness_pa) ** (1 / 3)
    return float(radius_and_load(high)[0] * scale)

"""The one table of quantities: symbol, unit and name of every number that a person reads.

Keys are the names in results.json, which end in the SI unit (or in no unit for a pure number).
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

from rig.presentation.numbers import with_uncertainty

_ARCSEC_PER_RAD: Final = 648000 / math.pi
_ARCMIN_PER_RAD: Final = 10800 / math.pi


@dataclass(frozen=True, slots=True)
class Quantity:
    """How a number is shown. `factor` times the number stored is the number shown in `unit`.

    `unit` is empty for a pure number.
    """

    symbol: str
    unit: str
    name: str
    factor: float = 1.0

    @property
    def label(self) -> str:
        """`γ / MPa`: the heading of a row, a column or an axis."""
        return f"{self.symbol} / {self.unit}" if self.unit else self.symbol

    def text(self, value: float, u: float) -> str:
        """A stored value and its standard uncertainty in the shown unit."""
        return with_uncertainty(value * self.factor, u * self.factor)


QUANTITIES: Final[Mapping[str, Quantity]] = {
    "b": Quantity("b", "rad⁻ᵖ", "friction coefficient of Eq. 1"),
    "p": Quantity("p", "", "exponent of the friction"),
    "c": Quantity("c", "", "adhesive part of the friction"),
    "n": Quantity("n", "", "exponent of the elastic moment"),
    "period0_s": Quantity("T₀", "s", "period without elastic adhesion"),
    "gamma_pa": Quantity("γ", "MPa", "elastic adhesion", 1e-6),
    "drag_s": Quantity("drag", "s", "linear drag"),
    "initial_amplitude_rad": Quantity("α₀", "arcsec", "amplitude at the start", _ARCSEC_PER_RAD),
    "start_time_s": Quantity("t₀", "s", "time of the first turning point"),
    "surface_energy_table2_j_per_m2": Quantity("σ (Table 2's form)", "mJ/m²", "surface energy", 1e3),
    "surface_energy_eq2_j_per_m2": Quantity("σ (Eq. 2 as printed)", "mJ/m²", "surface energy", 1e3),
    "contact_radius_m": Quantity("contact radius a", "µm", "radius of the contact", 1e6),
    "contact_depth_m": Quantity("depth a²/R", "µm", "depth of the contact", 1e6),
    "contact_angle_rad": Quantity("contact angle a/R", "arcmin", "angle of the contact", _ARCMIN_PER_RAD),
}


def quantity(key: str) -> Quantity:
    """How a number of results.json is shown; one that is not in the table goes by its key."""
    return QUANTITIES.get(key) or Quantity(key, "", key.replace("_", " "))


SOURCES: Final[Mapping[str, str]] = {
    "swings": "swings (fit)",
    "mass_kg": "mass",
    "ball_radius_m": "ball radius R",
    "gravity_m_per_s2": "local g",
    "arm_m": "lever arm",
    "pitch_m": "pixel pitch",
    "clock": "clock",
    "flat_youngs_modulus_pa": "E of the flat",
    "flat_poisson_ratio": "ν of the flat",
    "ball_youngs_modulus_pa": "E of the ball",
    "ball_poisson_ratio": "ν of the ball",
    "slow_angle_rad": "direction of the slow axis",
    "non_orthogonality_rad": "angle between the axes",
}
"""Names of the sources of an uncertainty budget."""

"""Table of all quantities that are shown to the user: symbol, unit and name.

The keys are the names under which the values are computed; they end in the SI unit. The deflections of the
balance have no unit in their names: they are in rad, or in px if `quantity` is called with that unit.
Parameters of the contact laws are defined with their laws, all other quantities here.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cache
from typing import TYPE_CHECKING, Final

from processing.angle import ARCSEC_RAD
from rig.presentation.numbers import with_uncertainty

if TYPE_CHECKING:
    from processing.contact import Parameter


@dataclass(frozen=True, slots=True)
class Quantity:
    """Presentation of a quantity: the number shown, in `unit`, is `factor` times the stored value.

    `unit` is empty for a dimensionless quantity.
    """

    symbol: str
    unit: str
    name: str
    factor: float = 1.0

    @property
    def label(self) -> str:
        """Heading of a row, a column or an axis, such as `γ / MPa`."""
        if not self.unit:
            return self.symbol
        return f"{self.symbol} / ({self.unit})" if "/" in self.unit else f"{self.symbol} / {self.unit}"

    def text(self, value: float, u: float) -> str:
        """Text of a stored value and its standard uncertainty, in the unit shown."""
        return with_uncertainty(value * self.factor, u * self.factor)

    def in_px(self) -> "Quantity":
        """The same quantity without a calibrated lever, where deflections are stored in px."""
        if not self.unit.startswith("arcsec"):
            return self
        return replace(self, unit=self.unit.replace("arcsec", "px"), factor=self.factor * ARCSEC_RAD)


_ARCSEC: Final = 1.0 / ARCSEC_RAD
_DEGREE: Final = math.degrees(1.0)
_PER_MIN: Final = 60.0

QUANTITIES: Final[Mapping[str, Quantity]] = {
    # of the fits
    "chi2_per_dof": Quantity("χ²/dof", "", "χ² per degree of freedom"),
    "degrees_of_freedom": Quantity("dof", "", "degrees of freedom"),
    "arae_decay": Quantity("ARAE (8)", "%", "ARAE of the amplitudes, Eq. 8", 100.0),
    "arae_period": Quantity("ARAE (9)", "%", "ARAE of the periods, Eq. 9", 100.0),
    "surface_energy_table2_j_per_m2": Quantity("σ (Table 2's form)", "mJ/m²", "surface energy", 1e3),
    "surface_energy_eq2_j_per_m2": Quantity("σ (Eq. 2 as printed)", "mJ/m²", "surface energy", 1e3),
    "dissipated_4a_j": Quantity("4A", "fJ", "work lost in a cycle", 1e15),
    "adhesive_4at_j": Quantity("4Aₜ", "fJ", "work lost in a cycle by adhesion", 1e15),
    # of the surroundings
    "temperature_c": Quantity("temperature", "°C", "temperature"),
    "humidity_percent": Quantity("humidity", "%", "relative humidity"),
    "pressure_pa": Quantity("pressure", "hPa", "pressure of the air", 1e-2),
    "dwell_s": Quantity("dwell", "h", "dwell of the ball on its place", 1 / 3600),
    "age_s": Quantity("age", "h", "age of the surfaces since cleaning", 1 / 3600),
    # of the contact after Hertz
    "contact_radius_m": Quantity("contact radius a", "µm", "radius of the contact", 1e6),
    "contact_depth_m": Quantity("depth a²/R", "µm", "depth of the contact", 1e6),
    "contact_angle_rad": Quantity("contact angle a/R", "arcmin", "angle of the contact", 60 * _DEGREE),
    # of the balance
    "period_s": Quantity("period", "s", "period of the slow mode"),
    "amplitude": Quantity("amplitude", "arcsec", "amplitude of the slow mode along Y", _ARCSEC),
    "transverse": Quantity("transverse", "arcsec", "amplitude of the fast mode along X", _ARCSEC),
    "transverse_ratio": Quantity("transverse ratio", "%", "transverse over amplitude", 100.0),
    "width_ratio": Quantity("ellipticity", "%", "width of the slow mode's ellipse over its length", 100.0),
    "line_angle_rad": Quantity("tilt of the line", "deg", "direction of the line, from Y to X", _DEGREE),
    "rotation_rad_per_s": Quantity("rotation", "deg/min", "turning of the line", _DEGREE * _PER_MIN),
    "rest_x": Quantity("rest X", "arcsec", "rest position along X", _ARCSEC),
    "rest_y": Quantity("rest Y", "arcsec", "rest position along Y", _ARCSEC),
    "drift_x_per_s": Quantity("drift X", "arcsec/min", "drift of the rest position", _ARCSEC * _PER_MIN),
    "drift_y_per_s": Quantity("drift Y", "arcsec/min", "drift of the rest position", _ARCSEC * _PER_MIN),
    "period_ratio": Quantity("T_V / T_U", "", "period of the fast mode over that of the slow one"),
}

SHOWN_UNITS: Final[Mapping[str, tuple[str, float]]] = {
    "1": ("", 1.0),
    "Pa": ("MPa", 1e-6),
    "rad": ("arcsec", _ARCSEC),
}
"""Unit in which a parameter of a law is shown, and factor, by its SI unit; others are shown in the SI
unit.
"""


def quantity(key: str, unit: str = "arcsec") -> Quantity:
    """Presentation of the quantity with this key; an unknown key is shown as it is.

    `unit` is that in which deflections are shown: arcsec, or px without a calibrated lever.
    """
    found = QUANTITIES.get(key)
    if found is None:
        parameter = law_parameters().get(key)
        if parameter is None:
            return Quantity(key.replace("_", " "), "", key.replace("_", " "))
        shown, factor = SHOWN_UNITS.get(parameter.unit, (parameter.unit, 1.0))
        found = Quantity(parameter.symbol, shown, parameter.description, factor)
    return found.in_px() if unit == "px" else found


@cache
def law_parameters() -> Mapping[str, "Parameter"]:
    """All parameters of all laws by their keys, and the drag and start values that every fit has in addition.

    The laws are imported only here, because the viewer's process does not need them and should start fast.
    """
    from processing.contact import AMPLITUDE, DRAG, LAWS, TIME

    own = [p for law in LAWS.values() for p in (*law.parameters, *law.uncalibrated.values())]
    # a key that several laws have is described as the first one has it
    return {parameter.key: parameter for parameter in reversed((*own, DRAG, AMPLITUDE, TIME))}


SOURCES: Final[Mapping[str, str]] = {
    "swings": "swings (fit)",
    "ground": "motion of the ground",
    "position_errors": "errors of position (map)",
    "mass_kg": "mass",
    "ball_radius_m": "ball radius R",
    "gravity_m_per_s2": "local g",
    "arm_m": "lever arm",
    "pitch_m": "pixel pitch",
    "clock": "clock",
    "row_time_s": "row time of the shutter",
    "flat_youngs_modulus_pa": "E of the flat",
    "flat_poisson_ratio": "ν of the flat",
    "ball_youngs_modulus_pa": "E of the ball",
    "ball_poisson_ratio": "ν of the ball",
}
"""Names of the sources of an uncertainty budget."""

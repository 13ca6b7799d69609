"""Declarations of numbers with symbol, meaning and units: on the field that holds one, or here."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cache
from typing import Annotated, Final, get_type_hints

from processing.arrays import Floats
from processing.units import conversion, unit_of_name

OWN: Final = "that of the quantity"
"""Unit of a number that has the unit of its quantity: its value, a part of its uncertainty."""
STATED: Final = "stated in "
"""``STATED + "unit"``: the unit is stated in the field `unit` of the same object."""
OF: Final = "unit of "
"""``OF + "source"``: the unit is that of the quantity named in the field `source` of the same object."""
PER: Final = " per "
"""Separator of two such units, of which the first is divided by the second."""


@dataclass(frozen=True, slots=True)
class Quantity:
    """Declaration of a number, or of a value with its uncertainty, or of an array of them."""

    symbol: str
    """Symbol in tables and figures."""
    meaning: str
    """Description in words."""
    shown: str = ""
    """Unit in which a person reads it; if empty the SI unit, and none for a plain number."""
    unit: str = ""
    """SI unit, "1" for a plain number; if empty the one in which the field's name ends."""

    @property
    def factor(self) -> float:
        """Ratio of the number shown to the stored one."""
        return conversion(self.unit, self.shown) if self.shown else 1.0


PLAIN: Final = Quantity("", "", unit="1")
"""Declaration of numbers without a unit in a mapping whose keys have one."""
IN_UNIT: Final = Quantity("", "in `unit`", unit=STATED + "unit")
"""Declaration of a number whose unit is stated in the field `unit` of the same object."""
PART: Final = Quantity("", "", unit=OWN)
"""Declaration of a number in the unit of its quantity: a value, a bound, a contribution."""


@cache
def quantities_of(kind: type) -> Mapping[str, Quantity]:
    """Declarations of a dataclass's fields by name, each with its unit."""
    return {
        name: quantity if quantity.unit else replace(quantity, unit=unit_of_name(name) or "1")
        for name, hint in get_type_hints(kind, include_extras=True).items()
        for quantity in getattr(hint, "__metadata__", ())
        if isinstance(quantity, Quantity)
    }


@dataclass(frozen=True, slots=True, kw_only=True)
class DerivedQuantity:
    """Quantities that follow from the parameters of the paper's law and the rig's input quantities.

    A quantity that is added here has a line in the budget, a row in the table of results, and a place in
    every file: `reported_quantities` of `processing.fit` calculates it.
    """

    surface_energy_table2_j_per_m2: Annotated[
        Floats, Quantity("σ (Table 2's form)", "surface energy, as in the paper's Table 2", "mJ/m²")
    ]
    surface_energy_eq2_j_per_m2: Annotated[
        Floats, Quantity("σ (Eq. 2 as printed)", "surface energy, by the paper's Eq. 2", "mJ/m²")
    ]
    contact_radius_m: Annotated[
        Floats, Quantity("contact radius a", "radius of the contact, after Hertz", "µm")
    ]
    contact_depth_m: Annotated[Floats, Quantity("depth a²/R", "depth of the contact", "µm")]
    contact_angle_rad: Annotated[Floats, Quantity("contact angle a/R", "angle of the contact", "arcmin")]


@dataclass(frozen=True, slots=True, kw_only=True)
class DecayQuantities:
    """Quantities of every decay, with or without a fitted law, and of the theories of adhesion."""

    log_decrement: Annotated[float, Quantity("log decrement", "log decrement", unit="1")]
    quality_factor: Annotated[float, Quantity("quality factor", "quality factor", unit="1")]
    initial_amplitude: Annotated[float, Quantity("first amplitude", "first amplitude", unit="1")]
    final_amplitude: Annotated[float, Quantity("last amplitude", "last amplitude", unit="1")]
    tabor: Annotated[float, Quantity("Tabor parameter", "Tabor parameter", unit="1")]


@dataclass(frozen=True, slots=True, kw_only=True)
class InstrumentQuantities:
    """Quantities that other kinds of pendulum measure, the main ones first."""

    time_hardness_s: Annotated[float, Quantity("time hardness", "time hardness, ten single swings", "s")]
    scale_hardness: Annotated[float, Quantity("scale hardness", "scale hardness, first swing", unit="1")]
    time_hardness_first_swing_s: Annotated[
        float, Quantity("time hardness × 10", "time hardness, first swing × 10", "s")
    ]
    damping_time_s: Annotated[float, Quantity("damping time", "damping time", "s")]
    damping_swings: Annotated[float, Quantity("swings", "swings", unit="1")]
    rolling_friction_coefficient: Annotated[float, Quantity("f", "coefficient of rolling friction", unit="1")]
    log_decrement: Annotated[float, Quantity("Λ", "log decrement of a whole swing", unit="1")]
    period0_s: Annotated[float, Quantity("T₀", "period at vanishing amplitude", "s")]
    circular_factor: Annotated[
        float, Quantity("circular factor", "circular error over the ideal pendulum's", unit="1")
    ]
    plane_rate_deg_per_min: Annotated[
        float, Quantity("turning", "turning of the swing plane", "deg/min", "deg/min")
    ]
    first_amplitude_deg: Annotated[float, Quantity("first amplitude", "first amplitude", "deg", "deg")]
    missing_half_cycles: Annotated[float, Quantity("missing", "half-cycles missing in it", unit="1")]
    damping_start_deg: Annotated[float, Quantity("from", "from", "deg", "deg")]
    damping_end_deg: Annotated[float, Quantity("to", "to", "deg", "deg")]
    friction_exponent: Annotated[
        float, Quantity("exponent", "power of the amplitude of the friction", unit="1")
    ]
    friction_moment: Annotated[float, Quantity("M/(m g d)", "frictional moment over m g d", unit="1")]
    chi2_per_dof: Annotated[float, Quantity("χ²/dof", "χ² per degree of freedom", unit="1")]
    plane_turned_deg: Annotated[float, Quantity("turned", "turned in all", "deg", "deg")]
    plane_width_ratio: Annotated[float, Quantity("width", "width of the swing over its length", unit="1")]
    inferred_half_cycles: Annotated[float, Quantity("inferred", "turning points off the sensor", unit="1")]
    mean_period_s: Annotated[float, Quantity("T", "mean period", "s")]

"""What follows from fitted parameters: names, units, meanings; apart from the fit, which loads slowly."""

from dataclasses import dataclass
from typing import Annotated

from processing.arrays import Floats
from processing.quantity import Quantity


@dataclass(frozen=True, slots=True, kw_only=True)
class Derived:
    """What follows from the parameters of the paper's law and the rig's input quantities.

    A quantity that is added here has a line in the budget, a row in the table of results, and a place in
    every file: `derived_quantities` of `processing.fit` calculates it.
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

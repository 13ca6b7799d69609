"""What is reported of the contact: the fits of its laws, and what follows from them.

Field names are keys of results.json; see `rig.analysis.results`.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from math import nan
from typing import Annotated

from processing.contact import DRAG, ContactParameters
from processing.contact.laws import DEFAULT_LAW
from processing.estimate import NOT_DETERMINED, Estimate
from processing.fit import FitQuality
from rig.analysis.encoding import Entries


@dataclass(frozen=True, slots=True)
class Correlation:
    """Correlation matrix of a fit's parameters, row by row."""

    names: tuple[str, ...] = ()
    matrix: tuple[tuple[float, ...], ...] = ()


@dataclass(frozen=True, kw_only=True)
class Fit(FitQuality):
    """One fit of one decay: parameters by name, and how well the curve describes the data.

    `law` names the law of `processing.contact.laws` that was fitted.
    `ground` and `whiteness` are empty for the asymptotic fit.
    """

    law: str = ""
    parameters: Annotated[Mapping[str, Estimate], Entries] = field(default_factory=dict)
    correlation: Correlation = field(default_factory=Correlation)

    def estimate(self, name: str) -> Estimate:
        """A parameter; NaN where the fit has none of that name."""
        return self.parameters.get(name, NOT_DETERMINED)

    def contact(self) -> ContactParameters:
        """The contact parameters as the laws take them."""
        values = {name: self.estimate(name).value for name in DEFAULT_LAW.names()}
        drag = self.parameters.get(DRAG.key)
        return ContactParameters(**values, drag_s=0.0 if drag is None else drag.value)


@dataclass(frozen=True, slots=True, kw_only=True)
class AdhesiveSpot:
    """Radius of the contact spot with adhesion, and the surface energy (Table 2's form) of that radius."""

    radius_m: Estimate = NOT_DETERMINED
    surface_energy_j_per_m2: Estimate = NOT_DETERMINED


@dataclass(frozen=True, slots=True, kw_only=True)
class Adhesion:
    """The contact spot in three theories of adhesion; `holds` names the one that the Tabor parameter selects.
    All other values follow the paper, with Hertz's radius."""

    tabor: float = nan
    holds: str = ""
    jkr: AdhesiveSpot = AdhesiveSpot()
    dmt: AdhesiveSpot = AdhesiveSpot()
    maugis_dugdale: AdhesiveSpot = AdhesiveSpot()

    def spots(self) -> dict[str, AdhesiveSpot]:
        """By the name of the theory."""
        return {"JKR": self.jkr, "Maugis-Dugdale": self.maugis_dugdale, "DMT": self.dmt}

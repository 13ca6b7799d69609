"""What is reported of the contact: the fits of its laws, and what follows from them.

Field names are keys of results.json; see `rig.analysis.results`.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from math import nan
from typing import Annotated, Literal

from processing.contact import DRAG, ContactParameters
from processing.contact.laws import PAPER
from processing.estimate import Determinacy, Estimate
from processing.fit import DragFinding, FitMethod
from rig.analysis.encoding import (
    Entries,
    LeftOut,
    Number,
    Value,
)

NOT_DETERMINED = Estimate(nan, nan)


@dataclass(frozen=True, slots=True)
class Correlation:
    """Correlation matrix of a fit's parameters, row by row."""

    names: tuple[str, ...] = ()
    matrix: tuple[tuple[Number, ...], ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class BaseMotion:
    """Horizontal acceleration of the ground that the drive of a pendulum corresponds to.

    One-sided spectral density at the pendulum's frequency, in m/s^2/sqrt(Hz), for the stated height of the
    mass centre over the point of contact, its bound of 95 %, and its level over Peterson's new low noise
    model of 1993.
    """

    mass_centre_height_m: Number
    acceleration_m_per_s2_rthz: Value
    upper_95: Number = nan
    above_low_noise_model_db: Number = nan


@dataclass(frozen=True, slots=True, kw_only=True)
class Ground:
    """How strongly the ground drove the pendulum during a run, as the turning points show it.

    `density_rad_per_s2_rthz` is the one-sided spectral density of the angular acceleration at the
    pendulum's frequency, in rad/s^2/sqrt(Hz), `upper_95` its bound of 95 %; `seen` is false where
    the run sets no more than that bound. `measurement_scale` is the factor by which turning points
    scatter more than their stated uncertainties. `left_out_half_cycles` at the end were not fitted:
    the ground moves the pendulum in one half-swing by more than a tenth of its amplitude there, and
    amplitude and phase do not describe its motion. `widening` says for each parameter how many times
    larger its uncertainty is than on ground at rest. `base` is empty where the configuration
    does not state the height of the mass centre.
    """

    density_rad_per_s2_rthz: Value = NOT_DETERMINED
    upper_95: Number = nan
    seen: bool = False
    measurement_scale: Number = 1.0
    left_out_half_cycles: int = 0
    widening: Mapping[str, Number] = field(default_factory=dict)
    base: Annotated[BaseMotion | None, LeftOut] = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Whiteness:
    """Test of Ljung and Box whether the residuals of neighbouring half-cycles are correlated.

    `p_amplitude` and `p_time` are the chances of correlations at least as large in pure noise, over `lags`
    neighbours; `first_amplitude` and `first_time` are the correlations of next neighbours. `widened`
    is the largest factor by which correlation enlarged an uncertainty of the fit.
    """

    lags: int = 0
    p_amplitude: Number = nan
    p_time: Number = nan
    first_amplitude: Number = nan
    first_time: Number = nan
    widened: Number = 1.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Fit:
    """One fit of one decay: parameters by name, and how well the curve describes the data.

    `law` names the law of `processing.contact.laws` that was fitted, empty in files of earlier
    versions. `ground` and `whiteness` are empty for the asymptotic fit and in files of earlier
    versions. `bias` of Eqs. 5 and 6 is how far they lie from the exact map where both describe the exact
    fit's own free decay. `arae_decay` and `arae_period` are the mean relative errors of Eqs. 8 and 9.
    `outliers` are indices of half-cycles.
    """

    law: str = ""
    parameters: Annotated[Mapping[str, Value], Entries] = field(default_factory=dict)
    mean_period_s: Value = NOT_DETERMINED
    arae_decay: Number = nan
    arae_period: Number = nan
    chi2_per_dof: Number = nan
    degrees_of_freedom: int = 0
    correlation: Correlation = field(default_factory=Correlation)
    ground: Annotated[Ground | None, LeftOut] = None
    whiteness: Annotated[Whiteness | None, LeftOut] = None
    bias: Annotated[Mapping[str, Number] | None, LeftOut] = None
    outliers: tuple[int, ...] = ()
    warnings: tuple[str, ...] = ()

    def estimate(self, name: str) -> Estimate:
        """A parameter; NaN where the fit has none of that name."""
        return self.parameters.get(name, NOT_DETERMINED)

    def contact(self) -> ContactParameters:
        """The contact parameters as the laws take them."""
        values = {name: self.estimate(name).value for name in PAPER.names()}
        drag = self.parameters.get(DRAG.key)
        return ContactParameters(**values, drag_s=0.0 if drag is None else drag.value)


@dataclass(frozen=True, slots=True)
class SurfaceEnergy:
    """Energy of adhesion in J/m^2 in the paper's two forms: that of Table 2, and Eq. 2 as printed."""

    table2: Value
    eq2: Value


@dataclass(frozen=True, slots=True)
class SurfaceEnergies(SurfaceEnergy):
    """Surface energy after the default fit; those after the other fits by the fit's name."""

    others: Annotated[Mapping[str, SurfaceEnergy], Entries] = field(default_factory=dict)

    def of(self, method: str) -> SurfaceEnergy | None:
        """The surface energy after one fit."""
        return self if method == FitMethod.EXACT else self.others.get(method)


@dataclass(frozen=True, slots=True)
class Hertz:
    """The contact after Hertz."""

    radius_m: Value
    depth_m: Value
    angle_rad: Value


@dataclass(frozen=True, slots=True, kw_only=True)
class AdhesiveSpot:
    """Radius of the contact spot with adhesion, and the surface energy (Table 2's form) of that radius."""

    radius_m: Value = NOT_DETERMINED
    surface_energy_j_per_m2: Value = NOT_DETERMINED


@dataclass(frozen=True, slots=True, kw_only=True)
class Adhesion:
    """The contact spot after three theories of adhesion; `holds` names the one that the Tabor parameter asks
    for. The values elsewhere are the paper's, with the radius after Hertz."""

    tabor: Number = nan
    holds: str = ""
    jkr: AdhesiveSpot = AdhesiveSpot()
    dmt: AdhesiveSpot = AdhesiveSpot()
    maugis_dugdale: AdhesiveSpot = AdhesiveSpot()

    def spots(self) -> dict[str, AdhesiveSpot]:
        """By the name of the theory."""
        return {"JKR": self.jkr, "Maugis-Dugdale": self.maugis_dugdale, "DMT": self.dmt}


@dataclass(frozen=True, slots=True, kw_only=True)
class ExpectedDrag:
    """The order of magnitude of the drag of the air on a bar in the pendulum's place; see
    `processing.contact.air_drag`.

    `assumed` names what was neither measured nor stated: of the air the usual (20 degrees Celsius, 50 %,
    101325 Pa), of the bar what follows from the pendulum's inertia.
    """

    drag_s: Number
    air_density_kg_per_m3: Number
    air_viscosity_pa_s: Number
    length_m: Number
    width_m: Number
    assumed: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class Drag:
    """Whether a linear drag is in the data: the default fit with it against that without."""

    drag_s: Value = NOT_DETERMINED
    f_statistic: Number = nan
    p_value: Number = nan
    aic_difference: Number = nan
    relative_shift_b: Number = nan
    relative_shift_c: Number = nan
    significant: bool = False
    text: str = ""
    with_drag: Mapping[str, Value] = field(default_factory=dict)
    of_air: Annotated[ExpectedDrag | None, LeftOut] = None

    @property
    def finding(self) -> DragFinding:
        """What the numbers say of it."""
        return DragFinding.of(self.drag_s, self.p_value, significant=self.significant)


@dataclass(frozen=True, slots=True, kw_only=True)
class Determination:
    """What the data say of one parameter: a value, an interval, a bound or nothing."""

    name: str
    verdict: Determinacy
    value: Number
    standard_uncertainty: Number = nan
    lower_95: Number
    upper_95: Number
    profile_likelihood: bool = False
    text: str = ""


@dataclass(frozen=True, slots=True)
class BudgetSource:
    """One source of uncertainty: type A from the data, type B stated; `share` of the variance."""

    source: str
    type: Literal["A", "B"]
    u_source: Number
    sensitivity: Number
    contribution: Number
    share: Number


@dataclass(frozen=True, slots=True, kw_only=True)
class Budget:
    """Uncertainty budget of one quantity after the GUM, largest contribution first."""

    unit: str = ""
    value: Number
    standard_uncertainty: Number
    degrees_of_freedom: Number = nan
    coverage_factor_95: Number
    expanded_uncertainty_95: Number
    sources: tuple[BudgetSource, ...] = ()


@dataclass(frozen=True, slots=True)
class Propagated:
    """One quantity by Monte Carlo; `gum_holds` says whether the budget's interval agrees with it."""

    mean: Number
    standard_uncertainty: Number
    lower_95: Number
    upper_95: Number
    gum_holds: bool


@dataclass(frozen=True, slots=True)
class MonteCarlo:
    """Monte Carlo propagation after JCGM 101."""

    draws: int = 0
    seed: int = 0
    quantities: Mapping[str, Propagated] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Work:
    """Work of one cycle: all of it (4A), the part of adhesion (4A_t), that of a linear drag."""

    amplitude_arcsec: Number
    dissipated_4a_j: Value
    adhesive_4at_j: Value
    drag_j: Number = 0.0

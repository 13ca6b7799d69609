"""The values of results.json. Field names are its keys, fixed so that other programs can rely on them.

Every field has a default: files of earlier versions, which lack some of them, are read as well.
`rig.analysis.encoding` says how estimates, arrays and "not determined" are spelled in the file.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from math import isfinite, nan
from typing import Annotated, Literal

import numpy as np

from acquisition.frame_losses import FrameLosses
from processing.contact import DRAG, ContactParameters, PendulumOnBall
from processing.contact.laws import PAPER
from processing.deflections import DeflectionUnit
from processing.estimate import Estimate
from processing.fit import FitMethod, Verdict
from processing.swing import KnownMotion, Swing, TurningPoints
from rig.analysis.encoding import (
    AsObject,
    Beside,
    Entries,
    Floats,
    Integers,
    JsonObject,
    LeftOut,
    Number,
    Section,
    Value,
)
from rig.analysis.instrument_results import InstrumentResults, InstrumentSeries

SCHEMA = 2
"""Version of the file. 1, the first, has no `amplitude_unit`, `record_bytes` and `turning_points`, and px
under the names in arcsec of a record without a lever."""

NOT_DETERMINED = Estimate(nan, nan)


@dataclass(frozen=True, slots=True)
class Correlation:
    """Correlation matrix of a fit's parameters, row by row."""

    names: tuple[str, ...] = ()
    matrix: tuple[tuple[Number, ...], ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class Fit:
    """One fit of one decay: parameters by name, and how well the curve describes the data.

    `law` names the law of `processing.contact.laws` that was fitted, empty in files of earlier
    versions. `arae_decay` and `arae_period` are the mean relative errors of Eqs. 8 and 9. `outliers` are
    indices of half-cycles.
    """

    law: str = ""
    parameters: Annotated[Mapping[str, Value], Entries] = field(default_factory=dict)
    mean_period_s: Value = NOT_DETERMINED
    arae_decay: Number = nan
    arae_period: Number = nan
    chi2_per_dof: Number = nan
    degrees_of_freedom: int = 0
    correlation: Correlation = field(default_factory=Correlation)
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


@dataclass(frozen=True, slots=True, kw_only=True)
class StoredTurningPoints:
    """The turning points that were fitted, and the half-cycles that were left out.

    Times are in true seconds from `first_ns`, the record's time of the first turning point. Amplitudes are
    in `unit`. `left_out_flags` are those of `processing.swing.SwingFlag`.
    """

    first_ns: int = 0
    unit: DeflectionUnit = DeflectionUnit.RAD
    index: Integers = field(default_factory=lambda: np.empty(0, dtype=np.int64))
    time_s: Floats = field(default_factory=lambda: np.empty(0))
    u_time_s: Floats = field(default_factory=lambda: np.empty(0))
    amplitude: Floats = field(default_factory=lambda: np.empty(0))
    u_amplitude: Floats = field(default_factory=lambda: np.empty(0))
    left_out_time_s: Floats = field(default_factory=lambda: np.empty(0))
    left_out_amplitude: Floats = field(default_factory=lambda: np.empty(0))
    left_out_flags: Integers = field(default_factory=lambda: np.empty(0, dtype=np.int64))

    @classmethod
    def of(
        cls, points: TurningPoints, swings: Sequence[Swing], unit: DeflectionUnit, clock_rate: float
    ) -> "StoredTurningPoints":
        """`points` were made of `swings`, of whose seconds each takes `clock_rate` true ones."""
        first_ns = next((swing.turn_time_ns for swing in swings if swing.flags == 0), None)
        if first_ns is None:
            first_ns = swings[0].turn_time_ns if swings else 0
        left_out = [swing for swing in swings if swing.flags]
        return cls(
            first_ns=first_ns,
            unit=unit,
            index=points.index,
            time_s=points.time_s,
            u_time_s=points.u_time_s,
            amplitude=points.amplitude,
            u_amplitude=points.u_amplitude,
            left_out_time_s=np.array(
                [(swing.turn_time_ns - first_ns) * 1e-9 * clock_rate for swing in left_out]
            ),
            left_out_amplitude=np.array([swing.amplitude for swing in left_out]),
            left_out_flags=np.array([swing.flags for swing in left_out], dtype=np.int64),
        )

    def points(self) -> TurningPoints:
        """As the fits take them."""
        return TurningPoints(self.index, self.time_s, self.u_time_s, self.amplitude, self.u_amplitude)


@dataclass(frozen=True, slots=True)
class Hertz:
    """The contact after Hertz."""

    radius_m: Value
    depth_m: Value
    angle_rad: Value


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


@dataclass(frozen=True, slots=True, kw_only=True)
class Determination:
    """What the data say of one parameter: a value, an interval, a bound or nothing."""

    name: str
    verdict: Verdict
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


@dataclass(frozen=True, slots=True, kw_only=True)
class RunResults:
    """What is reported of one run; `problem` says in one line why a fit is missing.

    `record` is relative to the folder of the file where it can be. `losses` says who lost the frames that
    are missing; None where an older record does not. `measured_again_on` is the motion on which the fitted
    turning points were measured again (see `processing.fit.remeasure`); None: they are as detected.
    `initial_amplitude` and `final_amplitude` are in `amplitude_unit`: arcsec, or px of a record without a
    lever; those in arcsec are not determined then. What follows from a fit (`pendulum` to `notes`) is empty
    where there is none.
    """

    record: str
    sha256: str = ""
    record_bytes: int | None = None
    frames: int = 0
    dropped_frames: int = 0
    losses: Annotated[FrameLosses, AsObject] | None = None
    half_cycles: int = 0
    measured_again_on: KnownMotion | None = None
    amplitude_unit: str | None = None
    initial_amplitude: Number = nan
    final_amplitude: Number = nan
    initial_amplitude_arcsec: Number = nan
    final_amplitude_arcsec: Number = nan
    fits: Mapping[str, Annotated[Fit, Beside("parameters")]] = field(default_factory=dict)
    surface_energy_j_per_m2: Annotated[Annotated[SurfaceEnergies, Beside("others")] | None, Section] = None
    problem: str = ""
    warnings: tuple[str, ...] = ()
    settings: JsonObject = field(default_factory=dict)
    calibration: JsonObject = field(default_factory=dict)
    pendulum: PendulumOnBall | None = None
    hertz: Annotated[Hertz | None, Section] = None
    drag: Annotated[Drag | None, Section] = None
    identifiability: tuple[Determination, ...] = ()
    strong_correlations: tuple[tuple[str, str, Number], ...] = ()
    budget: Mapping[str, Budget] = field(default_factory=dict)
    monte_carlo: Annotated[MonteCarlo | None, Section] = None
    work_per_cycle: tuple[Work, ...] = ()
    notes: tuple[str, ...] = ()
    instrument: Annotated[InstrumentResults | None, LeftOut] = None
    turning_points: StoredTurningPoints | None = None

    def half_cycles_text(self, unit: str, before_amplitudes: str = ", ") -> str:
        """`33 half-cycles, 123.24 to 101.09 arcsec`, or that there are none.

        `unit` is that of the record's deflections as shown, which files of schema 1 do not name.
        """
        if not self.half_cycles or not isfinite(self.initial_amplitude):
            return f"{self.half_cycles or 'no'} half-cycles"
        first, last = self.initial_amplitude, self.final_amplitude
        return f"{self.half_cycles} half-cycles{before_amplitudes}{first:.2f} to {last:.2f} {unit}"

    def verdicts(self) -> dict[str, Determination]:
        """By parameter, whether the data determine it."""
        return {item.name: item for item in self.identifiability}


@dataclass(frozen=True, slots=True, kw_only=True)
class CombinedParameter:
    """One parameter over the runs of a series: see `processing.fit.series.Combined`."""

    value: Number
    standard_uncertainty: Number
    expanded_uncertainty_95: Number = nan
    degrees_of_freedom: int = 0
    within_runs: Number = nan
    between_runs: Number = nan
    p_homogeneous: Number = nan
    runs: tuple[Value, ...] = ()


@dataclass(frozen=True, slots=True)
class Disagreement:
    """A run (counted from 1) that lies `deviation` standard uncertainties from what the others say."""

    run: int
    name: str
    deviation: Number


@dataclass(frozen=True, slots=True)
class AveragedCurves:
    """The paper's way: the runs' curves averaged, then Eqs. 5 and 6 fitted."""

    parameters: Annotated[Mapping[str, Value], Entries] = field(default_factory=dict)
    arae_decay: Number = nan
    arae_period: Number = nan


@dataclass(frozen=True, slots=True, kw_only=True)
class Series:
    """A series of runs: each fit's parameters combined, in `fits` by the fit's name."""

    runs: int = 0
    fits: Annotated[Mapping[str, Mapping[str, CombinedParameter]], Entries] = field(default_factory=dict)
    surface_energy_j_per_m2: Annotated[SurfaceEnergy | None, Section] = None
    budget: Mapping[str, Budget] = field(default_factory=dict)
    disagreements: tuple[Disagreement, ...] = ()
    averaged_curves: Annotated[Annotated[AveragedCurves, Beside("parameters")] | None, Section] = None
    problems: tuple[str, ...] = ()
    instrument: Annotated[InstrumentSeries | None, LeftOut] = None


@dataclass(frozen=True, slots=True, kw_only=True)
class SessionResults:
    """results.json of one or more records."""

    schema: int = SCHEMA
    runs: tuple[RunResults, ...]
    series: Annotated[Annotated[Series, Beside("fits")] | None, Section] = None


@dataclass(frozen=True, slots=True, kw_only=True)
class TableResults:
    """results.json of a table of positions of any instrument; amplitudes in its own `unit`."""

    schema: int = SCHEMA
    trajectory: str
    unit: str
    half_cycles: int
    initial_amplitude: Number
    final_amplitude: Number
    period_s: Value
    log_decrement: Value
    fits: Mapping[str, Annotated[Fit, Beside("parameters")]] = field(default_factory=dict)
    surface_energy_j_per_m2: Annotated[Annotated[SurfaceEnergies, Beside("others")] | None, Section] = None
    problem: str = ""

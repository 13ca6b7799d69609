"""Result of a fit: values, covariance, quality, changes during the run, warnings."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from enum import StrEnum
from math import nan
from typing import Annotated, Any

import numpy as np

from processing.arrays import Floats
from processing.contact import ContactParameters
from processing.contact.laws import AMPLITUDE, DRAG, PAPER, TIME, Law
from processing.errors import DataError
from processing.estimate import NOT_DETERMINED, Estimate, FitMethod
from processing.fit.evidence import NO_EVIDENCE, Evidence
from processing.fit.ground import Ground, GroundFit
from processing.least_squares import Loss
from processing.number_text import with_uncertainty
from processing.quantity import PLAIN, Quantity

MEASUREMENT = "swings"
"""Name of a fit's term: the measurement of the turning points, on ground at rest."""
FIXED_PATTERN = "position_errors"
"""Name of a fit's term: fixed-pattern position errors of the sensor that remain after their correction."""
DISCREPANCY = "discrepancy"
"""Name of a fit's term: the discrepancy of the law from the decay."""
FRICTION_STEP = "friction_step"
"""Name of a fit's term: steps of the friction during the run that are too small to be found."""
REST_POSITION = "rest_position"
"""Name of a fit's term: a rest position beside the middle of the contact."""
FITTED_DRIFTS = "drifts"
"""Name of a fit's term: drifts of contact, air and period that were fitted about zero."""
BOUNDARY_LAYER = "boundary_layer_drag"
"""Name of a fit's term: a boundary layer's drag, with the 3/2 power of the speed, that the data show."""

DISCREPANCY_SEEN = 10.0
"""Difference of -2 ln L from a law without errors above which a discrepancy is seen: chance about 0.3 %."""


@dataclass(frozen=True, slots=True, kw_only=True)
class DiscrepancySize:
    """Size of a law's discrepancy from a decay."""

    loss: float = 0.0
    """Relative standard deviation of the errors of the law's losses; 0 where they are not seen."""
    duration: float = 0.0
    """The same of its durations."""
    waveform: float = 0.0
    """The same of its harmonics."""
    against_law: float = 0.0
    """Increase of -2 ln L for the law without errors."""
    u_inflation: Annotated[Mapping[str, float], PLAIN] = field(default_factory=dict)
    """Factor by which the uncertainty of each parameter grew, by its name; empty where nothing is seen."""

    @property
    def seen(self) -> bool:
        return self.against_law > DISCREPANCY_SEEN


class ChangeKind(StrEnum):
    """Kind of a change during a run."""

    KNOCK = "knock"
    FRICTION = "friction"
    PERIOD = "period"


CLEAR_CHANGE_GAIN = 20.0
"""Gain in -2 ln L that a change must have beyond that of choosing among all half-cycles."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Change:
    """One change during a run."""

    kind: ChangeKind
    half_cycle: int
    """Index of the first half-cycle after it."""
    time_s: Annotated[float, Quantity("", "when it happened", unit="s")]
    """When it happened, on the clock of the turning points."""
    size: float
    """Relative size; that of a knock is relative to the amplitude, whatever its phase."""
    u_size: float
    gain: float
    """Fall of -2 ln L by the change."""

    @property
    def text(self) -> str:
        """The change in one line."""
        percent = with_uncertainty(100 * self.size, 100 * self.u_size, signed=True)
        event = {
            ChangeKind.KNOCK: f"a knock moves the swing by {percent.removeprefix('+')} % of its amplitude",
            ChangeKind.FRICTION: f"the friction changes by {percent} %: the contact slipped or was touched",
            ChangeKind.PERIOD: f"the period changes by {percent} %: something shifted",
        }[self.kind]
        return f"at half-cycle {self.half_cycle} ({self.time_s:.0f} s on the clock of the data) {event}"


SIGNIFICANT_CHANCE = 0.003
"""Significance level of a drag: the two-sided probability of three standard deviations."""


@dataclass(frozen=True, slots=True, kw_only=True)
class BoundaryLayerDrag:
    """A boundary layer's drag, moment ``-m g R coefficient |phi'|^0.5 phi'``, in addition to a fit's law."""

    coefficient: Annotated[Estimate, Quantity("drag 3/2", "drag with the 3/2 power", unit="s^1.5")] = (
        NOT_DETERMINED
    )
    p_value: float = nan
    """Probability of so large a value without it."""
    share: float = nan
    """Its loss over that of the linear drag at the first amplitude."""
    relative_shift_b: float = nan
    """Relative change of b with it."""
    shift_drag_s: float = nan
    """Change of the linear drag with it."""
    shift: Annotated[tuple[float, ...], PLAIN] = ()
    """Changes of all values of the fit with it, in their order."""

    @property
    def seen(self) -> bool:
        """Whether the data show it."""
        return self.p_value < SIGNIFICANT_CHANCE


CORRELATED = 0.001
"""Chance below which the residuals of amplitudes or times are called correlated."""


@dataclass(frozen=True, slots=True)
class Whiteness:
    """Test of Ljung and Box on the residuals of amplitudes and of times, in the order of the half-cycles."""

    lags: int = 0
    """Number of neighbours whose correlations are tested."""
    p_amplitude: float = nan
    """Chance of autocorrelations of the amplitudes' residuals at least as large in pure noise."""
    p_time: float = nan
    """The same of the times."""
    first_amplitude: float = nan
    """Correlation of next neighbours, of amplitudes."""
    first_time: float = nan
    """The same of times."""
    u_inflation: float = 1.0
    """Largest factor by which correlation enlarged a standard uncertainty of the fit."""

    @property
    def correlated(self) -> bool:
        return min(self.p_amplitude, self.p_time) < CORRELATED


@dataclass(frozen=True, kw_only=True)
class FitQuality:
    """Quality of one fit: how well it describes its decay, its findings and warnings."""

    mean_period_s: Annotated[Estimate, Quantity("T, mean", "mean period of the run")] = NOT_DETERMINED
    """Mean period of the run, from the times only, in the second of the camera. It is known even if T0, the
    period at vanishing amplitude, is too strongly correlated with n. The table of results has it with the
    uncertainty of the clock and of a period that changes."""
    arae_decay: Annotated[float, Quantity("ARAE (8)", "ARAE of the amplitudes, Eq. 8", "%")] = nan
    """Mean relative deviation of the amplitudes, Eq. 8, divided by the number of terms in the sum."""
    arae_period: Annotated[float, Quantity("ARAE (9)", "ARAE of the periods, Eq. 9", "%")] = nan
    """The same of the periods, Eq. 9."""
    chi2_per_dof: Annotated[float, Quantity("χ²/dof", "χ² per degree of freedom")] = nan
    """Of the unscaled residuals of amplitudes and times. For ground at rest the residuals are distances from
    the free decay; for a driven pendulum, from the predictions of a Kalman filter, and their uncertainties
    contain the drive."""
    degrees_of_freedom: Annotated[int, Quantity("dof", "degrees of freedom")] = 0
    bias: Mapping[str, float] | None = None
    """Parameters that Eqs. 5 and 6 give for the free decay of the exact fit, less those of this fit; None for
    the exact fit, or if it is not known."""
    ground: Ground | None = None
    """How strongly the ground drove the pendulum; None for a fit that does not estimate it."""
    whiteness: Whiteness | None = None
    discrepancy: DiscrepancySize | None = None
    """The law's discrepancy from the decay; None where it was not estimated."""
    changes: tuple[Change, ...] = ()
    """Events during the run: knocks, and steps of friction or period."""
    information_gain: Annotated[Mapping[str, Mapping[str, float]], PLAIN] = field(default_factory=dict)
    """Factors by which each uncertainty would be larger without the waveform, or without the prior of the
    air; empty where there is neither."""
    boundary_layer: BoundaryLayerDrag | None = None
    """Boundary layer's drag in addition to the fit; None where it was not estimated."""
    outliers: tuple[int, ...] = ()
    """Indices of half-cycles with a residual of amplitude or time above 5 standard uncertainties."""
    warnings: tuple[str, ...] = ()


@dataclass(frozen=True, kw_only=True)
class FitResult(FitQuality):
    """One fit of one decay."""

    method: FitMethod
    law: Law
    names: tuple[str, ...]
    """The law's parameters, ``drag_s`` if it was fitted, ``initial_amplitude_rad`` and, for the exact fit,
    ``start_time_s``, the time of the first turning point on the clock of the data."""
    values: Floats
    """In the order of `names`, in SI units."""
    covariance: Floats
    """It is multiplied by max(1, chi2/dof): enlarged if the residuals exceed the uncertainties, but not
    reduced if they are smaller."""
    reference_rad: float
    """Amplitude used as the unit in the fit. b reference^(p-1) and gamma reference^n are nearly normally
    distributed even if b and gamma are not."""
    by_log_rho: Floats
    """Derivative of `values` with respect to ln(R/a), which the exact fit takes as known; else NaN."""
    loss: Loss
    cost: float
    """Half of the sum of the loss function at the minimum (half of chi2 if linear)."""
    half_cycles: int = 0
    """Number of turning points fitted, counted from the first; 0 if it is not known."""
    ground: GroundFit | None = None
    u_inflation: Floats | None = None
    """Factor by which each standard uncertainty exceeds that by the likelihood; None where nothing did."""
    terms: Mapping[str, Floats] = field(default_factory=dict)
    """Named parts of the covariance: of each term the changes (values, m) of the values by one standard
    uncertainty of each of its m independent coordinates, infinite where nothing determines them. The rest of
    the covariance is by the drive of the ground."""
    evidence: Evidence = NO_EVIDENCE
    by_inputs: Mapping[str, Floats] = field(default_factory=dict)
    """Derivatives of the contact parameters, which come first, with respect to other inputs that the fit
    takes as known, by the names of `RigQuantities`: the row time of a shutter, an error of all amplitudes,
    drifts over a run."""

    @property
    def dof(self) -> int:
        return self.degrees_of_freedom

    @property
    def named_values(self) -> dict[str, float]:
        """Values by their names."""
        return dict(zip(self.names, self.values.tolist(), strict=True))

    @property
    def ground_fit(self) -> GroundFit:
        """`ground`, which every exact fit has; raises DataError for another fit."""
        if self.ground is None:
            raise DataError(f"the {self.method} fit does not estimate the drive of the ground")
        return self.ground

    @property
    def inflation(self) -> Floats:
        """`u_inflation`, 1 where nothing did."""
        return np.ones(len(self.names)) if self.u_inflation is None else self.u_inflation

    @property
    def scatter2(self) -> float:
        """Factor max(1, chi2/dof) of the covariance; 1 with a robust loss."""
        return max(1.0, self.chi2_per_dof) if self.loss == "linear" else 1.0

    @property
    def standard_uncertainty(self) -> Floats:
        return np.sqrt(np.diag(self.covariance))

    def covariance_by(self, *terms: str) -> Floats:
        """Covariance of the values by some terms; zeros where the fit has none of them."""
        covariance = np.zeros((len(self.names), len(self.names)))
        for changes in (self.terms[term] for term in terms if term in self.terms):
            undetermined = ~np.isfinite(changes.sum(axis=1))
            known = np.where(undetermined[:, None], 0.0, changes)
            covariance += known @ known.T
            covariance[undetermined, undetermined] = np.inf
        return covariance

    def with_term(self, name: str, changes: Floats, /, *warnings: str, **fields: Any) -> "FitResult":
        """The fit with one further term in covariance and `terms`; `fields` are those of `FitQuality` to set.

        `changes` are as in `terms`; a value that is not determined remains so.
        """
        if changes.shape[1] > len(self.names):
            # as many coordinates as there are values have the same covariance
            changes = np.asarray(np.linalg.qr(changes.T)[1].T, dtype=np.float64)
        known = np.isfinite(np.diag(self.covariance))
        added = np.where(np.outer(known, known), changes @ changes.T, 0.0)
        with np.errstate(invalid="ignore", divide="ignore"):
            factor = np.nan_to_num(np.sqrt(1.0 + np.diag(added) / self.standard_uncertainty**2), nan=1.0)
        return replace(
            self,
            covariance=self.covariance + added,
            u_inflation=self.inflation * factor,
            terms={**self.terms, name: changes},
            warnings=(*self.warnings, *warnings),
            **fields,
        )

    def with_terms_of(self, other: "FitResult", *terms: str) -> "FitResult":
        """This fit with some terms of another fit of the same law to the same points."""
        fit, rows = self, [other.names.index(name) for name in self.names if name in other.names]
        for term in terms:
            if term in other.terms:
                changes = np.zeros((len(self.names), other.terms[term].shape[1]))
                changes[[name in other.names for name in self.names]] = other.terms[term][rows]
                fit = fit.with_term(term, changes)
        return fit

    @property
    def correlation(self) -> Floats:
        """Correlation matrix; NaN in rows and columns of parameters that are not determined."""
        u = self.standard_uncertainty
        with np.errstate(invalid="ignore"):
            matrix = self.covariance / np.outer(u, u)
        matrix[np.diag_indices_from(matrix)] = 1.0
        return matrix

    @property
    def contact_names(self) -> tuple[str, ...]:
        """`names` without the initial amplitude and time, which describe the run."""
        return tuple(name for name in self.names if name not in (AMPLITUDE.key, TIME.key))

    @property
    def parameters(self) -> ContactParameters:
        """The values of the paper's law as one object; gamma is NaN without a calibration."""
        known = self.named_values
        return ContactParameters(
            **{name: known.get(name, nan) for name in PAPER.names()}, drag_s=known.get(DRAG.key, 0.0)
        )

    @property
    def has_drag(self) -> bool:
        return DRAG.key in self.names

    def estimate(self, name: str) -> Estimate:
        if name not in self.names:
            raise DataError(
                f"the {self.method} fit has no parameter {name!r}; it has {', '.join(self.names)}"
            )
        i = self.names.index(name)
        return Estimate(float(self.values[i]), float(np.sqrt(self.covariance[i, i])))

    def interval(self, name: str, coverage: float = 0.95) -> tuple[float, float]:
        """Confidence interval from the covariance and Student's t, symmetric in the logarithm for a positive
        value of a parameter marked `Parameter.logarithmic`."""
        from scipy.special import stdtrit

        value, u = self.estimate(name)
        k = float(stdtrit(self.dof, 0.5 * (1 + coverage)))
        if self.law.parameter(name).logarithmic and value > 0:
            factor = float(np.exp(min(k * u / value, 700.0)))
            return value / factor, value * factor
        return value - k * u, value + k * u

    def estimates(self) -> dict[str, Estimate]:
        return {name: self.estimate(name) for name in self.names}

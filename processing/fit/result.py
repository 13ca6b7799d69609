"""Result of a fit: values, covariance, goodness of fit, outliers, warnings."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from math import nan
from typing import Annotated

import numpy as np
from scipy.special import stdtrit

from processing.arrays import Floats
from processing.contact import ContactParameters
from processing.contact.laws import AMPLITUDE, DRAG, PAPER, TIME, Law
from processing.errors import DataError
from processing.estimate import NOT_DETERMINED, Estimate
from processing.fit.evidence import NO_EVIDENCE, Evidence
from processing.fit.ground import Ground, GroundFit
from processing.fit.law_errors import Change, Misfit
from processing.fit.steeper import SteeperDrag
from processing.fit.whiteness import Whiteness
from processing.fit_method import FitMethod
from processing.least_squares import Loss
from processing.quantity import PLAIN, Quantity


@dataclass(frozen=True, kw_only=True)
class FitQuality:
    """How well one fit describes its decay, and what is to be said of it.

    Attributes
    ----------
    mean_period_s
        Mean period of the run, from the times only. It is known even if T0, the period at vanishing
        amplitude, is too strongly correlated with n.
    arae_decay, arae_period
        Mean relative deviations of amplitude and period, Eqs. 8 and 9, divided by the number of terms in
        the sum.
    chi2_per_dof, degrees_of_freedom
        Of the unscaled residuals of amplitudes and times. For ground at rest the residuals are distances from
        the free decay; for a driven pendulum, from the predictions of a Kalman filter, and their
        uncertainties contain the drive.
    bias
        How far Eqs. 5 and 6 lie from the exact map where both describe one free decay, the exact fit's;
        None for the exact fit, or if it is not known.
    ground
        How strongly the ground drove the pendulum; None for a fit that does not ask.
    whiteness
        Test whether the residuals are correlated.
    misfit
        How far the law lies from the decay; None for a fit that does not ask.
    changes
        Events during the run after which something was another one.
    worth
        By how many times larger each uncertainty would be without the waveform, or without what is known of
        the air; empty where there is neither.
    steeper
        What the fit leaves of a drag with the 3/2 power of the speed; None where nobody asked.
    outliers
        Indices of half-cycles with a residual of amplitude or time above 5 standard uncertainties.
    warnings
        Warnings for the user.
    """

    mean_period_s: Annotated[Estimate, Quantity("T, mean", "mean period of the run")] = NOT_DETERMINED
    arae_decay: Annotated[float, Quantity("ARAE (8)", "ARAE of the amplitudes, Eq. 8", "%")] = nan
    arae_period: Annotated[float, Quantity("ARAE (9)", "ARAE of the periods, Eq. 9", "%")] = nan
    chi2_per_dof: Annotated[float, Quantity("χ²/dof", "χ² per degree of freedom")] = nan
    degrees_of_freedom: Annotated[int, Quantity("dof", "degrees of freedom")] = 0
    bias: Mapping[str, float] | None = None
    ground: Ground | None = None
    whiteness: Whiteness | None = None
    misfit: Misfit | None = None
    changes: tuple[Change, ...] = ()
    worth: Annotated[Mapping[str, Mapping[str, float]], PLAIN] = field(default_factory=dict)
    steeper: SteeperDrag | None = None
    outliers: tuple[int, ...] = ()
    warnings: tuple[str, ...] = ()


@dataclass(frozen=True, kw_only=True)
class FitResult(FitQuality):
    """One fit of one decay.

    Attributes
    ----------
    names
        The law's parameters, ``drag_s`` if it was fitted, ``initial_amplitude_rad`` and, for the exact fit,
        ``start_time_s``, the time of the first turning point on the clock of the data.
    values, covariance
        In the order of `names`, in SI units. The covariance is multiplied by max(1, chi2/dof): it is enlarged
        if the residuals exceed the uncertainties, but not reduced if they are smaller.
    reference_rad
        Amplitude used as the unit in the fit. b reference^(p-1) and gamma reference^n are nearly normally
        distributed even if b and gamma are not.
    by_log_rho
        Derivative of `values` by ln(R/a), which the fit takes as known.
    loss, cost
        The loss function, and half of its sum at the minimum (half of chi2 if linear).
    half_cycles
        Number of turning points fitted, counted from the first; 0 if it is not known.
    ground
        As `FitQuality` has it, with its likelihood.
    reading_covariance
        What the covariance would be on ground at rest: by the measurement of the turning points alone.
    widened
        By how many times every standard uncertainty is larger than the likelihood at the likeliest noise
        says: for noise that is not well known, and for correlated residuals. None: once.
    place_covariance
        Part of the covariance, and of `reading_covariance`, that errors of position fixed on the sensor
        leave; None where none were found.
    misfit_covariance
        Part of the covariance that the distance between law and data leaves; None where none is seen.
    change_covariance
        Part of it that a step of the friction during the run may leave; None where none was looked for.
    evidence
        What restrained the fit beside the turning points.
    by_air
        Change of the values for one standard uncertainty of what is known of the drag beside the decay, which
        the runs of a rig share; None where nothing is.
    """

    method: FitMethod
    law: Law
    names: tuple[str, ...]
    values: Floats
    covariance: Floats
    reference_rad: float
    by_log_rho: Floats
    loss: Loss
    cost: float
    half_cycles: int = 0
    ground: GroundFit | None = None
    reading_covariance: Floats | None = None
    widened: Floats | None = None
    place_covariance: Floats | None = None
    misfit_covariance: Floats | None = None
    change_covariance: Floats | None = None
    evidence: Evidence = NO_EVIDENCE
    by_air: Floats | None = None

    @property
    def dof(self) -> int:
        return self.degrees_of_freedom

    @property
    def standard_uncertainty(self) -> Floats:
        return np.sqrt(np.diag(self.covariance))

    @property
    def correlation(self) -> Floats:
        """Correlation matrix; NaN in rows and columns of parameters that are not determined."""
        u = self.standard_uncertainty
        with np.errstate(invalid="ignore"):
            matrix = self.covariance / np.outer(u, u)
        matrix[np.diag_indices_from(matrix)] = 1.0
        return matrix

    @property
    def calibrated(self) -> bool:
        """Whether the amplitudes are angles; if not, b and c refer to the amplitudes' unit."""
        return all(key in self.names for key in self.law.uncalibrated)

    @property
    def contact_names(self) -> tuple[str, ...]:
        """`names` without the initial amplitude and time, which describe the run."""
        return tuple(name for name in self.names if name not in (AMPLITUDE.key, TIME.key))

    @property
    def parameters(self) -> ContactParameters:
        """The values of the paper's law as one object; gamma is NaN without a calibration."""
        known = dict(zip(self.names, self.values.tolist(), strict=True))
        return ContactParameters(
            **{name: known.get(name, float("nan")) for name in PAPER.names()},
            drag_s=known.get(DRAG.key, 0.0),
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
        """Confidence interval from the covariance and Student's t.

        It is symmetric in the logarithm for a positive value of a parameter marked `Parameter.logarithmic`
        (b and gamma, whose units contain the exponents p and n). For poorly determined parameters
        `identifiability` uses the profile likelihood.
        """
        value, u = self.estimate(name)
        k = float(stdtrit(self.dof, 0.5 * (1 + coverage)))
        if self.law.parameter(name).logarithmic and value > 0:
            factor = float(np.exp(min(k * u / value, 700.0)))
            return value / factor, value * factor
        return value - k * u, value + k * u

    def estimates(self) -> dict[str, Estimate]:
        return {name: self.estimate(name) for name in self.names}

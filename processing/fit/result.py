"""What a fit hands on: values, uncertainties, correlations, residuals, doubts."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtrit

from processing.contact import ContactParameters
from processing.contact.laws import AMPLITUDE, DRAG, PAPER, TIME, Law
from processing.errors import DataError
from processing.estimate import Estimate
from processing.fit_method import FitMethod
from processing.least_squares import Loss


@dataclass(frozen=True)
class FitResult:
    """One fit of one decay.

    Attributes
    ----------
    names
        The law's parameters, ``drag_s`` where it was fitted, ``initial_amplitude_rad`` and, for
        the exact fit, ``start_time_s``: the first turning point on the clock of the data.
    values, covariance
        In that order, physical units. The covariance is scaled by max(1, chi2/dof): scatter
        beyond the stated uncertainties counts, luck does not.
    chi2, dof
        Of the unscaled residuals over both kinds of data.
    arae_decay, arae_period
        Mean relative deviations of amplitude and period, Eqs. 8 and 9 with the mean taken over
        as many terms as are summed.
    reference_rad
        Amplitude in whose units the fit was made: b reference^(p-1) and gamma reference^n are
        close to normally distributed even where b and gamma themselves are not.
    by_log_rho
        Derivative of `values` by ln(R/a), which the fit takes as known.
    mean_period_s
        Of the run, from the times alone: known even where T0, the period at vanishing amplitude,
        cannot be told from n.
    loss, cost
        The loss that was minimised, and half its sum at the minimum (half of chi2 if linear).
    outliers
        Half-cycles (by index) whose residual, in either kind, exceeds 5 standard uncertainties.
    warnings
        What a person should know before believing the numbers.
    """

    method: FitMethod
    law: Law
    names: tuple[str, ...]
    values: NDArray[np.float64]
    covariance: NDArray[np.float64]
    chi2: float
    dof: int
    arae_decay: float
    arae_period: float
    reference_rad: float
    by_log_rho: NDArray[np.float64]
    mean_period_s: Estimate
    loss: Loss
    cost: float
    outliers: tuple[int, ...]
    warnings: tuple[str, ...] = field(default=())

    @property
    def chi2_per_dof(self) -> float:
        return self.chi2 / self.dof

    @property
    def standard_uncertainty(self) -> NDArray[np.float64]:
        return np.sqrt(np.diag(self.covariance))

    @property
    def correlation(self) -> NDArray[np.float64]:
        """Correlation matrix; NaN in rows and columns of what is not determined."""
        u = self.standard_uncertainty
        with np.errstate(invalid="ignore"):
            matrix = self.covariance / np.outer(u, u)
        matrix[np.diag_indices_from(matrix)] = 1.0
        return matrix

    @property
    def calibrated(self) -> bool:
        """Whether amplitudes were angles; if not, b and c are in the amplitudes' unit."""
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
        """Interval of Student's t about the value, by the covariance alone.

        About the logarithm for a positive value of a parameter that says so (`Parameter.logarithmic`:
        b and gamma, in whose units the exponents p and n stand, whose scatter they inherit). Where a
        parameter is poorly determined, `identifiability` follows the likelihood itself.
        """
        value, u = self.estimate(name)
        k = float(stdtrit(self.dof, 0.5 * (1 + coverage)))
        if self.law.parameter(name).logarithmic and value > 0:
            factor = float(np.exp(min(k * u / value, 700.0)))
            return value / factor, value * factor
        return value - k * u, value + k * u

    def estimates(self) -> dict[str, Estimate]:
        return {name: self.estimate(name) for name in self.names}

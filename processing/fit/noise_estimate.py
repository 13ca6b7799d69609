"""Strength of the ground's drive of the pendulum, by the restricted likelihood of the turning points.

Two variances explain how far turning points lie from their predictions: the variance of their measurement
and that of the drive. They are estimated by the restricted likelihood, that of the residuals of a fit. The
likelihood of the turning points themselves would make them too small, since the fitted parameters take up
part of the scatter.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from processing.arrays import Floats
from processing.fit.exact_model import ExactModel, FilterResult
from processing.fit.exact_result import OUTLIER
from processing.fit.ground import Noise
from processing.least_squares import Loss

_FIRST_LOG_STEPS = np.arange(-3.0, 3.01, 0.5)
"""Decimal logarithms of the steps of the drive tried first, over the amplitudes' median uncertainty."""
_MAX_STEP_FRACTION = 0.2
"""Largest step tried, as a fraction of the lowest amplitude."""
_LOWEST_LOG_STEP, _LOG_STEP_SPACING = -2.0, 0.1
"""Lowest step and spacing of the steps over which a covariance is averaged, as in `_FIRST_LOG_STEPS`."""
_PRIOR_EXPONENT = 0.7
"""The prior density of a step falls with this power of the step."""
_MAX_U_KNOWN_STEP = 0.15
"""Relative uncertainty of the step below which it is taken as known."""
_RISE_AT_ONE_SIDED_95 = 2.706
"""Rise of -2 ln L at a bound of 95 %: the square of the normal quantile 1.645."""
_STATED_WEIGHT = 25.0
"""Weight of the stated uncertainties against a larger scale, as a number of residuals that agree with them.

In a short run a larger scale and a drive explain a scatter equally well, but only the drive enlarges the
uncertainties of the parameters."""
_SCALE_TOLERANCE = 1e-3
"""Relative change of the squared scale below which its iteration ends."""
_MIN_EIGENVALUE = 1e-13
"""Smallest eigenvalue of a matrix of unit diagonal; sums over thousands of half-cycles are rounded by as
much."""


class LikeliestNoise(NamedTuple):
    """The likeliest noise at given coordinates of the fit."""

    noise: Noise
    deviance: float
    """-2 ln L by the restricted likelihood."""
    against_rest: float = 0.0
    """Deviance of ground at rest minus this one."""
    covariance: Floats | None = None
    """Covariance of the coordinates with this noise."""
    unrestricted: float = np.inf
    """-2 ln L by the turning points themselves."""


class NoiseBounds(NamedTuple):
    """Standard uncertainty of the step and its bound of 95 %, in units of the reference."""

    u_step: float
    highest_step: float


class NoiseSearch:
    """Maximises the restricted likelihood over the drive and the scale of the stated uncertainties.

    The model is linear about the given `coordinates`; the caller repeats fit and search until neither
    changes. Every noise tried has the `averaged` and `limit` of `kind`. The scale is at least 1; with a
    robust loss, which copes with outliers by itself, it is 1.
    """

    def __init__(self, model: ExactModel, coordinates: Floats, loss: Loss, kind: Noise) -> None:
        self._model, self._coordinates, self._loss, self._kind = model, coordinates, loss, kind
        self._unit = float(np.median(model.u_amplitude))
        self._evidence_rows = model.evidence_rows(coordinates)
        self._highest = float(np.log10(_MAX_STEP_FRACTION * model.lowest / self._unit))
        self._known: dict[float, LikeliestNoise] = {}
        self._rest = self._evaluated(-np.inf)

    def likeliest(self) -> LikeliestNoise:
        """The optimum over all steps."""
        driven = self._evaluated(self._minimum_of(self._deviance))
        likeliest = driven if driven.deviance < self._rest.deviance else self._rest
        return likeliest._replace(against_rest=self._rest.deviance - likeliest.deviance)

    def least_unrestricted(self) -> float:
        """Least -2 ln L by the turning points themselves, over all noises.

        The restricted likelihood prefers another noise, with which laws must not be compared: a law for which
        it estimates some drive where there is none would lose against a simpler law with none.
        """
        log_step = self._minimum_of(self._unrestricted)
        return min(self._rest.unrestricted, self._unrestricted(log_step))

    def _minimum_of(self, function: Callable[[float], float]) -> float:
        """Decimal logarithm of the step, over its unit, at which a function of it is least."""
        tried = [*_FIRST_LOG_STEPS[self._highest > _FIRST_LOG_STEPS].tolist(), self._highest]
        best = int(np.argmin([function(log_step) for log_step in tried]))
        return _minimum_between(function, tried[max(best - 1, 0)], tried[min(best + 1, len(tried) - 1)])

    def bounds(self, likeliest: LikeliestNoise) -> NoiseBounds:
        """Uncertainty and bound of the step, by the rise of -2 ln L on either side of the optimum."""
        at_rest = likeliest.noise.at_rest
        start = float(_FIRST_LOG_STEPS[0])
        if not at_rest:
            start = float(np.log10(likeliest.noise.step / likeliest.noise.scale / self._unit))
        target = likeliest.deviance + _RISE_AT_ONE_SIDED_95
        above = start
        while self._deviance(above + 0.25) < target and above < self._highest:
            above += 0.25
        above = _crossing(lambda log_step: self._deviance(log_step) - target, above, above + 0.25)
        highest = self._evaluated(above).noise.step
        if at_rest:
            # half of a normal distribution about zero that has this bound
            return NoiseBounds(highest / 1.96, highest)
        h = 0.05
        curvature = self._deviance(start + h) - 2 * likeliest.deviance + self._deviance(start - h)
        relative = np.sqrt(2 / curvature) * h * np.log(10) if curvature > 0 else np.inf
        # where the likelihood hardly falls towards a step of zero, the curvature says less than the bound
        return NoiseBounds(min(float(likeliest.noise.step * relative), highest), highest)

    def averaged_covariance(self, likeliest: LikeliestNoise, bounds: NoiseBounds) -> Floats | None:
        """Covariance of the coordinates, averaged over the steps that the data allow; None for a known step.

        Uncertainties grow with the step. The likeliest step makes them too small where ground at rest is not
        improbable: one weak drive in three is estimated as zero. The weight of a step is its likelihood times
        a prior density that falls as step^-0.7: drives may be of any order of magnitude, and with this
        exponent intervals come nearest to their coverage at rest and at weak drives together. With an
        auxiliary seismometer, steps below the least that it leaves unexplained are left out.
        """
        known = self._model.known_drive
        least = 0.0 if known is None else known.least_unexplained(self._coordinates)
        if bounds.u_step < _MAX_U_KNOWN_STEP * likeliest.noise.step and likeliest.noise.step > least:
            return None
        lowest, spacing = _LOWEST_LOG_STEP, _LOG_STEP_SPACING
        if least:
            log_least = float(np.log10(least / likeliest.noise.scale / self._unit))
            lowest = min(max(lowest, log_least), self._highest)
        bound = bounds.highest_step / likeliest.noise.scale / self._unit
        above = float(np.log10(max(bound, 10 * 10**_LOWEST_LOG_STEP)))
        tried = np.arange(lowest, max(min(above + 0.5, self._highest), lowest + spacing), spacing)
        noises = [self._evaluated(log_step) for log_step in tried.tolist()]
        steps = 10.0**tried
        mass = steps ** (1 - _PRIOR_EXPONENT) * spacing * np.log(10)
        if not least:
            mass[0] += steps[0] ** (1 - _PRIOR_EXPONENT) / (1 - _PRIOR_EXPONENT)
        deviance = np.array([noise.deviance for noise in noises])
        weight = mass * np.exp(-0.5 * (deviance - np.min(deviance)))
        weight /= np.sum(weight)
        covariance = np.zeros((len(self._coordinates), len(self._coordinates)))
        for noise, share in zip(noises, weight.tolist(), strict=True):
            if noise.covariance is not None:
                covariance += share * noise.covariance
        return covariance

    def _deviance(self, log_step: float) -> float:
        return self._evaluated(log_step).deviance

    def _unrestricted(self, log_step: float) -> float:
        return self._evaluated(log_step).unrestricted

    def _evaluated(self, log_step: float) -> LikeliestNoise:
        if log_step not in self._known:
            self._known[log_step] = self._evaluate(10.0**log_step * self._unit)
        return self._known[log_step]

    def _evaluate(self, ratio: float) -> LikeliestNoise:
        """The likeliest noise whose step is `ratio` times its scale; the scale follows in closed form."""
        filtered = self._model.filtered(self._coordinates, replace(self._kind, step=ratio))
        if not np.all(np.isfinite(filtered.residuals)):
            return LikeliestNoise(self._kind, np.inf)
        scale2 = 1.0
        while True:
            likeliest = self._with_scale(filtered, ratio, scale2)
            last_scale2, scale2 = scale2, likeliest.noise.scale**2
            # with evidence, which does not scatter with the turning points, the scale takes some rounds
            if not len(self._evidence_rows[0]) or abs(scale2 - last_scale2) < _SCALE_TOLERANCE * scale2:
                return likeliest

    def _with_scale(self, filtered: FilterResult, ratio: float, weight: float) -> LikeliestNoise:
        """The noise with this ratio; the evidence is weighted for a squared scale `weight` of the points."""
        evidence, evidence_jacobian = (np.sqrt(weight) * rows for rows in self._evidence_rows)
        residuals = np.concatenate([filtered.residuals, evidence])
        jacobian = np.concatenate([filtered.jacobian, evidence_jacobian])
        linear = self._loss == "linear"
        is_used = np.ones(len(residuals), dtype=np.bool_) if linear else np.abs(residuals) < OUTLIER
        # Sums instead of a factorisation: threads of linear algebra cost more than they save for so few
        # coordinates, which are chosen so that they hardly depend on one another.
        weighted = jacobian * is_used[:, None]
        information = np.einsum("ij,ik->jk", weighted, jacobian)
        norm = np.sqrt(np.diag(information))
        norm[norm == 0] = 1.0
        eigenvalues, vectors = np.linalg.eigh(information / np.outer(norm, norm))
        eigenvalues = np.maximum(eigenvalues, _MIN_EIGENVALUE)
        score = np.einsum("ij,i->j", weighted, residuals) / norm
        unexplained = residuals - jacobian @ ((vectors / eigenvalues) @ (vectors.T @ score) / norm)
        count = len(filtered.residuals)
        chi2, evidence_chi2 = (
            float(np.sum(unexplained[rows][is_used[rows]] ** 2))
            + OUTLIER**2 * float(np.count_nonzero(~is_used[rows]))
            for rows in (slice(count), slice(count, None))
        )
        scale2 = max(1.0, chi2 / (count - len(self._coordinates) + _STATED_WEIGHT)) if linear else 1.0
        log_information = float(np.sum(np.log(eigenvalues)) + 2 * np.sum(np.log(norm)))
        unrestricted = chi2 / scale2 + evidence_chi2 / weight + count * np.log(scale2) + filtered.log_det
        deviance = unrestricted - (len(self._coordinates) - _STATED_WEIGHT) * np.log(scale2) + log_information
        scale = float(np.sqrt(scale2))
        noise = replace(self._kind, step=ratio * scale, scale=scale)
        covariance = scale2 * ((vectors / eigenvalues) @ vectors.T) / np.outer(norm, norm)
        return LikeliestNoise(noise, float(deviance), covariance=covariance, unrestricted=float(unrestricted))


def _minimum_between(function: Callable[[float], float], low: float, high: float) -> float:
    """Argument of the minimum between two points, by golden sections."""
    ratio = 0.5 * (np.sqrt(5) - 1)
    left, right = high - ratio * (high - low), low + ratio * (high - low)
    while high - low > 3e-3:
        if function(left) < function(right):
            high, right = right, left
            left = high - ratio * (high - low)
        else:
            low, left = left, right
            right = low + ratio * (high - low)
    return float(left if function(left) < function(right) else right)


def _crossing(function: Callable[[float], float], low: float, high: float) -> float:
    """Zero of a function that rises from negative values, by halving the interval."""
    for _ in range(8):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if function(middle) < 0 else (low, middle)
    return 0.5 * (low + high)

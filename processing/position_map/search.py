"""Search for an error of position that is fixed on the sensor, in the residuals of whole cycles.

The residuals r of cycle c are ``B theta + J l_c + K s + noise``: splines B of the place with the same theta
in all cycles, derivatives J of the motion by the parameters l_c of each cycle, and K by the parameters s that
all cycles have in common, frequency and shape. l_c and s are free. An error that goes with the phase of the
motion at all amplitudes is thus ascribed to the motion; one that stays at a place while the amplitude falls,
and is passed in both directions, to the sensor. theta is a Gaussian process with the variance and correlation
length that make the residuals most likely.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from processing.arrays import Floats
from processing.position_map.fixed_pattern import PositionMap, Splines
from processing.swing import SHARED_PARAMETERS, CycleResiduals

_BATCH_CYCLES = 8
"""Number of cycles whose columns are multiplied together."""


_SPLINES = 320
"""Number of splines; the shortest correlation length is 2.5 of their spacings."""
_LENGTHS = (0.25, 0.125, 0.0625, 0.032, 0.016, 0.008)
"""Correlation lengths that are tried, as fractions of the range."""
_MIN_GROUPS = 8
_SAMPLED_CYCLES = 24
"""Number of cycles whose residuals are stored, to measure their scatter about a common error."""
_MAX_GROUPS = 64
"""About the largest number of groups of neighbouring cycles whose scores are summed."""
_CROSS_VALIDATION_PARTS = 10
"""Number of parts of the run, each of which is predicted by the others."""
_MIN_CONFIRMED_FRACTION = 0.8
"""Smallest fraction of the parts that must be described better with the map of the others."""
_MIN_RELATIVE_INFORMATION = 1e-9
"""Smallest information of the cycles about a component of the error, relative to the largest."""
SIGNIFICANT = 12.0
"""Score in its standard deviations above which the error is accepted.

Noise gives such a score with a probability of 2e-5 for each correlation length, if the error has a single
degree of freedom, in which case the score scatters most."""


class NormalEquations(NamedTuple):
    """Normal equations of the splines, then of the common columns."""

    information: Floats
    """``J^T W J``."""
    score: Floats
    """``J^T W r``."""

    def spline_equations(self, scale: float = 1.0) -> "NormalEquations":
        """Equations of the splines with the common columns free; `scale` is the variance of the residuals."""
        gain = self.common_gain()
        return NormalEquations(
            (self.information[:_SPLINES, :_SPLINES] - gain @ self.information[_SPLINES:, :_SPLINES]) / scale,
            (self.score[:_SPLINES] - gain @ self.score[_SPLINES:]) / scale,
        )

    def common_gain(self) -> Floats:
        """Gain (splines, SHARED_PARAMETERS) of the splines' score by the score of the free common columns."""
        return np.asarray(self.information[:_SPLINES, _SPLINES:] @ self._inverse())

    def complete(self, coefficients: Floats) -> Floats:
        """Coefficients of the splines, followed by the likeliest ones of the common columns given these."""
        score = self.score[_SPLINES:] - self.information[_SPLINES:, :_SPLINES] @ coefficients
        return np.concatenate([coefficients, self._inverse() @ score])

    def explained(self, coefficients: Floats) -> float:
        """Reduction of chi-square by the coefficients of all columns."""
        return float(2.0 * coefficients @ self.score - coefficients @ self.information @ coefficients)

    def _inverse(self) -> Floats:
        common = self.information[_SPLINES:, _SPLINES:]
        scale = 1.0 / np.sqrt(np.maximum(np.diag(common), 1e-300))
        inverse = np.linalg.pinv(common * np.outer(scale, scale), rcond=1e-10, hermitian=True)
        return np.asarray(inverse * np.outer(scale, scale), dtype=np.float64)


def sum_equations(parts: Sequence[NormalEquations]) -> NormalEquations:
    """Sum of one or more normal equations."""
    return NormalEquations(
        np.asarray(sum(part.information for part in parts)), np.asarray(sum(part.score for part in parts))
    )


class Accumulator:
    """Normal equations summed over `cycles` so far, with the parameters of each cycle free.

    The products of the splines are a band matrix, from which each cycle's free parameters take a few columns:
    the large matrix is not computed for every cycle.
    """

    def __init__(self, splines: Splines) -> None:
        self.cycles = 0
        self._splines = splines
        self._band = np.zeros((4, splines.count))
        self._mixed_products = np.zeros((splines.count, SHARED_PARAMETERS))
        self._common = np.zeros((SHARED_PARAMETERS, SHARED_PARAMETERS))
        self._own_columns: list[Floats] = []
        self._own_products = np.zeros((splines.count, splines.count))
        self._score = np.zeros(splines.count + SHARED_PARAMETERS)

    def add(self, cycle: CycleResiduals) -> Floats:
        """Add one cycle and return its score."""
        from scipy.sparse import csr_array

        self.cycles += 1
        root = np.sqrt(cycle.weight)
        own = cycle.cycle_derivatives * root[:, None]
        own /= np.maximum(np.sqrt(np.sum(own**2, axis=0)), 1e-300)
        directions, size, _ = np.linalg.svd(own, full_matrices=False)
        directions = directions[:, size > 1e-6 * size[0]]
        columns = np.column_stack([cycle.shared_derivatives, cycle.residual]) * root[:, None]
        columns -= directions @ (directions.T @ columns)
        first, values = self._splines.four_values(cycle.deflection)
        values *= root[:, None]
        count, splines = len(root), self._splines.count
        basis = csr_array(
            (values.ravel(), (first[:, None] + np.arange(4)).ravel(), np.arange(0, 4 * count + 1, 4)),
            shape=(count, splines),
        )
        products = basis.T @ np.column_stack([directions, columns])
        for distance in range(4):
            for j in range(4 - distance):
                band = values[:, j] * values[:, j + distance]
                self._band[distance] += np.bincount(first + j, band, minlength=splines)
        own_count = directions.shape[1]
        self._own_columns.append(products[:, :own_count])
        self._mixed_products += products[:, own_count:-1]
        self._common += columns[:, :-1].T @ columns[:, :-1]
        score = np.concatenate([products[:, -1], columns[:, :-1].T @ columns[:, -1]])
        self._score += score
        if len(self._own_columns) == _BATCH_CYCLES:
            self._add_own_products()
        return score

    def sums(self) -> NormalEquations:
        """Normal equations of all cycles so far."""
        splines = self._splines.count
        information = np.zeros((splines + SHARED_PARAMETERS, splines + SHARED_PARAMETERS))
        for distance in range(4):
            rows = np.arange(splines - distance)
            information[rows, rows + distance] = information[rows + distance, rows] = self._band[
                distance, : splines - distance
            ]
        self._add_own_products()
        information[:splines, :splines] -= self._own_products
        information[:splines, splines:] = self._mixed_products
        information[splines:, :splines] = self._mixed_products.T
        information[splines:, splines:] = self._common
        return NormalEquations(information, self._score)

    def _add_own_products(self) -> None:
        if self._own_columns:
            columns = np.column_stack(self._own_columns)
            self._own_columns.clear()
            self._own_products += columns @ columns.T


class _LikelihoodPeak(NamedTuple):
    """Most likely error for a correlation length."""

    gain: float
    """Log likelihood relative to that of no error."""
    length: float
    coefficients: Floats
    covariance: Floats


class PositionMapSearch:
    """Collection of the cycles of a run, and test whether they share a fixed-pattern position error.

    Parameters
    ----------
    low, high
        Smallest and largest deflection of the run.
    cycles
        Approximate number of cycles that will be added.
    """

    def __init__(self, low: float, high: float, cycles: int) -> None:
        self._splines = Splines.over(low, high, _SPLINES)
        self._parts = [Accumulator(self._splines) for _ in range(_CROSS_VALIDATION_PARTS)]
        self._expected_cycles = max(cycles, 1)
        self._group_size = max(1, math.ceil(cycles / _MAX_GROUPS))
        self._sample_interval = max(1, math.ceil(cycles / _SAMPLED_CYCLES))
        self._scores: list[Floats] = []
        self._sampled_cycles: list[CycleResiduals] = []
        self._cycles = 0

    def add(self, cycle: CycleResiduals) -> None:
        """Add the residuals of one cycle."""
        part = _CROSS_VALIDATION_PARTS * self._cycles // self._expected_cycles
        score = self._parts[min(part, _CROSS_VALIDATION_PARTS - 1)].add(cycle)
        if self._cycles % self._group_size == 0:
            self._scores.append(score)
        else:
            self._scores[-1] = self._scores[-1] + score
        if self._cycles % self._sample_interval == 0:
            self._sampled_cycles.append(cycle)
        self._cycles += 1

    def position_map(self) -> PositionMap | None:
        """Map of the error; None if it is not significant, or not confirmed by the parts of the run."""
        if len(self._scores) < _MIN_GROUPS:
            return None
        parts = [part.sums() for part in self._parts if part.cycles]
        total = sum_equations(parts)
        scores = np.array(self._scores)
        scores = scores[:, :_SPLINES] - scores[:, _SPLINES:] @ total.common_gain().T
        significance = max(_significance(self._prior(length), scores) for length in _LENGTHS)
        if not significance > SIGNIFICANT:
            return None
        scale, lengths = 1.0, _LENGTHS
        for _ in range(2):
            peaks = (
                _likeliest(length, self._prior(length), total.spline_equations(scale)) for length in lengths
            )
            best = max(peaks, key=lambda peak: peak.gain)
            scale = self._scatter(best, total)
        best = _likeliest(best.length, self._prior(best.length), total.spline_equations(scale))
        if not self._is_confirmed(parts, best.length, scale):
            return None
        return PositionMap(
            splines=self._splines,
            coefficients=best.coefficients,
            covariance=best.covariance + self._scale_covariance(best.coefficients),
            correlation_length=best.length * self._splines.spacing * (_SPLINES - 3),
            significance=significance,
            cycles=self._cycles,
            noise_scale=math.sqrt(scale),
        )

    def _scale_covariance(self, coefficients: Floats) -> Floats:
        """Covariance by an unknown error of scale, whose size is taken from that of the position errors.

        Smooth errors of a given correlation length have hardly any mean slope, but a nonlinear scale has one.
        """
        place = self._splines.centres - self._splines.centres.mean()
        error = self._splines.matrix(self._splines.centres[1:-1]) @ coefficients
        # splines whose coefficients equal their centres add up to a straight line
        u_scale = float(np.std(error) / np.std(place[1:-1]))
        return np.asarray(u_scale**2 * np.outer(place, place), dtype=np.float64)

    def _is_confirmed(self, parts: Sequence[NormalEquations], length: float, scale: float) -> bool:
        """Whether the parts of the run are described better with the map of the others than without one.

        Residuals from another motion are alike in neighbouring cycles, but not over the whole run.
        """
        gains = []
        for part in parts:
            others = sum_equations([other for other in parts if other is not part])
            predicted = _likeliest(length, self._prior(length), others.spline_equations(scale)).coefficients
            gains.append(
                part.explained(others.complete(predicted))
                - part.explained(others.complete(np.zeros(_SPLINES)))
            )
        gain = np.array(gains)
        return bool(gain.sum() > 0.0 and np.mean(gain > 0.0) >= _MIN_CONFIRMED_FRACTION)

    def _prior(self, length: float) -> Floats:
        """Correlation matrix of the coefficients for a correlation length, a fraction of the range."""
        from scipy.linalg import toeplitz

        step = np.arange(_SPLINES) / ((_SPLINES - 3) * length)
        return np.asarray(toeplitz(np.exp(-0.5 * step**2)), dtype=np.float64)

    def _scatter(self, peak: _LikelihoodPeak, total: NormalEquations) -> float:
        """Variance of the cycles' scores about the common error, relative to the samples' uncertainties.

        It is taken in the directions of the prior, in which disturbances of neighbouring samples count fully.
        """
        coefficients = total.complete(peak.coefficients)
        prior, power, expected = self._prior(peak.length), 0.0, 0.0
        for cycle in self._sampled_cycles:
            single = Accumulator(self._splines)
            single.add(cycle)
            sums = single.sums()
            residual = (sums.score - sums.information @ coefficients)[:_SPLINES]
            power += float(residual @ prior @ residual)
            expected += float(np.sum(prior * sums.information[:_SPLINES, :_SPLINES]))
        return power / expected


def _significance(prior: Floats, scores: Floats) -> float:
    """Score for an error common to all cycles, in its standard deviations for independent cycles.

    With the sum g of the scores, their covariance S and the prior C it is ``(g.C g - tr CS) / sqrt(2 tr
    CSCS)``. Second differences of the scores have six times S, and a common error drops out of them.
    """
    difference = scores[:-2] - 2.0 * scores[1:-1] + scores[2:]
    scale = len(scores) / (6.0 * len(difference))
    total = scores.sum(axis=0)
    products = scale * difference @ prior @ difference.T
    spread = math.sqrt(2.0 * float(np.sum(products**2)))
    return float((total @ prior @ total - np.trace(products)) / spread) if spread > 0.0 else 0.0


def _likeliest(length: float, prior: Floats, sums: NormalEquations) -> _LikelihoodPeak:
    """Error with the variance that makes the residuals most likely, for one correlation length.

    With the prior ``v C = v A A^T`` and ``A^T N A = Q L Q^T``, ``h = Q^T A^T g``: twice the logarithm of the
    likelihood is ``sum h^2 v/(1 + v L) - ln(1 + v L)``.
    """
    information, score = sums
    variance, directions = np.linalg.eigh(prior)
    significant = variance > 1e-9 * variance[-1]
    root = directions[:, significant] * np.sqrt(variance[significant])
    size, rotation = np.linalg.eigh(root.T @ information @ root)
    basis = root @ rotation
    # components below this have no information except by rounding errors
    has_information = size > _MIN_RELATIVE_INFORMATION * size[-1]
    size = np.where(has_information, size, 0.0)
    projected = np.where(has_information, basis.T @ score, 0.0)

    def gain(log_v: float) -> float:
        v = math.exp(log_v)
        return float(np.sum(projected**2 * v / (1.0 + v * size) - np.log1p(v * size)))

    # variances from far below what all cycles could show to far above any real one
    log_variances = (-math.log(float(size.max())) + np.arange(-5.0, 30.0, 0.25)).tolist()
    log_v = max(log_variances, key=gain)
    v = math.exp(log_v)
    weight = v / (1.0 + v * size)
    coefficients = basis @ (weight * projected)
    return _LikelihoodPeak(0.5 * gain(log_v), length, coefficients, (basis * weight) @ basis.T)

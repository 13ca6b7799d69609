"""Fixed-pattern position error as a function of the true deflection (the place), with its covariance."""

import math
from dataclasses import dataclass, replace

import numpy as np

from processing.arrays import Floats, Ints
from processing.deflections import Deflections
from processing.least_squares import FactoredJacobian


@dataclass(frozen=True, slots=True)
class Splines:
    """Set of cubic B-splines with equal distances."""

    low: float
    """Centre of the second spline; that of the first one is outside the range."""
    spacing: float
    count: int

    @classmethod
    def over(cls, low: float, high: float, count: int) -> "Splines":
        """Set of `count` splines from `low` to `high`."""
        return cls(low, (high - low) / (count - 3), count)

    @property
    def centres(self) -> Floats:
        """Places (count,) at which the splines are largest."""
        return np.asarray(self.low + self.spacing * (np.arange(self.count) - 1.0), dtype=np.float64)

    def four_values(self, place: Floats) -> tuple[Ints, Floats]:
        """Index of the first of the four splines at each place (n,), and the values (n, 4) of the four.

        Places outside are moved to the nearest end.
        """
        x = np.clip((place - self.low) / self.spacing, 0.0, self.count - 3.0)
        first = np.minimum(x.astype(np.int64), self.count - 4)
        f = x - first
        g = 1.0 - f
        values = np.stack([g**3, 3.0 * f**3 - 6.0 * f**2 + 4.0, 3.0 * g**3 - 6.0 * g**2 + 4.0, f**3], axis=-1)
        return first, values / 6.0

    def matrix(self, place: Floats) -> Floats:
        """Values (n, count) of all splines."""
        first, values = self.four_values(place)
        out = np.zeros((len(place), self.count))
        out[np.arange(len(place))[:, None], first[:, None] + np.arange(4)] = values
        return out


_PLACE_ITERATIONS = 4
"""Iterations for the true place: each reduces its error by the slope of the map, a few per cent."""
_PHASES = 512
"""Number of phases of an integral over a cycle. The errors of amplitudes differ by 2.6e-6 of themselves from
those with 16,384 phases, at any correlation length."""


@dataclass(frozen=True)
class PositionMap:
    """Error of the measured deflection at every place of the range that a run swept."""

    splines: Splines
    """Splines of the place, which is a true deflection in the unit of the measured ones."""
    coefficients: Floats
    """Most likely coefficients of the splines (count,)."""
    covariance: Floats
    """A constant error, which no free swing shows, is as uncertain as errors of this size and correlation
    length allow; an error of scale is as uncertain as the size of the errors."""
    correlation_length: float
    """Distance over which the error changes, in the unit of the deflections."""
    significance: float
    """Score of the error in its standard deviations (see `search.SIGNIFICANT`)."""
    cycles: int
    """Number of cycles from which the map follows."""
    noise_scale: float
    """Scatter of the residuals of whole cycles, relative to their samples' uncertainties."""

    def error(self, place: Floats) -> Floats:
        """Error (n,) at true deflections `place`; 0 where they are NaN."""
        error = np.zeros(len(place))
        good = np.isfinite(place)
        first, values = self.splines.four_values(place[good])
        error[good] = sum(values[:, k] * self.coefficients[first + k] for k in range(4))
        return error

    def u_error(self, place: Floats) -> Floats:
        """Standard uncertainties (n,) of `error` except for an undetermined constant and scale."""
        matrix = self.splines.matrix(place)
        trend = np.column_stack([np.ones(len(place)), place - place.mean()])
        matrix = FactoredJacobian(trend).residual(matrix)
        variance = np.einsum("ij,jk,ik->i", matrix, self.covariance, matrix)
        return np.asarray(np.sqrt(np.maximum(variance, 0.0)), dtype=np.float64)

    def corrected(self, deflections: Deflections) -> Deflections:
        """Deflections without the error."""
        place = deflections.y
        for _ in range(_PLACE_ITERATIONS):
            place = deflections.y - self.error(place)
        return replace(deflections, y=place)

    @property
    def limits(self) -> tuple[float, float]:
        """Smallest and largest place."""
        return self.splines.low, self.splines.low + self.splines.spacing * (self.splines.count - 3)

    def plus(self, other: "PositionMap") -> "PositionMap":
        """Sum of this map and another one over the same range, of deflections corrected by this one."""
        return replace(self, coefficients=self.coefficients + other.coefficients)

    def amplitude_errors(self, amplitude: Floats, centre: Floats, side: Floats) -> Floats:
        """Errors of n amplitudes by the map's covariance, as independent columns (n, m).

        ``errors @ errors.T`` is the amplitudes' covariance. A half-cycle is fitted to all of its samples, its
        rest position to whole cycles: with the place x = centre + side A cos s and the splines B(x), its
        amplitude moves by ``2/pi`` times the integral of ``side (B - mean of B over the cycle) cos s`` over
        the half-cycle. The time of the turning point does not move: an error that depends on the place alone
        is the same before and after it.
        """
        cosine = np.cos((np.arange(_PHASES) + 0.5) * (2.0 * math.pi / _PHASES))
        in_half_cycle = cosine > 0.0
        gain = np.empty((len(amplitude), self.splines.count))
        for k in range(len(amplitude)):
            values = self.splines.matrix(centre[k] + side[k] * amplitude[k] * cosine)
            values[in_half_cycle] -= values.mean(axis=0)
            gain[k] = (side[k] * 4.0 / _PHASES) * (cosine[in_half_cycle] @ values[in_half_cycle])
        return np.asarray(gain @ self._root(), dtype=np.float64)

    def adjusted(self, values: Floats, covariance: Floats) -> "PositionMap":
        """Map updated by a fit of the coordinates of the columns that `amplitude_errors` returned.

        `values` (m,) and `covariance` (m, m) are the fitted ones; before the fit they are 0 and 1.
        """
        root = self._root()
        return replace(
            self,
            coefficients=self.coefficients + root @ values,
            covariance=root @ covariance @ root.T,
        )

    def _root(self) -> Floats:
        variance, directions = np.linalg.eigh(self.covariance)
        return np.asarray(directions * np.sqrt(np.maximum(variance, 0.0)), dtype=np.float64)

"""Error of position as a function of place, with its covariance."""

import math
from dataclasses import dataclass, replace

import numpy as np

from processing.arrays import Floats, Ints
from processing.deflections import Deflections
from processing.least_squares import FactoredJacobian


@dataclass(frozen=True, slots=True)
class Splines:
    """`count` cubic B-splines, `spacing` apart; the second is centred on `low`, the first lies outside."""

    low: float
    spacing: float
    count: int

    @classmethod
    def over(cls, low: float, high: float, count: int) -> "Splines":
        """So many splines from `low` to `high`."""
        return cls(low, (high - low) / (count - 3), count)

    @property
    def centres(self) -> Floats:
        """Places (count,) at which the splines are largest."""
        return np.asarray(self.low + self.spacing * (np.arange(self.count) - 1.0), dtype=np.float64)

    def at(self, place: Floats) -> tuple[Ints, Floats]:
        """Index of the first of the four splines at each place (n,), and the values (n, 4) of the four.

        Places outside are moved to the nearest end.
        """
        s = np.clip((place - self.low) / self.spacing, 0.0, self.count - 3.0)
        first = np.minimum(s.astype(np.int64), self.count - 4)
        f = s - first
        g = 1.0 - f
        values = np.stack([g**3, 3.0 * f**3 - 6.0 * f**2 + 4.0, 3.0 * g**3 - 6.0 * g**2 + 4.0, f**3], axis=-1)
        return first, values / 6.0

    def matrix(self, place: Floats) -> Floats:
        """Values (n, count) of all splines."""
        first, values = self.at(place)
        out = np.zeros((len(place), self.count))
        rows = np.arange(len(place))
        for k in range(4):
            out[rows, first + k] = values[:, k]
        return out


_ROUNDS = 4
"""Each makes the place of an error right to the error's slope, a few per cent."""
_QUADRATURE = 512
"""Against 16,384 places the errors of amplitudes differ by 2.6e-6 of themselves, at any correlation
length."""


@dataclass(frozen=True)
class PositionMap:
    """Error of the measured deflection at every place of the stretch that a run swept.

    Attributes
    ----------
    splines
        What it is made of, over places: true deflections, in the unit of the measured ones.
    coefficients, covariance
        Of the splines: the most likely error, and how well it is known. A constant, which no free swing
        shows, is as uncertain as errors of the found size and correlation length let it be, a scale by as
        much as the errors bend it.
    correlation_length
        Distance over which the error changes, in the unit of the deflections.
    significance
        See `PositionMapSearch`.
    cycles
        From how many cycles it was made.
    noise_scale
        By how much the residuals of whole cycles scatter more than their samples' uncertainties say.
    """

    splines: Splines
    coefficients: Floats
    covariance: Floats
    correlation_length: float
    significance: float
    cycles: int
    noise_scale: float

    def error(self, place: Floats) -> Floats:
        """Error (n,) at true deflections `place`; 0 where they are NaN."""
        found = np.zeros(len(place))
        good = np.isfinite(place)
        first, values = self.splines.at(place[good])
        found[good] = sum(values[:, k] * self.coefficients[first + k] for k in range(4))
        return found

    def u_error(self, place: Floats) -> Floats:
        """Standard uncertainties (n,) of `error` beside a constant and a scale, which the map leaves open."""
        matrix = self.splines.matrix(place)
        trend = np.column_stack([np.ones(len(place)), place - place.mean()])
        matrix = FactoredJacobian(trend).left(matrix)
        variance = np.einsum("ij,jk,ik->i", matrix, self.covariance, matrix)
        return np.asarray(np.sqrt(np.maximum(variance, 0.0)), dtype=np.float64)

    def corrected(self, deflections: Deflections) -> Deflections:
        """Deflections without the error."""
        place = deflections.y
        for _ in range(_ROUNDS):
            place = deflections.y - self.error(place)
        return replace(deflections, y=place)

    @property
    def stretch(self) -> tuple[float, float]:
        """Least and largest place."""
        return self.splines.low, self.splines.low + self.splines.spacing * (self.splines.count - 3)

    def with_more(self, other: "PositionMap") -> "PositionMap":
        """The map with the errors of another one over the same stretch, which was found without its own."""
        return replace(self, coefficients=self.coefficients + other.coefficients)

    def amplitude_errors(self, amplitude: Floats, centre: Floats, side: Floats) -> Floats:
        """Errors of amplitudes that the map's covariance leaves, as independent columns (n, m).

        ``errors @ errors.T`` is the amplitudes' covariance. A half-cycle is fitted to all of its samples, its
        rest position to whole cycles: with the place x = centre + side A cos s and the splines B(x), its
        amplitude moves by ``2/pi`` times the integral of ``side (B - mean of B over the cycle) cos s`` over
        the half-cycle. The time of the turning point does not move: an error that depends on the place alone
        is the same before and after it.
        """
        s = (np.arange(_QUADRATURE) + 0.5) * (2.0 * math.pi / _QUADRATURE)
        cosine = np.cos(s)
        inner = cosine > 0.0
        gain = np.empty((len(amplitude), self.splines.count))
        for k in range(len(amplitude)):
            values = self.splines.matrix(centre[k] + side[k] * amplitude[k] * cosine)
            values[inner] -= values.mean(axis=0)
            gain[k] = (side[k] * 4.0 / _QUADRATURE) * (cosine[inner] @ values[inner])
        return np.asarray(gain @ self._root(), dtype=np.float64)

    def adjusted(self, values: Floats, covariance: Floats) -> "PositionMap":
        """The map with what became known of the coordinates whose columns `amplitude_errors` returned.

        `values` (m,) and `covariance` (m, m) were 0 and 1 before.
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

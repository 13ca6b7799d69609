"""Cubic B-splines on equidistant knots over a stretch of places."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


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

    def at(self, place: Floats) -> tuple[NDArray[np.int64], Floats]:
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

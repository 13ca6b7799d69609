"""Splines of the angle for friction and elastic moment of a contact, and the works that these do."""

from collections.abc import Callable
from math import log
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from processing.contact.quadrature import quarter_nodes

if TYPE_CHECKING:
    from scipy.interpolate import CubicHermiteSpline

Array = NDArray[np.float64]

_DEGREE = 3
_RATIO = 2.0
"""Ratio of neighbouring knots: a power of the angle is followed to 1e-3 of its value."""
_BEYOND = 1.08
"""How far the splines reach beyond the first amplitude."""
_PER_KNOT, _FINE = 12, 40
"""Amplitudes of `grid`, and points at which works are tabulated, between two knots."""


class MomentSplines:
    """Cubic splines over the amplitudes of one decay, in units of `unit_rad`; knots lie evenly in ln x.

    Friction f(x) is a spline of the root of x, below the lowest amplitude a straight line whose value at 0 is
    the first coefficient. The elastic moment is x g(x); g is a spline of ln x, below the lowest amplitude a
    straight line in ln x whose change of slope is the last coefficient, and 0 at x = 1. So a constant and a
    power of x are followed best. `lost` and `stored`, shape (grid, nodes of a quarter, coefficients), are the
    works of unit coefficients from x = A to x = A cos theta over ``(A sin theta)^2 / 2``.
    """

    def __init__(self, highest_rad: float, lowest_rad: float, unit_rad: float) -> None:
        from scipy.interpolate import BSpline  # here, because it would slow down every command

        self.unit_rad = unit_rad
        self._lowest, top = lowest_rad / unit_rad, _BEYOND * highest_rad / unit_rad
        lowest = self._lowest
        steps = max(1, round(log(top / lowest, _RATIO)))
        knots = np.linspace(log(lowest), log(top), steps + 1)
        knots = np.concatenate([np.repeat(knots[0], _DEGREE), knots, np.repeat(knots[-1], _DEGREE)])
        self._of_root = BSpline(np.exp(0.5 * knots), np.eye(steps + _DEGREE), _DEGREE)
        self._of_log = BSpline(knots, np.eye(steps + _DEGREE), _DEGREE)
        # that g vanishes at x = 1 costs one of its splines
        at_one = self._of_log(0.0)
        self._kept = np.delete(np.arange(len(at_one)), np.argmax(at_one))
        self._at_one = at_one[self._kept]
        self._slope = np.append(self._of_log(log(lowest), 1)[self._kept], 1.0)
        self.friction_count, self.elastic_count = len(at_one) + 1, len(self._slope)
        u = np.linspace(log(lowest), log(top), _FINE * steps + 1)
        self._friction_work = self._works(u, self.friction, self._friction_below)
        self._elastic_work = self._works(u, self.elastic, self._elastic_below)
        self.grid = np.exp(np.linspace(log(0.3 * lowest), log(top), _PER_KNOT * (steps + 2)))
        nodes = quarter_nodes()
        x = self.grid[:, None] * nodes.cos
        size = (0.5 * self.grid[:, None] ** 2 * nodes.sin2)[..., None]
        self.lost = (self.friction_work(self.grid)[:, None] - self.friction_work(x)) / size
        self.stored = (self.elastic_work(self.grid)[:, None] - self.elastic_work(x)) / size

    def friction(self, x: Array) -> Array:
        """f of unit coefficients, shape (..., friction_count)."""
        share = np.minimum(x / self._lowest, 1.0)[..., None]
        return np.concatenate([1 - share, share * self._friction_splines(x)], axis=-1)

    def elastic(self, x: Array) -> Array:
        """x g of unit coefficients, shape (..., elastic_count)."""
        beyond = np.minimum(np.log(x / self._lowest), 0.0)[..., None]
        own = self._of_log(np.log(np.maximum(x, self._lowest)))[..., self._kept] - self._at_one
        own = np.concatenate([own, np.zeros_like(beyond)], axis=-1)
        return np.asarray(x[..., None] * (own + beyond * self._slope))

    def friction_work(self, x: Array) -> Array:
        """Integral of f from 0."""
        found = self._friction_work(np.log(x))
        return np.asarray(np.where(x[..., None] < self._lowest, self._friction_below(x), found))

    def elastic_work(self, x: Array) -> Array:
        """Integral of x g from 0."""
        found = self._elastic_work(np.log(x))
        return np.asarray(np.where(x[..., None] < self._lowest, self._elastic_below(x), found))

    def _friction_splines(self, x: Array) -> Array:
        return np.asarray(self._of_root(np.sqrt(np.maximum(x, self._lowest))))

    def _friction_below(self, x: Array) -> Array:
        rising = (0.5 * x**2 / self._lowest)[..., None]
        return np.concatenate([x[..., None] - rising, rising * self._friction_splines(x)], axis=-1)

    def _elastic_below(self, x: Array) -> Array:
        return np.asarray(0.5 * x[..., None] * (self.elastic(x) - 0.5 * x[..., None] * self._slope))

    @staticmethod
    def _works(
        u: Array, moment: Callable[[Array], Array], below: Callable[[Array], Array]
    ) -> "CubicHermiteSpline":
        """The work over u = ln x, by Gauss's rule from one point to the next."""
        from scipy.interpolate import CubicHermiteSpline

        at, weight = np.polynomial.legendre.leggauss(5)
        half = 0.5 * (u[1] - u[0])
        x, ends = np.exp(u[:-1, None] + half * (1 + at)), np.exp(u)
        pieces = half * np.einsum("uk,ukj->uj", weight * x, moment(x))
        work = np.cumsum(np.concatenate([below(ends[:1]), pieces]), axis=0)
        return CubicHermiteSpline(u, work, ends[:, None] * moment(ends))

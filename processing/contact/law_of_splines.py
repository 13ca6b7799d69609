"""The contact's moments as splines of the angle, a law that assumes no form of them.

    M = -m g R f(|phi|) sign(phi') + m g R phi g(|phi|)

A moment proportional to phi cannot be told from gravity's: g is zero at the reference amplitude by
definition, and T0 is the period by the proportional moment there. Swings of a law with memory have losses and
durations that some f and g give as well: those of the contact without memory with the same turning points.
"""

from collections.abc import Callable
from functools import partial
from math import log
from typing import TYPE_CHECKING

import numpy as np

from processing.arrays import Floats
from processing.contact.asymptotic import StartValues
from processing.contact.coordinates import Scaling, logarithms_of
from processing.contact.law import FREE_PERIOD, PERIOD, Law, Parameter
from processing.contact.memoryless import Moment, Moments, memoryless_law
from processing.decay_summary import reference_amplitude
from processing.least_squares import FactoredJacobian
from processing.swing import TurningPoints

if TYPE_CHECKING:
    from scipy.interpolate import CubicHermiteSpline


_DEGREE = 3
_RATIO = 2.0
"""Ratio of neighbouring knots: a power of the angle is followed to 1e-3 of its value."""
_BEYOND = 1.08
"""Highest angle of the splines over the first amplitude."""
_FINE = 40
"""Points at which works are tabulated between two knots."""
_PER_FIT = 100
"""Angles at which splines are fitted to the friction of a start."""


class MomentSplines:
    """Cubic splines over the amplitudes of one decay, in units of `unit_rad`; knots lie evenly in ln x.

    Friction f(x) is a spline of the root of x, below the lowest amplitude a straight line whose value at 0 is
    the first coefficient. The elastic moment is x g(x); g is a spline of ln x, below the lowest amplitude a
    straight line in ln x whose change of slope is the last coefficient, and 0 at x = 1. So a constant and a
    power of x are followed best.
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
        # the condition that g vanishes at x = 1 takes one coefficient
        at_one = self._of_log(0.0)
        self._free = np.delete(np.arange(len(at_one)), np.argmax(at_one))
        self._at_one = at_one[self._free]
        self._slope = np.append(self._of_log(log(lowest), 1)[self._free], 1.0)
        self.friction_count, self.elastic_count = len(at_one) + 1, len(self._slope)
        u = np.linspace(log(lowest), log(top), _FINE * steps + 1)
        self._friction_work = work_over_log(u, self.friction, self._friction_below)
        self._elastic_work = work_over_log(u, self.elastic, self._elastic_below)

    def friction(self, x: Floats) -> Floats:
        """f of unit coefficients, shape (..., friction_count)."""
        share = np.minimum(x / self._lowest, 1.0)[..., None]
        return np.concatenate([1 - share, share * self._friction_splines(x)], axis=-1)

    def elastic(self, x: Floats) -> Floats:
        """x g of unit coefficients, shape (..., elastic_count)."""
        beyond = np.minimum(np.log(x / self._lowest), 0.0)[..., None]
        own = self._of_log(np.log(np.maximum(x, self._lowest)))[..., self._free] - self._at_one
        own = np.concatenate([own, np.zeros_like(beyond)], axis=-1)
        return np.asarray(x[..., None] * (own + beyond * self._slope))

    def friction_work(self, x: Floats) -> Floats:
        """Integral of f from 0."""
        found = self._friction_work(np.log(x))
        return np.asarray(np.where(x[..., None] < self._lowest, self._friction_below(x), found))

    def elastic_work(self, x: Floats) -> Floats:
        """Integral of x g from 0."""
        found = self._elastic_work(np.log(x))
        return np.asarray(np.where(x[..., None] < self._lowest, self._elastic_below(x), found))

    def _friction_splines(self, x: Floats) -> Floats:
        return np.asarray(self._of_root(np.sqrt(np.maximum(x, self._lowest))))

    def _friction_below(self, x: Floats) -> Floats:
        rising = (0.5 * x**2 / self._lowest)[..., None]
        return np.concatenate([x[..., None] - rising, rising * self._friction_splines(x)], axis=-1)

    def _elastic_below(self, x: Floats) -> Floats:
        return np.asarray(0.5 * x[..., None] * (self.elastic(x) - 0.5 * x[..., None] * self._slope))


def work_over_log(
    u: Floats, moment: Callable[[Floats], Floats], to_first: Callable[[Floats], Floats]
) -> "CubicHermiteSpline":
    """The integral of moments (..., m) of x over u = ln x, which rises evenly, by Gauss's rule between its
    points; `to_first` gives it for the first x."""
    from scipy.interpolate import CubicHermiteSpline  # here, because it would slow down every command

    at, weight = np.polynomial.legendre.leggauss(5)
    half = 0.5 * (u[1] - u[0])
    x, ends = np.exp(u[:-1, None] + half * (1 + at)), np.exp(u)
    pieces = half * np.einsum("uk,ukj->uj", weight * x, moment(x))
    work = np.cumsum(np.concatenate([to_first(ends[:1]), pieces]), axis=0)
    return CubicHermiteSpline(u, work, ends[:, None] * moment(ends))


def _moment(
    of_unit: Callable[[Floats], Floats],
    works: Callable[[Floats], Floats],
    coefficients: Floats,
    first: int,
    unit: float,
) -> Moment:
    """A moment by its spline coefficients, the map's parameters from place `first` on; x is times `unit`."""

    def work(x: Floats) -> Floats:
        by = works(unit * x)
        return np.concatenate([(by @ coefficients)[None], np.moveaxis(by, -1, 0)])

    return Moment(
        tuple(range(first, first + len(coefficients))),
        lambda x: np.asarray(of_unit(unit * x) @ coefficients),
        work,
    )


def _spline_moments(splines: MomentSplines, parameters: Floats, _: float, __: float) -> Moments:
    """The moments in units of the map's reference, which need not be the splines'."""
    count, more = splines.friction_count, splines.elastic_count
    unit = float(parameters[-2]) / splines.unit_rad
    return Moments(
        _moment(
            splines.friction,
            lambda x: splines.friction_work(x) / unit,
            parameters[:count],
            0,
            unit,
        ),
        _moment(
            lambda x: splines.elastic(x) / unit,
            lambda x: splines.elastic_work(x) / unit**2,
            parameters[count : count + more],
            count,
            unit,
        ),
    )


def spline_law(points: TurningPoints) -> tuple[Law, MomentSplines]:
    """The contact of one decay without a law, and its splines in units of the decay's reference amplitude.

    Parameters are f0, f1, ... and g1, g2, ... (over m g R), and T0.
    """
    reference = reference_amplitude(points)
    splines = MomentSplines(float(points.amplitude.max()), float(points.amplitude.min()), reference)
    of_friction = [f"f{number}" for number in range(splines.friction_count)]
    of_elastic = [f"g{number + 1}" for number in range(splines.elastic_count)]

    def propose_starts(found: StartValues, _: float) -> list[dict[str, float]]:
        x = np.geomspace(0.3 * points.amplitude.min(), points.amplitude.max(), _PER_FIT) / reference
        wanted = found.decay.c + max(found.decay.b, 0.0) * x**found.decay.p
        friction = FactoredJacobian(splines.friction(x) / wanted[:, None]).coefficients(np.ones_like(x))
        known = dict(zip(of_friction, friction.tolist(), strict=True))
        return [known | dict.fromkeys(of_elastic, 0.0) | {PERIOD: found.mean_period_s}]

    parameters = (
        *(Parameter(key, key, "1", "spline of the friction, over m g R", "no law") for key in of_friction),
        *(Parameter(key, key, "1", "spline of the stiffness, over m g R", "no law") for key in of_elastic),
        FREE_PERIOD,
    )
    scalings = dict.fromkeys(of_friction, Scaling(1.0)) | dict.fromkeys(of_elastic, Scaling())
    law = memoryless_law(
        "none",
        "no law: moments as splines of the angle",
        "",
        parameters,
        partial(_spline_moments, splines),
        scalings,
        lambda _: logarithms_of(),
        propose_starts,
    )
    return law, splines

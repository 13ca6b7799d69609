"""The contact's moments as splines of the angle, a law that assumes no form of them.

    M = -m g R f(|phi|) sign(phi') + m g R phi g(|phi|)

A moment proportional to phi cannot be told from gravity's: g is zero at the reference amplitude by
definition, and T0 is the period by the proportional moment there. For a contact with memory, f and g are
those of the contact without memory that has the same turning points.
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
_KNOT_RATIO = 2.0
"""Ratio of neighbouring knots: a power of the angle is followed to 1e-3 of its value."""
_HIGHEST_RATIO = 1.08
"""Highest angle of the splines over the first amplitude."""
_WORK_POINTS = 40
"""Number of points at which works are tabulated between two knots."""
_FITTED_ANGLES = 100
"""Number of angles at which splines are fitted to the friction of a start."""


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
        lowest, top = lowest_rad / unit_rad, _HIGHEST_RATIO * highest_rad / unit_rad
        self._lowest = lowest
        steps = max(1, round(log(top / lowest, _KNOT_RATIO)))
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
        log_x = np.linspace(log(lowest), log(top), _WORK_POINTS * steps + 1)
        self._friction_work = work_over_log(log_x, self.friction, self._friction_work_below)
        self._elastic_work = work_over_log(log_x, self.elastic, self._elastic_work_below)

    def friction(self, x: Floats) -> Floats:
        """f of unit coefficients, shape (..., friction_count)."""
        fraction = np.minimum(x / self._lowest, 1.0)[..., None]
        return np.concatenate([1 - fraction, fraction * self._friction_splines(x)], axis=-1)

    def elastic(self, x: Floats) -> Floats:
        """x g of unit coefficients, shape (..., elastic_count)."""
        log_below = np.minimum(np.log(x / self._lowest), 0.0)[..., None]
        splines = self._of_log(np.log(np.maximum(x, self._lowest)))[..., self._free] - self._at_one
        splines = np.concatenate([splines, np.zeros_like(log_below)], axis=-1)
        return np.asarray(x[..., None] * (splines + log_below * self._slope))

    def friction_work(self, x: Floats) -> Floats:
        """Integral of f from 0."""
        is_below = x[..., None] < self._lowest
        return np.asarray(np.where(is_below, self._friction_work_below(x), self._friction_work(np.log(x))))

    def elastic_work(self, x: Floats) -> Floats:
        """Integral of x g from 0."""
        is_below = x[..., None] < self._lowest
        return np.asarray(np.where(is_below, self._elastic_work_below(x), self._elastic_work(np.log(x))))

    def _friction_splines(self, x: Floats) -> Floats:
        return np.asarray(self._of_root(np.sqrt(np.maximum(x, self._lowest))))

    def _friction_work_below(self, x: Floats) -> Floats:
        rising = (0.5 * x**2 / self._lowest)[..., None]
        return np.concatenate([x[..., None] - rising, rising * self._friction_splines(x)], axis=-1)

    def _elastic_work_below(self, x: Floats) -> Floats:
        return np.asarray(0.5 * x[..., None] * (self.elastic(x) - 0.5 * x[..., None] * self._slope))


def work_over_log(
    log_x: Floats, moment: Callable[[Floats], Floats], first_work: Callable[[Floats], Floats]
) -> "CubicHermiteSpline":
    """The integral of moments (..., m) over x from 0, as a function of ln x, by Gauss's rule between evenly
    rising `log_x`; `first_work` is the integral to the first x."""
    from scipy.interpolate import CubicHermiteSpline  # here, because it would slow down every command

    nodes, weight = np.polynomial.legendre.leggauss(5)
    half = 0.5 * (log_x[1] - log_x[0])
    x, ends = np.exp(log_x[:-1, None] + half * (1 + nodes)), np.exp(log_x)
    pieces = half * np.einsum("uk,ukj->uj", weight * x, moment(x))
    work = np.cumsum(np.concatenate([first_work(ends[:1]), pieces]), axis=0)
    return CubicHermiteSpline(log_x, work, ends[:, None] * moment(ends))


def _moment(
    unit_moments: Callable[[Floats], Floats],
    unit_works: Callable[[Floats], Floats],
    coefficients: Floats,
    first: int,
    unit: float,
) -> Moment:
    """A moment by its spline coefficients, the map's parameters from index `first` on; x is times `unit`."""

    def work(x: Floats) -> Floats:
        works = unit_works(unit * x)
        return np.concatenate([(works @ coefficients)[None], np.moveaxis(works, -1, 0)])

    return Moment(
        tuple(range(first, first + len(coefficients))),
        lambda x: np.asarray(unit_moments(unit * x) @ coefficients),
        work,
    )


def _spline_moments(splines: MomentSplines, parameters: Floats, _: float, __: float) -> Moments:
    """The moments in units of the map's reference, which need not be the splines'."""
    count, unit = splines.friction_count, float(parameters[-2]) / splines.unit_rad
    friction, elastic = np.split(parameters[: count + splines.elastic_count], [count])
    return Moments(
        _moment(splines.friction, lambda x: splines.friction_work(x) / unit, friction, 0, unit),
        _moment(
            lambda x: splines.elastic(x) / unit,
            lambda x: splines.elastic_work(x) / unit**2,
            elastic,
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
    friction_keys = [f"f{number}" for number in range(splines.friction_count)]
    elastic_keys = [f"g{number + 1}" for number in range(splines.elastic_count)]

    def propose_starts(start: StartValues, _: float) -> list[dict[str, float]]:
        x = np.geomspace(0.3 * points.amplitude.min(), points.amplitude.max(), _FITTED_ANGLES) / reference
        friction = start.decay.c + max(start.decay.b, 0.0) * x**start.decay.p
        values = FactoredJacobian(splines.friction(x) / friction[:, None]).coefficients(np.ones_like(x))
        scaled = dict(zip(friction_keys, values.tolist(), strict=True))
        return [scaled | dict.fromkeys(elastic_keys, 0.0) | {PERIOD: start.mean_period_s}]

    parameters = (
        *(Parameter(key, key, "1", "spline of the friction, over m g R", "no law") for key in friction_keys),
        *(Parameter(key, key, "1", "spline of the stiffness, over m g R", "no law") for key in elastic_keys),
        FREE_PERIOD,
    )
    scalings = dict.fromkeys(friction_keys, Scaling(1.0)) | dict.fromkeys(elastic_keys, Scaling())
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

"""No law: the moments of the contact as splines of the angle, whatever they are.

    M = -m g R f(|phi|) sign(phi') + m g R phi g(|phi|)

A moment proportional to phi is gravity's: g is zero at the reference amplitude by definition, and T0 the
period of what is proportional there. With D and V, the integrals of f and of x g, and U = x^2/2 - V, a swing
from A turns next at A' where

    U(A) - D(A) = U(A') + D(A')

and either quarter lasts ``integral dtheta / (2 pi sqrt(G))`` in units of T0, with x = A cos theta and

    G = 1 - 2 [V(A) - V(x) +- (D(A) - D(x))] / (A sin theta)^2

(+ after the turning point, - before it). But for the root this is linear in the coefficients of the splines.
A linear drag takes ``drag A^2`` times the integral of ``sin^2 sqrt(G)`` in each quarter, and changes G by
twice that over ``sin^2 theta``.

A swing of a law with memory loses and lasts as one of this kind does; f and g are then those of the contact
without memory that has the same turning points.
"""

from collections.abc import Callable, Mapping
from functools import partial
from math import log
from typing import TYPE_CHECKING, NamedTuple, Protocol

import numpy as np

from processing.arrays import Floats, Ints
from processing.contact.branch_columns import PERIOD, BranchColumns, Scaling, logarithms_of
from processing.contact.branch_law import FREE_PERIOD
from processing.contact.law import BranchMoments, HalfSwings, Law, Parameter
from processing.contact.moments import weight_moment
from processing.contact.parameters import PendulumOnBall
from processing.contact.quadrature import quarter_nodes
from processing.contact.start_values import StartValues
from processing.contact.tabulated_decay import SwingTable, walk
from processing.periods import reference_amplitude
from processing.swing import TurningPoints

if TYPE_CHECKING:
    from scipy.interpolate import CubicHermiteSpline


_DEGREE = 3
_RATIO = 2.0
"""Ratio of neighbouring knots: a power of the angle is followed to 1e-3 of its value."""
_BEYOND = 1.08
"""How far the splines reach beyond the first amplitude."""
_PER_KNOT, _FINE = 12, 40
"""Amplitudes of `grid`, and points at which works are tabulated, between two knots."""


class TabulatedMoments(Protocol):
    """Friction and elastic moment over the amplitudes of one decay, as `MomentSplines` has them: functions
    with a last axis of coefficients.
    """

    grid: Floats
    lost: Floats
    stored: Floats

    def friction(self, x: Floats) -> Floats: ...
    def elastic(self, x: Floats) -> Floats: ...
    def friction_work(self, x: Floats) -> Floats: ...
    def elastic_work(self, x: Floats) -> Floats: ...


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

    def friction(self, x: Floats) -> Floats:
        """f of unit coefficients, shape (..., friction_count)."""
        share = np.minimum(x / self._lowest, 1.0)[..., None]
        return np.concatenate([1 - share, share * self._friction_splines(x)], axis=-1)

    def elastic(self, x: Floats) -> Floats:
        """x g of unit coefficients, shape (..., elastic_count)."""
        beyond = np.minimum(np.log(x / self._lowest), 0.0)[..., None]
        own = self._of_log(np.log(np.maximum(x, self._lowest)))[..., self._kept] - self._at_one
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

    @staticmethod
    def _works(
        u: Floats, moment: Callable[[Floats], Floats], below: Callable[[Floats], Floats]
    ) -> "CubicHermiteSpline":
        """The work over u = ln x, by Gauss's rule from one point to the next."""
        from scipy.interpolate import CubicHermiteSpline

        at, weight = np.polynomial.legendre.leggauss(5)
        half = 0.5 * (u[1] - u[0])
        x, ends = np.exp(u[:-1, None] + half * (1 + at)), np.exp(u)
        pieces = half * np.einsum("uk,ukj->uj", weight * x, moment(x))
        work = np.cumsum(np.concatenate([below(ends[:1]), pieces]), axis=0)
        return CubicHermiteSpline(u, work, ends[:, None] * moment(ends))


_ROUNDS = 8
"""Iterations of the work of the drag: each gains the ratio of its moment to the weight's, 1 %."""
_FEWEST = 8
"""Fewest amplitudes of a table."""


class _Quarters(NamedTuple):
    """Quarters of a swing from (sign 1) or to (-1) a turning point, at the amplitudes of the grid.

    `time` is in units of T0, `lost` the work of the drag over ``drag A^2``; `by` and `lost_by` are their
    derivatives by the coefficients and the drag.
    """

    time: Floats
    by: Floats
    lost: Floats
    lost_by: Floats


def _quarters(
    splines: TabulatedMoments, of_friction: Floats, of_elastic: Floats, drag: float, sign: float
) -> _Quarters:
    nodes = quarter_nodes()
    without = 1 - splines.stored @ of_elastic - sign * (splines.lost @ of_friction)
    factor, travelled = without, np.zeros_like(without)
    for _ in range(_ROUNDS if drag else 1):
        travelled = np.sqrt(factor) @ nodes.travelled.T
        factor = without - 2 * sign * drag * travelled
    root = 1 / np.sqrt(factor)
    by = np.concatenate([-sign * splines.lost, -splines.stored, -2 * sign * travelled[..., None]], axis=2)
    if drag:
        # the drag works on a speed that all of them change; the square of the drag is left out
        by = by - sign * drag * (nodes.travelled @ (by * root[..., None]))
    by_time = -0.5 * np.einsum("ak,akj->aj", nodes.weight * root**3, by) / (2 * np.pi)
    lost = (nodes.sin2 * np.sqrt(factor)) @ nodes.weight
    lost_by = 0.5 * np.einsum("ak,akj->aj", nodes.weight * nodes.sin2 * root, by)
    return _Quarters(root @ nodes.weight / (2 * np.pi), by_time, lost, lost_by)


def _turning(
    splines: TabulatedMoments,
    energy: Floats,
    of_friction: Floats,
    of_elastic: Floats,
    of_drag: Callable[[Floats], Floats],
) -> Floats:
    """The amplitudes below those of the grid at which U + D reaches an energy; NaN where there is none.

    `of_drag` is what its work in the quarter before is, over the square of the amplitude.
    """
    highest = splines.grid
    x, lowest = highest.copy(), 0.1 * highest[0]
    for _ in range(40):
        air = of_drag(x)
        above = 0.5 * x**2 - splines.elastic_work(x) @ of_elastic + splines.friction_work(x) @ of_friction
        above += air * x**2
        slope = x - splines.elastic(x) @ of_elastic + splines.friction(x) @ of_friction + 2 * air * x
        following = np.clip(x - (above - energy) / slope, lowest, highest)
        settled = np.all(np.abs(following - x) < 1e-15 * highest)
        x = following
        if settled:
            break
    return np.where(x > lowest, x, np.nan)


def swing_table(
    splines: TabulatedMoments, of_friction: Floats, of_elastic: Floats, drag: float
) -> SwingTable | None:
    """Half-swings from the amplitudes of the grid; None where the pendulum sticks."""
    from scipy.interpolate import CubicSpline  # here, because it would slow down every command

    grid = splines.grid
    lost, stored = splines.friction_work(grid), splines.elastic_work(grid)
    with np.errstate(all="ignore"):
        leaving, coming = (_quarters(splines, of_friction, of_elastic, drag, sign) for sign in (1.0, -1.0))
        if not (np.all(np.isfinite(coming.time)) and np.all(np.isfinite(coming.lost))):
            return None
        arriving = CubicSpline(np.log(grid), np.column_stack([coming.time, coming.by, coming.lost_by]))
        work = CubicSpline(np.log(grid), coming.lost)
        energy = 0.5 * grid**2 - stored @ of_elastic - lost @ of_friction - drag * leaving.lost * grid**2
        following = _turning(
            splines, energy, of_friction, of_elastic, lambda x: np.asarray(drag * work(np.log(x)))
        )
    first = len(grid) - int(np.argmax(np.append(~(following[::-1] > grid[0]), True)))
    if len(grid) - first < _FEWEST or not np.all(np.isfinite(leaving.time)):
        return None
    grid, following = grid[first:], following[first:]
    at = np.log(following)
    stiffness = (
        following
        - splines.elastic(following) @ of_elastic
        + splines.friction(following) @ of_friction
        + 2 * drag * work(at) * following
    )
    by = np.column_stack(
        [
            -(lost[first:] + splines.friction_work(following)),
            splines.elastic_work(following) - stored[first:],
            -(leaving.lost[first:] * grid**2 + work(at) * following**2),
        ]
    )
    there, count = arriving(at), by.shape[1]
    by -= drag * (
        leaving.lost_by[first:] * grid[:, None] ** 2 + there[:, 1 + count :] * following[:, None] ** 2
    )
    by /= stiffness[:, None]
    duration = leaving.time[first:] + there[:, 0]
    by_duration = (
        leaving.by[first:] + there[:, 1 : 1 + count] + arriving(at, 1)[:, :1] / following[:, None] * by
    )
    nothing = np.zeros((len(grid), 1))  # by the reference
    rows = [following / grid, duration, by / grid[:, None], nothing, by_duration, nothing]
    return SwingTable(float(grid[0]), CubicSpline(np.log(grid), np.column_stack(rows)))


def _half_swings(splines: MomentSplines, parameters: Floats, index: Ints) -> HalfSwings:
    """The map, whose parameters and amplitudes are in units of a reference that need not be the splines'."""
    count, last = splines.friction_count, len(parameters) - 1
    in_units = np.ones(last + 1)
    in_units[[*range(count), last]] = parameters[-2] / splines.unit_rad
    scaled = parameters * in_units
    table = swing_table(splines, scaled[:count], scaled[count:-3], float(scaled[-3]))

    def table_from(amplitude: float) -> SwingTable | None:
        return table if table is not None and amplitude >= table.lowest else None

    found = walk(table_from, last, float(scaled[-1]), index)
    return HalfSwings(
        found.amplitude / in_units[-1],
        found.time,
        found.amplitude_gradient * in_units / in_units[-1],
        found.time_gradient * in_units,
    )


def spline_law(points: TurningPoints) -> tuple[Law, MomentSplines]:
    """The contact of one decay without a law, and its splines in units of the decay's reference amplitude.

    Parameters are f0, f1, ... and g1, g2, ... (over m g R), and T0.
    """
    reference = reference_amplitude(points)
    splines = MomentSplines(float(points.amplitude.max()), float(points.amplitude.min()), reference)
    of_friction = [f"f{number}" for number in range(splines.friction_count)]
    of_elastic = [f"g{number + 1}" for number in range(splines.elastic_count)]

    def moments(
        phi_rad: Floats, direction: Floats, values: Mapping[str, float], pendulum: PendulumOnBall
    ) -> BranchMoments:
        x, weight = np.abs(phi_rad) / reference, weight_moment(pendulum)
        friction = splines.friction(x) @ np.array([values[key] for key in of_friction])
        elastic = splines.elastic(x) @ np.array([values[key] for key in of_elastic]) * reference
        return BranchMoments(-weight * np.sign(direction) * friction, weight * np.sign(phi_rad) * elastic)

    def likely(found: StartValues, _: float) -> list[dict[str, float]]:
        x = splines.grid
        wanted = found.decay.c + max(found.decay.b, 0.0) * x**found.decay.p
        friction = np.linalg.lstsq(splines.friction(x) / wanted[:, None], np.ones_like(x), rcond=None)[0]
        known = dict(zip(of_friction, friction.tolist(), strict=True))
        return [known | dict.fromkeys(of_elastic, 0.0) | {PERIOD: found.mean_period_s}]

    parameters = (
        *(Parameter(key, key, "1", "spline of the friction, over m g R", "no law") for key in of_friction),
        *(Parameter(key, key, "1", "spline of the stiffness, over m g R", "no law") for key in of_elastic),
        FREE_PERIOD,
    )
    scalings = dict.fromkeys(of_friction, Scaling(1.0)) | dict.fromkeys(of_elastic, Scaling())
    law = Law(
        name="none",
        title="no law: moments as splines of the angle",
        source="",
        parameters=parameters,
        branch_moments=moments,
        half_swing_map=partial(_half_swings, splines),
        columns=partial(
            BranchColumns, parameters=parameters, scalings=scalings, straight=logarithms_of(), likely=likely
        ),
    )
    return law, splines

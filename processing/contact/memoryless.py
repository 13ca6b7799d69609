"""Half-swings of a law without memory: friction and elastic moment are functions of the angle.

    M = -m g R f(|phi|) sign(phi') + m g R e(|phi|) sign(phi) - m g R drag phi'/w0

With D and V, the integrals of f and e from 0 (their works), a swing from A turns next at A' where

    A^2/2 - V(A) - D(A) = A'^2/2 - V(A') + D(A')

and either quarter lasts ``integral dtheta / (2 pi sqrt(G))`` in units of T0, with x = A cos theta and

    G = 1 - 2 [V(A) - V(x) +- (D(A) - D(x))] / (A sin theta)^2

(+ after the turning point, - before it). The drag takes ``drag A^2`` times the integral of ``sin^2 sqrt(G)``
in each quarter, and changes G by twice that over ``sin^2 theta``, with the integral up to theta.

A law states f, e, D and V, and the derivatives of D and V with respect to its parameters; those of a
half-swing follow. Angles and the moments over m g R are in units of a reference.
"""

from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache, partial
from math import ceil, log
from typing import NamedTuple

import numpy as np

from processing.arrays import Floats
from processing.contact.asymptotic import StartValues
from processing.contact.coordinates import Coordinates, Scaling, ValleyCoordinates, scaled_values
from processing.contact.half_swing import SwingTable
from processing.contact.law import (
    BranchMoments,
    Law,
    Parameter,
    PendulumOnBall,
    relative_curvature,
    weight_moment,
)

_PER_OCTAVE, _MARGIN_AMPLITUDES, _MIN_AMPLITUDES = 24, 2, 4
"""Number of a table's amplitudes in a factor of two, beyond either end, and at least."""
_NODES = 20
"""Nodes of a quarter; the error is below 1e-12 of a half period for any exponent above zero."""
_MAX_ITERATIONS, _DRAG_TOLERANCE, _NEWTON_TOLERANCE = 60, 1e-12, 1e-9
"""Most iterations, and the relative change at which they end: of those for a drag, each of which reduces the
change by its moment over the weight's, and of Newton's, which square it."""
_DERIVATIVE_TOLERANCE = 1e-9
"""Relative change at which the iteration of derivatives with respect to a drag ends."""
_MAX_AMPLITUDE_ITERATIONS, _AMPLITUDE_TOLERANCE = 5, 1e-9
"""Most iterations of the next amplitude with the drag's work before it, and the relative change at which they
end: each reduces the change by a hundredth of the drag's moment."""


class Moment(NamedTuple):
    """A moment over m g R and its work from 0, as functions of angles x > 0 of any shape.

    `work` returns a first axis of the value and its derivatives with respect to the parameters of the map at
    `parameter_indices`.
    """

    parameter_indices: tuple[int, ...]
    moment: Callable[[Floats], Floats]
    work: Callable[[Floats], Floats]


NO_MOMENT = Moment((), np.zeros_like, lambda x: np.zeros((1, *x.shape)))


class Moments(NamedTuple):
    """A law without memory: friction against the motion, and elastic moment in the direction of phi."""

    friction: Moment
    elastic: Moment


MomentsFunction = Callable[[Floats, float, float], Moments | None]
"""Function of a law: its moments between two angles, for the map's parameters without the first amplitude
(`Coordinates.map_parameters`); None where these have none."""


# The substitution ``phi = A cos(theta)`` removes the square-root singularity of the duration at the turning
# point. Fractional powers of |phi| leave another one at the zero crossing, which ``pi/2 - theta =
# (pi/2) v**3`` smooths. A Gauss-Legendre rule in v then converges quickly for every exponent.


class _QuarterNodes(NamedTuple):
    """Nodes from the turning point (theta = 0) to the zero crossing (theta = pi/2).

    `weight` are the weights for integration over theta, `turn_and_cos` is 1, then cos(theta). The square
    matrix `travelled` maps values f at the nodes to ``integral_0^theta_k sin^2 f dtheta' / sin^2 theta_k``,
    the work of a moment proportional to the speed; dividing by sin^2 avoids 0/0 at the turning point.
    """

    weight: Floats
    turn_and_cos: Floats
    sin2: Floats
    travelled: Floats


@lru_cache(maxsize=1)
def _quarter_nodes() -> _QuarterNodes:
    """The nodes; computed once and cached."""
    x, w = np.polynomial.legendre.leggauss(_NODES)
    v = (x[::-1] + 1.0) / 2.0  # falling v: rising theta
    w = w[::-1] / 2.0
    past_zero = np.pi / 2 * v**3
    weight = 1.5 * np.pi * v**2 * w
    sin2 = np.cos(past_zero) ** 2
    # The integral from v_k to 1 of a polynomial through the nodes, by its Legendre coefficients.
    legendre = np.polynomial.legendre.legvander(2 * v - 1, _NODES)
    to_coefficients = ((2 * np.arange(_NODES) + 1)[:, None] * legendre[:, :_NODES].T) * w
    integral = np.empty((_NODES, _NODES))
    integral[:, 0] = 1.0 - v
    for k in range(1, _NODES):
        # integral_x^1 P_k = (P_{k-1}(x) - P_{k+1}(x)) / (2 k + 1); half of it, for dv = dx/2
        integral[:, k] = (legendre[:, k - 1] - legendre[:, k + 1]) / (2 * (2 * k + 1))
    travelled = (integral @ to_coefficients) * (1.5 * np.pi * v**2 * sin2) / sin2[:, None]
    return _QuarterNodes(weight, np.append(1.0, np.sin(past_zero)), sin2, travelled)


class _Quarter(NamedTuple):
    """Quarters from or to turning points: time in T0, `drag_work`, the work of the drag over ``drag A^2``,
    and the derivatives `time_derivatives` and `drag_work_derivatives` (first axis: the friction's parameters,
    the elastic moment's, the drag, ln A). `friction` and `elastic` are the works at the turning points.
    """

    time: Floats
    time_derivatives: Floats
    drag_work: Floats
    drag_work_derivatives: Floats
    friction: Floats
    elastic: Floats


def _quarter(moments: Moments, a: Floats, drag: float, sign: float, *, derived: bool = True) -> _Quarter:
    """Quarters after (`sign` 1) or before (-1) turning points at `a`; `derived` is with derivatives."""
    nodes = _quarter_nodes()
    x = a[:, None] * nodes.turn_and_cos
    per_size = 2 / (a[:, None] ** 2 * nodes.sin2)
    friction, elastic = moments.friction.work(x), moments.elastic.work(x)
    of_friction, of_elastic = ((one[..., :1] - one[..., 1:]) * per_size for one in (friction, elastic))
    total = of_elastic[0] + sign * of_friction[0]
    without = 1 - total
    factor, travelled = without, without
    for _ in range(_MAX_ITERATIONS if drag else 1):
        travelled = np.sqrt(factor) @ nodes.travelled.T
        before, factor = factor, without - 2 * sign * drag * travelled
        if not np.any(np.abs(factor - before) > _DRAG_TOLERANCE):
            break
    speed = np.sqrt(factor)
    root = 1 / speed
    time, drag_work = root @ nodes.weight / (2 * np.pi), speed @ (nodes.weight * nodes.sin2)
    at_turn = friction[..., 0], elastic[..., 0]
    if not derived:
        return _Quarter(time, time[None], drag_work, drag_work[None], *at_turn)
    along = x * (moments.elastic.moment(x) + sign * moments.friction.moment(x))
    explicit = np.concatenate(
        [
            -sign * of_friction[1:],
            -of_elastic[1:],
            -2 * sign * travelled[None],
            (2 * total - (along[:, :1] - along[:, 1:]) * per_size)[None],
        ]
    )
    factor_derivatives = explicit
    if drag:
        # the drag's work depends on the speed, which all parameters change
        for _ in range(_MAX_ITERATIONS):
            again = explicit - sign * drag * ((factor_derivatives * root) @ nodes.travelled.T)
            converged = not np.any(
                np.abs(again - factor_derivatives)
                > _DERIVATIVE_TOLERANCE * np.max(np.abs(factor_derivatives), initial=0.0)
            )
            factor_derivatives = again
            if converged:
                break
    time_derivatives = -0.25 / np.pi * np.einsum("kmn,mn->km", factor_derivatives, nodes.weight * root**3)
    drag_work_derivatives = 0.5 * np.einsum(
        "kmn,mn->km", factor_derivatives, nodes.weight * nodes.sin2 * root
    )
    return _Quarter(time, time_derivatives, drag_work, drag_work_derivatives, *at_turn)


def _turning(
    moments: Moments, highest: Floats, energy: Floats, drag_work: Floats, near: Floats | None = None
) -> Floats:
    """Amplitudes A' below `highest` at which A'^2/2 - V + D + drag_work A'^2 is `energy`; NaN where there is
    none.

    The search begins at `near`, or at the highest.
    """
    friction, elastic = moments.friction, moments.elastic
    x = highest if near is None else np.where(np.isfinite(near), near, highest)
    for _ in range(_MAX_ITERATIONS):
        above = (0.5 + drag_work) * x**2 - elastic.work(x)[0] + friction.work(x)[0]
        slope = (1 + 2 * drag_work) * x - elastic.moment(x) + friction.moment(x)
        before, x = x, np.clip(x - (above - energy) / slope, 0.1 * x, 1.5 * x)
        if not np.any(np.abs(x - before) > _NEWTON_TOLERANCE * highest):
            break
    return np.where((energy > 0) & (x > 1e-6 * highest), x, np.nan)


def memoryless_table(
    moments_function: MomentsFunction, parameters: Floats, highest: float, lowest: float
) -> SwingTable | None:
    """The law's table (`Law.table`)."""
    steps = max(_MIN_AMPLITUDES, ceil(_PER_OCTAVE * log(highest / lowest, 2)))
    log_a = np.linspace(log(lowest), log(highest), steps + 1)
    step = log_a[1] - log_a[0]
    log_a = log_a[0] + step * np.arange(-_MARGIN_AMPLITUDES, steps + 1 + _MARGIN_AMPLITUDES)
    a = np.exp(log_a)
    with np.errstate(all="ignore"):  # a search tries values for which terms overflow
        moments = moments_function(parameters, float(a[0]), float(a[-1]))
        if moments is None:
            return None
        rows = _rows(moments, a, float(parameters[-3]), len(parameters))
    return SwingTable.of(log_a, rows, _MIN_AMPLITUDES + _MARGIN_AMPLITUDES, _MARGIN_AMPLITUDES)


def _rows(moments: Moments, a: Floats, drag: float, count: int) -> Floats:
    """Rows (2 + 2 k, amplitudes) of a table, see `SwingTable.of`."""
    leaving = _quarter(moments, a, drag, 1.0)
    energy = (0.5 - drag * leaving.drag_work) * a**2 - leaving.elastic[0] - leaving.friction[0]
    following = _turning(moments, a, energy, drag * leaving.drag_work)
    if drag:
        for _ in range(_MAX_AMPLITUDE_ITERATIONS):
            drag_work = _quarter(moments, following, drag, -1.0, derived=False).drag_work
            before, following = following, _turning(moments, a, energy, drag * drag_work, following)
            if not np.any(np.abs(following - before) > _AMPLITUDE_TOLERANCE * a):
                break
    coming = _quarter(moments, following, drag, -1.0)
    amplitude_derivatives = np.concatenate(
        [
            -leaving.friction[1:] - coming.friction[1:],
            coming.elastic[1:] - leaving.elastic[1:],
            -(leaving.drag_work * a**2 + coming.drag_work * following**2)[None],
        ]
    )
    if drag:
        amplitude_derivatives -= drag * (
            leaving.drag_work_derivatives[:-1] * a**2 + coming.drag_work_derivatives[:-1] * following**2
        )
    at_end = moments.friction.moment(following) - moments.elastic.moment(following)
    amplitude_derivatives /= (
        following + at_end + drag * following * (2 * coming.drag_work + coming.drag_work_derivatives[-1])
    )
    time_derivatives = (
        leaving.time_derivatives[:-1]
        + coming.time_derivatives[:-1]
        + coming.time_derivatives[-1] / following * amplitude_derivatives
    )
    indices = np.array([*moments.friction.parameter_indices, *moments.elastic.parameter_indices, count - 3])
    rows = np.zeros((2 + 2 * count, len(a)))
    rows[0], rows[1] = following / a, leaving.time + coming.time
    np.add.at(rows, 2 + indices, amplitude_derivatives / a)
    np.add.at(rows, 2 + count + indices, time_derivatives)
    return rows


def memoryless_law(
    name: str,
    title: str,
    source: str,
    parameters: Sequence[Parameter],
    moments_function: MomentsFunction,
    scalings: Mapping[str, Scaling],
    valley_coordinates: Callable[[bool], ValleyCoordinates],
    propose_starts: Callable[[StartValues, float], Sequence[Mapping[str, float]]],
) -> Law:
    """A law of friction and elastic moment; see `Coordinates` for the last arguments."""

    def moments(
        phi_rad: Floats, direction: Floats, values: Mapping[str, float], pendulum: PendulumOnBall
    ) -> BranchMoments:
        own = scaled_values(scalings, values, pendulum, 1.0).values()
        found = moments_function(np.array([*own, 0.0, 1.0, relative_curvature(pendulum)]), 0.0, 0.0)
        if found is None:
            # a fit may end where the law has no moments; NaN is not plotted
            undefined = np.full(np.shape(phi_rad), np.nan)
            return BranchMoments(undefined, undefined)
        weight, size = weight_moment(pendulum), np.abs(phi_rad)
        with np.errstate(all="ignore"):  # ln 0 in derivatives
            friction, elastic = (one.moment(size) for one in found)
        return BranchMoments(-weight * np.sign(direction) * friction, weight * np.sign(phi_rad) * elastic)

    return Law(
        name=name,
        title=title,
        source=source,
        parameters=tuple(parameters),
        branch_moments=moments,
        table=partial(memoryless_table, moments_function),
        columns=partial(
            Coordinates,
            parameters=parameters,
            scalings=scalings,
            valley_coordinates=valley_coordinates,
            propose_starts=propose_starts,
        ),
    )

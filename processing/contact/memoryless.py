"""Half-cycles of a law without memory: friction and elastic moment are functions of the angle.

    M = -m g R f(|phi|) sign(phi') + m g R e(|phi|) sign(phi) - m g R drag phi'/w0

With D and V, the integrals of f and e from 0 (their works), a half-cycle from A ends at A' where

    A^2/2 - V(A) - D(A) = A'^2/2 - V(A') + D(A')

and either quarter lasts ``integral dtheta / (2 pi sqrt(G))`` in units of T0, with x = A cos theta and

    G = 1 - 2 [V(A) - V(x) +- (D(A) - D(x))] / (A sin theta)^2      (+ after the turning point, - before it)

The drag takes ``drag A^2 integral sin^2 sqrt(G) dtheta`` in each quarter. Fractional powers of |phi| leave a
singularity at the zero crossing, which ``pi/2 - theta = (pi/2) v^3`` smooths for a Gauss-Legendre rule in v.
"""

from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache, partial
from math import ceil, log
from typing import NamedTuple

import numpy as np

from processing.arrays import Floats
from processing.contact.coordinates import (
    Coordinates,
    Scaling,
    StartProposal,
    ValleyCoordinates,
    scaled_values,
)
from processing.contact.half_cycle_table import HalfCycleTable
from processing.contact.law import (
    BranchMoments,
    Law,
    Parameter,
    PendulumOnBall,
    relative_curvature,
    weight_moment,
)

_AMPLITUDES_PER_OCTAVE, _EXTRA_AMPLITUDES, _MIN_AMPLITUDES = 24, 2, 4
"""Numbers of amplitudes of a table: in each factor of two, beyond either end of the range, and at least."""
_NODES = 20
"""Nodes of a quarter; the error is below 1e-12 of a half period for any exponent above zero."""
_MAX_ITERATIONS = 60
_DRAG_TOLERANCE = 1e-12
"""Change of G at which the iteration for a drag ends, which the drag's moment over the weight's reduces."""
_NEWTON_TOLERANCE = 1e-9
"""Relative change at which Newton's iteration ends; the next change would be its square."""
_DERIVATIVE_TOLERANCE = 1e-9
"""Relative change at which the iteration of derivatives with respect to a drag ends."""
_MAX_AMPLITUDE_ITERATIONS, _AMPLITUDE_TOLERANCE = 5, 1e-9
"""Most iterations of the next amplitude with the drag's work before it, and the relative change at which they
end: each reduces the change by a hundredth of the drag's moment."""


class Moment(NamedTuple):
    """A moment over m g R and its work from 0, as functions of angles x > 0 of any shape, in units of a
    reference."""

    parameter_indices: tuple[int, ...]
    """Indices of the moment's parameters among those of the map."""
    moment: Callable[[Floats], Floats]
    work: Callable[[Floats], Floats]
    """Returns a first axis of the work and its derivatives with respect to these parameters."""


NO_MOMENT = Moment((), np.zeros_like, lambda x: np.zeros((1, *x.shape)))


class Moments(NamedTuple):
    """A law without memory: friction against the motion, and elastic moment in the direction of phi."""

    friction: Moment
    elastic: Moment


MomentsFunction = Callable[[Floats, float, float], Moments | None]
"""Function (parameters, lowest, highest) of a law that gives its moments between two angles, for the map's
parameters without the first amplitude (`Coordinates.map_parameters`); None if these have none."""


class _QuarterNodes(NamedTuple):
    """Nodes from the turning point (theta = 0) to the zero crossing (theta = pi/2)."""

    weight: Floats
    """Weights for integration over theta."""
    turn_and_cos: Floats
    """1, then cos(theta)."""
    sin_square: Floats
    drag_work_matrix: Floats
    """Square matrix that maps f at the nodes to ``integral_0^theta_k sin^2 f dtheta' / sin^2 theta_k``, the
    work of a moment proportional to the speed; dividing by sin^2 avoids 0/0 at the turning point."""


@lru_cache(maxsize=1)
def _quarter_nodes() -> _QuarterNodes:
    x, w = np.polynomial.legendre.leggauss(_NODES)
    v = (x[::-1] + 1.0) / 2.0  # falling v: rising theta
    w = w[::-1] / 2.0
    past_zero = np.pi / 2 * v**3
    weight = 1.5 * np.pi * v**2 * w
    sin_square = np.cos(past_zero) ** 2
    # the integral from v_k to 1 of a polynomial through the nodes, by its Legendre coefficients
    legendre = np.polynomial.legendre.legvander(2 * v - 1, _NODES)
    to_coefficients = ((2 * np.arange(_NODES) + 1)[:, None] * legendre[:, :_NODES].T) * w
    integral = np.empty((_NODES, _NODES))
    integral[:, 0] = 1.0 - v
    for k in range(1, _NODES):
        # integral_x^1 P_k = (P_{k-1}(x) - P_{k+1}(x)) / (2 k + 1); half of it, for dv = dx/2
        integral[:, k] = (legendre[:, k - 1] - legendre[:, k + 1]) / (2 * (2 * k + 1))
    drag_work_matrix = (integral @ to_coefficients) * (1.5 * np.pi * v**2 * sin_square) / sin_square[:, None]
    return _QuarterNodes(weight, np.append(1.0, np.sin(past_zero)), sin_square, drag_work_matrix)


class _Quarter(NamedTuple):
    """Quarters of a period from or to turning points."""

    time: Floats
    """Durations in T0."""
    time_derivatives: Floats
    """Their first axis: the friction's parameters, the elastic moment's, the drag, and ln A."""
    drag_work: Floats
    """Work of the drag over ``drag A^2``."""
    drag_work_derivatives: Floats
    friction: Floats
    elastic: Floats
    """Works of friction and elastic moment at the turning points, with their derivatives."""


def _quarter(
    moments: Moments, a: Floats, drag: float, sign: float, *, with_derivatives: bool = True
) -> _Quarter:
    """Quarters after (`sign` 1) or before (-1) turning points at `a`."""
    nodes = _quarter_nodes()
    x = a[:, None] * nodes.turn_and_cos
    per_size = 2 / (a[:, None] ** 2 * nodes.sin_square)
    friction, elastic = moments.friction.work(x), moments.elastic.work(x)
    friction_loss, elastic_loss = ((work[..., :1] - work[..., 1:]) * per_size for work in (friction, elastic))
    loss = elastic_loss[0] + sign * friction_loss[0]
    g = g_without_drag = 1 - loss
    for _ in range(_MAX_ITERATIONS if drag else 1):
        drag_loss = np.sqrt(g) @ nodes.drag_work_matrix.T
        last_g, g = g, g_without_drag - 2 * sign * drag * drag_loss
        if not np.any(np.abs(g - last_g) > _DRAG_TOLERANCE):
            break
    speed = np.sqrt(g)
    root = 1 / speed
    time, drag_work = root @ nodes.weight / (2 * np.pi), speed @ (nodes.weight * nodes.sin_square)
    turn_works = friction[..., 0], elastic[..., 0]
    if not with_derivatives:
        return _Quarter(time, time[None], drag_work, drag_work[None], *turn_works)
    virial = x * (moments.elastic.moment(x) + sign * moments.friction.moment(x))
    explicit = np.concatenate(
        [
            -sign * friction_loss[1:],
            -elastic_loss[1:],
            -2 * sign * drag_loss[None],
            (2 * loss - (virial[:, :1] - virial[:, 1:]) * per_size)[None],
        ]
    )
    g_derivatives = explicit
    # the drag's work depends on the speed, which all parameters change
    for _ in range(_MAX_ITERATIONS if drag else 0):
        last_derivatives = g_derivatives
        g_derivatives = explicit - sign * drag * ((last_derivatives * root) @ nodes.drag_work_matrix.T)
        tolerance = _DERIVATIVE_TOLERANCE * np.max(np.abs(last_derivatives), initial=0.0)
        if not np.any(np.abs(g_derivatives - last_derivatives) > tolerance):
            break
    time_derivatives = -0.25 / np.pi * np.einsum("kmn,mn->km", g_derivatives, nodes.weight * root**3)
    drag_work_derivatives = 0.5 * np.einsum(
        "kmn,mn->km", g_derivatives, nodes.weight * nodes.sin_square * root
    )
    return _Quarter(time, time_derivatives, drag_work, drag_work_derivatives, *turn_works)


def _end_amplitudes(
    moments: Moments, highest: Floats, energy: Floats, drag_work: Floats, start: Floats | None = None
) -> Floats:
    """Amplitudes A' below `highest` at which A'^2/2 - V + D + drag_work A'^2 is `energy`, or NaN."""
    friction, elastic = moments.friction, moments.elastic
    x = highest if start is None else np.where(np.isfinite(start), start, highest)
    for _ in range(_MAX_ITERATIONS):
        energy_at_x = (0.5 + drag_work) * x**2 - elastic.work(x)[0] + friction.work(x)[0]
        slope = (1 + 2 * drag_work) * x - elastic.moment(x) + friction.moment(x)
        last_x, x = x, np.clip(x - (energy_at_x - energy) / slope, 0.1 * x, 1.5 * x)
        if not np.any(np.abs(x - last_x) > _NEWTON_TOLERANCE * highest):
            break
    return np.where((energy > 0) & (x > 1e-6 * highest), x, np.nan)


def memoryless_table(
    moments_function: MomentsFunction, parameters: Floats, highest: float, lowest: float
) -> HalfCycleTable | None:
    """The table of a law (`TableMaker`)."""
    steps = max(_MIN_AMPLITUDES, ceil(_AMPLITUDES_PER_OCTAVE * log(highest / lowest, 2)))
    log_a = np.linspace(log(lowest), log(highest), steps + 1)
    step = log_a[1] - log_a[0]
    log_a = log_a[0] + step * np.arange(-_EXTRA_AMPLITUDES, steps + 1 + _EXTRA_AMPLITUDES)
    a = np.exp(log_a)
    with np.errstate(all="ignore"):  # a search tries values for which terms overflow
        moments = moments_function(parameters, float(a[0]), float(a[-1]))
        if moments is None:
            return None
        rows = _rows(moments, a, float(parameters[-3]), len(parameters))
    return HalfCycleTable.of(log_a, rows, _MIN_AMPLITUDES + _EXTRA_AMPLITUDES, _EXTRA_AMPLITUDES)


def _rows(moments: Moments, a: Floats, drag: float, count: int) -> Floats:
    """Rows (2 + 2 k, amplitudes) of a table, see `HalfCycleTable.of`."""
    first = _quarter(moments, a, drag, 1.0)
    energy = (0.5 - drag * first.drag_work) * a**2 - first.elastic[0] - first.friction[0]
    end = _end_amplitudes(moments, a, energy, drag * first.drag_work)
    for _ in range(_MAX_AMPLITUDE_ITERATIONS if drag else 0):
        drag_work = _quarter(moments, end, drag, -1.0, with_derivatives=False).drag_work
        last_end, end = end, _end_amplitudes(moments, a, energy, drag * drag_work, end)
        if not np.any(np.abs(end - last_end) > _AMPLITUDE_TOLERANCE * a):
            break
    second = _quarter(moments, end, drag, -1.0)
    end_derivatives = np.concatenate(
        [
            -first.friction[1:] - second.friction[1:],
            second.elastic[1:] - first.elastic[1:],
            -(first.drag_work * a**2 + second.drag_work * end**2)[None],
        ]
    )
    if drag:
        end_derivatives -= drag * (
            first.drag_work_derivatives[:-1] * a**2 + second.drag_work_derivatives[:-1] * end**2
        )
    end_moment = moments.friction.moment(end) - moments.elastic.moment(end)
    end_derivatives /= (
        end + end_moment + drag * end * (2 * second.drag_work + second.drag_work_derivatives[-1])
    )
    time_derivatives = (
        first.time_derivatives[:-1]
        + second.time_derivatives[:-1]
        + second.time_derivatives[-1] / end * end_derivatives
    )
    indices = np.array([*moments.friction.parameter_indices, *moments.elastic.parameter_indices, count - 3])
    rows = np.zeros((2 + 2 * count, len(a)))
    rows[0], rows[1] = end / a, first.time + second.time
    np.add.at(rows, 2 + indices, end_derivatives / a)
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
    propose_starts: StartProposal,
) -> Law:
    """A law of friction and elastic moment; `Coordinates` describes the last three arguments."""

    def moments(
        phi_rad: Floats, direction: Floats, values: Mapping[str, float], pendulum: PendulumOnBall
    ) -> BranchMoments:
        scaled = scaled_values(scalings, values, pendulum, 1.0).values()
        law_moments = moments_function(np.array([*scaled, 0.0, 1.0, relative_curvature(pendulum)]), 0.0, 0.0)
        if law_moments is None:
            # a fit may end where the law has no moments; NaN is not plotted
            undefined = np.full(np.shape(phi_rad), np.nan)
            return BranchMoments(undefined, undefined)
        weight, size = weight_moment(pendulum), np.abs(phi_rad)
        with np.errstate(all="ignore"):  # ln 0 in derivatives
            friction, elastic = (moment.moment(size) for moment in law_moments)
        return BranchMoments(-weight * np.sign(direction) * friction, weight * np.sign(phi_rad) * elastic)

    return Law(
        name=name,
        title=title,
        source=source,
        parameters=tuple(parameters),
        branch_moments=moments,
        table=partial(memoryless_table, moments_function),
        coordinates=partial(
            Coordinates,
            parameters=parameters,
            scalings=scalings,
            valley_coordinates=valley_coordinates,
            propose_starts=propose_starts,
        ),
    )

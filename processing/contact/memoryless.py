"""Half-swings of a law without memory: friction and elastic moment are functions of the angle.

    M = -m g R f(|phi|) sign(phi') + m g R e(|phi|) sign(phi) - m g R drag phi'/w0

With D and V, the integrals of f and e from 0 (their works), a swing from A turns next at A' where

    A^2/2 - V(A) - D(A) = A'^2/2 - V(A') + D(A')

and either quarter lasts ``integral dtheta / (2 pi sqrt(G))`` in units of T0, with x = A cos theta and

    G = 1 - 2 [V(A) - V(x) +- (D(A) - D(x))] / (A sin theta)^2

(+ after the turning point, - before it). The drag takes ``drag A^2`` times the integral of ``sin^2 sqrt(G)``
in each quarter, and changes G by twice that over ``sin^2 theta``, with the integral up to theta.

A law states f, e, D and V together with their derivatives by its parameters; those of a half-swing follow.
Angles and the moments over m g R are in units of a reference.
"""

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from math import ceil, log
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from processing.arrays import Floats
from processing.contact.coordinates import Coordinates, Scaling, Straight, scaled_values
from processing.contact.half_swing import SwingTable, quarter_nodes
from processing.contact.law import BranchMoments, Law, Parameter
from processing.contact.parameters import PendulumOnBall, relative_curvature, weight_moment
from processing.contact.start_values import StartValues

_PER_OCTAVE, _BEYOND, _FEWEST = 24, 2, 4
"""Amplitudes of a table in a factor of two, how many of them lie beyond either end, and the fewest."""
_ROUNDS, _SETTLED = 60, 1e-15
"""Most iterations, and the relative change at which they end."""
_OF_DRAG = 1e-11
"""Last change of derivatives through the speed at which a drag works, relative."""
_TIGHT = 5
"""Rounds of the next amplitude and the drag before it: each gains a hundredth of the drag's moment."""


class Moment(NamedTuple):
    """A moment over m g R and its work from 0, as functions of angles x > 0 of any shape.

    Both return a last axis of the value and its derivatives by the law's parameters, then R/a (`columns`).
    """

    moment: Callable[[Floats], Floats]
    work: Callable[[Floats], Floats]


class Moments(NamedTuple):
    """A law without memory: friction against the motion, and elastic moment in the direction of phi."""

    friction: Moment
    elastic: Moment


MomentsOf = Callable[[Floats, float, float], Moments | None]
"""Of a law: its moments for the map's parameters without the first amplitude (`Columns.map_parameters`),
needed between two angles; None where the parameters have none."""


def columns(shape: tuple[int, ...], count: int, value: Floats, by: Mapping[int, Floats | float]) -> Floats:
    """Value and derivatives by `count` parameters as a last axis, those not given by place being 0."""
    out = np.zeros((*shape, 1 + count))
    out[..., 0] = value
    for place, derivative in by.items():
        out[..., 1 + place] = derivative
    return out


def no_moment(count: int) -> Moment:
    """None at all, of a law with so many parameters."""

    def nothing(x: Floats) -> Floats:
        return columns(x.shape, count, np.zeros(x.shape), {})

    return Moment(nothing, nothing)


class _Quarter(NamedTuple):
    """Quarters from or to turning points: time in T0, work of the drag over ``drag A^2``, and derivatives by
    the parameters, the drag and ln A.
    """

    time: Floats
    by: Floats
    lost: Floats
    lost_by: Floats


def _quarter(moments: Moments, a: Floats, drag: float, sign: float, *, derived: bool = True) -> _Quarter:
    """After (sign 1) or before (-1) turning points at `a`."""
    nodes = quarter_nodes()
    x, size = a[:, None] * nodes.cos, 0.5 * a[:, None] ** 2 * nodes.sin2
    works = [(one.work(a)[:, None] - one.work(x)) / size[..., None] for one in moments]
    total = works[1] + sign * works[0]  # of elastic moment and friction
    without = 1 - total[..., 0]
    factor, travelled = without, np.zeros_like(without)
    for _ in range(_ROUNDS if drag else 1):
        root = np.sqrt(factor)
        travelled = root @ nodes.travelled.T
        before, factor = factor, without - 2 * sign * drag * travelled
        if not np.any(np.abs(factor - before) > _SETTLED):
            break
    root = 1 / np.sqrt(factor)
    time = root @ nodes.weight / (2 * np.pi)
    lost = (nodes.sin2 * np.sqrt(factor)) @ nodes.weight
    if not derived:
        return _Quarter(time, time[:, None], lost, lost[:, None])
    there, along = (
        moments.elastic.moment(at)[..., 0] + sign * moments.friction.moment(at)[..., 0] for at in (a, x)
    )
    by_log_a = 2 * total[..., 0] - (a[:, None] * there[:, None] - x * along) / size
    explicit = np.concatenate(
        [-total[..., 1:], -2 * sign * travelled[..., None], by_log_a[..., None]], axis=2
    )
    by = explicit
    if drag:
        # the drag works on a speed that all of them change
        for _ in range(_ROUNDS):
            again = explicit - sign * drag * (nodes.travelled @ (by * root[..., None]))
            settled = not np.any(np.abs(again - by) > _OF_DRAG * np.max(np.abs(by), initial=0.0))
            by = again
            if settled:
                break
    by_time = -0.5 / (2 * np.pi) * ((nodes.weight * root**3)[:, None, :] @ by)[:, 0]
    lost_by = 0.5 * ((nodes.weight * nodes.sin2 * root)[:, None, :] @ by)[:, 0]
    return _Quarter(time, by_time, lost, lost_by)


def _turning(moments: Moments, highest: Floats, energy: Floats, lost: Floats) -> Floats:
    """The amplitudes below `highest` at which A'^2/2 - V + D + lost A'^2 is an energy; NaN where none is."""
    x = highest
    for _ in range(_ROUNDS):
        elastic, friction = (one.moment(x)[..., 0] for one in (moments.elastic, moments.friction))
        above = (0.5 + lost) * x**2 - moments.elastic.work(x)[..., 0] + moments.friction.work(x)[..., 0]
        following = x - (above - energy) / (x - elastic + friction + 2 * lost * x)
        following = np.clip(following, 0.1 * x, 1.5 * x)
        settled = not np.any(np.abs(following - x) > _SETTLED * highest)
        x = following
        if settled:
            break
    return np.where((energy > 0) & (x > 1e-6 * highest), x, np.nan)


def memoryless_table(
    moments_of: MomentsOf, parameters: Floats, highest: float, lowest: float
) -> SwingTable | None:
    """The law's table (`Law.table`)."""
    steps = max(_FEWEST, ceil(_PER_OCTAVE * log(highest / lowest, 2)))
    log_a = np.linspace(log(lowest), log(highest), steps + 1)
    step = log_a[1] - log_a[0]
    log_a = log_a[0] + step * np.arange(-_BEYOND, steps + 1 + _BEYOND)
    a = np.exp(log_a)
    with np.errstate(all="ignore"):  # where a search goes too far
        moments = moments_of(parameters, float(a[0]), float(a[-1]))
        if moments is None:
            return None
        rows = _rows(moments, a, float(parameters[-3]))
    return SwingTable.of(log_a, rows, _FEWEST + _BEYOND, _BEYOND)


def _rows(moments: Moments, a: Floats, drag: float) -> Floats:
    leaving = _quarter(moments, a, drag, 1.0)
    friction, elastic = moments.friction.work(a), moments.elastic.work(a)
    energy = 0.5 * a**2 - elastic[:, 0] - friction[:, 0] - drag * leaving.lost * a**2
    following = _turning(moments, a, energy, drag * leaving.lost)
    if drag:
        for _ in range(_TIGHT):
            lost = _quarter(moments, following, drag, -1.0, derived=False).lost
            before, following = following, _turning(moments, a, energy, drag * lost)
            if not np.any(np.abs(following - before) > _SETTLED * a):
                break
    coming = _quarter(moments, following, drag, -1.0)
    at_end = [one.moment(following)[:, 0] for one in (moments.elastic, moments.friction)]
    slope = following - at_end[0] + at_end[1] + drag * following * (2 * coming.lost + coming.lost_by[:, -1])
    by_works = (
        moments.elastic.work(following)[:, 1:]
        - moments.friction.work(following)[:, 1:]
        - elastic[:, 1:]
        - friction[:, 1:]
    )
    of_drag = -(leaving.lost * a**2 + coming.lost * following**2)
    by = np.column_stack([by_works, of_drag])
    if drag:
        by -= drag * (
            leaving.lost_by[:, :-1] * a[:, None] ** 2 + coming.lost_by[:, :-1] * following[:, None] ** 2
        )
    by /= slope[:, None]
    by_time = leaving.by[:, :-1] + coming.by[:, :-1] + coming.by[:, -1:] / following[:, None] * by
    nothing = np.zeros((len(a), 1))  # by the reference

    def in_order(values: Floats) -> list[Floats]:
        return [values[:, :-2], values[:, -1:], nothing, values[:, -2:-1]]

    ratio = following / a
    return np.column_stack(
        [ratio, leaving.time + coming.time, *in_order(by / a[:, None]), *in_order(by_time)]
    )


def memoryless_law(
    name: str,
    title: str,
    source: str,
    parameters: Sequence[Parameter],
    moments_of: MomentsOf,
    scalings: Mapping[str, Scaling],
    straight: Callable[[bool], Straight],
    likely: Callable[[StartValues, float], Sequence[Mapping[str, float]]],
    uncalibrated: Mapping[str, Parameter] = MappingProxyType({}),
) -> Law:
    """A law of friction and elastic moment; see `Coordinates` for the last arguments."""

    def moments(
        phi_rad: Floats, direction: Floats, values: Mapping[str, float], pendulum: PendulumOnBall
    ) -> BranchMoments:
        own = scaled_values(scalings, values, pendulum, 1.0).values()
        found = moments_of(np.array([*own, 0.0, 1.0, relative_curvature(pendulum)]), 0.0, 0.0)
        if found is None:
            # a fit may end outside of what the law takes; what is withheld is drawn nowhere
            undefined = np.full(np.shape(phi_rad), np.nan)
            return BranchMoments(undefined, undefined)
        weight, size = weight_moment(pendulum), np.abs(phi_rad)
        with np.errstate(all="ignore"):  # ln 0 in derivatives
            friction, elastic = (one.moment(size)[..., 0] for one in found)
        return BranchMoments(-weight * np.sign(direction) * friction, weight * np.sign(phi_rad) * elastic)

    return Law(
        name=name,
        title=title,
        source=source,
        parameters=tuple(parameters),
        branch_moments=moments,
        table=partial(memoryless_table, moments_of),
        columns=partial(
            Coordinates, parameters=parameters, scalings=scalings, straight=straight, likely=likely
        ),
        uncalibrated=dict(uncalibrated),
    )

"""A law that somebody states as a function: its friction, and if wanted its elastic moment, of the angle.

    M = -m g R f(|phi|) sign(phi') + m g R e(|phi|) sign(phi)

Half-swings follow as those of `law_of_splines` do, from the works of f and e by quadrature. What of e is
proportional to phi at the reference amplitude, e(1), weakens gravity, so that in units of the period there
the other moments are larger by 1/(1 - e(1)).
"""

import inspect
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from math import isfinite, log, sqrt
from typing import NamedTuple

import numpy as np

from processing.arrays import Floats, Ints
from processing.contact.branch_columns import PERIOD, BranchColumns, Scaling, logarithms_of
from processing.contact.branch_law import FREE_PERIOD
from processing.contact.law import DRAG, BranchMoments, HalfSwings, Law, Parameter
from processing.contact.law_of_splines import swing_table
from processing.contact.laws import LAWS, PAPER
from processing.contact.moments import weight_moment
from processing.contact.parameters import PendulumOnBall
from processing.contact.quadrature import quarter_nodes
from processing.contact.start_values import StartValues
from processing.contact.stated_moment import Moment, called, refuse_odd
from processing.contact.tabulated_decay import walk
from processing.errors import DataError
from processing.periods import reference_amplitude
from processing.swing import TurningPoints

_ELASTIC = ("n", "gamma_pa")
"""Of Eq. 3, which is fitted where no other elastic moment is stated."""
_LOWEST = 1e-5
"""Angle, over the smallest amplitude, below which the friction is taken as constant."""
_PER_OCTAVE, _GRID_PER_OCTAVE, _BEYOND = 40, 24, 1.08
_TIMES = (1.0, 0.3, 3.0)
"""Of the stated starts, from which the fit begins one after the other."""
_COMPARED = 24
"""Angles at which a friction is compared with the paper's, to find where its fit begins."""
_STEP = 1e-4
"""Of a parameter, for derivatives."""


class _Moments:
    """f and e over an octave or more, in units of the reference, as `law_of_splines.MomentSplines` has them:
    with one coefficient each, which is 1.
    """

    def __init__(self, friction: Moment, elastic: Moment, highest: float, lowest: float) -> None:
        from scipy.interpolate import CubicHermiteSpline  # here, as it would slow down every command

        self._f, self._e = friction, elastic
        self._first = _LOWEST * lowest
        top = _BEYOND * highest
        steps = int(_PER_OCTAVE * log(top / self._first, 2)) + 1
        u = np.linspace(log(self._first), log(top), steps + 1)
        at, weight = np.polynomial.legendre.leggauss(5)
        half = 0.5 * (u[1] - u[0])
        x, ends = np.exp(u[:-1, None] + half * (1 + at)), np.exp(u)
        works = []
        for moment in (friction, elastic):
            pieces = half * (x * moment(x)) @ weight
            below = ends[0] * float(moment(ends[:1])[0])
            works.append(
                CubicHermiteSpline(u, below + np.append(0.0, np.cumsum(pieces)), ends * moment(ends))
            )
        self._friction_work, self._elastic_work = works
        count = int(_GRID_PER_OCTAVE * log(top / (0.3 * lowest), 2)) + 1
        self.grid = np.exp(np.linspace(log(0.3 * lowest), log(top), count))
        nodes = quarter_nodes()
        x = self.grid[:, None] * nodes.cos
        size = (0.5 * self.grid[:, None] ** 2 * nodes.sin2)[..., None]
        self.lost = (self.friction_work(self.grid)[:, None] - self.friction_work(x)) / size
        self.stored = (self.elastic_work(self.grid)[:, None] - self.elastic_work(x)) / size

    def friction(self, x: Floats) -> Floats:
        return np.asarray(self._f(np.maximum(x, self._first))[..., None])

    def elastic(self, x: Floats) -> Floats:
        return np.asarray(self._e(np.maximum(x, self._first))[..., None])

    def friction_work(self, x: Floats) -> Floats:
        return self._work(self._friction_work, x)

    def elastic_work(self, x: Floats) -> Floats:
        return self._work(self._elastic_work, x)

    def _work(self, work: Callable[[Floats], Floats], x: Floats) -> Floats:
        share = np.minimum(x / self._first, 1.0)
        return np.asarray((share * work(np.log(np.maximum(x, self._first))))[..., None])


class _Swung(NamedTuple):
    """Turning points, and their derivatives by the drag and the first amplitude."""

    amplitude: Floats
    time: Floats
    by_last: tuple[Floats, Floats]


class _Stated:
    """The half-swing map of stated moments; its parameters are theirs, drag, reference, first amplitude."""

    def __init__(
        self,
        friction: Moment,
        elastic: Callable[[Floats, Mapping[str, float]], Floats],
        names: tuple[str, ...],
        of_friction: tuple[str, ...],
        start: Mapping[str, float],
        amplitudes: tuple[float, float],
        *,
        scaled_by_n: bool,
    ) -> None:
        self._friction, self._elastic = friction, elastic
        self._names, self._of_friction = names, of_friction
        self._scale = [abs(start[name]) or 1.0 for name in names]
        self._highest, self._lowest = amplitudes
        self._scaled_by_n = scaled_by_n

    def values(self, own: Floats, reference: float) -> dict[str, float]:
        found = dict(zip(self._names, own.tolist(), strict=True))
        if self._scaled_by_n:
            n, gamma = _ELASTIC
            found[gamma] *= reference ** -found[n]
        return found

    def _swing(self, parameters: Floats, index: Ints) -> _Swung:
        count = len(self._names)
        drag, reference, first = parameters[count:].tolist()
        known = self.values(parameters[:count], reference)
        of_friction = {name: known[name] for name in self._of_friction}
        at_one = float(np.ravel(self._elastic(np.array([reference]), known))[0]) / reference
        nothing = np.full(len(index), np.nan)
        if not at_one < 1:
            return _Swung(nothing, nothing, (nothing[:, None] * np.ones(2),) * 2)
        weaker = 1 - at_one
        slower = 1 / sqrt(weaker)

        def f(x: Floats) -> Floats:
            found = np.asarray(self._friction(x * reference, **of_friction), dtype=np.float64)
            return np.asarray(np.broadcast_to(found, x.shape) / (reference * weaker))

        def e(x: Floats) -> Floats:
            found = np.asarray(self._elastic(x * reference, known), dtype=np.float64)
            return np.asarray((np.broadcast_to(found, x.shape) / reference - x * at_one) / weaker)

        moments = _Moments(f, e, self._highest / reference, self._lowest / reference)
        one = np.ones(1)
        with np.errstate(all="ignore"):
            table = swing_table(moments, one, one, drag * slower)
        found = walk(lambda x: table if table is not None and x >= table.lowest else None, 4, first, index)
        by_last = found.amplitude_gradient[:, [2, 4]], found.time_gradient[:, [2, 4]] * slower
        for by in by_last:
            by[:, 0] *= slower
        return _Swung(found.amplitude, found.time * slower, by_last)

    def __call__(self, parameters: Floats, index: Ints) -> HalfSwings:
        with np.errstate(all="ignore"):  # where the search goes too far
            return self._differentiated(parameters, index)

    def _differentiated(self, parameters: Floats, index: Ints) -> HalfSwings:
        found = self._swing(parameters, index)
        count = len(self._names)
        gradients = [np.zeros((len(index), count + 3)) for _ in range(2)]
        for place, scale in enumerate(self._scale):
            step = np.zeros(len(parameters))
            step[place] = _STEP * max(abs(float(parameters[place])), 1e-3 * scale)
            above, below = (self._swing(parameters + sign * step, index) for sign in (1, -1))
            gradients[0][:, place] = (above.amplitude - below.amplitude) / (2 * step[place])
            gradients[1][:, place] = (above.time - below.time) / (2 * step[place])
        for by, by_last in zip(gradients, found.by_last, strict=True):
            by[:, [count, count + 2]] = by_last
        return HalfSwings(found.amplitude, found.time, *gradients)


def _starts_of(moment: Moment) -> dict[str, float]:
    """The parameters of a stated moment and where a fit begins: the defaults in its signature.

    Raises
    ------
    DataError
        A parameter without a number as its default.
    """
    _, *own = inspect.signature(moment).parameters.values()
    name = getattr(moment, "__name__", "law")
    for one in own:
        if not isinstance(one.default, int | float) or not isfinite(one.default):
            raise DataError(
                f"{name}: its parameter {one.name} has no number where the fit begins; state one as its "
                f"default, as in {name}(phi_rad, {one.name}=1e-3)"
            )
        if one.name in (PERIOD, DRAG.key, "initial_amplitude_rad", "start_time_s"):
            raise DataError(f"{name}: its parameter {one.name} is fitted with every law; name it otherwise")
    if not own:
        raise DataError(f"{name}: a law has the angle and at least one parameter")
    return {one.name: float(one.default) for one in own}


@dataclass(frozen=True, slots=True)
class StatedLaw:
    """A friction f(phi_rad, a=..., b=...) over m g R, and an elastic moment in the direction of phi likewise.

    Angles are above 0, arrays of any shape; without `elastic` that of Eq. 3 is fitted beside the friction.
    The defaults of the parameters are where a fit begins.
    """

    friction: Moment
    elastic: Moment | None = None

    @property
    def name(self) -> str:
        """The function's own, where it has one."""
        name = getattr(self.friction, "__name__", "")
        return name if name.isidentifier() and name not in LAWS else "stated"

    def of(self, points: TurningPoints, pendulum: PendulumOnBall, like: Mapping[str, float]) -> Law:
        """The law of one decay; from `like`, the values of the paper's law for it, period and Eq. 3 begin.

        Raises
        ------
        DataError
            A parameter without a start, or a friction that has no finite value there.
        """
        return _law(self, points, pendulum, like)


def _as_the_papers(
    friction: Moment, start: Mapping[str, float], like: Mapping[str, float], points: TurningPoints
) -> list[dict[str, float]]:
    """The parameters by which a friction is nearest to the paper's as fitted, found from its own start; none
    where the search for them fails.
    """
    from scipy.optimize import least_squares  # here, as it would slow down every command

    if not {"b", "p", "c"} <= like.keys():
        return []
    phi_rad = np.geomspace(float(points.amplitude.min()), float(points.amplitude.max()), _COMPARED)
    papers = like["c"] + like["b"] * phi_rad ** like["p"]
    scale = np.array([abs(value) or 1.0 for value in start.values()])

    def off(own: Floats) -> Floats:
        found = friction(phi_rad, **dict(zip(start, (own * scale).tolist(), strict=True)))
        return np.asarray(np.broadcast_to(np.asarray(found, dtype=np.float64) / papers - 1, phi_rad.shape))

    with np.errstate(all="ignore"):
        try:
            found = least_squares(off, np.array(list(start.values())) / scale, x_scale="jac")
        except (ValueError, DataError):  # a friction that is not finite on the way, or that refuses it
            return []
    return [dict(zip(start, (found.x * scale).tolist(), strict=True))]


def _law(
    stated: StatedLaw, points: TurningPoints, pendulum: PendulumOnBall, like: Mapping[str, float]
) -> Law:
    elastic, name = stated.elastic, stated.name
    start = _starts_of(stated.friction)
    own = tuple(start)
    friction = called(stated.friction, name)
    refuse_odd(friction, start, points, name)
    if elastic is None:
        if taken := set(own) & set(_ELASTIC):
            raise DataError(f"{name}: its parameter {min(taken)} is one of Eq. 3, which is fitted with it")
        start |= {key: like[key] for key in _ELASTIC}
    else:
        if taken := set(own) & set(_starts_of(elastic)):
            raise DataError(f"{name}: its parameter {min(taken)} is one of the elastic moment, too")
        of_elastic = _starts_of(elastic)
        elastic = called(elastic, getattr(elastic, "__name__", "elastic"))
        refuse_odd(elastic, of_elastic, points, f"{name}, elastic")
        start |= of_elastic
    names = tuple(start)
    weight = weight_moment(pendulum)
    paper = dict.fromkeys((each.key for each in PAPER.parameters), 0.0) | {"p": 1.0, PERIOD: 1.0}

    def elastic_of(phi_rad: Floats, known: Mapping[str, float]) -> Floats:
        if elastic is not None:
            return np.asarray(elastic(phi_rad, **{key: known[key] for key in names if key not in own}))
        values = {**paper, **{key: known[key] for key in _ELASTIC}}
        found = PAPER.branch_moments(phi_rad, np.ones_like(phi_rad), values, pendulum)
        return np.asarray(found.elastic_n_m / weight)

    def moments(
        phi_rad: Floats, direction: Floats, values: Mapping[str, float], pendulum: PendulumOnBall
    ) -> BranchMoments:
        size = np.abs(phi_rad)
        against = np.broadcast_to(friction(size, **{key: values[key] for key in own}), size.shape)
        along = np.broadcast_to(elastic_of(size, values), size.shape)
        return BranchMoments(-weight * np.sign(direction) * against, weight * np.sign(phi_rad) * along)

    reference = reference_amplitude(points)
    scalings = dict.fromkeys(names, Scaling())
    scaled = dict(start)
    if elastic is None:
        n, gamma = _ELASTIC
        scalings[gamma] = Scaling(0.0, -1.0, n)
        scaled[gamma] *= reference ** start[n]

    stated_start = {key: start[key] for key in own}
    as_papers = _as_the_papers(friction, stated_start, like, points)

    def likely(_: StartValues, __: float) -> list[dict[str, float]]:
        stated = [{key: times * value for key, value in stated_start.items()} for times in _TIMES]
        return [{**scaled, **each, PERIOD: like[PERIOD]} for each in [*as_papers, *stated]]

    known = {each.key: each for each in PAPER.parameters}
    parameters = (
        *(
            known[key]
            if elastic is None and key in _ELASTIC
            else Parameter(key, key, "1", f"parameter of {name}", "stated")
            for key in names
        ),
        FREE_PERIOD,
    )
    return Law(
        name=name,
        title=(inspect.getdoc(stated.friction) or "stated").splitlines()[0].rstrip("."),
        source="stated",
        parameters=parameters,
        branch_moments=moments,
        half_swing_map=_Stated(
            friction,
            elastic_of,
            names,
            own,
            scaled,
            (float(points.amplitude.max()), float(points.amplitude.min())),
            scaled_by_n=elastic is None,
        ),
        columns=partial(
            BranchColumns, parameters=parameters, scalings=scalings, straight=logarithms_of(), likely=likely
        ),
    )

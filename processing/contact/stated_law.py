"""A law that a user states as functions of the angle: its friction and, optionally, its elastic moment.

    M = -m g R f(|phi|) sign(phi') + m g R e(|phi|) sign(phi)

The works of f and e are computed by quadrature, their derivatives with respect to the parameters by
differences.
"""

import inspect
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from math import isfinite, log

import numpy as np

from processing.arrays import Floats
from processing.contact.asymptotic import StartValues
from processing.contact.coordinates import Scaling, logarithms_of
from processing.contact.law import DRAG, FREE_PERIOD, PERIOD, Law, Parameter, PendulumOnBall, stiffness_ratio
from processing.contact.law_of_splines import work_over_log
from processing.contact.laws import LAWS, PAPER, STIFFNESS, elastic_moment
from processing.contact.memoryless import Moment, Moments, memoryless_law
from processing.decay_summary import reference_amplitude
from processing.errors import DataError
from processing.least_squares import differenced, solve
from processing.swing import TurningPoints

_ELASTIC = ("n", "gamma_pa")
"""Parameters of Eq. 3, which is fitted where no other elastic moment is stated."""
_LOWEST, _PER_OCTAVE = 1e-5, 40
"""Angle, over the smallest amplitude, below which a moment is taken as constant, and the points at which its
work is tabulated in a factor of two."""
_START_FACTORS = (1.0, 0.3, 3.0)
"""Factors of the stated start values, with each of which a fit begins."""
_COMPARED_ANGLES = 24
"""Angles at which a friction is compared with the paper's, for start values of its fit."""
_RELATIVE_STEP = 1e-4
"""Relative step of a parameter, for derivatives."""

StatedMoment = Callable[..., Floats]
"""A moment over m g R: function of |phi| (rad) and of parameters by name, whose defaults are start values."""


def _check_result(moment: StatedMoment, name: str) -> StatedMoment:
    """A stated moment whose result is an array of floats; it raises DataError with the fault of any other.

    It gets a copy of the angles, so that a function that writes into them changes no others.
    """

    def result(phi_rad: Floats, **own: float) -> Floats:
        values = ", ".join(f"{key} = {value:.6g}" for key, value in own.items())
        try:
            found = np.asarray(moment(np.array(phi_rad), **own))
        except Exception as error:
            raise DataError(
                f"{name}: raises {type(error).__name__} ({error}) for an array of {phi_rad.size} angles and "
                f"{values}; a law has a value for each of them"
            ) from error
        if found.dtype.kind not in "fiu":
            raise DataError(
                f"{name}: returns {found.dtype} for {values}; one real number for each angle is needed"
            )
        return np.asarray(found, dtype=np.float64)

    return result


def _require_finite(
    moment: StatedMoment, start: Mapping[str, float], points: TurningPoints, name: str
) -> None:
    """Raise DataError unless a moment has a finite value where a fit begins."""
    probe = np.geomspace(1e-3, 1, 9) * float(points.amplitude.max())
    found = moment(probe, **start)
    if found.shape not in ((), probe.shape) or not np.all(np.isfinite(found)):
        raise DataError(
            f"{name}: returns an array of shape {found.shape} for {len(probe)} angles, with "
            f"{int(np.isfinite(found).sum())} finite numbers; one for each angle is needed"
        )


def _by_quadrature(
    stated: StatedMoment,
    values: Mapping[str, float],
    steps: Mapping[str, float],
    names: tuple[str, ...],
    reference: float,
    lowest: float,
    highest: float,
) -> Moment:
    """A stated moment in units of the reference; its parameters are those of `values`, in `names`."""
    first = _LOWEST * lowest

    def at(x: Floats, changed: Mapping[str, float]) -> Floats:
        found = stated(x * reference, **{**values, **changed}) / reference
        return np.asarray(np.broadcast_to(found, x.shape))

    def moment(x: Floats) -> Floats:
        return at(np.maximum(x, first), {})

    def with_derivatives(x: Floats) -> Floats:
        found = [at(x, {})]
        for name, value in values.items():
            high, low = value + steps[name], value - steps[name]
            found.append((at(x, {name: high}) - at(x, {name: low})) / (high - low))
        return np.stack(found, axis=-1)

    @cache
    def tabulated() -> Callable[[Floats], Floats]:
        u = np.linspace(log(first), log(highest), int(_PER_OCTAVE * log(highest / first, 2)) + 2)
        return work_over_log(u, with_derivatives, lambda x: x[:, None] * with_derivatives(x))

    def work(x: Floats) -> Floats:
        share = np.minimum(x / first, 1.0)[..., None]
        return np.moveaxis(share * tabulated()(np.log(np.maximum(x, first))), -1, 0)

    return Moment(tuple(map(names.index, values)), moment, work)


def _starts_of(moment: StatedMoment) -> dict[str, float]:
    """The parameters of a stated moment with their start values, the defaults in its signature.

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

    Angles are above 0, arrays of any shape; without `elastic` that of Eq. 3 is fitted with the friction.
    The defaults of the parameters are the start values of a fit.
    """

    friction: StatedMoment
    elastic: StatedMoment | None = None

    @property
    def name(self) -> str:
        """Name of the friction's function, or ``stated`` if it has none or that of another law."""
        name = getattr(self.friction, "__name__", "")
        return name if name.isidentifier() and name not in LAWS else "stated"

    def of(self, points: TurningPoints, pendulum: PendulumOnBall, like: Mapping[str, float]) -> Law:
        """The law of one decay; `like`, the paper's law fitted to it, gives start values of period and Eq. 3.

        Raises
        ------
        DataError
            A parameter without a start value, or a moment without finite values there.
        """
        return _law(self, points, pendulum, like)


def _starts_near_paper(
    friction: StatedMoment, start: Mapping[str, float], like: Mapping[str, float], points: TurningPoints
) -> list[dict[str, float]]:
    """Start values with which a friction is nearest to the paper's fitted one, searched from its own; none
    where the search fails.
    """
    if not {"b", "p", "c"} <= like.keys():
        return []
    phi_rad = np.geomspace(float(points.amplitude.min()), float(points.amplitude.max()), _COMPARED_ANGLES)
    papers = like["c"] + like["b"] * phi_rad ** like["p"]
    scale = np.array([abs(value) or 1.0 for value in start.values()])

    def off(own: Floats) -> Floats:
        found = friction(phi_rad, **dict(zip(start, (own * scale).tolist(), strict=True)))
        return np.asarray(np.broadcast_to(np.asarray(found, dtype=np.float64) / papers - 1, phi_rad.shape))

    with np.errstate(all="ignore"):
        try:
            found = solve(differenced(off), np.array(list(start.values())) / scale)
        except (ValueError, DataError):  # a friction that is not finite on the way, or that refuses it
            return []
    return [dict(zip(start, (found.values * scale).tolist(), strict=True))]


def _law(
    stated: StatedLaw, points: TurningPoints, pendulum: PendulumOnBall, like: Mapping[str, float]
) -> Law:
    elastic, name = stated.elastic, stated.name
    start = _starts_of(stated.friction)
    own = tuple(start)
    friction = _check_result(stated.friction, name)
    _require_finite(friction, start, points, name)
    if elastic is None:
        if taken := set(own) & set(_ELASTIC):
            raise DataError(f"{name}: its parameter {min(taken)} is one of Eq. 3, which is fitted with it")
        start |= {key: like[key] for key in _ELASTIC}
    else:
        if taken := set(own) & set(_starts_of(elastic)):
            raise DataError(f"{name}: its parameter {min(taken)} is one of the elastic moment, too")
        of_elastic = _starts_of(elastic)
        elastic = _check_result(elastic, getattr(elastic, "__name__", "elastic"))
        _require_finite(elastic, of_elastic, points, f"{name}, elastic")
        start |= of_elastic
    names = tuple(start)
    scale = {name: 1e-3 * (abs(value) or 1.0) for name, value in start.items()}
    rest = tuple(name for name in names if name not in own)

    def moments_function(parameters: Floats, lowest: float, highest: float) -> Moments:
        known = dict(zip(names, parameters[:-3].tolist(), strict=True))
        steps = {name: _RELATIVE_STEP * max(abs(value), scale[name]) for name, value in known.items()}
        _, reference, rho = parameters[-3:].tolist()

        def stated_one(moment: StatedMoment, keys: tuple[str, ...]) -> Moment:
            values = {key: known[key] for key in keys}
            return _by_quadrature(moment, values, steps, names, reference, lowest, highest)

        return Moments(
            stated_one(friction, own),
            elastic_moment(known["n"], known["gamma_pa"], rho, (*map(names.index, _ELASTIC), len(names) + 2))
            if elastic is None
            else stated_one(elastic, rest),
        )

    reference = reference_amplitude(points)
    scalings = dict.fromkeys(names, Scaling())
    scaled = dict(start)
    if elastic is None:
        n, gamma = _ELASTIC
        scalings[gamma] = STIFFNESS
        scaled[gamma] *= stiffness_ratio(1.0, pendulum) * reference ** start[n]

    stated_start = {key: start[key] for key in own}
    near_paper = _starts_near_paper(friction, stated_start, like, points)

    def propose_starts(_: StartValues, __: float) -> list[dict[str, float]]:
        stated = [{key: times * value for key, value in stated_start.items()} for times in _START_FACTORS]
        return [{**scaled, **each, PERIOD: like[PERIOD]} for each in [*near_paper, *stated]]

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
    return memoryless_law(
        name,
        (inspect.getdoc(stated.friction) or "stated").splitlines()[0].rstrip("."),
        "stated",
        parameters,
        moments_function,
        scalings,
        lambda _: logarithms_of(),
        propose_starts,
    )

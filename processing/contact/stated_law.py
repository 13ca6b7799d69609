"""A law that a user states as functions of the angle: its friction and, optionally, its elastic moment.

    M = -m g R f(|phi|) sign(phi') + m g R e(|phi|) sign(phi)

The works of f and e are computed by quadrature, their derivatives with respect to the parameters by
differences.
"""

import inspect
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import cache
from math import isfinite, log

import numpy as np

from processing.arrays import Floats
from processing.contact.asymptotic import StartValues
from processing.contact.coordinates import Scaling, logarithms_of
from processing.contact.law import (
    AMPLITUDE,
    DRAG,
    FREE_PERIOD,
    PERIOD,
    TIME,
    Law,
    Parameter,
    PendulumOnBall,
    stiffness_ratio,
)
from processing.contact.law_of_splines import work_over_log
from processing.contact.laws import LAWS, PAPER, STIFFNESS, elastic_moment
from processing.contact.memoryless import Moment, Moments, memoryless_law
from processing.decay_summary import reference_amplitude
from processing.errors import DataError
from processing.least_squares import differenced, solve
from processing.swing import TurningPoints

_ELASTIC_KEYS = ("n", "gamma_pa")
"""Parameters of Eq. 3, which is fitted where no other elastic moment is stated."""
_LOWEST_RATIO = 1e-5
"""Angle, over the smallest amplitude, below which a moment is taken as constant."""
_POINTS_PER_OCTAVE = 40
"""Number of points in a factor of two at which the work of a moment is tabulated."""
_START_FACTORS = (1.0, 0.3, 3.0)
"""Factors of the stated start values, with each of which a fit is tried to begin."""
_COMPARED_ANGLES = 24
"""Angles at which a friction is compared with the paper's, for start values of its fit."""
_RELATIVE_STEP = 1e-4
"""Relative step of a parameter, for derivatives."""

StatedMoment = Callable[..., Floats]
"""A moment over m g R: function of |phi| (rad) and of parameters by name, whose defaults are start values."""


def _check_result(moment: StatedMoment, name: str) -> StatedMoment:
    """A stated moment whose result is an array of floats; it raises DataError if that of `moment` is none."""

    def checked(phi_rad: Floats, **parameters: float) -> Floats:
        values = ", ".join(f"{key} = {value:.6g}" for key, value in parameters.items())
        try:
            # a copy: a function of the user may write into its angles
            result = np.asarray(moment(np.array(phi_rad), **parameters))
        except Exception as error:
            raise DataError(
                f"{name}: raises {type(error).__name__} ({error}) for an array of {phi_rad.size} angles and "
                f"{values}; a law has a value for each of them"
            ) from error
        if result.dtype.kind not in "fiu":
            raise DataError(
                f"{name}: returns {result.dtype} for {values}; one real number for each angle is needed"
            )
        return np.asarray(result, dtype=np.float64)

    return checked


def _require_finite(
    moment: StatedMoment, start: Mapping[str, float], points: TurningPoints, name: str
) -> None:
    """Raise DataError unless a moment has a finite value where a fit begins."""
    phi_rad = np.geomspace(1e-3, 1, 9) * float(points.amplitude.max())
    result = moment(phi_rad, **start)
    if result.shape not in ((), phi_rad.shape) or not np.all(np.isfinite(result)):
        raise DataError(
            f"{name}: returns an array of shape {result.shape} for {len(phi_rad)} angles, with "
            f"{int(np.isfinite(result).sum())} finite numbers; one for each angle is needed"
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
    first = _LOWEST_RATIO * lowest

    def evaluate(x: Floats, **changed: float) -> Floats:
        result = stated(x * reference, **{**values, **changed}) / reference
        return np.asarray(np.broadcast_to(result, x.shape))

    def moment(x: Floats) -> Floats:
        return evaluate(np.maximum(x, first))

    def with_derivatives(x: Floats) -> Floats:
        columns = [evaluate(x)]
        for name, value in values.items():
            high, low = value + steps[name], value - steps[name]
            columns.append((evaluate(x, **{name: high}) - evaluate(x, **{name: low})) / (high - low))
        return np.stack(columns, axis=-1)

    @cache
    def work_table() -> Callable[[Floats], Floats]:
        count = int(_POINTS_PER_OCTAVE * log(highest / first, 2)) + 2
        log_x = np.linspace(log(first), log(highest), count)
        return work_over_log(log_x, with_derivatives, lambda x: x[:, None] * with_derivatives(x))

    def work(x: Floats) -> Floats:
        fraction = np.minimum(x / first, 1.0)[..., None]
        return np.moveaxis(fraction * work_table()(np.log(np.maximum(x, first))), -1, 0)

    return Moment(tuple(map(names.index, values)), moment, work)


def _starts_of(moment: StatedMoment) -> dict[str, float]:
    """The parameters of a stated moment with their start values, the defaults in its signature."""
    _, *parameters = inspect.signature(moment).parameters.values()
    name = getattr(moment, "__name__", "law")
    for parameter in parameters:
        if not isinstance(parameter.default, int | float) or not isfinite(parameter.default):
            raise DataError(
                f"{name}: its parameter {parameter.name} has no number where the fit begins; state one as "
                f"its default, as in {name}(phi_rad, {parameter.name}=1e-3)"
            )
        if parameter.name in (PERIOD, DRAG.key, AMPLITUDE.key, TIME.key):
            raise DataError(
                f"{name}: its parameter {parameter.name} is fitted with every law; name it otherwise"
            )
    if not parameters:
        raise DataError(f"{name}: a law has the angle and at least one parameter")
    return {parameter.name: float(parameter.default) for parameter in parameters}


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

    def of(self, points: TurningPoints, pendulum: PendulumOnBall, paper_values: Mapping[str, float]) -> Law:
        """The law of one decay; the parameters of the paper's law fitted to it give start values.

        Raises DataError for a parameter without a start value, or a moment without finite values there.
        """
        return _law(self, points, pendulum, paper_values)


def _starts_near_paper(
    friction: StatedMoment,
    start: Mapping[str, float],
    paper_values: Mapping[str, float],
    points: TurningPoints,
) -> list[dict[str, float]]:
    """Start values with which a friction is nearest to the paper's fitted one, searched from `start`; none if
    the search fails.
    """
    if not {"b", "p", "c"} <= paper_values.keys():
        return []
    phi_rad = np.geomspace(float(points.amplitude.min()), float(points.amplitude.max()), _COMPARED_ANGLES)
    paper_friction = paper_values["c"] + paper_values["b"] * phi_rad ** paper_values["p"]
    scale = np.array([abs(value) or 1.0 for value in start.values()])

    def by_key(columns: Floats) -> dict[str, float]:
        return dict(zip(start, (columns * scale).tolist(), strict=True))

    def residuals(columns: Floats) -> Floats:
        result = friction(phi_rad, **by_key(columns))
        return np.asarray(np.broadcast_to(result / paper_friction - 1, phi_rad.shape))

    with np.errstate(all="ignore"):
        try:
            solution = solve(differenced(residuals), np.array(list(start.values())) / scale)
        except (ValueError, DataError):  # a friction that is not finite on the way, or that refuses it
            return []
    return [by_key(solution.values)]


def _law(
    stated: StatedLaw, points: TurningPoints, pendulum: PendulumOnBall, paper_values: Mapping[str, float]
) -> Law:
    elastic, name = stated.elastic, stated.name
    friction_start = _starts_of(stated.friction)
    friction = _check_result(stated.friction, name)
    _require_finite(friction, friction_start, points, name)
    if elastic is None:
        elastic_start, owner = (
            {key: paper_values[key] for key in _ELASTIC_KEYS},
            "Eq. 3, which is fitted with it",
        )
    else:
        elastic_start, owner = _starts_of(elastic), "the elastic moment, too"
        elastic = _check_result(elastic, getattr(elastic, "__name__", "elastic"))
        _require_finite(elastic, elastic_start, points, f"{name}, elastic")
    if shared := friction_start.keys() & elastic_start.keys():
        raise DataError(f"{name}: its parameter {min(shared)} is one of {owner}")
    start = friction_start | elastic_start
    names = tuple(start)
    scale = {name: 1e-3 * (abs(value) or 1.0) for name, value in start.items()}

    def moments_function(parameters: Floats, lowest: float, highest: float) -> Moments:
        all_values = dict(zip(names, parameters[:-3].tolist(), strict=True))
        steps = {name: _RELATIVE_STEP * max(abs(value), scale[name]) for name, value in all_values.items()}
        _, reference, rho = parameters[-3:].tolist()

        def moment_of(stated_moment: StatedMoment, keys: Iterable[str]) -> Moment:
            values = {key: all_values[key] for key in keys}
            return _by_quadrature(stated_moment, values, steps, names, reference, lowest, highest)

        if elastic is not None:
            return Moments(moment_of(friction, friction_start), moment_of(elastic, elastic_start))
        indices = (*map(names.index, _ELASTIC_KEYS), len(names) + 2)
        n, kappa = (all_values[key] for key in _ELASTIC_KEYS)
        return Moments(moment_of(friction, friction_start), elastic_moment(n, kappa, rho, indices))

    scalings = dict.fromkeys(names, Scaling())
    scaled = dict(start)
    if elastic is None:
        n, gamma = _ELASTIC_KEYS
        scalings[gamma] = STIFFNESS
        scaled[gamma] *= stiffness_ratio(1.0, pendulum) * reference_amplitude(points) ** start[n]

    near_paper = _starts_near_paper(friction, friction_start, paper_values, points)

    def propose_starts(_: StartValues, __: float) -> list[dict[str, float]]:
        multiples = [
            {key: factor * value for key, value in friction_start.items()} for factor in _START_FACTORS
        ]
        return [{**scaled, **values, PERIOD: paper_values[PERIOD]} for values in [*near_paper, *multiples]]

    parameters = (
        *(
            PAPER.parameter(key)
            if elastic is None and key in _ELASTIC_KEYS
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

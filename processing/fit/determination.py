"""Confidence intervals of parameters that the data determine poorly, by the profile likelihood.

A value with a symmetric uncertainty describes a parameter only if chi2 is nearly a parabola. Otherwise the
profile likelihood gives the interval: the parameter is held at a value, all others are fitted again, and the
interval ends where chi2 has risen by the amount that corresponds to the coverage.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from math import nan
from typing import NamedTuple

import numpy as np

from processing.arrays import Floats
from processing.contact import PendulumOnBall
from processing.errors import DataError
from processing.estimate import WELL_DETERMINED, Determinacy, FitMethod
from processing.fit.exact import starts_of
from processing.fit.exact_model import ExactModel
from processing.fit.exact_result import impossible_signs
from processing.fit.result import FitResult
from processing.least_squares import FactoredJacobian, Solution, solve
from processing.swing import TurningPoints

_MAX_PARABOLIC_U = 0.01
"""Relative standard uncertainty up to which chi2 is taken as a parabola, without its profile."""
_MIN_BENT_CORRELATION = 0.7
"""Correlation with a parameter whose chi2 is no parabola above which the profile of another is computed."""
_MAX_EVALUATIONS = 40
"""Most evaluations of the model in one refit; where an unconverged one would set a limit, as many again."""
_MAX_UNCONVERGED = 1
"""Most refits without convergence that the search on one side passes over; one more ends it."""
_MAX_RISE_RATIO = 10.0
"""Root of the rise of chi2, over that of a limit, beyond which a refit lies outside the valley. It sets a
limit only if the search has come next to it inside the valley."""
_MAX_HELD_VALUES = 20
"""Most values at which a parameter is held on each side."""
_MAX_END_DIFFERENCE = 0.15
"""Largest difference between ends of the interval by the profile and that by the covariance, over the
half-width, at which value and uncertainty describe a parameter."""


class Determination(NamedTuple):
    """Verdict of the data on one parameter: a value, an interval, a bound or none."""

    name: str
    verdict: Determinacy
    lower_95: float
    """NaN if the data set no limit; 0 if only physics does, since friction dissipates energy."""
    upper_95: float
    """NaN if the data set no limit."""
    profile_likelihood: bool = False
    """Whether the limits come from the profile likelihood."""


class _ConditionalModel:
    """The exact model with one physical parameter held fixed, and therefore one coordinate less."""

    def __init__(self, model: ExactModel, name: str, best: Floats) -> None:
        self._model = model
        self.row = model.names.index(name)
        is_positive = bool(model.parametrisation.physical(best)[0][self.row] > 0)
        self._is_logarithmic = model.law.parameter(name).logarithmic and is_positive
        self.missing, self._keeps_sign = model.parametrisation.held(name)
        self.free = np.delete(np.arange(len(model.lower)), self.missing)
        self.guess = float(best[self.missing])  # at the last values, where the next search begins

    def full(self, held: float, free: Floats) -> tuple[Floats, Floats]:
        """All coordinates, the missing one by Newton's method, and its derivatives by the others."""
        coordinates = np.empty(len(free) + 1)
        coordinates[self.free] = free
        coordinates[self.missing] = self.guess
        for _ in range(50 if np.all(np.isfinite(free)) else 0):
            values, slopes = self._model.parametrisation.physical(coordinates)
            value, slope = values[self.row], slopes[self.row]
            if not np.all(np.isfinite(slope)):
                break
            if self._is_logarithmic and not value / held > 0:
                break
            if self._is_logarithmic:
                error, error_slope = np.log(value / held), slope[self.missing] / value
            else:
                error, error_slope = value - held, slope[self.missing]
            with np.errstate(all="ignore"):
                step = np.divide(error, error_slope)
            if not np.isfinite(step):
                break
            if self._is_logarithmic and self._keeps_sign:
                half = 0.5 * abs(float(coordinates[self.missing]))
                step = float(np.clip(step, -half, half))
            coordinates[self.missing] -= step
            if abs(step) <= 1e-13 * max(abs(coordinates[self.missing]), 1e-3):
                self.guess = float(coordinates[self.missing])
                return coordinates, -slope[self.free] / slope[self.missing]
        return np.full(len(coordinates), np.nan), np.zeros(len(free))

    def with_held(self, held: float) -> Callable[[Floats], tuple[Floats, Floats]]:
        """The model of the free coordinates, with the parameter held at a value."""

        def model(free: Floats) -> tuple[Floats, Floats]:
            coordinates, missing_by_free = self.full(held, free)
            residuals, jacobian = self._model(coordinates)
            jacobian[:, self.free] += jacobian[:, [self.missing]] * missing_by_free
            return residuals, jacobian[:, self.free]

        return model

    def follow(self, held: float, free: Floats, target: float) -> Floats:
        """Estimate of the free coordinates at another value of the held parameter (one Gauss-Newton step)."""
        residuals, jacobian = self.with_held(held)(free)
        step = 1e-3 * (target - held)
        if held + step == held:
            return free
        change = (self.with_held(held + step)(free)[0] - residuals) * ((target - held) / step)
        if not np.all(np.isfinite(change)):
            return free
        return free - FactoredJacobian(jacobian).coefficients(change)


@dataclass(frozen=True)
class Profile:
    """Limits of one parameter by the profile likelihood; NaN if chi2 does not rise enough."""

    lower: float
    upper: float
    trace: Floats
    """Rows of (value, rise of chi2) in order of rising value."""
    allowed: Floats
    """All coordinates (points, n) at the values within the limits."""


def profile_likelihood(
    points: TurningPoints,
    pendulum: PendulumOnBall,
    result: FitResult,
    name: str,
    *,
    coverage: float = 0.95,
    begin: Floats | None = None,
) -> Profile:
    """Profile likelihood of one parameter on both sides of its fitted value.

    Parameters
    ----------
    result
        The exact fit of the same points. `name` is one of its contact parameters or ``drag_s``.
    begin
        Coordinates at which the search on both sides begins, near another minimum; default: at the fit.

    Notes
    -----
    The noise is that of the fit. The rise of chi2 is divided by max(1, chi2/dof) and by the square of the
    fit's `u_inflation`; the limit is where its square root equals Student's t. b and gamma are varied on a
    logarithmic scale if their estimates are positive. The search ends at ten standard uncertainties (b and
    gamma: at a factor of a million), or at zero for parameters that cannot be negative. Where the fit itself
    lies below zero, the rise counts from the best fit at zero: a limit is never one of impossible values.
    A refit that has not converged bounds the rise of chi2 from above: the search may pass it, but it sets no
    limit. The search then goes nearer to the best fit, and soon ends without a limit.
    """
    from scipy.special import stdtrit

    if result.method is not FitMethod.EXACT:
        raise DataError("a profile likelihood belongs to an exact fit")
    model, best = ExactModel.of(points, pendulum, result)
    parameter = result.law.parameter(name)
    value, u = result.estimate(name)
    if not np.isfinite(u):
        u = abs(value) or 1.0
    scale = result.scatter2 * float(result.inflation[result.names.index(name)]) ** 2
    target = float(stdtrit(result.dof, 0.5 * (1 + coverage)))
    conditional = _ConditionalModel(model, name, best)
    low_end, high_end = model.lower[conditional.free], model.upper[conditional.free]
    refit = partial(solve, lower=low_end, upper=high_end, loss=result.loss, cost_tolerance=1e-7)
    logarithmic = parameter.logarithmic and value > 0
    lowest_cost, free_at_lowest = result.cost, best[conditional.free]
    if parameter.lower == 0 and value < 0:
        start = np.clip(conditional.follow(value, free_at_lowest, 0.0), low_end, high_end)
        at_zero = _refit(refit, conditional.with_held(0.0), start)
        if at_zero is None:
            return Profile(nan, nan, np.array([[value, 0.0]]), np.empty((0, len(best))))
        value, lowest_cost, free_at_lowest = 0.0, at_zero.cost, at_zero.values
    root_at_begin = 0.0
    if begin is not None:
        value = float(model.parametrisation.physical(begin)[0][conditional.row])
        free_at_lowest, conditional.guess = begin[conditional.free], float(begin[conditional.missing])
        residuals = model(begin)[0]
        root_at_begin = float(np.sqrt(max(float(residuals @ residuals) - 2 * lowest_cost, 0.0) / scale))
    guess_at_lowest = conditional.guess
    trace: list[tuple[float, float]] = [(value, root_at_begin**2)]
    allowed: list[Floats] = []

    def value_at(z: float) -> float:
        return float(value * np.exp(z)) if logarithmic else value + z

    def rise_root(solution: Solution) -> float:
        return float(np.sqrt(max(2 * (solution.cost - lowest_cost), 0.0) / scale))

    def is_open(solution: Solution) -> bool:
        return not solution.converged and rise_root(solution) > 0.99 * target

    def side(sign: float) -> float:
        unit = min(u / value, 1.0) if logarithmic else u
        farthest = 14.0 if logarithmic else 10 * target * unit
        room = value - parameter.lower if sign < 0 else parameter.upper - value
        if np.isfinite(room) and not logarithmic:
            if room <= 0:
                return float("nan")
            # 0 itself is included, but not the limit of a range of search
            farthest = min(farthest, room if parameter.lower == 0 else 0.999 * room)
        free, guess = free_at_lowest, guess_at_lowest
        low, low_root = 0.0, root_at_begin
        high, high_root = np.inf, np.inf
        z = farthest_step = min(target * unit, farthest)
        was_below: bool | None = None
        unconverged_count = 0
        for _ in range(_MAX_HELD_VALUES):
            # a refit that went astray leaves a guess from which none of the next ones begins
            conditional.guess = guess
            start = conditional.follow(value_at(sign * low), free, value_at(sign * z))
            start = np.clip(start, low_end + 1e-9, high_end - 1e-9)
            model_at_z = conditional.with_held(value_at(sign * z))
            solution = _refit(refit, model_at_z, start)
            if solution is not None and is_open(solution):
                solution = _refit(refit, model_at_z, solution.values)
                if solution is not None and is_open(solution):
                    solution, unconverged_count = None, unconverged_count + 1
                    if unconverged_count > _MAX_UNCONVERGED:
                        z = high
                        break
            root = np.inf if solution is None else rise_root(solution)
            if solution is None or root > _MAX_RISE_RATIO * target:
                # the law has no value there, or the refit went astray: u may be thousands of times the range
                # that the law allows, and the valley may bend
                farthest_step = (z - low) * (0.5 if low else 0.1)
                nearest, next_value = value_at(sign * low), value_at(sign * (low + farthest_step))
                if farthest_step < 1e-3 * low or abs(next_value - nearest) < 1e-9 * abs(nearest):
                    z = high if solution is None else z
                    break
                z = low + farthest_step
                continue
            trace.append((value_at(sign * z), root**2))
            is_below = root < target
            if abs(root - target) < 0.01 * target:
                break
            # an end that stays for a second time counts half as far from the target (the Illinois method)
            if is_below:
                if was_below:
                    high_root = target + 0.5 * (high_root - target)
                free, guess = solution.values, conditional.guess
                allowed.append(conditional.full(value_at(sign * z), free)[0])
                farthest_step = max(farthest_step, 2.5 * (z - low))
                low, low_root = z, root
                if z >= farthest:
                    return float("nan")
            else:
                if was_below is False:
                    low_root = target - 0.5 * (target - low_root)
                high, high_root = z, root
            was_below = is_below
            if np.isfinite(high):
                # the square root of the rise is nearly linear in z
                share = (target - low_root) / (high_root - low_root)
                z = low + (high - low) * float(np.clip(share, 0.02, 0.98))
                if high - low < 1e-3 * high:
                    break
            else:
                estimate = z * target / root if root > 0 else 2 * z
                z = min(float(np.clip(1.02 * estimate, 1.05 * z, 2.5 * z)), low + farthest_step, farthest)
        else:
            # no more values are tried: the limit lies before the end that is known to be beyond it
            z = high
        return value_at(sign * z) if np.isfinite(z) else float("nan")

    if not np.all(np.isfinite(model(best)[0])):
        raise DataError(f"the fitted parameters do not reach the last half-cycle; no profile of {name}")
    lower, upper = side(-1.0), side(1.0)
    trace.sort()
    return Profile(lower, upper, np.array(trace), np.reshape(allowed, (-1, len(best))))


def _refit(
    refit: Callable[..., Solution], model: Callable[[Floats], tuple[Floats, Floats]], start: Floats
) -> Solution | None:
    """The other parameters fitted again; None where the law has no value at the start."""
    try:
        return refit(model, start, max_evaluations=_MAX_EVALUATIONS)
    except DataError:
        return None


def identifiability(
    points: TurningPoints, pendulum: PendulumOnBall, result: FitResult
) -> tuple[Determination, ...]:
    """Verdict on every parameter of an exact fit; for poorly determined ones by the profile likelihood.

    A parameter that cannot be negative but lies far below zero shows that the law is not that of the motion.
    Others that would move by more than their uncertainty, were it at zero, are not determined.
    """
    correlation = np.abs(result.correlation)
    undetermined = set[str]()
    for cause, below_u in impossible_signs(result.law, result.estimates()).items():
        shifts_u = below_u * correlation[result.names.index(cause)]
        undetermined |= {
            name
            for name in result.contact_names
            if name != cause and shifts_u[result.names.index(name)] > 1.0
        }
    verdicts = {name: Determination(name, Determinacy.UNDETERMINED, nan, nan) for name in undetermined}
    profiles: dict[str, Profile] = {}

    def determine(name: str, max_parabolic_u: float = _MAX_PARABOLIC_U) -> None:
        value, u = result.estimate(name)
        if not u <= max_parabolic_u * abs(value):
            profiles[name] = profile_likelihood(points, pendulum, result, name)
        verdicts[name] = _determination(result, name, profiles.get(name))

    names = [name for name in result.contact_names if name not in undetermined]
    for name in names:
        determine(name)
    # T0 is known to per mille however wrong it is: only the profile shows that it bends with an unknown n
    bent = [result.names.index(name) for name in names if verdicts[name].profile_likelihood]
    for name in names:
        bends = bool(np.any(correlation[result.names.index(name), bent] > _MIN_BENT_CORRELATION))
        if bends and not verdicts[name].profile_likelihood:
            determine(name, 0.0)
    if profiles:
        model = ExactModel.of(points, pendulum, result)[0]
        allowed = [profile.allowed for profile in profiles.values()]
        if not profiles.keys().isdisjoint(model.parametrisation.exponents):
            minima = _other_minima(model, result)
            for name in names:
                if name not in profiles and _lie_outside(model, result, name, minima):
                    determine(name, 0.0)
            allowed.append(minima)
        everywhere = np.concatenate(allowed)
        for name, profile in profiles.items():
            wider = _with_other_valleys(points, pendulum, result, name, profile, everywhere, model)
            if wider is not profile:
                verdicts[name] = _determination(result, name, wider)
    return tuple(verdicts[name] for name in result.contact_names)


def _with_other_valleys(
    points: TurningPoints,
    pendulum: PendulumOnBall,
    result: FitResult,
    name: str,
    profile: Profile,
    allowed: Floats,
    model: ExactModel,
) -> Profile:
    """The profile with limits beyond all values at the coordinates (n, columns) that the data allow.

    Chi2 may have a second minimum beyond a rise, which a search along another parameter goes around, or which
    only another start reaches.
    """
    row = result.names.index(name)
    values = np.array([model.parametrisation.physical(coordinates)[0][row] for coordinates in allowed])
    if not np.any(np.isfinite(values)):
        return profile
    lowest, highest = int(np.nanargmin(values)), int(np.nanargmax(values))
    if values[lowest] < profile.lower:
        farther = profile_likelihood(points, pendulum, result, name, begin=allowed[lowest])
        profile = replace(profile, lower=farther.lower)
    if values[highest] > profile.upper:
        farther = profile_likelihood(points, pendulum, result, name, begin=allowed[highest])
        profile = replace(profile, upper=farther.upper)
    return profile


def _other_minima(model: ExactModel, result: FitResult) -> Floats:
    """Coordinates (n, columns) of the minima from all starts of the law that the data allow at 95 %."""
    from scipy.special import stdtrit

    u_inflation = 1.0 if result.u_inflation is None else float(np.max(result.u_inflation))
    scale = max(1.0, 2 * result.cost / result.dof) * u_inflation**2
    highest = result.cost + 0.5 * scale * float(stdtrit(result.dof, 0.975)) ** 2
    minima: list[Floats] = []
    for start in starts_of(model):
        refit = partial(solve, lower=model.lower, upper=model.upper, loss=result.loss, cost_tolerance=1e-7)
        solution = _refit(refit, model, start)
        if solution is not None and solution.cost < highest:
            minima.append(solution.values)
    return np.reshape(minima, (-1, len(model.lower)))


def _lie_outside(model: ExactModel, result: FitResult, name: str, minima: Floats) -> bool:
    """Whether a value at one of the minima is outside the interval by value and uncertainty."""
    row, (lower, upper) = result.names.index(name), result.interval(name)
    values = [model.parametrisation.physical(coordinates)[0][row] for coordinates in minima]
    return any(not lower <= value <= upper for value in values)


def _determination(result: FitResult, name: str, profile: Profile | None) -> Determination:
    """The verdict by value and uncertainty, or by the profile where that was computed and disagrees."""
    value, u = result.estimate(name)
    lower, upper = result.interval(name)
    if profile is None:
        return Determination(name, Determinacy.DETERMINED, lower, upper)
    differences = np.abs(np.array([profile.lower - lower, profile.upper - upper]))
    if u <= WELL_DETERMINED * abs(value) and np.all(
        differences < _MAX_END_DIFFERENCE * 0.5 * (upper - lower)
    ):
        return Determination(name, Determinacy.DETERMINED, lower, upper)
    lower, upper = profile.lower, profile.upper
    verdict, is_not_negative = Determinacy.INTERVAL, result.law.parameter(name).lower == 0
    if np.isnan(lower) and np.isnan(upper):
        verdict = Determinacy.UNDETERMINED
    elif np.isnan(upper):
        verdict = Determinacy.LOWER_BOUND
    elif np.isnan(lower) or (lower <= 0 and is_not_negative):
        verdict = Determinacy.UPPER_BOUND
        lower = 0.0 if is_not_negative else lower
    return Determination(name, verdict, lower, upper, profile_likelihood=True)

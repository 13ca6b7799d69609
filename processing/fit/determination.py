"""Confidence intervals of parameters that the data determine poorly, by the profile likelihood.

A value with a symmetric uncertainty describes a parameter only if chi2 is nearly a parabola. Otherwise the
profile likelihood gives the interval: the parameter is held at a value, all others are fitted again, and the
interval ends where chi2 has risen by the amount that corresponds to the coverage.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from functools import partial
from math import nan
from typing import NamedTuple

import numpy as np

from processing.arrays import Floats
from processing.contact import PendulumOnBall
from processing.errors import DataError
from processing.estimate import WELL_DETERMINED, Determinacy, FitMethod
from processing.fit.exact_model import ExactModel
from processing.fit.exact_result import impossible_signs
from processing.fit.result import FitResult
from processing.least_squares import FactoredJacobian, Solution, solve
from processing.swing import TurningPoints

_MAX_PARABOLIC_U = 0.01
"""Relative standard uncertainty up to which chi2 is taken as a parabola, without a look at its profile."""
_BENDS_WITH = 0.7
"""Correlation with a parameter whose chi2 is no parabola above which that of another is looked at, too."""
_MAX_EVALUATIONS = 40
"""Most evaluations of the model in one refit; a second round where it would set a limit unconverged."""
_MAX_UNCONVERGED = 1
"""Refits that never converge which the search on one side passes over; one more ends it."""
_ASTRAY = 10.0
"""Root of the rise of chi2, over that of a limit, beyond which a refit is not of the same valley: it sets no
limit, unless it begins beside a good one."""
_MAX_HELD_VALUES = 20
"""Most values at which a parameter is held on each side."""
_MAX_END_DIFFERENCE = 0.15
"""Largest difference of the two intervals' ends, over the half-width, at which value and uncertainty do."""


class Determination(NamedTuple):
    """Verdict of the data on one parameter: a value, an interval, a bound or none.

    `lower_95` or `upper_95` is NaN if the data set no limit (0 if only physics does: friction dissipates
    energy). `profile_likelihood` is whether the limits come from it.
    """

    name: str
    verdict: Determinacy
    lower_95: float
    upper_95: float
    profile_likelihood: bool = False


class _ConditionalModel:
    """The exact model with one physical parameter held fixed, and therefore one column less.

    `guess` is the missing column of the last values, at which the search for the next one begins.
    """

    def __init__(self, model: ExactModel, name: str, best: Floats) -> None:
        self._model = model
        self.row = model.names.index(name)
        positive = bool(model.parametrisation.physical(best)[0][self.row] > 0)
        self._logarithmic = model.law.parameter(name).logarithmic and positive
        self.column, self._keeps_sign = model.parametrisation.held(name)
        self.free = np.delete(np.arange(len(model.lower)), self.column)
        self.guess = float(best[self.column])

    def full(self, held: float, free: Floats) -> tuple[Floats, Floats]:
        """All columns, the missing one by Newton's method, and its derivatives with respect to the others."""
        values = np.empty(len(free) + 1)
        values[self.free] = free
        values[self.column] = self.guess
        for _ in range(50 if np.all(np.isfinite(free)) else 0):
            known, slopes = self._model.parametrisation.physical(values)
            slope = slopes[self.row]
            if not np.all(np.isfinite(slope)):
                break
            if self._logarithmic and not known[self.row] / held > 0:
                break
            if self._logarithmic:
                error, per_column = np.log(known[self.row] / held), slope[self.column] / known[self.row]
            else:
                error, per_column = known[self.row] - held, slope[self.column]
            with np.errstate(all="ignore"):
                step = np.divide(error, per_column)
            if not np.isfinite(step):
                break
            if self._logarithmic and self._keeps_sign:
                half = 0.5 * abs(float(values[self.column]))
                step = float(np.clip(step, -half, half))
            values[self.column] -= step
            if abs(step) <= 1e-13 * max(abs(values[self.column]), 1e-3):
                self.guess = float(values[self.column])
                return values, -slope[self.free] / slope[self.column]
        return np.full(len(values), np.nan), np.zeros(len(free))

    def at(self, held: float) -> Callable[[Floats], tuple[Floats, Floats]]:
        def model(free: Floats) -> tuple[Floats, Floats]:
            values, through = self.full(held, free)
            residuals, jacobian = self._model(values)
            jacobian[:, self.free] += jacobian[:, [self.column]] * through
            return residuals, jacobian[:, self.free]

        return model

    def follow(self, before: float, free: Floats, after: float) -> Floats:
        """Estimate of the free columns at another value of the held parameter (one Gauss-Newton step)."""
        here, jacobian = self.at(before)(free)
        step = 1e-3 * (after - before)
        if before + step == before:
            return free
        change = (self.at(before + step)(free)[0] - here) * ((after - before) / step)
        if not np.all(np.isfinite(change)):
            return free
        return free - FactoredJacobian(jacobian).coefficients(change)


@dataclass(frozen=True)
class Profile:
    """Limits of one parameter by the profile likelihood; NaN if chi2 does not rise enough.

    `trace` holds the points computed, rows of (value, rise of chi2) in order of rising value, for a figure.
    `allowed` (points, columns) are all columns of those within the limits.
    """

    lower: float
    upper: float
    trace: Floats
    allowed: Floats


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
        Columns at which the search on both sides begins, near another minimum; default: at the fit.

    Notes
    -----
    The noise is that of the fit. The rise of chi2 is divided by max(1, chi2/dof) and by what else widened the
    fit's uncertainty; the limit is where its square root equals Student's t. b and gamma are varied on a
    logarithmic scale if their estimates are positive. The search ends at ten standard uncertainties (b and
    gamma: at a factor of a million), or at zero for parameters that cannot be negative. Where the fit itself
    lies below zero, the rise counts from the best fit at zero: a limit is never one of impossible values.
    A refit that has not converged bounds the rise of chi2 from above: it may be passed, but sets no limit.
    The search then goes nearer to the best fit, and soon ends without a limit.
    """
    from scipy.special import stdtrit

    if result.method is not FitMethod.EXACT:
        raise DataError("a profile likelihood belongs to an exact fit")
    model, best = ExactModel.of(points, pendulum, result)
    parameter = result.law.parameter(name)
    value, u = result.estimate(name)
    if not np.isfinite(u):
        u = abs(value) or 1.0
    scale = max(1.0, 2 * result.cost / result.dof) if result.loss == "linear" else 1.0
    u_inflation = 1.0 if result.u_inflation is None else float(result.u_inflation[result.names.index(name)])
    scale *= u_inflation**2
    target = float(stdtrit(result.dof, 0.5 * (1 + coverage)))
    held = _ConditionalModel(model, name, best)
    low_end, high_end = model.lower[held.free], model.upper[held.free]
    refitted = partial(solve, lower=low_end, upper=high_end, loss=result.loss, cost_tolerance=1e-7)
    logarithmic = parameter.logarithmic and value > 0
    lowest_cost, free_at_lowest = result.cost, best[held.free]
    if parameter.lower == 0 and value < 0:
        start = np.clip(held.follow(value, free_at_lowest, 0.0), low_end, high_end)
        at_zero = refitted(held.at(0.0), start)
        value, lowest_cost, free_at_lowest = 0.0, at_zero.cost, at_zero.values
    root_at_begin = 0.0
    if begin is not None:
        value, free_at_lowest = float(model.parametrisation.physical(begin)[0][held.row]), begin[held.free]
        held.guess = float(begin[held.column])
        residuals = model(begin)[0]
        root_at_begin = float(np.sqrt(max(float(residuals @ residuals) - 2 * lowest_cost, 0.0) / scale))
    guess_at_lowest = held.guess
    trace: list[tuple[float, float]] = [(value, root_at_begin**2)]
    allowed: list[Floats] = []

    def at(z: float) -> float:
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
        unconverged = 0
        for _ in range(_MAX_HELD_VALUES):
            # a refit that went astray leaves a guess from which none of the next ones begins
            held.guess = guess
            start = held.follow(at(sign * low), free, at(sign * z))
            start = np.clip(start, low_end + 1e-9, high_end - 1e-9)
            model_there = held.at(at(sign * z))
            solution = _refit(refitted, model_there, start)
            if solution is not None and is_open(solution):
                solution = _refit(refitted, model_there, solution.values)
                if solution is not None and is_open(solution):
                    solution, unconverged = None, unconverged + 1
                    if unconverged > _MAX_UNCONVERGED:
                        z = high
                        break
            root = np.inf if solution is None else rise_root(solution)
            if solution is None or root > _ASTRAY * target:
                # the law has no value there, or the refit went astray: u may be thousands of times the range
                # that the law allows, and the valley may bend
                farthest_step = (z - low) * (0.5 if low else 0.1)
                nearest, there = at(sign * low), at(sign * (low + farthest_step))
                if farthest_step < 1e-3 * low or abs(there - nearest) < 1e-9 * abs(nearest):
                    z = high if solution is None else z
                    break
                z = low + farthest_step
                continue
            trace.append((at(sign * z), root**2))
            is_below = root < target
            if abs(root - target) < 0.01 * target:
                break
            # an end that stays for a second time counts half as far from the target (the Illinois method)
            if is_below:
                if was_below:
                    high_root = target + 0.5 * (high_root - target)
                free, guess = solution.values, held.guess
                allowed.append(held.full(at(sign * z), free)[0])
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
                wanted = z * target / root if root > 0 else 2 * z
                z = min(float(np.clip(1.02 * wanted, 1.05 * z, 2.5 * z)), low + farthest_step, farthest)
        else:
            # no step is left: the limit lies somewhere before the end that is known to be beyond it
            z = high
        return at(sign * z) if np.isfinite(z) else float("nan")

    if not np.all(np.isfinite(model(best)[0])):
        raise DataError(f"the fitted parameters do not reach the last half-cycle; no profile of {name}")
    lower, upper = side(-1.0), side(1.0)
    trace.sort()
    return Profile(lower, upper, np.array(trace), np.reshape(allowed, (-1, len(best))))


def _refit(
    refit: Callable[..., Solution],
    model: Callable[[Floats], tuple[Floats, Floats]],
    start: Floats,
) -> Solution | None:
    """The other parameters fitted again; None where the law has no value to begin with."""
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
    withheld = set[str]()
    for cause, below in impossible_signs(result).items():
        moved = below * correlation[result.names.index(cause)]
        withheld |= {
            name for name in result.contact_names if name != cause and moved[result.names.index(name)] > 1.0
        }
    found = {
        name: Determination(name, Determinacy.UNDETERMINED, nan, nan)
        for name in result.contact_names
        if name in withheld
    }
    profiles: dict[str, Profile] = {}

    def determine(name: str, max_parabolic_u: float = _MAX_PARABOLIC_U) -> None:
        value, u = result.estimate(name)
        if not u <= max_parabolic_u * abs(value):
            profiles[name] = profile_likelihood(points, pendulum, result, name)
        found[name] = _determination(result, name, profiles.get(name))

    for name in result.contact_names:
        if name not in withheld:
            determine(name)
    # T0 is known to per mille however wrong it is: only the profile shows that it bends with an unknown n
    bent = [result.names.index(name) for name in found if found[name].profile_likelihood]
    for name in result.contact_names:
        bends = bool(np.any(correlation[result.names.index(name), bent] > _BENDS_WITH))
        if bends and not found[name].profile_likelihood and name not in withheld:
            determine(name, 0.0)
    model = ExactModel.of(points, pendulum, result)[0] if profiles else None
    for name, profile in profiles.items():
        assert model is not None
        wider = _with_other_valleys(points, pendulum, result, name, profile, profiles.values(), model)
        if wider is not profile:
            found[name] = _determination(result, name, wider)
    return tuple(found[name] for name in result.contact_names)


def _with_other_valleys(
    points: TurningPoints,
    pendulum: PendulumOnBall,
    result: FitResult,
    name: str,
    profile: Profile,
    profiles: Iterable[Profile],
    model: ExactModel,
) -> Profile:
    """The profile with limits beyond all that the profiles of other parameters allow.

    Chi2 may have a second minimum beyond a rise; to a search along another parameter there is none.
    """
    row = model.names.index(name)
    allowed = np.concatenate([one.allowed for one in profiles])
    values = np.array([model.parametrisation.physical(columns)[0][row] for columns in allowed])
    if not np.any(np.isfinite(values)):
        return profile
    lowest, highest = int(np.nanargmin(values)), int(np.nanargmax(values))
    if values[lowest] < profile.lower:
        begun = profile_likelihood(points, pendulum, result, name, begin=allowed[lowest])
        profile = replace(profile, lower=begun.lower)
    if values[highest] > profile.upper:
        begun = profile_likelihood(points, pendulum, result, name, begin=allowed[highest])
        profile = replace(profile, upper=begun.upper)
    return profile


def _determination(result: FitResult, name: str, found: Profile | None) -> Determination:
    """The verdict by value and uncertainty, and by the profile where it was looked at."""
    value, u = result.estimate(name)
    verdict = Determinacy.INTERVAL
    lower, upper = result.interval(name)
    by_profile = found is not None
    if found is not None:
        limits, half = np.array([found.lower, found.upper]), 0.5 * (upper - lower)
        if u <= WELL_DETERMINED * abs(value) and np.all(
            np.abs(limits - (lower, upper)) < _MAX_END_DIFFERENCE * half
        ):
            by_profile = False
    if found is None or not by_profile:
        verdict = Determinacy.DETERMINED
    else:
        lower, upper = found.lower, found.upper
        not_negative = result.law.parameter(name).lower == 0
        if np.isnan(lower) and np.isnan(upper):
            verdict = Determinacy.UNDETERMINED
        elif np.isnan(upper):
            verdict = Determinacy.LOWER_BOUND
        elif np.isnan(lower) or (lower <= 0 and not_negative):
            verdict = Determinacy.UPPER_BOUND
            lower = 0.0 if not_negative else lower
    return Determination(name, verdict, lower, upper, by_profile)

"""Combination of repeated runs of one contact pair."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from math import hypot, isfinite, nan, sqrt
from typing import Annotated

import numpy as np

from processing.errors import DataError
from processing.estimate import Estimate
from processing.fit import AIR, DISCREPANCY, FitResult
from processing.quantity import PART

_HOMOGENEOUS_ABOVE = 0.05
"""Probability above which the scatter of the runs is attributed to their own uncertainties."""
_DISAGREES_BELOW = 0.003
"""Probability, for all runs and parameters together, below which a run is reported to disagree."""
_MIN_OWN_SHARE = 0.01
"""Least share of a run's uncertainty that counts as its own, where the prior of the air would be all."""
_NORMAL_95 = 1.959964
_MAX_LIMIT_DISTANCE = 1e3
"""Distance from the best value, over the range of the runs' values, up to which a limit is searched."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CombinedValue:
    """One parameter over a series of runs."""

    value: Annotated[float, PART]
    """Mean weighted by within-run and between-run variance."""
    standard_uncertainty: Annotated[float, PART]
    """It contains the scatter within and between runs, and is at least `within_runs`."""
    degrees_of_freedom: int = 0
    within_runs: Annotated[float, PART] = nan
    """Standard uncertainty of the mean from the runs' own uncertainties only."""
    between_runs: Annotated[float, PART] = nan
    """Standard deviation between runs in excess of their own uncertainties; 0 if there is none."""
    p_homogeneous: float = nan
    """Probability of a scatter at least as large if only the runs' own uncertainties contribute."""
    by_air: Annotated[float, PART] = 0.0
    """Part of `standard_uncertainty`, with its sign, by the prior of the air. All runs share it, so that more
    runs do not reduce it."""
    runs: Annotated[tuple[Estimate, ...], PART] = ()

    @property
    def estimate(self) -> Estimate:
        return Estimate(self.value, self.standard_uncertainty)

    @property
    def own(self) -> float:
        """Standard uncertainty without the part that the runs share."""
        return sqrt(max(self.standard_uncertainty**2 - self.by_air**2, 0.0))

    @property
    def expanded_uncertainty_95(self) -> float:
        """Half-width of the 95 % interval: Student's t for the scatter, the normal's for the shared part."""
        from scipy.special import stdtrit

        return hypot(float(stdtrit(self.degrees_of_freedom, 0.975)) * self.own, _NORMAL_95 * self.by_air)


@dataclass(frozen=True, slots=True)
class Disagreement:
    """A run (counted from 1) that deviates from the others by `deviation` standard uncertainties."""

    run: int
    name: str
    deviation: float


@dataclass(frozen=True)
class SeriesResult:
    """A series of runs: combined parameters, and the runs that disagree with the others."""

    parameters: Mapping[str, CombinedValue]
    disagreements: tuple[Disagreement, ...]
    combined: FitResult
    """The combined parameters as one fit, for `budgets`."""


def combine(name: str, runs: Sequence[Estimate], by_air: Sequence[float] = ()) -> CombinedValue:
    """Combine one parameter over runs.

    `by_air` are the changes of the runs' values by one standard uncertainty of the prior of the air, a part
    of their uncertainties that they share.

    The between-run variance is that of Mandel and Paule, with which the weighted sum of squares equals its
    expectation. The uncertainty of the mean is that of Hartung and Knapp, with Student's t for the number of
    runs minus one, but at least the within-run part. Raises DataError for fewer than two runs, or one whose
    uncertainty is not positive and finite.
    """
    from scipy.special import chdtrc

    if len(runs) < 2:
        raise DataError(f"{len(runs)} run: a series needs at least 2 to show its scatter")
    x, u = np.array([tuple(run) for run in runs], dtype=np.float64).T
    bad = np.flatnonzero(~(np.isfinite(u) & (u > 0)))
    if len(bad):
        raise DataError(
            f"run {bad[0] + 1} does not determine {name} (u = {u[bad[0]]}); leave it out of the series"
        )
    dof = len(runs) - 1
    shared = np.array(by_air) if len(by_air) else np.zeros(len(runs))
    # a shared error scatters between runs as far as its effects differ
    own_u2 = np.maximum(u**2 - shared**2, (_MIN_OWN_SHARE * u) ** 2)

    def scatter(variance: float) -> float:
        weight = 1 / (own_u2 + variance)
        return float(np.sum(weight * (x - np.sum(weight * x) / np.sum(weight)) ** 2))

    chi2, variance = scatter(0.0), 0.0
    if chi2 > dof:
        from scipy.optimize import brentq

        high = float(np.var(x, ddof=1)) + float(np.max(own_u2))
        while scatter(high) > dof:
            high *= 2
        variance = float(brentq(lambda v: scatter(v) - dof, 0.0, high, xtol=1e-12 * high))
    weight = 1 / (u**2 + variance)
    weight /= np.sum(weight)
    value, precision = float(weight @ x), 1 / (own_u2 + variance)
    mean_u2 = float(precision @ (x - value) ** 2 / (dof * np.sum(precision)))
    own_u = max(sqrt(mean_u2), float(np.sqrt(weight**2 @ (own_u2 + variance))))
    of_air = float(weight @ shared)
    return CombinedValue(
        value=value, standard_uncertainty=hypot(own_u, of_air), degrees_of_freedom=dof,
        within_runs=float(1 / np.sqrt(np.sum(1 / own_u2))), between_runs=sqrt(variance),
        p_homogeneous=float(chdtrc(dof, chi2)), by_air=of_air, runs=tuple(runs),
    )  # fmt: skip


def combined_limits(
    runs: Sequence[tuple[Estimate, tuple[float, float]]], *, logarithmic: bool = False
) -> tuple[float, float]:
    """95 % limits of one parameter over runs whose chi2 is no parabola; NaN where they set none.

    Each run's chi2 is taken as two half parabolas, which meet at its value and rise to the normal quantile at
    its own 95 % limits (Barlow 2004); it is flat where a limit is NaN. A mean weighted by the uncertainties
    would be far off: the smaller an uncertain exponent happens to be, the smaller is the uncertainty that a
    parabola gives it.

    At a limit the sum has risen over its minimum by the square of Student's t for the number of runs minus
    one, times chi2/dof of the runs if that exceeds 1.
    """
    from scipy.optimize import brentq, minimize_scalar
    from scipy.special import stdtrit

    table = np.array([(run.value, *limits) for run, limits in runs])
    if logarithmic:
        table = np.log(np.where(table > 0, table, nan))
    x, low, high = table.T
    below, above = (np.where(side > 0, _NORMAL_95 / side, 0.0) for side in (x - low, high - x))

    def chi2(value: float) -> float:
        distance = value - x
        return float(np.sum((np.where(distance < 0, below, above) * distance) ** 2))

    dof, span = len(runs) - 1, float(np.ptp(x)) or float(np.abs(x).max())
    best = float(minimize_scalar(chi2, bounds=(x.min(), x.max()), method="bounded").x) if np.ptp(x) else x[0]
    scatter = max(1.0, chi2(best) / dof)
    target = chi2(best) + scatter * float(stdtrit(dof, 0.975)) ** 2

    def limit(side: float) -> float:
        far = span
        while chi2(best + side * far) < target:
            far *= 2.0
            if far > _MAX_LIMIT_DISTANCE * span:
                return nan
        return float(brentq(lambda z: chi2(best + side * z) - target, 0.0, far)) * side + best

    lower, upper = limit(-1.0), limit(1.0)
    return (float(np.exp(lower)), float(np.exp(upper))) if logarithmic else (lower, upper)


def combine_runs(results: Sequence[FitResult]) -> SeriesResult:
    """Combine every parameter of the runs' fits, and find the runs that disagree with the others.

    The covariance of the combined fit has the mean within-run correlations and the combined uncertainties.
    """
    names = [name for name in results[0].contact_names if all(name in result.names for result in results)]
    parameters = {name: _combined(name, results) for name in names}
    first, places = results[0], [[result.names.index(name) for name in names] for result in results]
    in_order = list(zip(results, places, strict=True))
    correlation = np.mean([result.correlation[np.ix_(own, own)] for result, own in in_order], axis=0)
    u = np.array([parameters[name].standard_uncertainty for name in names])
    combined = FitResult(
        method=first.method,
        law=first.law,
        names=tuple(names),
        values=np.array([parameters[name].value for name in names]),
        covariance=correlation * np.outer(u, u),
        degrees_of_freedom=len(results) - 1,
        reference_rad=first.reference_rad,
        by_log_rho=np.mean([result.by_log_rho[own] for result, own in in_order], axis=0),
        loss=first.loss,
        cost=nan,
        terms={AIR: np.array([[parameters[name].by_air] for name in names])},
    )
    return SeriesResult(parameters, tuple(_disagreements(names, results)), combined)


def _combined(name: str, results: Sequence[FitResult]) -> CombinedValue:
    """A parameter over runs; the mean keeps the part by the model discrepancy, which is alike in all."""
    of_law, runs = [], []
    for result in results:
        place, (value, u) = result.names.index(name), result.estimate(name)
        of_law.append(float(result.covariance_by(DISCREPANCY)[place, place]))
        runs.append(Estimate(value, sqrt(max(u**2 - of_law[-1], 0.0)) if isfinite(u) else u))
    combined, added = combine(name, runs, _by_air(name, results)), float(np.mean(of_law))
    if not added > 0:
        return combined
    factor = sqrt(1 + added / combined.standard_uncertainty**2)
    return replace(combined, standard_uncertainty=factor * combined.standard_uncertainty)


def _by_air(name: str, results: Sequence[FitResult]) -> tuple[float, ...]:
    """Changes of the runs' values by one standard uncertainty of the prior of the air."""
    return tuple(
        float(result.terms[AIR][result.names.index(name), 0]) if AIR in result.terms else 0.0
        for result in results
    )


def _disagreements(names: Sequence[str], results: Sequence[FitResult]) -> list[Disagreement]:
    """Compare each run with the others, parameter by parameter, with Bonferroni's correction; of two runs
    both are reported. The others' scatter counts, unless it agrees with their own uncertainties."""
    from scipy.special import stdtr

    disagreements, count = [], len(results)
    limit = _DISAGREES_BELOW / (count * len(names))
    for name in names:
        shared = _by_air(name, results)
        runs = []
        for result, by_air in zip(results, shared, strict=True):
            value, u = result.estimate(name)
            runs.append(Estimate(value, sqrt(max(u**2 - by_air**2, (_MIN_OWN_SHARE * u) ** 2))))
        for i, run in enumerate(runs):
            others, between, dof = [*runs[:i], *runs[i + 1 :]], 0.0, 1e9
            mean = others[0]
            if count > 2:
                combined = combine(name, others)
                mean, between = combined.estimate, combined.between_runs
                dof = 1e9 if combined.p_homogeneous > _HOMOGENEOUS_ABOVE else float(count - 2)
            air_difference = shared[i] - float(np.mean([*shared[:i], *shared[i + 1 :]]))
            u = hypot(run.standard_uncertainty, mean.standard_uncertainty, between, air_difference)
            deviation = (run.value - mean.value) / u
            if 2 * float(stdtr(dof, -abs(deviation))) < limit:
                disagreements.append(Disagreement(i + 1, name, deviation))
    if count == 2 or not disagreements:
        return disagreements
    # One deviating run also shifts the means with which the others are compared. Report the largest
    # deviation first, and another only if it remains after that run has been removed.
    worst = max(disagreements, key=lambda item: abs(item.deviation)).run
    of_worst = [item for item in disagreements if item.run == worst]
    remaining = [j for j in range(count) if j + 1 != worst]
    if len(remaining) > 2:
        further = _disagreements(names, [results[j] for j in remaining])
        of_worst += [replace(item, run=remaining[item.run - 1] + 1) for item in further]
    return of_worst

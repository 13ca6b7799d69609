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
_LEAST_OWN = 0.01
"""Least part of a run's uncertainty that counts as its own, where the prior of the air would be all of it."""
_NORMAL_95 = 1.959964
_FARTHEST = 1e3
"""Distance from the best value, over the range of the runs' values, up to which a limit is looked for."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CombinedValue:
    """One parameter over a series of runs.

    Attributes
    ----------
    value, standard_uncertainty
        Mean weighted by within-run and between-run variance, and its standard uncertainty, which contains
        both and is at least `within_runs`.
    within_runs
        Standard uncertainty of the mean from the runs' own uncertainties only.
    between_runs
        Standard deviation between runs in excess of their own uncertainties; 0 if there is none.
    p_homogeneous
        Probability of a scatter at least as large if only the runs' own uncertainties contribute.
    by_air
        Part of `standard_uncertainty`, with its sign, by the prior of the air. All runs share it, so that
        more runs do not reduce it.
    """

    value: Annotated[float, PART]
    standard_uncertainty: Annotated[float, PART]
    degrees_of_freedom: int = 0
    within_runs: Annotated[float, PART] = nan
    between_runs: Annotated[float, PART] = nan
    p_homogeneous: float = nan
    by_air: Annotated[float, PART] = 0.0
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
    """A series of runs: combined parameters, the runs that disagree with the others, and the input of
    `budgets`."""

    parameters: Mapping[str, CombinedValue]
    disagreements: tuple[Disagreement, ...]
    measured: FitResult


def combine(name: str, runs: Sequence[Estimate], by_air: Sequence[float] = ()) -> CombinedValue:
    """Combine one parameter over runs.

    `by_air` are the changes of the runs' values by one standard uncertainty of the prior of the air, a part
    of their uncertainties that they share.

    The between-run variance is that of Mandel and Paule, with which the weighted sum of squares equals its
    expectation. The uncertainty of the mean is that of Hartung and Knapp, with Student's t for the number of
    runs minus one, but at least the within-run part.

    Raises
    ------
    DataError
        Fewer than two runs, or a run whose uncertainty is not positive and finite.
    """
    from scipy.special import chdtrc

    if len(runs) < 2:
        raise DataError(f"{len(runs)} run: a series needs at least 2 to show its scatter")
    x, whole = np.array([tuple(run) for run in runs], dtype=np.float64).T
    bad = np.flatnonzero(~(np.isfinite(whole) & (whole > 0)))
    if len(bad):
        raise DataError(
            f"run {bad[0] + 1} does not determine {name} (u = {whole[bad[0]]}); leave it out of the series"
        )
    dof = len(runs) - 1
    shared = np.array(by_air) if len(by_air) else np.zeros(len(runs))
    # a shared error scatters between runs as far as its effects differ
    u2 = np.maximum(whole**2 - shared**2, (_LEAST_OWN * whole) ** 2)

    def scatter(variance: float) -> float:
        weight = 1 / (u2 + variance)
        return float(np.sum(weight * (x - np.sum(weight * x) / np.sum(weight)) ** 2))

    alone, variance = scatter(0.0), 0.0
    if alone > dof:
        from scipy.optimize import brentq

        high = float(np.var(x, ddof=1)) + float(np.max(u2))
        while scatter(high) > dof:
            high *= 2
        variance = float(brentq(lambda v: scatter(v) - dof, 0.0, high, xtol=1e-12 * high))
    weight = 1 / (whole**2 + variance)
    weight /= np.sum(weight)
    value, inverse = float(weight @ x), 1 / (u2 + variance)
    spread = float(inverse @ (x - value) ** 2 / (dof * np.sum(inverse)))
    own = max(sqrt(spread), float(np.sqrt(weight**2 @ (u2 + variance))))
    of_air = float(weight @ shared)
    return CombinedValue(
        value=value, standard_uncertainty=hypot(own, of_air), degrees_of_freedom=dof,
        within_runs=float(1 / np.sqrt(np.sum(1 / u2))), between_runs=sqrt(variance),
        p_homogeneous=float(chdtrc(dof, alone)), by_air=of_air, runs=tuple(runs),
    )  # fmt: skip


def combined_limits(
    runs: Sequence[tuple[Estimate, tuple[float, float]]], *, logarithmic: bool = False
) -> tuple[float, float]:
    """95 % limits of one parameter over runs whose chi2 is no parabola; NaN where they set none.

    Each run's chi2 is taken as two half parabolas, which meet at its value and end at its own 95 % limits
    (Barlow 2004); it is flat where a limit is NaN. A mean weighted by the uncertainties would be far off: the
    smaller an uncertain exponent happens to be, the smaller is the uncertainty that a parabola gives it.

    The rise of the sum over its minimum counts by Student's t for the number of runs minus one, and by how
    much more than their limits say the runs scatter.
    """
    from scipy.optimize import brentq, minimize_scalar
    from scipy.special import stdtrit

    table = np.array([(run.value, *limits) for run, limits in runs])
    if logarithmic:
        table = np.log(np.where(table > 0, table, nan))
    x, low, high = table.T
    below, above = (np.where(side > 0, _NORMAL_95 / side, 0.0) for side in (x - low, high - x))

    def chi2(at: float) -> float:
        off = at - x
        return float(np.sum((np.where(off < 0, below, above) * off) ** 2))

    dof, span = len(runs) - 1, float(np.ptp(x)) or float(np.abs(x).max())
    best = float(minimize_scalar(chi2, bounds=(x.min(), x.max()), method="bounded").x) if np.ptp(x) else x[0]
    scatter = max(1.0, chi2(best) / dof)
    target = chi2(best) + scatter * float(stdtrit(dof, 0.975)) ** 2

    def end(side: float) -> float:
        far = span
        while chi2(best + side * far) < target:
            far *= 2.0
            if far > _FARTHEST * span:
                return nan
        return float(brentq(lambda z: chi2(best + side * z) - target, 0.0, far)) * side + best

    lower, upper = end(-1.0), end(1.0)
    return (float(np.exp(lower)), float(np.exp(upper))) if logarithmic else (lower, upper)


def combine_runs(results: Sequence[FitResult]) -> SeriesResult:
    """Combine every parameter of the runs' fits, and find the runs that disagree with the others.

    The covariance of `measured` has the mean within-run correlations and the combined uncertainties.
    """
    if len(results) < 2:
        raise DataError(f"{len(results)} run: a series needs at least 2 to show its scatter")
    names = [name for name in results[0].contact_names if all(name in result.names for result in results)]
    parameters = {name: _combined(name, results) for name in names}
    first, places = results[0], [[result.names.index(name) for name in names] for result in results]
    covariances = [result.covariance[np.ix_(at, at)] for result, at in zip(results, places, strict=True)]
    correlation = np.mean(
        [one / np.sqrt(np.outer(np.diag(one), np.diag(one))) for one in covariances], axis=0
    )
    u = np.array([parameters[name].standard_uncertainty for name in names])
    together = FitResult(
        method=first.method,
        law=first.law,
        names=tuple(names),
        values=np.array([parameters[name].value for name in names]),
        covariance=correlation * np.outer(u, u),
        degrees_of_freedom=len(results) - 1,
        reference_rad=first.reference_rad,
        by_log_rho=np.mean(
            [result.by_log_rho[at] for result, at in zip(results, places, strict=True)], axis=0
        ),
        loss=first.loss,
        cost=nan,
        terms={AIR: np.array([[parameters[name].by_air] for name in names])},
    )
    return SeriesResult(parameters, tuple(_disagreements(names, results)), together)


def _combined(name: str, results: Sequence[FitResult]) -> CombinedValue:
    """A parameter over runs; the mean keeps the part by the model discrepancy, which is alike in all."""
    of_law, runs = [], []
    for result in results:
        at, (value, u) = result.names.index(name), result.estimate(name)
        part = float(result.covariance_by(DISCREPANCY)[at, at])
        of_law.append(part)
        runs.append(Estimate(value, sqrt(max(u**2 - part, 0.0)) if isfinite(u) else u))
    found, added = combine(name, runs, _by_air(name, results)), float(np.mean(of_law))
    if not added > 0:
        return found
    factor = sqrt(1 + added / found.standard_uncertainty**2)
    return replace(found, standard_uncertainty=factor * found.standard_uncertainty)


def _by_air(name: str, results: Sequence[FitResult]) -> tuple[float, ...]:
    """Changes of the runs' values by one standard uncertainty of the prior of the air."""
    return tuple(
        float(result.terms[AIR][result.names.index(name), 0]) if AIR in result.terms else 0.0
        for result in results
    )


def _disagreements(names: Sequence[str], results: Sequence[FitResult]) -> list[Disagreement]:
    """Compare each run with the others, parameter by parameter, with Bonferroni's correction.

    Of two runs it cannot be decided which is wrong, and both are reported. The scatter of the others is used
    with its few degrees of freedom, unless it agrees with their own uncertainties, which are then used
    instead.
    """
    from scipy.special import stdtr

    found, count = [], len(results)
    limit = _DISAGREES_BELOW / (count * len(names))
    for name in names:
        shared = _by_air(name, results)
        runs = [
            _without_air(result.estimate(name), part) for result, part in zip(results, shared, strict=True)
        ]
        for i, own in enumerate(runs):
            others, between, dof = [*runs[:i], *runs[i + 1 :]], 0.0, 1e9
            rest = others[0]
            if count > 2:
                combined = combine(name, others)
                rest, between = combined.estimate, combined.between_runs
                dof = 1e9 if combined.p_homogeneous > _HOMOGENEOUS_ABOVE else float(count - 2)
            differs = shared[i] - float(np.mean([*shared[:i], *shared[i + 1 :]]))
            u = hypot(own.standard_uncertainty, rest.standard_uncertainty, between, differs)
            deviation = (own.value - rest.value) / u
            if 2 * float(stdtr(dof, -abs(deviation))) < limit:
                found.append(Disagreement(i + 1, name, deviation))
    if count == 2 or not found:
        return found
    # One deviating run also shifts the means with which the others are compared. Report the largest
    # deviation first, and another only if it remains after that run has been removed.
    worst = max(found, key=lambda item: abs(item.deviation)).run
    named = [item for item in found if item.run == worst]
    kept = [j for j in range(count) if j + 1 != worst]
    if len(kept) > 2:
        remaining = _disagreements(names, [results[j] for j in kept])
        named += [replace(item, run=kept[item.run - 1] + 1) for item in remaining]
    return named


def _without_air(found: Estimate, by_air: float) -> Estimate:
    """A value with the part of its uncertainty that is not by the air."""
    u = found.standard_uncertainty
    return Estimate(found.value, sqrt(max(u**2 - by_air**2, (_LEAST_OWN * u) ** 2)))

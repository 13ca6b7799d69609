"""Combination of repeated runs of one contact pair, and comparison of series of runs."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from math import hypot, isfinite, nan, sqrt
from typing import Annotated

import numpy as np
from scipy.special import chdtrc, stdtr, stdtrit

from processing.angle import ARCSEC_RAD
from processing.arrays import Ints
from processing.errors import DataError
from processing.estimate import Estimate
from processing.fit.evidence import AIR
from processing.fit.reported import FittedContact, fitted_contact
from processing.fit.result import MISFIT, FitResult
from processing.quantity import PART
from processing.swing import TurningPoints

AGREE = 0.05
"""Probability above which the scatter of the runs is attributed to their own uncertainties."""
DISAGREES = 0.003
"""Probability, for all runs and parameters together, below which a run is reported to disagree."""


_LEAST_OWN = 0.01
"""Least part of a run's uncertainty that is its own: where what is known of the air is all of it."""
_NORMAL_95 = 1.959964


@dataclass(frozen=True, slots=True, kw_only=True)
class Combined:
    """One parameter over a series of runs.

    Attributes
    ----------
    value, standard_uncertainty
        Mean weighted by within-run and between-run variance, and its standard uncertainty, which contains
        both and is at least `within_runs`.
    degrees_of_freedom
        Number of runs minus one.
    within_runs
        Standard uncertainty of the mean from the runs' own uncertainties only.
    between_runs
        Standard deviation between runs in excess of their own uncertainties; 0 if there is none.
    p_homogeneous
        Probability of a scatter at least as large if only the runs' own uncertainties contribute.
    by_air
        Part of `standard_uncertainty`, with its sign, from the knowledge of the air. All runs share it, so
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
    def expanded_uncertainty_95(self) -> float:
        """Half-width of the 95 % interval: Student's t of what scatters, the normal's of what is shared."""
        own = sqrt(max(self.standard_uncertainty**2 - self.by_air**2, 0.0))
        return hypot(float(stdtrit(self.degrees_of_freedom, 0.975)) * own, _NORMAL_95 * self.by_air)


@dataclass(frozen=True, slots=True)
class Disagreement:
    """A run (counted from 1) that deviates from the others by `deviation` standard uncertainties."""

    run: int
    name: str
    deviation: float


@dataclass(frozen=True)
class SeriesResult:
    """A series of runs: combined parameters, and the runs that disagree with the others."""

    parameters: Mapping[str, Combined]
    disagreements: tuple[Disagreement, ...]
    measured: FittedContact

    def estimates(self) -> dict[str, Estimate]:
        return {name: combined.estimate for name, combined in self.parameters.items()}


def combine(name: str, runs: Sequence[Estimate], by_air: Sequence[float] = ()) -> Combined:
    """Combine one parameter over runs.

    `by_air` are the changes of the runs' values for one standard uncertainty of what is known of the air,
    which is a part of their uncertainties that they share.

    The between-run variance is that of Mandel and Paule, with which the weighted sum of squares equals its
    expectation. The uncertainty of the mean is that of Hartung and Knapp, with Student's t for the number of
    runs minus one, but at least the within-run part.

    Raises
    ------
    DataError
        Fewer than two runs, or a run whose uncertainty is not positive and finite.
    """
    if len(runs) < 2:
        raise DataError(f"{len(runs)} run: a series needs at least 2 to show its scatter")
    x = np.array([run.value for run in runs])
    u = np.array([run.standard_uncertainty for run in runs])
    if not np.all(np.isfinite(u) & (u > 0)):
        worst = int(np.nonzero(~(np.isfinite(u) & (u > 0)))[0][0])
        raise DataError(
            f"run {worst + 1} does not determine {name} (u = {u[worst]}); leave it out of the series"
        )
    dof = len(runs) - 1
    shared = np.array(by_air) if len(by_air) else np.zeros(len(runs))
    # what runs share scatters between them as far as it differs
    whole, u = u, np.sqrt(np.maximum(u**2 - shared**2, (_LEAST_OWN * u) ** 2))

    def scatter(variance: float) -> float:
        weight = 1 / (u**2 + variance)
        mean = np.sum(weight * x) / np.sum(weight)
        return float(np.sum(weight * (x - mean) ** 2))

    alone = scatter(0.0)
    variance = 0.0
    if alone > dof:
        from scipy.optimize import brentq

        high = float(np.var(x, ddof=1)) + float(np.max(u) ** 2)
        while scatter(high) > dof:
            high *= 2
        variance = float(brentq(lambda v: scatter(v) - dof, 0.0, high, xtol=1e-12 * high))
    weight = 1 / (whole**2 + variance)
    weight /= np.sum(weight)
    value = float(weight @ x)
    within = float(1 / np.sqrt(np.sum(1 / u**2)))
    inverse = 1 / (u**2 + variance)
    spread = float(inverse @ (x - value) ** 2 / (dof * np.sum(inverse)))
    own = max(sqrt(spread), float(np.sqrt(weight**2 @ (u**2 + variance))))
    of_air = float(weight @ shared)
    uncertainty = hypot(own, of_air)
    return Combined(
        value=value,
        standard_uncertainty=uncertainty,
        degrees_of_freedom=dof,
        within_runs=within,
        between_runs=sqrt(variance),
        p_homogeneous=float(chdtrc(dof, alone)),
        by_air=of_air,
        runs=tuple(runs),
    )


def combine_runs(results: Sequence[FitResult]) -> SeriesResult:
    """Combine every parameter of the runs' fits, and find the runs that disagree with the others.

    The field `measured` is the input of `budgets`; its covariance has the mean within-run correlations and
    the combined uncertainties.
    """
    if len(results) < 2:
        raise DataError(f"{len(results)} run: a series needs at least 2 to show its scatter")
    names = [name for name in results[0].contact_names if all(name in result.names for result in results)]
    parameters = {
        name: _with_misfit(
            combine(name, [_own(result, name) for result in results], _by_air(name, results)), name, results
        )
        for name in names
    }
    runs = [fitted_contact(result) for result in results]
    at = [list(runs[0].names).index(name) for name in names]
    correlation = np.mean(
        [
            run.covariance[np.ix_(at, at)]
            / np.sqrt(np.outer(np.diag(run.covariance)[at], np.diag(run.covariance)[at]))
            for run in runs
        ],
        axis=0,
    )
    u = np.array([parameters[name].standard_uncertainty for name in names])
    together = FittedContact(
        tuple(names),
        np.array([parameters[name].value for name in names]),
        correlation * np.outer(u, u),
        float(len(results) - 1),
        np.mean([run.by_log_rho[at] for run in runs], axis=0),
        float(np.exp(np.mean([np.log(run.reference_rad) for run in runs]))),
        {AIR: np.array([[parameters[name].by_air] for name in names])},
    )
    return SeriesResult(parameters, tuple(_disagreements(names, results)), together)


def _own(result: FitResult, name: str) -> Estimate:
    """A parameter without what the distance between law and data adds, which runs have in common."""
    value, u = result.estimate(name)
    return Estimate(value, sqrt(max(u**2 - _of_misfit(result, name), 0.0)) if isfinite(u) else u)


def _of_misfit(result: FitResult, name: str) -> float:
    at = result.names.index(name)
    return float(result.part(MISFIT)[at, at])


def _with_misfit(found: Combined, name: str, results: Sequence[FitResult]) -> Combined:
    """The mean of runs, whose law is wrong in all of them alike."""
    added = float(np.mean([_of_misfit(result, name) for result in results]))
    if not added > 0:
        return found
    factor = sqrt(1 + added / found.standard_uncertainty**2)
    return replace(found, standard_uncertainty=factor * found.standard_uncertainty)


def _by_air(name: str, results: Sequence[FitResult]) -> tuple[float, ...]:
    """Changes of the runs' values for one standard uncertainty of what is known of the air."""
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
    found = []
    count = len(results)
    limit = DISAGREES / (count * len(names))
    for name in names:
        shared = _by_air(name, results)
        runs = [_without(result.estimate(name), part) for result, part in zip(results, shared, strict=True)]
        for i in range(count):
            own = runs[i]
            others = [runs[j] for j in range(count) if j != i]
            if count == 2:
                rest = others[0]
                between, dof = 0.0, 1e9
            else:
                combined = combine(name, others)
                rest = combined.estimate
                between = combined.between_runs
                dof = 1e9 if combined.p_homogeneous > AGREE else float(count - 2)
            differs = shared[i] - float(np.mean([shared[j] for j in range(count) if j != i]))
            u = hypot(own.standard_uncertainty, rest.standard_uncertainty, between, differs)
            deviation = (own.value - rest.value) / u
            if 2 * float(stdtr(dof, -abs(deviation))) < limit:
                found.append(Disagreement(i + 1, name, deviation))
    if count > 2 and found:
        # One deviating run also shifts the means with which the others are compared. Report the largest
        # deviation first, and another only if it remains after that run has been removed.
        worst = max(
            {item.run for item in found}, key=lambda run: max(abs(d.deviation) for d in found if d.run == run)
        )
        named = [item for item in found if item.run == worst]
        kept = [j for j in range(count) if j + 1 != worst]
        if len(kept) > 2:
            named += [
                Disagreement(kept[item.run - 1] + 1, item.name, item.deviation)
                for item in _disagreements(names, [results[j] for j in kept])
            ]
        return named
    return found


def _without(found: Estimate, by_air: float) -> Estimate:
    """A value with what its run alone leaves uncertain."""
    u = found.standard_uncertainty
    return Estimate(found.value, sqrt(max(u**2 - by_air**2, (_LEAST_OWN * u) ** 2)))


def average_curves(runs: Sequence[TurningPoints]) -> TurningPoints:
    """The paper's method: average the runs' curves into one, which is fitted as a single run.

    The half-cycles of each run are counted from the first one at or below the largest amplitude that all runs
    contain, and are averaged where all runs have one. Uncertainties are those of the mean, from the runs'
    own.

    Notes
    -----
    The runs do not start at exactly the same amplitude, so that the average is not exactly the decay of any
    pendulum. For starts within one half-cycle's loss this changes the parameters by less than their
    uncertainties. `combine_runs` avoids the problem and is preferable.
    """
    if len(runs) < 2:
        raise DataError(f"{len(runs)} run: there is nothing to average")
    common = min(float(run.amplitude[0]) for run in runs)
    starts = []
    for number, run in enumerate(runs, start=1):
        below = np.nonzero(run.amplitude <= common)[0]
        if not len(below):
            lowest, highest = (
                f"{value / ARCSEC_RAD:.3g} arcsec" for value in (float(run.amplitude.min()), common)
            )
            raise DataError(
                f"run {number} ends at {lowest}, above the {highest} at which another begins: "
                "nothing to average"
            )
        starts.append(int(below[0]))
    shared: Ints | None = None
    for run, start in zip(runs, starts, strict=True):
        counted = run.index[start:] - run.index[start]
        shared = counted if shared is None else np.intersect1d(shared, counted)
    assert shared is not None
    if len(shared) < 3:
        raise DataError(f"the runs share {len(shared)} half-cycles: too few to average")
    rows = []
    for run, start in zip(runs, starts, strict=True):
        at = start + np.searchsorted(run.index[start:] - run.index[start], shared)
        time_s = run.time_s[at] - run.time_s[at[0]]
        rows.append((time_s, run.u_time_s[at], run.amplitude[at], run.u_amplitude[at]))
    time_s, u_time_s, amplitude, u_amplitude = (np.array(column) for column in zip(*rows, strict=True))
    return TurningPoints(
        index=shared,
        time_s=np.mean(time_s, axis=0),
        u_time_s=np.sqrt(np.sum(u_time_s**2, axis=0)) / len(runs),
        amplitude=np.mean(amplitude, axis=0),
        u_amplitude=np.sqrt(np.sum(u_amplitude**2, axis=0)) / len(runs),
    )


@dataclass(frozen=True, slots=True)
class Comparison:
    """One parameter of two series: difference, its standard uncertainty, and the probability of a difference
    at least as large if the series are equal (Welch's t-test).

    The probability is NaN for two series of one run each: how runs scatter is then not known, and the
    uncertainty is that of the swings alone.
    """

    name: str
    first: str
    second: str
    difference: float
    standard_uncertainty: float
    p_value: float


def compare_series(series: Mapping[str, SeriesResult]) -> tuple[Comparison, ...]:
    """Compare all pairs of series (samples, days, humidities), parameter by parameter.

    Type B uncertainties are not included, because errors of the rig's mass or radius shift all series
    equally. What is known of the air counts as far as it shifts them differently. A single run scatters as
    those of the other series do.
    """
    rows = []
    for first, second in combinations(series, 2):
        for name, a in series[first].parameters.items():
            b = series[second].parameters.get(name)
            if b is None:
                continue
            difference = a.value - b.value
            u, dof = _u_of_difference(a, b)
            u = hypot(u, a.by_air - b.by_air)
            p_value = 2 * float(stdtr(dof, -abs(difference) / u)) if dof > 0 else nan
            rows.append(Comparison(name, first, second, difference, u, p_value))
    return tuple(rows)


def _u_of_difference(a: Combined, b: Combined) -> tuple[float, float]:
    """Standard uncertainty of a difference and its degrees of freedom, none where no scatter is known."""
    u_a, u_b = (_without(one.estimate, one.by_air).standard_uncertainty for one in (a, b))
    several = [one for one in (a, b) if len(one.runs) > 1]
    if len(several) == 1:
        (known,) = several
        return hypot(u_a, u_b, known.between_runs), float(known.degrees_of_freedom)
    u = hypot(u_a, u_b)
    dof = u**4 / (u_a**4 / a.degrees_of_freedom + u_b**4 / b.degrees_of_freedom) if several else 0.0
    return u, dof

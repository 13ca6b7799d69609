"""The likelihood of each run, compressed from its results.

It is made of results.json alone: parameters with their correlation, what inputs the budget says they share,
how uneven the profiles are, which values are only bounded.
"""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from math import inf, isfinite, log, nan, sqrt
from typing import Annotated

import numpy as np

from processing.arrays import Floats
from processing.contact import DRAG
from processing.contact.laws import AMPLITUDE, DEFAULT_LAW
from processing.estimate import NOT_DETERMINED, Determinacy, Estimate
from processing.fit import BudgetSource, FitMethod
from processing.quantity import PART
from processing.series import (
    EXPONENT_OF,
    GROWTH,
    POSITIVE,
    Bound,
    ChangePoint,
    CompressedRun,
    EndSide,
    to_coordinates,
)
from rig.analysis import Fit, JsonObject, ResultRow, RunResults
from rig.campaigns.campaign_file import SURROUNDING_COVARIATES

_AIR, _MISFIT = "air", "misfit"
_OWN = ("period_drift", "drag_drift", "plane_of_swing_rad")
"""Sources that every run has for itself."""
_MOST_SHARED = 0.9999
"""Of a variance: what is left is the run's own."""
_WELL = 0.5
"""Relative standard uncertainty from which on a positive parameter without a verdict is only bounded."""
_UNEVEN = 0.1
"""Asymmetry of a profile from which on it counts."""
_MOST_UNEVEN = 0.8
_SOFT = 0.3


@dataclass(frozen=True, kw_only=True)
class FoundRun:
    """A run as it was found: where, under which hash of its results, and its contact."""

    label: str
    contact: str
    results_sha256: str
    run: RunResults


def compressed(
    found: FoundRun, reference_rad: float, u_covariates: Mapping[str, float]
) -> tuple[CompressedRun | None, str]:
    """The run's likelihood; or None, and in a line why it cannot enter."""
    run, fit = found.run, found.run.fits.get(FitMethod.EXACT)
    if fit is None:
        return None, f"{found.label}: left out: {run.problem or 'it has no exact fit'}"
    names, bounds = [], {}
    for name in (*DEFAULT_LAW.names(), DRAG.key):
        value, u = fit.estimate(name)
        row = run.rows.get(name)
        if not isfinite(value):
            continue
        bound = _bound(name, value, u, row)
        if bound is not None:
            bounds[name] = bound
        elif 0 < u < inf and _is_determined(row):
            names.append(name)
    # b and gamma are independent of their exponents only beside them
    names = [name for name in names if EXPONENT_OF.get(name, (name, 0.0))[0] in names]
    if not names:
        return None, f"{found.label}: left out: its data determine no parameter"
    values, to = to_coordinates(names, np.array([fit.estimate(name).value for name in names]), reference_rad)
    covariance = _covariance(fit, names)
    moved, u_of = _sources(run, names, to)
    # a budget corrects the values for an input: seen ones move the other way
    shared = {source: -by for source, by in moved.items() if source not in GROWTH + _OWN and np.any(by)}
    grown = {source: moved[source] for source in GROWTH if u_of.get(source, 0.0) > 0}
    shared |= grown
    own, of_law = _less_misfit(run, names, to @ covariance @ to.T)
    of_air = _u_of_air(run, fit)
    if of_air > 0 and DRAG.key in names:
        # what is known of the drag moves all parameters along the drag's own column
        drag = names.index(DRAG.key)
        part = to @ covariance[:, drag] * (of_air / covariance[drag, drag])
        share = float(part @ np.linalg.solve(own, part))
        shared[_AIR] = part = part * min(1.0, (_MOST_SHARED / share) ** 0.5) if share > 0 else part
        own = own - np.outer(part, part)
    shared |= of_law
    for source in _OWN:
        if source in moved:
            own = own + np.outer(moved[source], moved[source])
    duration_s = _duration_s(run)
    return (
        CompressedRun(
            label=found.label,
            contact=found.contact,
            names=tuple(names),
            values=values,
            covariance=0.5 * (own + own.T),
            shared=shared,
            asymmetry=_asymmetry(fit, names, run.rows),
            bounds=bounds,
            covariates=_covariates(run, fit, u_covariates, duration_s),
            by_growth=sum((by / u_of[key] for key, by in grown.items()), np.zeros(len(names)))
            if grown
            else None,
            duration_s=duration_s,
        ),
        "",
    )


def _is_determined(row: ResultRow | None) -> bool:
    return row is None or row.verdict in (Determinacy.DETERMINED, Determinacy.INTERVAL)


def _bound(name: str, value: float, u: float, row: ResultRow | None) -> Bound | None:
    """The limit of a positive parameter that a run only bounds, in its coordinate; not of b and gamma,
    whose coordinates hold other parameters."""
    if name != "c":
        return None
    if row is not None and row.verdict is Determinacy.LOWER_BOUND and row.lower > 0:
        return Bound(log(row.lower), EndSide.LOWER, _SOFT)
    upper = row.upper if row is not None and isfinite(row.upper) else value + 2 * u
    only = not _is_determined(row) or value <= 0 or (row is None and u > _WELL * value)
    if not only or not 0 < upper < inf:
        return None
    # the likelihood falls from one u below the limit on: its half is at the value plus one u
    return Bound(log(upper) - _SOFT, EndSide.UPPER, _SOFT)


def _covariance(fit: Fit, names: Sequence[str]) -> Floats:
    """Of the parameters, from their uncertainties and correlations."""
    u = np.array([fit.estimate(name).standard_uncertainty for name in names])
    known, matrix = fit.correlation.names, np.array(fit.correlation.matrix)
    correlation = np.eye(len(names))
    for i, first in enumerate(names):
        for j, second in enumerate(names):
            if i != j and first in known and second in known:
                correlation[i, j] = matrix[known.index(first), known.index(second)]
    correlation = np.nan_to_num(correlation)
    # rounding in the file must not make it singular
    values, vectors = np.linalg.eigh(0.5 * (correlation + correlation.T))
    correlation = (vectors * np.maximum(values, 1e-9)) @ vectors.T
    return np.asarray(correlation * np.outer(u, u), dtype=np.float64)


def _lines(run: RunResults, name: str) -> Sequence[BudgetSource]:
    budget = run.budget.get(name)
    return () if budget is None else budget.sources


def _sources(run: RunResults, names: Sequence[str], to: Floats) -> tuple[dict[str, Floats], dict[str, float]]:
    """By source, what one standard uncertainty of it does to the coordinates, and that uncertainty."""
    moved: dict[str, Floats] = {}
    u: dict[str, float] = {}
    for place, name in enumerate(names):
        for one in _lines(run, name):
            if isfinite(one.sensitivity):
                by = moved.setdefault(one.source, np.zeros(len(names)))
                by += to[:, place] * (one.sensitivity * one.u_source)
                u[one.source] = one.u_source
    return moved, u


def _u_of_air(run: RunResults, fit: Fit) -> float:
    """Part of the drag's standard uncertainty that is what is known of the air."""
    shares = {one.source: one.share for one in _lines(run, DRAG.key) if one.type == "A" or one.source == _AIR}
    if not shares.get(_AIR, 0.0) > 0:
        return 0.0
    return fit.estimate(DRAG.key).standard_uncertainty * sqrt(shares[_AIR] / sum(shares.values()))


def _less_misfit(run: RunResults, names: Sequence[str], own: Floats) -> tuple[Floats, dict[str, Floats]]:
    """A law that is wrong is so in all runs alike: that part of each variance is shared, by coordinate."""
    keep, shared = np.ones(len(names)), {}
    for place, name in enumerate(names):
        sources = _lines(run, name)
        part = sum(one.share for one in sources if one.source == _MISFIT)
        whole = sum(one.share for one in sources if one.type == "A" or one.source == _AIR)
        if part > 0 and isfinite(whole):
            share = min(part / whole, _MOST_SHARED)
            keep[place] = (1 - share) ** 0.5
            shared[f"{_MISFIT} of {name}"] = (share * own[place, place]) ** 0.5 * np.eye(len(names))[place]
    return own * np.outer(keep, keep), shared


def _asymmetry(fit: Fit, names: Sequence[str], rows: Mapping[str, ResultRow]) -> dict[str, float]:
    """Of profiles whose ends lie unevenly about the value, in coordinates that are the parameter's own."""
    found = {}
    for name in names:
        row = rows.get(name)
        if row is None or not row.by_profile or name in EXPONENT_OF:
            continue
        ends = np.array([row.lower, fit.estimate(name).value, row.upper])
        if not np.all(np.isfinite(ends)) or (name in POSITIVE and ends[0] <= 0):
            continue
        low, high = np.diff(np.log(ends) if name in POSITIVE else ends)
        uneven = float((high - low) / (high + low)) if low > 0 and high > 0 else 0.0
        if abs(uneven) > _UNEVEN:
            found[name] = float(np.clip(uneven, -_MOST_UNEVEN, _MOST_UNEVEN))
    return found


def _covariates(run: RunResults, fit: Fit, u: Mapping[str, float], duration_s: float) -> dict[str, Estimate]:
    known = {} if run.surroundings is None else asdict(run.surroundings)
    found = {name: float(known[name]) for name in SURROUNDING_COVARIATES if isfinite(known.get(name, inf))}
    for name in ("dwell_s", "age_s"):
        if name in found:
            # parameters are those of the middle of the run
            found[name] += 0.5 * duration_s
    first = fit.estimate(AMPLITUDE.key).value
    if isfinite(first):
        found["first_amplitude_rad"] = first
    if run.pendulum is not None:
        found["load_n"] = run.pendulum.mass_kg * run.pendulum.gravity_m_per_s2
    return {name: Estimate(value, u.get(name, 0.0)) for name, value in found.items()}


def _duration_s(run: RunResults) -> float:
    time_s = run.stored.time_s
    return 0.0 if len(time_s) < 2 else float(time_s[-1] - time_s[0])


SCHEMA = 1


@dataclass(frozen=True, slots=True, kw_only=True)
class CampaignValue:
    """A quantity of a contact where all effects are zero.

    `without_priors` is the answer of the data alone. Ends are of the 95 % band.
    """

    value: Annotated[float, PART]
    standard_uncertainty: Annotated[float, PART]
    lower_95: Annotated[float, PART] = nan
    upper_95: Annotated[float, PART] = nan
    without_priors: Annotated[Estimate, PART] = NOT_DETERMINED

    @property
    def estimate(self) -> Estimate:
        return Estimate(self.value, self.standard_uncertainty)


@dataclass(frozen=True, slots=True, kw_only=True)
class CampaignSource:
    """What one source adds to the uncertainty of a contact's quantity, and its share of the variance."""

    source: str
    contribution: float
    share: float


@dataclass(frozen=True, slots=True, kw_only=True)
class CampaignEffect:
    """One effect: slope in its coordinate (of b, c and gamma the logarithm) per unit of its form.

    `over_span` is what it moves over the campaign. `chance` is that of one as large where there is none
    (`chance_is_limit`: at most, because there are no more draws), `seen` whether that is below 5 % shared by
    all that were tried. `log_bayes_factor` is that of the form against none, `probability` after it, with the
    choice among those that were tried charged; `margin` is what would not matter, `equivalent` the
    probability that the effect over the span is smaller.
    """

    label: str
    parameter: str
    covariate: str
    form: str
    reference: float
    slope: Estimate = NOT_DETERMINED
    slope_without_priors: Estimate = NOT_DETERMINED
    lower_95: float = nan
    upper_95: float = nan
    over_span: Estimate = NOT_DETERMINED
    chance: float = nan
    chance_is_limit: bool = False
    seen: bool = False
    log_bayes_factor: float = nan
    probability: float = nan
    margin: float | None = None
    equivalent: float = nan


@dataclass(frozen=True, slots=True, kw_only=True)
class CampaignDifference:
    """Two contacts where all effects are zero: the first's coordinate less the second's, with the ends of its
    95 % band. The coordinate of b, c and gamma is the logarithm, of b and gamma at the reference amplitude.

    What runs share cancels. `chance` is that of a difference as large where there is none, `seen` whether it
    is below 5 %, shared by all differences of the campaign.
    """

    first: str
    second: str
    parameter: str
    difference: Estimate
    lower_95: float
    upper_95: float
    chance: float
    seen: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class CampaignRun:
    """One run: what it says alone, what the campaign says of it, and how likely it is a bad one.

    `likelihood` is what entered, in coordinates; `results_sha256` the hash of the results it was made of.
    `residuals` are deviations from the model over what run and scatter leave.
    """

    label: str
    contact: str
    record: str
    sha256: str
    results_sha256: str
    likelihood: JsonObject
    alone: Annotated[Mapping[str, Estimate], PART] = field(default_factory=dict)
    together: Annotated[Mapping[str, Estimate], PART] = field(default_factory=dict)
    residuals: Mapping[str, float] = field(default_factory=dict)
    bad: float = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class SamplerFindings:
    """What the sampler's chains say of themselves: the worst R-hat, the fewest independent draws."""

    worst_r_hat: float
    fewest_draws: float
    settled: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class CampaignResults:
    """campaign.json.

    `between_runs` and `between_contacts` are standard deviations, of b, c and gamma as fractions. `shared`
    are inputs that runs have in common, in their standard uncertainties: what the runs say of them.
    `nothing` is the probability that no candidate holds. `draws_that_count` says how well Laplace's method
    describes the posterior, `predictive_p` how probable it is
    that runs of the model scatter as much as the real ones. `stated` is what the configuration states.
    """

    schema: int = SCHEMA
    parameters: tuple[str, ...]
    reference_arcsec: float
    runs: tuple[CampaignRun, ...]
    contacts: Annotated[Mapping[str, Mapping[str, CampaignValue]], PART]
    differences: tuple[CampaignDifference, ...] = ()
    between_runs: Mapping[str, Estimate] = field(default_factory=dict)
    between_contacts: Mapping[str, Estimate] = field(default_factory=dict)
    effects: tuple[CampaignEffect, ...] = ()
    candidates: tuple[CampaignEffect, ...] = ()
    nothing: float = nan
    changes: tuple[ChangePoint, ...] = ()
    shared: Mapping[str, Estimate] = field(default_factory=dict)
    budgets: Mapping[str, Mapping[str, tuple[CampaignSource, ...]]] = field(default_factory=dict)
    draws: int = 0
    draws_that_count: float = nan
    predictive_p: float = nan
    sampler: SamplerFindings | None = None
    left_out: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    simulated: bool = False
    stated: JsonObject = field(default_factory=dict)


def likelihood_tree(run: CompressedRun) -> JsonObject:
    """What entered of a run, as it stands in the file."""
    return {
        "names": list(run.names),
        "values": run.values.tolist(),
        "covariance": run.covariance.tolist(),
        "shared": {key: moved.tolist() for key, moved in run.shared.items()},
        "asymmetry": dict(run.asymmetry),
        "bounds": {
            key: {"limit": b.limit, "side": str(b.side), "softness": b.softness}
            for key, b in run.bounds.items()
        },
        "covariates": {key: list(found) for key, found in run.covariates.items()},
        "by_growth": None if run.by_growth is None else run.by_growth.tolist(),
        "duration_s": run.duration_s,
    }

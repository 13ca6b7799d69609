"""The likelihood of each run, compressed from its results, and the results of a campaign.

A likelihood is made of results.json alone: parameters with their correlation, inputs shared by the budget,
and bounds.
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
from processing.fit import FitMethod
from processing.quantity import PART
from processing.series import (
    EXPONENT_OF,
    GROWTH,
    Bound,
    ChangePoint,
    CompressedRun,
    EndSide,
    to_coordinates,
)
from rig.analysis import Fit, JsonObject, ResultRow, RunResults
from rig.report.campaign_input import AMBIENT_COVARIATES, CandidateRun

_AIR, _DISCREPANCY = "air", "discrepancy"
_RUN_SOURCES = ("period_drift", "drag_drift", "plane_of_swing_rad")
"""Sources of uncertainty that are independent from run to run."""
_MAX_SHARED_FRACTION = 0.9999
"""Largest fraction of a variance that is shared; the rest is the run's own."""
_MAX_U = 0.5
"""Relative standard uncertainty above which a positive parameter without a verdict is only bounded."""
_BOUND_SOFTNESS = 0.3
"""Softness of a bound: width of its edge in the coordinate."""


def compress(candidate: CandidateRun, reference_rad: float) -> tuple[CompressedRun | None, str]:
    """The likelihood of a run; or None and one line on why the run cannot enter."""
    run, fit = candidate.run, candidate.run.fits.get(FitMethod.EXACT)
    if fit is None:
        return None, f"{candidate.label}: left out: {run.problem or 'it has no exact fit'}"
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
    # b and gamma need their exponents, without which their coordinates are not independent
    names = [name for name in names if EXPONENT_OF.get(name, (name, 0.0))[0] in names]
    if not names:
        return None, f"{candidate.label}: left out: its data determine no parameter"
    values, jacobian = to_coordinates(
        names, np.array([fit.estimate(name).value for name in names]), reference_rad
    )
    covariance = _covariance(fit, names)
    shifts, u_of = _sources(run, names, jacobian)
    # the budget gives corrections of the values; the observed values move the other way
    shared = {
        source: -shift
        for source, shift in shifts.items()
        if source not in GROWTH + _RUN_SOURCES and np.any(shift)
    }
    growth = {source: shifts[source] for source in GROWTH if u_of.get(source, 0.0) > 0}
    shared |= growth
    own_covariance, law_shared = _without_model_discrepancy(run, names, jacobian @ covariance @ jacobian.T)
    by_air = _own_fractions(run, DRAG.key).get(_AIR, 0.0)
    if by_air > 0 and DRAG.key in names:
        u_air = fit.estimate(DRAG.key).standard_uncertainty * sqrt(by_air)
        # the prior knowledge of the drag moves all parameters along the drag's column of the covariance
        drag = names.index(DRAG.key)
        air_shift = jacobian @ covariance[:, drag] * (u_air / covariance[drag, drag])
        share = float(air_shift @ np.linalg.solve(own_covariance, air_shift))
        shared[_AIR] = air_shift = (
            air_shift * min(1.0, (_MAX_SHARED_FRACTION / share) ** 0.5) if share > 0 else air_shift
        )
        own_covariance = own_covariance - np.outer(air_shift, air_shift)
    shared |= law_shared
    for source in _RUN_SOURCES:
        if source in shifts:
            own_covariance = own_covariance + np.outer(shifts[source], shifts[source])
    time_s = run.stored.time_s
    duration_s = float(time_s[-1] - time_s[0]) if len(time_s) else 0.0
    return (
        CompressedRun(
            label=candidate.label,
            contact=candidate.contact,
            names=tuple(names),
            values=values,
            covariance=0.5 * (own_covariance + own_covariance.T),
            shared=shared,
            bounds=bounds,
            covariates=_covariates(run, fit, duration_s),
            by_growth=sum((shift / u_of[key] for key, shift in growth.items()), np.zeros(len(names)))
            if growth
            else None,
            duration_s=duration_s,
        ),
        "",
    )


def _is_determined(row: ResultRow | None) -> bool:
    return row is None or row.verdict in (Determinacy.DETERMINED, Determinacy.INTERVAL)


def _bound(name: str, value: float, u: float, row: ResultRow | None) -> Bound | None:
    """The bound of a positive parameter that a run does not determine, in its coordinate; only of c."""
    if name != "c":
        return None
    if row is not None and row.verdict is Determinacy.LOWER_BOUND and row.lower > 0:
        return Bound(log(row.lower), EndSide.LOWER, _BOUND_SOFTNESS)
    upper = row.upper if row is not None and isfinite(row.upper) else value + 2 * u
    is_bounded = not _is_determined(row) or value <= 0 or (row is None and u > _MAX_U * value)
    if not is_bounded or not 0 < upper < inf:
        return None
    # the likelihood falls from one u below the limit on, and is half at the value plus one u
    return Bound(log(upper) - _BOUND_SOFTNESS, EndSide.UPPER, _BOUND_SOFTNESS)


def _covariance(fit: Fit, names: Sequence[str]) -> Floats:
    """Covariance of the parameters, from their uncertainties and correlations."""
    u = np.array([fit.estimate(name).standard_uncertainty for name in names])
    known, correlation = fit.correlation.names, np.eye(len(names))
    if set(names) <= set(known):
        indices = [known.index(name) for name in names]
        correlation = np.nan_to_num(np.array(fit.correlation.matrix)[np.ix_(indices, indices)])
    # rounding in the file must not make the matrix singular
    values, vectors = np.linalg.eigh(0.5 * (correlation + correlation.T))
    correlation = (vectors * np.maximum(values, 1e-9)) @ vectors.T
    return np.asarray(correlation * np.outer(u, u), dtype=np.float64)


def _sources(
    run: RunResults, names: Sequence[str], jacobian: Floats
) -> tuple[dict[str, Floats], dict[str, float]]:
    """Shifts of the coordinates by one standard uncertainty of each source, and these uncertainties."""
    shifts: dict[str, Floats] = {}
    u: dict[str, float] = {}
    for column, name in enumerate(names):
        for line in run.budget[name].sources if name in run.budget else ():
            if isfinite(line.sensitivity):
                shift = shifts.setdefault(line.source, np.zeros(len(names)))
                shift += jacobian[:, column] * (line.sensitivity * line.u_source)
                u[line.source] = line.u_source
    return shifts, u


def _own_fractions(run: RunResults, name: str) -> dict[str, float]:
    """Fractions of the variance of a fitted parameter by source, without those of the apparatus."""
    lines = run.budget[name].sources if name in run.budget else ()
    shares = {line.source: line.share for line in lines if line.type == "A" or line.source == _AIR}
    total = sum(shares.values())
    return {source: share / total for source, share in shares.items() if share > 0}


def _without_model_discrepancy(
    run: RunResults, names: Sequence[str], covariance: Floats
) -> tuple[Floats, dict[str, Floats]]:
    """The covariance without model discrepancy, and the shifts by it, which all runs share."""
    factors, shared = np.ones(len(names)), {}
    for index, name in enumerate(names):
        fraction = min(_own_fractions(run, name).get(_DISCREPANCY, 0.0), _MAX_SHARED_FRACTION)
        if fraction > 0:
            factors[index] = (1 - fraction) ** 0.5
            unit_vector = np.eye(len(names))[index]
            shared[f"{_DISCREPANCY} of {name}"] = (fraction * covariance[index, index]) ** 0.5 * unit_vector
    return covariance * np.outer(factors, factors), shared


def _covariates(run: RunResults, fit: Fit, duration_s: float) -> dict[str, float]:
    known = {} if run.ambient is None else asdict(run.ambient)
    covariates = {name: float(known[name]) for name in AMBIENT_COVARIATES if isfinite(known.get(name, inf))}
    for name in ("dwell_s", "age_s"):
        if name in covariates:
            # parameters refer to the middle of the run
            covariates[name] += 0.5 * duration_s
    first_rad = fit.estimate(AMPLITUDE.key).value
    if isfinite(first_rad):
        covariates["first_amplitude_rad"] = first_rad
    if run.pendulum is not None:
        covariates["load_n"] = run.pendulum.mass_kg * run.pendulum.gravity_m_per_s2
    return covariates


SCHEMA = 1


@dataclass(frozen=True, slots=True, kw_only=True)
class CampaignValue:
    """A quantity of a contact at zero effects."""

    value: Annotated[float, PART]
    standard_uncertainty: Annotated[float, PART]
    lower_95: Annotated[float, PART] = nan
    upper_95: Annotated[float, PART] = nan
    without_priors: Annotated[Estimate, PART] = NOT_DETERMINED
    """The result of the data alone."""

    @property
    def estimate(self) -> Estimate:
        return Estimate(self.value, self.standard_uncertainty)


@dataclass(frozen=True, slots=True, kw_only=True)
class CampaignEffect:
    """One effect: slope in its coordinate (of b, c and gamma the logarithm) per unit of its form."""

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
    """Change over the campaign's span."""
    chance: float = nan
    """Probability of an effect as large if there is none."""
    chance_is_limit: bool = False
    """Whether `chance` is only an upper limit, by the number of draws."""
    seen: bool = False
    """Whether `chance` is below the 5 % level, which all effects share."""
    margin: float | None = None
    """The stated negligible size."""
    equivalent: float = nan
    """Probability, the smaller of those with and without priors, of a change over the span below `margin`."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CampaignDifference:
    """Difference of two contacts at zero effects: first minus second coordinate, with its 95 % band.

    The coordinate of b, c and gamma is the logarithm, of b and gamma at the reference amplitude. Shared
    inputs cancel.
    """

    first: str
    second: str
    parameter: str
    difference: Estimate
    lower_95: float
    upper_95: float
    chance: float
    """Probability of a difference as large if there is none."""
    seen: bool
    """Whether `chance` is below the 5 % level, which all differences share."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CampaignRun:
    """One run of a campaign."""

    label: str
    contact: str
    record: str
    sha256: str
    results_sha256: str
    together: Annotated[Mapping[str, Estimate], PART] = field(default_factory=dict)
    """Parameters together with the campaign; not determined if all runs of the contact only bound them."""
    residuals: Mapping[str, float] = field(default_factory=dict)
    """Deviations from the model, in units of the uncertainty of run and scatter."""
    bad: float = 0.0
    """Probability that the run is bad."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CampaignResults:
    """The contents of campaign.json.

    `between_runs` and `between_contacts` are standard deviations, of b, c and gamma as fractions. `shared`
    are posteriors of inputs that runs have in common, in their standard uncertainties, `budgets` the shares
    of sources in the variance of each contact's quantity. `draws_that_count` (effective draws) tells how well
    Laplace's method describes the posterior. `worst_r_hat` and `fewest_draws` (independent ones) are those of
    the sampler's chains, NaN without it. `stated` is the contents of campaign.toml.
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
    changes: tuple[ChangePoint, ...] = ()
    shared: Mapping[str, Estimate] = field(default_factory=dict)
    budgets: Mapping[str, Mapping[str, Mapping[str, float]]] = field(default_factory=dict)
    draws: int = 0
    draws_that_count: float = nan
    worst_r_hat: float = nan
    fewest_draws: float = nan
    left_out: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    simulated: bool = False
    stated: JsonObject = field(default_factory=dict)

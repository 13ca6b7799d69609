"""The likelihood of each run, compressed from its results.

It is made of results.json alone: parameters with their correlation, what inputs the budget says they share,
how uneven the profiles are, which values are only bounded.
"""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from math import inf, isfinite, log
from typing import NamedTuple

import numpy as np

from processing.arrays import Floats
from processing.campaign import POSITIVE, Bound, CompressedRun, Side, to_coordinates
from processing.contact import DRAG
from processing.contact.laws import AMPLITUDE, DEFAULT_LAW
from processing.estimate import Determinacy, Estimate
from processing.fit import FitMethod
from rig.analysis import Fit, ResultRow, RunResults
from rig.campaigns.stated import SURROUNDING_COVARIATES

_AIR, _MISFIT = "air", "misfit"
_GROWN = ("ageing", "adhesion_ageing")
"""Of the contact as a whole, which an effect on b and c alike describes."""
_OWN = ("period_drift", "drag_drift", "plane_of_swing_rad")
"""Sources that every run has for itself."""
_MOST_SHARED = 0.9999
"""Of a variance: what is left is the run's own."""
_WELL = 0.5
"""Relative standard uncertainty from which on a positive parameter without a verdict is only bounded."""
_UNEVEN = 0.1
"""Asymmetry of a profile from which on it counts."""
_MOST_UNEVEN = 0.8


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
    run = found.run
    fit = run.fits.get(FitMethod.EXACT)
    if fit is None:
        return None, f"{found.label}: left out: {run.problem or 'it has no exact fit'}"
    rows, names, bounds = run.rows, [], {}
    for name in (*DEFAULT_LAW.names(), DRAG.key):
        value, u = fit.estimate(name)
        if not isfinite(value):
            continue
        bound = _bound(name, value, u, rows.get(name))
        if bound is not None:
            bounds[name] = bound
        elif 0 < u < inf and _is_told(rows.get(name)):
            names.append(name)
    # b and gamma are independent of their exponents only beside them
    names = [
        name for name in names
        if not (name == "b" and "p" not in names) and not (name == "gamma_pa" and "n" not in names)
    ]  # fmt: skip
    if not names:
        return None, f"{found.label}: left out: its data determine no parameter"
    values = np.array([fit.estimate(name).value for name in names])
    at = to_coordinates(names, values, reference_rad)
    own = at.by_parameters @ _covariance(fit, names) @ at.by_parameters.T
    shared, by_growth = _shared(run, names, at.by_parameters)
    own, shared = _less_misfit(run, names, at.by_parameters, own, shared)
    if _AIR in shared:
        part = shared[_AIR]
        share = float(part @ np.linalg.solve(own, part))
        part = part * min(1.0, (_MOST_SHARED / share) ** 0.5) if share > 0 else part
        shared[_AIR], own = part, own - np.outer(part, part)
    moved = _relative_sources(run, names, at.by_parameters)
    for source in _OWN:
        if source in moved:
            own = own + np.outer(moved[source], moved[source])
    return (
        CompressedRun(
            label=found.label,
            contact=found.contact,
            names=tuple(names),
            values=at.values,
            covariance=0.5 * (own + own.T),
            shared=shared,
            asymmetry=_asymmetry(fit, names, rows),
            bounds=bounds,
            covariates=_covariates(run, fit, u_covariates),
            by_growth=by_growth,
            duration_s=_duration_s(run),
        ),
        "",
    )


def _is_told(row: ResultRow | None) -> bool:
    return row is None or row.verdict in (Determinacy.DETERMINED, Determinacy.INTERVAL)


def _bound(name: str, value: float, u: float, row: ResultRow | None) -> Bound | None:
    """The limit of a positive parameter that a run only bounds, in its coordinate; not of b and gamma,
    whose coordinates hold other parameters."""
    if name != "c":
        return None
    if row is not None and row.verdict is Determinacy.LOWER_BOUND and row.lower > 0:
        return Bound(log(row.lower), Side.LOWER, 0.3)
    upper = row.upper if row is not None and isfinite(row.upper) else value + 2 * u
    only = not _is_told(row) or value <= 0 or (row is None and u > _WELL * value)
    if not only or not 0 < upper < inf:
        return None
    # the likelihood falls from one u below the limit on: its half is at the value plus one u
    return Bound(log(upper) - 0.3, Side.UPPER, 0.3)


def _covariance(fit: Fit, names: Sequence[str]) -> Floats:
    """Of the parameters, from their uncertainties and correlations."""
    u = np.array([fit.estimate(name).standard_uncertainty for name in names])
    known = fit.correlation.names
    matrix = np.array(fit.correlation.matrix)
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


class _Sources(NamedTuple):
    """Of one parameter's budget, by source: change by one standard uncertainty, and its uncertainty."""

    moved: Mapping[str, float]
    u: Mapping[str, float]


def _sources(run: RunResults, name: str) -> _Sources:
    budget = run.budget.get(name)
    signed = () if budget is None else [one for one in budget.sources if isfinite(one.sensitivity)]
    return _Sources(
        {one.source: one.sensitivity * one.u_source for one in signed},
        {one.source: one.u_source for one in signed},
    )


def _relative_sources(run: RunResults, names: Sequence[str], to: Floats) -> dict[str, Floats]:
    """By source, what one standard uncertainty of it does to the coordinates."""
    found = [_sources(run, name).moved for name in names]
    keys = dict.fromkeys(source for one in found for source in one)
    return {key: to @ np.array([one.get(key, 0.0) for one in found]) for key in keys}


def _shared(run: RunResults, names: Sequence[str], to: Floats) -> tuple[dict[str, Floats], Floats | None]:
    """What inputs of the rig, and the air, do to the values as they are seen; and what growing friction does.

    A budget corrects the values for an input: seen ones move the other way.
    """
    moved = _relative_sources(run, names, to)
    shared = {source: -by for source, by in moved.items() if source not in _GROWN + _OWN and np.any(by)}
    u = {key: u for name in names for key, u in _sources(run, name).u.items()}
    grown = [key for key in _GROWN if u.get(key, 0.0) > 0]
    by_growth = sum((moved[key] / u[key] for key in grown), np.zeros(len(names))) if grown else None
    shared |= {key: moved[key] for key in grown}
    fit, budget = run.fits[FitMethod.EXACT], run.budget.get(DRAG.key)
    of_air = 0.0
    if budget is not None:
        shares = {one.source: one.share for one in budget.sources if one.type == "A" or one.source == _AIR}
        if shares.get(_AIR, 0.0) > 0:
            of_air = (
                fit.estimate(DRAG.key).standard_uncertainty * (shares[_AIR] / sum(shares.values())) ** 0.5
            )
    if of_air > 0 and DRAG.key in names:
        covariance = _covariance(fit, names)
        drag = names.index(DRAG.key)
        # what is known of the drag moves all parameters along the drag's own column
        shared[_AIR] = to @ covariance[:, drag] * (of_air / covariance[drag, drag])
    return shared, by_growth


def _less_misfit(
    run: RunResults, names: Sequence[str], to: Floats, own: Floats, shared: dict[str, Floats]
) -> tuple[Floats, dict[str, Floats]]:
    """A law that is wrong is so in all runs alike: that part of each variance is shared, by coordinate."""
    keep = np.ones(len(names))
    for place, name in enumerate(names):
        budget = run.budget.get(name)
        sources = () if budget is None else budget.sources
        part = sum(one.share for one in sources if one.source == _MISFIT)
        whole = sum(one.share for one in sources if one.type == "A" or one.source == _AIR)
        if part > 0 and isfinite(whole):
            share = min(part / whole, _MOST_SHARED)
            keep[place] = (1 - share) ** 0.5
            column = np.zeros(len(names))
            column[place] = (share * own[place, place]) ** 0.5
            shared[f"{_MISFIT} of {name}"] = column
    return own * np.outer(keep, keep), shared


def _asymmetry(fit: Fit, names: Sequence[str], rows: Mapping[str, ResultRow]) -> dict[str, float]:
    """Of profiles whose ends lie unevenly about the value, in coordinates that are the parameter's own."""
    found = {}
    for name in names:
        row = rows.get(name)
        if row is None or not row.by_profile or name in ("b", "gamma_pa"):
            continue
        ends = np.array([row.lower, fit.estimate(name).value, row.upper])
        if not np.all(np.isfinite(ends)) or (name in POSITIVE and ends[0] <= 0):
            continue
        low, high = np.diff(np.log(ends) if name in POSITIVE else ends)
        if low > 0 and high > 0:
            uneven = float((high - low) / (high + low))
            if abs(uneven) > _UNEVEN:
                found[name] = float(np.clip(uneven, -_MOST_UNEVEN, _MOST_UNEVEN))
    return found


def _covariates(run: RunResults, fit: Fit, u: Mapping[str, float]) -> dict[str, Estimate]:
    known = {} if run.surroundings is None else asdict(run.surroundings)
    found = {name: float(known[name]) for name in SURROUNDING_COVARIATES if isfinite(known.get(name, inf))}
    for name in ("dwell_s", "age_s"):
        if name in found:
            # parameters are those of the middle of the run
            found[name] += 0.5 * _duration_s(run)
    first = fit.estimate(AMPLITUDE.key).value
    if isfinite(first):
        found["first_amplitude_rad"] = first
    if run.pendulum is not None:
        found["load_n"] = run.pendulum.mass_kg * run.pendulum.gravity_m_per_s2
    return {name: Estimate(value, u.get(name, 0.0)) for name, value in found.items()}


def _duration_s(run: RunResults) -> float:
    points = run.turning_points
    return (
        float(points.time_s[-1] - points.time_s[0]) if points is not None and len(points.time_s) > 1 else 0.0
    )

"""Assumptions about a series, and the arrays by which latent numbers move the values of the runs."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Final, NamedTuple

import numpy as np

from processing.arrays import Floats, Ints
from processing.errors import DataError
from processing.estimate import Estimate
from processing.series.runs import (
    FRICTION,
    ORDER,
    CompressedRun,
    Effect,
    EndSide,
    Form,
    covariate_of,
    only_bound,
)

USUAL_SIZE: Final[Mapping[str, float]] = {
    "b": 0.2, "p": 0.02, "c": 0.5, "n": 0.1, "period0_s": 0.01, "gamma_pa": 0.2, "drag_s": 5e-4,
}  # fmt: skip
"""Prior size of a parameter's change over a series, in its coordinate."""
GROWTH: Final = ("ageing", "adhesion_ageing")
"""Names of the shared inputs for a friction that grows within every run, where no effect describes it."""
_UNKNOWN_LEVEL = 100.0
"""Prior standard deviation of an unknown level about the median of the data, in usual sizes."""
_BOUNDED_U = 3.0
"""Prior standard deviation of a level that runs only bound: near the limit it makes the prior of the
parameter itself nearly even."""
_NO_PRIOR_FACTOR = 30.0
"""Factor by which priors are widened so that they have no influence."""
_BAD_FACTORS = (3.0, 10.0, 30.0)
"""Factors, of equal probability, on a bad run's own uncertainty and its scatter."""


@dataclass(frozen=True, kw_only=True)
class SeriesModel:
    """Assumptions about a series."""

    names: tuple[str, ...]
    """The coordinates that are modelled, each with a scatter between runs; others are left out."""
    effects: tuple[Effect, ...] = ()
    sizes: Mapping[str, float] = field(default_factory=dict)
    """By coordinate, the prior standard deviation of an effect over the series (normal about zero) and of the
    scatter between runs (half-normal)."""
    levels: Mapping[str, Estimate] = field(default_factory=dict)
    """Priors of levels by coordinate, where something is known."""
    contacts_alike: bool = False
    """Whether contacts are of one kind and scatter about its mean; else their levels are unrelated."""
    bad_run_chance: float = 0.02
    """Prior probability of a run to be bad."""

    def size(self, name: str) -> float:
        """The usual size of a coordinate; that of friction is b's if it is not stated."""
        known = {**USUAL_SIZE, **self.sizes}
        return known.get(name, known["b"]) if name == FRICTION else known[name]

    def without_priors(self) -> "SeriesModel":
        """The same with priors so wide that the data alone decide."""
        wide = {name: _NO_PRIOR_FACTOR * self.size(name) for name in (*self.names, FRICTION)}
        return replace(self, sizes=wide, levels={})

    def with_effects(self, *effects: Effect) -> "SeriesModel":
        """The same with further effects."""
        return replace(self, effects=(*self.effects, *effects))


class LatentNumber(NamedTuple):
    """A latent number, or a scatter."""

    kind: str
    """``contact`` or ``mean`` for the level of a coordinate, ``effect`` for a slope, ``shared`` for an input;
    ``between runs`` or ``between contacts`` for a scatter."""
    name: str
    contact: str = ""


class Bounds(NamedTuple):
    """Values of B runs that are only bounded."""

    x: Floats
    """Derivatives (B, P) of the values with respect to the latent numbers."""
    limit: Floats
    sign: Floats
    """+1 for an upper limit, -1 for a lower one."""
    softness: Floats
    """Standard deviations of the limits."""
    coordinate: Ints
    """Indices of the bounded coordinates."""


class Design(NamedTuple):
    """Arrays of a series of R runs, k coordinates, P latent numbers."""

    y: Floats
    """Means (R, k) of the runs' normal likelihoods; 0 where a run does not have a coordinate."""
    covariance: Floats
    """Their covariances (R, k, k), with the variance 1 where a run does not have a coordinate."""
    has: Floats
    """1 where a run has a coordinate (R, k), else 0."""
    x: Floats
    """Derivatives (R, k, P) of the values with respect to the latent numbers."""
    blurred: Floats
    """Standard deviations (E, R, k) of the values by unknown covariates, for effects of size 1."""
    blurred_by: Ints
    """Indices (E,) of these effects among the latent numbers."""
    levels: tuple[LatentNumber, ...]
    """The latent numbers (P,), whose priors are normal."""
    prior_mean: Floats
    prior_u: Floats
    varies: Ints
    """Index (P,) of the scatter of each latent number; -1 for none."""
    scales: Floats
    """Scales (H,) of the scatters' half-normal priors."""
    hyper: tuple[LatentNumber, ...]
    """The scatters (H,), first those between runs (k,)."""
    bounds: Bounds
    log_kind: Floats
    """Logarithms (K,) of the prior probabilities of good and bad runs."""
    worse: Floats
    """Factors (K,) on the widths of good and bad runs."""


def design_of(runs: Sequence[CompressedRun], model: SeriesModel) -> Design:
    """The arrays of a model over runs.

    Raises DataError without runs, for an unknown parameter of an effect, or a coordinate that no run has.
    """
    if not runs:
        raise DataError("a series needs runs")
    names, count = model.names, len(runs)
    latent: list[tuple[LatentNumber, Floats, float, float, int]] = []
    hyper = [LatentNumber("between runs", name) for name in names]
    contacts = list(dict.fromkeys(run.contact for run in runs))
    alike = model.contacts_alike and len(contacts) > 1
    for place, name in enumerate(names):
        measured = [run.values[run.names.index(name)] for run in runs if name in run.names]
        measured = measured or [run.bounds[name].limit for run in runs if name in run.bounds]
        if not measured:
            raise DataError(f"{name}: no run of the series determines it; leave it out of the parameters")
        unknown = Estimate(float(np.median(measured)), _UNKNOWN_LEVEL * model.size(name))
        prior = model.levels.get(name, unknown)
        all_runs = np.zeros((count, len(names)))
        all_runs[:, place] = 1.0
        if alike:
            latent.append((LatentNumber("mean", name), all_runs, *prior, -1))
            hyper.append(LatentNumber("between contacts", name))
        for contact in contacts:
            own = all_runs * np.array([run.contact == contact for run in runs])[:, None]
            own_prior = prior if name in model.levels else _prior_of_bounded(runs, contact, name) or prior
            contact_prior = (0.0, 1.0, len(hyper) - 1) if alike else (*own_prior, -1)
            latent.append((LatentNumber("contact", name, contact), own, *contact_prior))
    blurred: list[Floats] = []
    blurred_by: list[int] = []
    for effect in model.effects:
        column, blur = _effect(runs, effect, names)
        if np.any(blur):
            blurred.append(blur)
            blurred_by.append(len(latent))
        size = model.size(effect.parameter) / effect.span(runs)
        latent.append((LatentNumber("effect", effect.label), column, 0.0, size, -1))
    grows = any(effect.bends_decays for effect in model.effects)
    for source in dict.fromkeys(source for run in runs for source in run.shared):
        if grows and source in GROWTH:
            continue  # the effect describes it, so that it is no unknown input
        column = np.zeros((count, len(names)))
        for row, run in enumerate(runs):
            _add(column[row], names, run, run.shared.get(source))
        if np.any(column):
            latent.append((LatentNumber("shared", source), column, 0.0, 1.0, -1))
    levels, columns, mean, u, varies = zip(*latent, strict=True)
    x = np.stack(columns, axis=-1)
    y, covariance, has = _values(runs, names)
    bad = model.bad_run_chance
    with np.errstate(divide="ignore"):
        log_kind = np.log([1 - bad, *([bad / len(_BAD_FACTORS)] * len(_BAD_FACTORS))])
    return Design(
        y, covariance, has, x * has[:, :, None],
        np.array(blurred).reshape(-1, count, len(names)) * has, np.array(blurred_by, dtype=np.int64),
        levels, np.array(mean), np.array(u), np.array(varies, dtype=np.int64),
        np.array([model.size(level.name) for level in hyper]), tuple(hyper), _bounds(runs, names, x),
        log_kind, np.array([1.0, *_BAD_FACTORS]),
    )  # fmt: skip


def _prior_of_bounded(runs: Sequence[CompressedRun], contact: str, name: str) -> Estimate | None:
    """Prior of the level of a contact that runs only bound on one side; None otherwise.

    One that is even in the logarithm would put the level far from the limit in nearly all cases. This one
    rises towards the limit as the parameter itself, or its inverse.
    """
    side = only_bound(runs, contact, name)
    if side is None:
        return None
    limits = [run.bounds[name].limit for run in runs if run.contact == contact and name in run.bounds]
    if side is EndSide.UPPER:
        return Estimate(min(limits) + _BOUNDED_U**2, _BOUNDED_U)
    return Estimate(max(limits) - _BOUNDED_U**2, _BOUNDED_U)


def _add(row: Floats, names: Sequence[str], run: CompressedRun, changes: Floats | None) -> None:
    """Add changes of a run's values to a row of the model's coordinates."""
    for name, change in zip(run.names, () if changes is None else changes, strict=False):
        if name in names:
            row[names.index(name)] += change


def _values(runs: Sequence[CompressedRun], names: Sequence[str]) -> tuple[Floats, Floats, Floats]:
    y, has = np.zeros((2, len(runs), len(names)))
    covariance = np.tile(np.eye(len(names)), (len(runs), 1, 1))
    for row, run in enumerate(runs):
        in_run = [place for place, name in enumerate(run.names) if name in names]
        in_model = [names.index(run.names[place]) for place in in_run]
        y[row, in_model], has[row, in_model] = run.values[in_run], 1.0
        covariance[row][np.ix_(in_model, in_model)] = run.covariance[np.ix_(in_run, in_run)]
    return y, covariance, has


def _effect(runs: Sequence[CompressedRun], effect: Effect, names: Sequence[str]) -> tuple[Floats, Floats]:
    """Derivatives (R, k) of the values by an effect's slope, and the part by its covariate's uncertainty."""
    moved = [names.index(name) for name in effect.moves() if name in names]
    if not moved:
        raise DataError(f"{effect.label}: {effect.parameter} is not one of the parameters {', '.join(names)}")
    x, u = covariate_of(runs, effect.covariate if effect.form is not Form.DURING else ORDER)
    has_effect = np.array([effect.contact in ("", run.contact) for run in runs])
    column, blur = np.zeros((2, len(runs), len(names)))
    value, u_value = effect.expected(x, u)
    column[:, moved], blur[:, moved] = (value * has_effect)[:, None], (u_value * has_effect)[:, None]
    if effect.bends_decays:
        for row, (run, rate) in enumerate(zip(runs, effect.slope(x) * has_effect, strict=True)):
            if run.by_growth is not None:
                _add(column[row], names, run, run.by_growth * rate * run.duration_s)
    return column, blur


def _bounds(runs: Sequence[CompressedRun], names: Sequence[str], x: Floats) -> Bounds:
    rows = [
        (x[row, names.index(name)], bound.limit, 1.0 if bound.side is EndSide.UPPER else -1.0, bound.softness,
         names.index(name))
        for row, run in enumerate(runs) for name, bound in run.bounds.items() if name in names
    ]  # fmt: skip
    columns, limit, sign, softness, place = zip(*rows, strict=True) if rows else ((), (), (), (), ())
    return Bounds(
        np.array(columns).reshape(-1, x.shape[-1]), np.array(limit), np.array(sign), np.array(softness),
        np.array(place, dtype=np.int64),
    )  # fmt: skip

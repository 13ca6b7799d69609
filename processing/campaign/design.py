"""The linear part of a campaign's model: which latent number moves which value of which run."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from processing.arrays import Floats, Ints
from processing.campaign.compressed import CompressedRun, Side
from processing.campaign.coordinates import USUAL_SIZE
from processing.campaign.forms import FRICTION, ORDER, Effect, Form, covariate_of
from processing.errors import DataError
from processing.estimate import Estimate

_VAGUE = 100.0
"""A level of which nothing is known lies within so many usual sizes of the data's middle."""
_WIDENED = 30.0
"""A prior is none where it is this much wider than stated."""
GROWTH = ("ageing", "adhesion_ageing")
"""The shared input that a friction growing within every run is, where no effect describes it."""
_FAR = 0.2
"""Share of the sub-likelihood on the long side of an uneven one."""
_BAD_BY = (3.0, 10.0, 30.0)
"""A bad run lies off by so many times what it and the scatter between runs say; each as likely."""


@dataclass(frozen=True, kw_only=True)
class CampaignModel:
    """What is supposed of a campaign.

    Attributes
    ----------
    names
        The coordinates that are modelled; others of the runs are left out.
    effects
        Dependences on covariates.
    sizes
        By coordinate, how far an effect may move it over the campaign (standard deviation of a normal
        distribution about nought), and how far runs may scatter (of half a normal distribution).
    levels
        Priors of levels by coordinate, where something is known; else nothing is.
    scatter
        The coordinates that scatter between runs; None: all.
    contacts_alike
        Contacts are of one kind, about whose mean they scatter; else each stands for itself.
    bad_run_chance
        Chance of one run to be bad.
    """

    names: tuple[str, ...]
    effects: tuple[Effect, ...] = ()
    sizes: Mapping[str, float] = field(default_factory=dict)
    levels: Mapping[str, Estimate] = field(default_factory=dict)
    scatter: tuple[str, ...] | None = None
    contacts_alike: bool = False
    bad_run_chance: float = 0.02

    def size(self, name: str) -> float:
        """The usual size of a coordinate."""
        known = {**USUAL_SIZE, **self.sizes}
        return known["b" if name == FRICTION else name]

    def without_priors(self) -> "CampaignModel":
        """The same with all that is stated made so wide that the data alone decide."""
        wide = {name: _WIDENED * self.size(name) for name in self.names}
        return replace(self, sizes=wide, levels={})

    def with_effects(self, *effects: Effect) -> "CampaignModel":
        """The same with other effects."""
        return replace(self, effects=effects)


class Level(NamedTuple):
    """A latent number: the level of a coordinate (of a contact), the slope of an effect, a shared input."""

    kind: str
    name: str
    contact: str = ""


class Bounds(NamedTuple):
    """Censored values: design, limits, +1 for upper ones, softness, place of the coordinate."""

    x: Floats
    limit: Floats
    sign: Floats
    softness: Floats
    coordinate: Ints


class Design(NamedTuple):
    """Arrays of a campaign of R runs, k coordinates, P latent numbers, S sub-likelihoods a run.

    `y` (R, S, k), `covariance` (R, S, k, k), `log_share` (R, S): each run's likelihood as a sum of normal
    ones. Where a run does not have a coordinate `has` (R, k) is 0, its variance 1 and its value 0. `x`
    (R, k, P). `blurred` (E, R, k) times the latent numbers `blurred_by` (E,) are standard deviations that
    uncertain covariates leave. `scatter` (k,) and `varies` (P,) are places among `scales`, the scales (H,)
    of half-normal priors of scatters, or -1.
    """

    y: Floats
    covariance: Floats
    log_share: Floats
    has: Floats
    x: Floats
    blurred: Floats
    blurred_by: Ints
    levels: tuple[Level, ...]
    prior_mean: Floats
    prior_u: Floats
    varies: Ints
    scatter: Ints
    scales: Floats
    hyper: tuple[Level, ...]
    bounds: Bounds
    log_kind: Floats
    worse: Floats


def design_of(runs: Sequence[CompressedRun], model: CampaignModel) -> Design:
    """The arrays of a model over runs.

    Raises
    ------
    DataError
        No runs, an unknown parameter of an effect, or a coordinate that no run has.
    """
    if not runs:
        raise DataError("a campaign needs runs")
    names, count = model.names, len(runs)
    y, covariance, has = _values(runs, names)
    log_share, y, covariance = _skewed(runs, names, y, covariance)
    middle = {}
    for place, name in enumerate(names):
        seen = [run.values[run.names.index(name)] for run in runs if name in run.names]
        limits = [run.bounds[name].limit for run in runs if name in run.bounds]
        if not seen and not limits:
            raise DataError(f"{name}: no run of the campaign determines it; leave it out of the parameters")
        middle[place] = float(np.median(seen or limits))
    columns: list[Floats] = []
    levels: list[Level] = []
    priors: list[tuple[float, float, int]] = []
    hyper: list[Level] = []
    scales: list[float] = []

    def add(level: Level, column: Floats, mean: float, u: float, varies: int = -1) -> None:
        levels.append(level)
        columns.append(column)
        priors.append((mean, u, varies))

    scatter = np.full(len(names), -1, dtype=np.int64)
    for place, name in enumerate(names):
        if model.scatter is None or name in model.scatter:
            scatter[place] = len(hyper)
            hyper.append(Level("between runs", name))
            scales.append(model.size(name))
    contacts = list(dict.fromkeys(run.contact for run in runs))
    alike = model.contacts_alike and len(contacts) > 1
    for place, name in enumerate(names):
        mean, u = model.levels.get(name, Estimate(middle[place], _VAGUE * model.size(name)))
        whole = np.zeros((count, len(names)))
        whole[:, place] = 1.0
        if alike:
            add(Level("mean", name), whole, mean, u)
            hyper.append(Level("between contacts", name))
            scales.append(model.size(name))
        for contact in contacts:
            own = whole * np.array([run.contact == contact for run in runs])[:, None]
            if alike:
                add(Level("contact", name, contact), own, 0.0, 1.0, len(hyper) - 1)
            else:
                add(Level("contact", name, contact), own, mean, u)
    blurred, blurred_by = [], []
    for effect in model.effects:
        column, blur, span = _effect(runs, effect, names)
        if np.any(blur):
            blurred.append(blur)
            blurred_by.append(len(levels))
        add(Level("effect", effect.label), column, 0.0, model.size(effect.parameter) / span)
    grows = any(effect.bends_decays for effect in model.effects)
    for source in dict.fromkeys(source for run in runs for source in run.shared):
        if grows and source in GROWTH:
            continue  # what an effect describes is no input of which little is known
        column = np.zeros((count, len(names)))
        for row, run in enumerate(runs):
            for name, moved in zip(run.names, run.shared.get(source, ()), strict=False):
                if name in names:
                    column[row, names.index(name)] = moved
        if np.any(column):
            add(Level("shared", source), column, 0.0, 1.0)
    x = np.stack(columns, axis=-1)
    stated = np.array(priors, dtype=np.float64)
    kinds = np.array([1 - model.bad_run_chance, *([model.bad_run_chance / len(_BAD_BY)] * len(_BAD_BY))])
    with np.errstate(divide="ignore"):
        log_kind = np.log(kinds)
    return Design(
        y, covariance, log_share, has, x * has[:, :, None],
        np.array(blurred).reshape(-1, count, len(names)) * has, np.array(blurred_by, dtype=np.int64),
        tuple(levels), stated[:, 0], stated[:, 1], stated[:, 2].astype(np.int64), scatter, np.array(scales),
        tuple(hyper),
        _bounds(runs, names, x), log_kind, np.array([1.0, *_BAD_BY]),
    )  # fmt: skip


def _values(runs: Sequence[CompressedRun], names: Sequence[str]) -> tuple[Floats, Floats, Floats]:
    count, size = len(runs), len(names)
    y, has = np.zeros((count, size)), np.zeros((count, size))
    covariance = np.tile(np.eye(size), (count, 1, 1))
    for row, run in enumerate(runs):
        own = [place for place, name in enumerate(run.names) if name in names]
        there = [names.index(run.names[place]) for place in own]
        y[row, there], has[row, there] = run.values[own], 1.0
        covariance[row][np.ix_(there, there)] = run.covariance[np.ix_(own, own)]
    return y, covariance, has


def _skewed(
    runs: Sequence[CompressedRun], names: Sequence[str], y: Floats, covariance: Floats
) -> tuple[Floats, Floats, Floats]:
    """Each run as a sum of two normal likelihoods with the first three moments of one that falls by other
    widths on either side, along the value with the most uneven profile; one for a parabola."""
    uneven = [
        max(
            ((abs(a), a, names.index(name)) for name, a in run.asymmetry.items() if name in names),
            default=(0.0, 0.0, 0),
        )
        for run in runs
    ]
    if not any(most > 0 for most, _, _ in uneven):
        return np.zeros((len(runs), 1)), y[:, None], covariance[:, None]
    both, wide = np.repeat(y[:, None], 2, axis=1), np.repeat(covariance[:, None], 2, axis=1)
    share = np.full((len(runs), 2), 0.5)
    for row, (most, a, place) in enumerate(uneven):
        if not most > 0:
            continue
        u = np.sqrt(covariance[row, place, place])
        low, high = u * (1 - a), u * (1 + a)
        mean, variance, third = _moments(float(low), float(high))
        apart = np.cbrt(third / (_FAR * (1 - _FAR) * (1 - 2 * _FAR)))
        inner = variance - _FAR * (1 - _FAR) * apart**2
        # along the direction in which the others follow this value
        along = covariance[row][:, place] / u**2
        shift = mean + apart * np.array([-_FAR, 1 - _FAR])
        share[row] = 1 - _FAR, _FAR
        both[row] = y[row] + shift[:, None] * along
        wide[row] = covariance[row] + (inner - u**2) * np.outer(along, along)
    return np.log(share), both, wide


def _moments(low: float, high: float) -> tuple[float, float, float]:
    """Mean, variance and third moment of a normal distribution with other widths on either side of nought."""
    apart, product = high - low, low * high
    mean = float(np.sqrt(2 / np.pi)) * apart
    return mean, (1 - 2 / np.pi) * apart**2 + product, mean * ((4 / np.pi - 1) * apart**2 + product)


def _effect(
    runs: Sequence[CompressedRun], effect: Effect, names: Sequence[str]
) -> tuple[Floats, Floats, float]:
    """Column of an effect, what its covariate's uncertainty leaves, and how far its form moves."""
    moved = [names.index(name) for name in effect.moves() if name in names]
    if not moved:
        raise DataError(f"{effect.label}: {effect.parameter} is not one of the parameters {', '.join(names)}")
    x, u = covariate_of(runs, effect.covariate if effect.form is not Form.DURING else ORDER)
    here = np.array([effect.contact in ("", run.contact) for run in runs])
    column, blur = np.zeros((len(runs), len(names))), np.zeros((len(runs), len(names)))
    value, u_value = effect.seen(x, u)
    column[:, moved] = (value * here)[:, None]
    blur[:, moved] = (u_value * here)[:, None]
    if effect.bends_decays:
        rate = effect.slope(x) * here
        for row, run in enumerate(runs):
            for name, by in zip(run.names, run.by_growth if run.by_growth is not None else (), strict=False):
                if name in names:
                    column[row, names.index(name)] += by * rate[row] * run.duration_s
    return column, blur, span_of(runs, effect)


def span_of(runs: Sequence[CompressedRun], effect: Effect) -> float:
    """How far an effect moves over the campaign with slope 1."""
    if effect.form is Form.DURING:
        return max(run.duration_s for run in runs)
    return effect.span(covariate_of(runs, effect.covariate)[0])


def _bounds(runs: Sequence[CompressedRun], names: Sequence[str], x: Floats) -> Bounds:
    found = [
        (row, names.index(name), bound)
        for row, run in enumerate(runs)
        for name, bound in run.bounds.items()
        if name in names
    ]
    return Bounds(
        np.array([x[row, place] for row, place, _ in found]).reshape(-1, x.shape[-1]),
        np.array([bound.limit for *_, bound in found]),
        np.array([1.0 if bound.side is Side.UPPER else -1.0 for *_, bound in found]),
        np.array([bound.softness for *_, bound in found]),
        np.array([place for _, place, _ in found], dtype=np.int64),
    )

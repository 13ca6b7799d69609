"""What runs to come would add to a campaign, before they are made.

Given the scatters between runs all is linear and normal: what a run adds to the information does not depend
on what it will find. Scatters are drawn from the posterior, or from their priors where no run was made.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import sqrt
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq
from scipy.special import ndtr, ndtri

from processing.arrays import Floats
from processing.campaign.compressed import CompressedRun
from processing.campaign.design import CampaignModel, Design, Level, design_of, span_of
from processing.campaign.forms import ORDER, Effect
from processing.campaign.posterior import CampaignPosterior
from processing.errors import DataError
from processing.estimate import Estimate

PLACE: Final = "place"
"""The place of a planned run in the campaign, as a covariate."""
_SCATTERS = 8
_WIDENED = 30.0
"""A prior is none where it is this much wider than stated."""
_SEEN_TOGETHER = 2
"""Values among which a covariate that nobody sets is thought to alternate."""


@dataclass(frozen=True, kw_only=True)
class CandidateRun:
    """A run that may be made.

    Attributes
    ----------
    likelihood
        As it is expected; its values do not count. Covariates are those that the run itself sets.
    waiting_s
        Before it: the contact stands.
    ready_s
        What else a run costs before its first turning point: rest, preflight, release.
    """

    likelihood: CompressedRun
    waiting_s: float = 0.0
    ready_s: float = 0.0

    @property
    def label(self) -> str:
        return self.likelihood.label

    @property
    def contact(self) -> str:
        return self.likelihood.contact

    @property
    def rig_time_s(self) -> float:
        return self.waiting_s + self.ready_s + self.likelihood.duration_s


@dataclass(frozen=True, kw_only=True)
class Goal:
    """Standard uncertainty that is asked of a linear combination: of coordinates of a contact (of every one,
    where none is named), or of the slope of an effect of the model."""

    limit: float
    coordinates: Mapping[str, float] = field(default_factory=dict)
    contact: str = ""
    effect: Effect | None = None


class Outlook:
    """The information of a campaign so far, and what each candidate adds to it.

    Parameters
    ----------
    runs, model
        What was made (nothing: priors alone), and what is supposed.
    candidates, goals
        Runs that may be made, and what is asked for.
    posterior
        Of the runs, if there are any.
    horizon_s
        Time over which effects of age are supposed to be seen.

    Raises
    ------
    DataError
        No candidate, a goal that names what no run tells, or an effect over a covariate that is unknown.
    """

    def __init__(
        self,
        runs: Sequence[CompressedRun],
        model: CampaignModel,
        candidates: Sequence[CandidateRun],
        goals: Sequence[Goal],
        *,
        posterior: CampaignPosterior | None = None,
        horizon_s: float = 0.0,
    ) -> None:
        if not candidates or not goals:
            raise DataError("nothing to choose from: a plan needs runs that may be made, and a goal")
        self.candidates, self.goals = tuple(candidates), tuple(goals)
        self._made = len(runs)
        ages = [
            run.covariates["age_s"].value + 0.5 * run.duration_s for run in runs if "age_s" in run.covariates
        ]
        self._began_s = max(ages, default=0.0)
        self._model = replace(model, effects=tuple(_by_place(effect) for effect in model.effects))
        self.ordered = any(effect.covariate in ("age_s", PLACE) for effect in self._model.effects)
        """Whether it counts when, or at which place, a run is made."""
        before = [_with(run, PLACE, float(place)) for place, run in enumerate(runs)]
        self._usual = _usual(self._model.effects, before, candidates)
        # every candidate at once and at the end, so that all levels and spans are there
        self._known = [*before]
        for candidate in candidates:
            self._known += [self._placed(candidate, 0.0, 0), self._placed(candidate, horizon_s, 1)]
        design = design_of(self._known, self._model)
        self.levels = design.levels
        self._h = _scatters(design, posterior)
        u = np.tile(design.prior_u, (len(self._h), 1))
        # what a form is told by is the runs' say, not what is thought of its slope beforehand
        asked = {_by_place(goal.effect).label for goal in goals if goal.effect is not None}
        u[:, [level.kind == "effect" and level.name in asked for level in design.levels]] *= _WIDENED
        varies = design.varies >= 0
        u[:, varies] = np.exp(self._h[:, design.varies[varies]])
        self.before = u[:, :, None] ** -2 * np.eye(u.shape[1])
        """Information (M, P, P) of priors and runs, by draw of the scatters."""
        for row in range(len(runs)):
            good = 1.0 if posterior is None else 1 - float(posterior.bad[row])
            self.before = self.before + good * self._information(design, row)
        self._rows = {
            (which, 0.0, place): (1 - model.bad_run_chance)
            * self._information(design, len(runs) + _SEEN_TOGETHER * which + place)
            for which in range(len(candidates))
            for place in range(_SEEN_TOGETHER)
            if not self.ordered
        }
        self._targets, self._limits = self._of_goals(design)

    def ratio(self, information: Floats) -> float:
        """The worst expected uncertainty over its limit: below 1 all goals are reached."""
        return float(np.max(self._ratios(information)))

    def reached(self, information: Floats) -> NDArray[np.bool_]:
        """For each draw (M,) of the scatters whether all goals are reached, if it were known."""
        return np.asarray(np.all(np.sqrt(self._variances(information)) < self._limits, axis=1))

    def merit(self, information: Floats) -> float:
        """A smooth form of `ratio`: what is not the worst counts, and each draw of the scatters alike, of
        which large ones would else decide alone."""
        of_draws = np.sqrt(self._variances(information)) / self._limits
        return float(np.exp(np.mean(0.25 * np.log(np.sum(of_draws**4, axis=1)))))

    def adds(self, which: int, elapsed_s: float, place: int) -> Floats:
        """Information of a candidate that is begun then, as the run of that place (from 0) to come."""
        key = (which, elapsed_s, place) if self.ordered else (which, 0.0, place % _SEEN_TOGETHER)
        if key not in self._rows:
            run = self._placed(self.candidates[which], elapsed_s, place)
            design = design_of([*self._known, run], self._model)
            self._rows[key] = (1 - self._model.bad_run_chance) * self._information(design, len(self._known))
        return self._rows[key]

    def _ratios(self, information: Floats) -> Floats:
        # scatters are not known: variances are averaged over them
        return np.asarray(np.sqrt(self._variances(information).mean(axis=0)) / self._limits)

    def _variances(self, information: Floats) -> Floats:
        """Of the goals' combinations (M, G)."""
        columns = np.broadcast_to(self._targets.T, (len(information), *self._targets.T.shape))
        solved = np.linalg.solve(information, columns)
        return np.asarray(np.einsum("gp,mpg->mg", self._targets, solved))

    def _placed(self, candidate: CandidateRun, elapsed_s: float, place: int) -> CompressedRun:
        """A candidate as a run of the campaign: when it would be made, and under what."""
        run = candidate.likelihood
        middle_s = candidate.waiting_s + candidate.ready_s + 0.5 * run.duration_s
        covariates = {
            "dwell_s": Estimate(middle_s, 0.0),
            **run.covariates,
            "age_s": Estimate(self._began_s + elapsed_s + middle_s, 0.0),
            PLACE: Estimate(float(self._made + place), 0.0),
        }
        for name, (value, spread) in self._usual.items():
            side = 1 if place % _SEEN_TOGETHER else -1
            covariates.setdefault(name, Estimate(value + side * spread, 0.0))
        return replace(run, covariates=covariates)

    def _information(self, design: Design, row: int) -> Floats:
        variance = np.zeros((len(self._h), design.has.shape[1]))
        inside = design.scatter >= 0
        variance[:, inside] = np.exp(2 * self._h[:, design.scatter[inside]])
        whole = design.covariance[row, 0] + (variance * design.has[row])[:, :, None] * np.eye(
            variance.shape[1]
        )
        x = design.x[row]
        return np.asarray(x.T @ np.linalg.solve(whole, np.broadcast_to(x, (len(whole), *x.shape))))

    def _of_goals(self, design: Design) -> tuple[Floats, Floats]:
        rows, limits = [], []
        contacts = dict.fromkeys(level.contact for level in design.levels if level.kind == "contact")
        for goal in self.goals:
            if goal.effect is not None:
                effect = _by_place(goal.effect)
                target = np.zeros(len(design.levels))
                target[design.levels.index(Level("effect", effect.label))] = span_of(self._known, effect)
                rows.append(target)
                limits.append(goal.limit)
                continue
            for contact in [goal.contact] if goal.contact else contacts:
                target = np.zeros(len(design.levels))
                for name, share in goal.coordinates.items():
                    if Level("contact", name, contact) not in design.levels:
                        raise DataError(f"{name} of {contact}: no run determines it")
                    for level in (Level("contact", name, contact), Level("mean", name)):
                        if level in design.levels:
                            target[design.levels.index(level)] = share
                rows.append(target)
                limits.append(goal.limit)
        return np.array(rows), np.array(limits)


def ratio_against_nothing(chance: float, size_over_margin: float) -> float:
    """Effect over uncertainty from which on it and nothing are told apart with this chance.

    Half of the cases have none, half one of that size, whose prior has `size_over_margin` times its width.
    The form is taken where its evidence is larger.
    """

    def right(ratio: float) -> float:
        q2 = (ratio * size_over_margin) ** 2
        z = sqrt(np.log1p(q2) * (1 + 1 / q2))
        return float(1 - 0.5 * (ndtr(z - ratio) + 2 * ndtr(-z)))

    return float(brentq(lambda ratio: right(ratio) - chance, 0.5, 1e4))


def ratio_between_forms(chance: float) -> float:
    """The same for two forms, each of which is told from the other while that is free."""
    return float(2 * ndtri(chance))


def _by_place(effect: Effect) -> Effect:
    return replace(effect, covariate=PLACE) if effect.covariate == ORDER else effect


def _with(run: CompressedRun, name: str, value: float) -> CompressedRun:
    return replace(run, covariates={**run.covariates, name: Estimate(value, 0.0)})


def _usual(
    effects: Sequence[Effect], runs: Sequence[CompressedRun], candidates: Sequence[CandidateRun]
) -> dict[str, Estimate]:
    """Of covariates that nobody sets: mean and scatter in the runs, which those to come are to have."""
    usual = {}
    for effect in effects:
        name = effect.covariate
        set_by_runs = name in ("", "dwell_s", "age_s", PLACE)
        if set_by_runs or all(name in one.likelihood.covariates for one in candidates):
            continue
        known = [run.covariates[name].value for run in runs if name in run.covariates]
        if len(known) < _SEEN_TOGETHER:
            raise DataError(
                f"{effect.label}: {name} is known of {len(known)} runs, and of none to come; "
                "measure two at different values first, or leave the effect out"
            )
        usual[name] = Estimate(float(np.mean(known)), float(np.std(known, ddof=1)))
    return usual


def _scatters(design: Design, posterior: CampaignPosterior | None) -> Floats:
    """Draws (M, H) of logarithms of scatters; without a posterior quantiles of half-normal priors."""
    middles = (np.arange(_SCATTERS) + 0.5) / _SCATTERS
    found = np.log(design.scales) + np.log(ndtri(0.5 + 0.5 * middles))[:, None]
    if posterior is None or not len(posterior.hyper):
        return np.asarray(found)
    order = np.argsort(posterior.h[:, 0]) if posterior.h.shape[1] else np.arange(len(posterior.h))
    reached = np.cumsum(posterior.weight[order])
    drawn = posterior.h[order[np.minimum(np.searchsorted(reached, middles), len(order) - 1)]]
    for place, level in enumerate(design.hyper):
        if level in posterior.hyper:
            found[:, place] = drawn[:, posterior.hyper.index(level)]
    return np.asarray(found)

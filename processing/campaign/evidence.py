"""What the runs say for one form against another, with the choice among several charged."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.special import logsumexp

from processing.arrays import Floats
from processing.campaign.compressed import CompressedRun
from processing.campaign.design import CampaignModel, Level, design_of
from processing.campaign.forms import ORDER, Effect, Form
from processing.campaign.laplace import likeliest
from processing.campaign.parts import InParts, here
from processing.campaign.posterior import CampaignPosterior
from processing.errors import DataError

SEEN = 0.05
"""Chance, shared between all effects that were tried, below which one is said to be seen."""
ALIKE = 0.95
"""Probability of an effect to be smaller than what matters, from which on there is said to be none."""
_FEWEST = 2
"""Runs on either side of a change."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FormEvidence:
    """One form against none: logarithm of the ratio of evidences, and the probability among all that were
    tried, of which together "something" is as probable beforehand as "nothing"."""

    effect: str
    log_bayes_factor: float
    probability: float


class Forms(NamedTuple):
    """The forms that were tried, and the probability that none of them holds."""

    tried: tuple[FormEvidence, ...]
    nothing: float


@dataclass(frozen=True, slots=True, kw_only=True)
class ChangePoint:
    """A change at one place of the campaign.

    Attributes
    ----------
    probability
        Of a change at any place against none, both as probable beforehand: the choice of the place is
        charged.
    first_run
        Place, from 0, of the run from which on there was another value: the likeliest one.
    at_least, at_most
        Places between which it lies with 95 %.
    """

    parameter: str
    probability: float
    first_run: int
    at_least: int
    at_most: int


def compare_forms(
    runs: Sequence[CompressedRun],
    model: CampaignModel,
    candidates: Sequence[Effect],
    *,
    do: InParts = here,
) -> Forms:
    """Each candidate beside the model's effects against the model without it, by Laplace's method.

    Half of the probability beforehand is that of nothing, the candidates share the other half: among many a
    chance resemblance is charged for.
    """
    base = likeliest(design_of(runs, model), do=do)
    gains = np.array(
        [
            likeliest(design_of(runs, model.with_effects(*model.effects, one)), base.h, do).log_evidence
            - base.log_evidence
            for one in candidates
        ]
    )
    log_share = np.concatenate([[0.0], gains - np.log(max(len(gains), 1))])
    probability = np.exp(log_share - logsumexp(log_share))
    return Forms(
        tuple(
            FormEvidence(effect=one.label, log_bayes_factor=gain, probability=share)
            for one, gain, share in zip(candidates, gains.tolist(), probability[1:].tolist(), strict=True)
        ),
        float(probability[0]),
    )


def find_change(
    runs: Sequence[CompressedRun], model: CampaignModel, parameter: str, *, do: InParts = here
) -> ChangePoint:
    """Where, if anywhere, a parameter of the campaign became another one; runs are in their order.

    Raises
    ------
    DataError
        Fewer than four runs.
    """
    if len(runs) < 2 * _FEWEST:
        raise DataError(f"{len(runs)} runs: a change needs {_FEWEST} on either side")
    places = np.arange(_FEWEST, len(runs) - _FEWEST + 1)
    base = likeliest(design_of(runs, model), do=do)
    gains = []
    for place in places.tolist():
        step = Effect(parameter=parameter, covariate=ORDER, form=Form.STEP, reference=place)
        changed = design_of(runs, model.with_effects(*model.effects, step))
        gains.append(likeliest(changed, base.h, do).log_evidence - base.log_evidence)
    found = np.array(gains)
    share = np.exp(found - logsumexp(found))
    reached = np.cumsum(share)
    log_odds = float(logsumexp(found) - np.log(len(places)))
    return ChangePoint(
        parameter=parameter,
        probability=float(1 / (1 + np.exp(-log_odds))),
        first_run=int(places[np.argmax(share)]),
        at_least=int(places[np.searchsorted(reached, 0.025)]),
        at_most=int(places[np.clip(np.searchsorted(reached, 0.975), 0, len(places) - 1)]),
    )


def chance(found: CampaignPosterior, level: Level) -> float:
    """Two-sided chance of an effect as large where there is none; at least that of one draw."""
    draws = found.draws(level)
    positive = 1 - found.below(draws, 0.0)
    return float(max(2 * min(positive, 1 - positive), 1 / found.effective))


def is_limit(found: CampaignPosterior, level: Level) -> bool:
    """Whether `chance` is only an upper limit: less than one draw lies on the other side of nought."""
    return chance(found, level) <= 1 / found.effective


def is_seen(found: CampaignPosterior, level: Level, tried: int) -> bool:
    """Whether an effect is told from nothing, of `tried` that were looked at."""
    return chance(found, level) * max(tried, 1) < SEEN


def within(found: CampaignPosterior, draws: Floats, margin: float) -> float:
    """Probability that a quantity is smaller than a margin: from `ALIKE` on it is equivalent to nought."""
    return found.below(np.abs(draws), margin)

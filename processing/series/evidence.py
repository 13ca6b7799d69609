"""What the runs say for one form against another, with the choice among several charged."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import logsumexp

from processing.arrays import Floats
from processing.errors import DataError
from processing.series.density import likeliest
from processing.series.model import SeriesModel, design_of
from processing.series.runs import ORDER, CompressedRun, Effect, Form

SEEN = 0.05
"""Chance, shared between all effects that were tried, below which one is said to be seen."""
ALIKE = 0.95
"""Probability of an effect to be smaller than what matters, from which on there is said to be none."""
_FEWEST = 2
"""Runs on either side of a change."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ChangePoint:
    """A change at one place of the series.

    `probability` is that of a change at any place against none, both as probable beforehand: the choice of
    the place is charged. `first_run` is the likeliest place, from 0, of the run from which on there was
    another value, which lies between `at_least` and `at_most` with 95 %.
    """

    parameter: str
    probability: float
    first_run: int
    at_least: int
    at_most: int


def compare_forms(
    runs: Sequence[CompressedRun], model: SeriesModel, candidates: Sequence[Effect]
) -> tuple[Floats, Floats, float]:
    """Each candidate beside the model's effects against the model without it: logarithms of the ratios of
    evidences by Laplace's method, the candidates' probabilities, and that of none.

    Half of the probability beforehand is that of nothing, the candidates share the other half: among many a
    chance resemblance is charged for.
    """
    base = likeliest(design_of(runs, model))
    gains = np.array(
        [
            likeliest(design_of(runs, model.with_effects(one)), base.h).log_evidence - base.log_evidence
            for one in candidates
        ]
    )
    log_share = np.concatenate([[0.0], gains - np.log(max(len(gains), 1))])
    probability = np.exp(log_share - logsumexp(log_share))
    return gains, probability[1:], float(probability[0])


def find_change(runs: Sequence[CompressedRun], model: SeriesModel, parameter: str) -> ChangePoint:
    """Where, if anywhere, a parameter became another one; runs are in their order. Raises DataError for fewer
    than four runs."""
    if len(runs) < 2 * _FEWEST:
        raise DataError(f"{len(runs)} runs: a change needs {_FEWEST} on either side")
    places = range(_FEWEST, len(runs) - _FEWEST + 1)
    steps = [
        Effect(parameter=parameter, covariate=ORDER, form=Form.STEP, reference=place) for place in places
    ]
    gains, _, nothing = compare_forms(runs, model, steps)
    share = np.exp(gains - logsumexp(gains))
    first, last = np.searchsorted(np.cumsum(share), (0.025, 0.975))
    return ChangePoint(
        parameter=parameter, probability=1 - nothing, first_run=places[int(np.argmax(share))],
        at_least=places[int(first)], at_most=places[min(int(last), len(places) - 1)],
    )  # fmt: skip

"""Chosen runs against a fixed plan, over campaigns that are made up.

Run as ``python -m tests.benchmarks.bench_plan_for [--quick] [PART...]`` from the repository. Decays are those
of tests/processing/campaign/simulated_decays.py; what is true is drawn anew for each campaign, plans are made
for its middle.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from processing.campaign import (
    CampaignModel,
    CampaignPosterior,
    CandidateRun,
    CompressedRun,
    Effect,
    Form,
    Goal,
    Level,
    Outlook,
    choose_next,
    choose_runs,
    compare_forms,
    fit_campaign,
    ratio_against_nothing,
    ratio_between_forms,
)
from processing.errors import DataError
from processing.estimate import Estimate
from tests.benchmarks.parts import Parts, run_parts, words_of
from tests.processing.campaign.simulated_decays import NAMES, TRUTH, expected, measured

SIZES = {"b": 0.01, "p": 0.001, "c": 0.1}
"""Half-normal scatters between runs, which are drawn from these, too."""
VARIES = np.array([0.05, 0.004, 0.3])
"""How far what is true lies from what plans are made for."""
READY_S = 120.0
USUAL = (124.0, 2.0)
"""First and last amplitude of a rig as it is configured."""
SPANS = [
    (first, last) for first in (124.0, 60.0, 30.0) for last in (30.0, 15.0, 8.0, 4.0, 2.0) if last < first
]
GOALS = {
    "u(c)/c < 0.05": [Goal(limit=0.05, coordinates={"c": 1.0})],
    "u(b)/b < 0.005": [Goal(limit=0.005, coordinates={"b": 1.0})],
    "u(p)/p < 0.001": [Goal(limit=0.000944, coordinates={"p": 1.0})],
    "u(b)/b < 0.01, u(c)/c < 0.1": [
        Goal(limit=0.01, coordinates={"b": 1.0}), Goal(limit=0.1, coordinates={"c": 1.0}),
    ],
}  # fmt: skip
AT_REST = Effect(parameter="b", covariate="dwell_s", form=Form.LOGARITHM, reference=600.0)
BY_AMPLITUDE = Effect(
    parameter="b", covariate="first_amplitude_rad", form=Form.LINEAR, reference=124 * 4.848e-6
)
BY_WAITING, OVER_AMPLITUDES = 0.04, 0.04
"""Sizes of both effects, of ln b: from the shortest rest to the longest, from 30 to 124 arcsec."""
WAITS_S = (0.0, 1800.0, 7200.0)
MOST_RUNS = 60
DRAWS = 400


def candidate(span: tuple[float, float], waiting_s: float = 0.0) -> CandidateRun:
    run = expected(*span)
    dwell_s = waiting_s + READY_S + 0.5 * run.duration_s
    covariates = {**run.covariates, "dwell_s": Estimate(dwell_s, 0.0)}
    return CandidateRun(likelihood=replace(run, covariates=covariates), waiting_s=waiting_s, ready_s=READY_S)


class Nature:
    """What is true of one campaign; makes its runs."""

    def __init__(
        self,
        seed: int,
        *,
        at_rest: float = 0.0,
        by_amplitude: float = 0.0,
    ) -> None:
        self._rng = np.random.default_rng([11, seed])
        self.truth = np.array(TRUTH) + VARIES * self._rng.normal(size=3)
        self._scatter = np.abs(self._rng.normal(size=3)) * np.array([SIZES[name] for name in NAMES])
        self._air = float(self._rng.normal())
        self._at_rest, self._by_amplitude = at_rest, by_amplitude
        self.runs: list[CompressedRun] = []
        self.elapsed_s = 0.0

    def measure(self, one: CandidateRun) -> None:
        """One more run."""
        own = self.truth + self._scatter * self._rng.normal(size=3)
        first_rad = one.likelihood.covariates["first_amplitude_rad"].value
        dwell_s = one.likelihood.covariates["dwell_s"].value
        own[0] += self._by_amplitude * (first_rad - BY_AMPLITUDE.reference)
        own[0] += self._at_rest * np.log(dwell_s / AT_REST.reference)
        run = measured(
            one.likelihood, own, self._air, self._rng, truth=tuple(np.round(self.truth, 9).tolist()),
            number=len(self.runs) + 1, began_s=self.elapsed_s,
        )  # fmt: skip
        self.runs.append(run)
        self.elapsed_s += one.waiting_s + one.ready_s + run.duration_s


class Reached(NamedTuple):
    """When a campaign reached its goal, by how many runs; the last posterior."""

    elapsed_s: float
    runs: int
    reached: bool
    posterior: CampaignPosterior | None


def one_by_one(
    nature: Nature, model: CampaignModel, goals: Sequence[Goal], candidates: Sequence[CandidateRun], seed: int
) -> Reached:
    """Measure, learn, choose again, until the goal is reached; with one candidate that is a fixed plan that
    stops as soon as it may."""
    posterior = None
    while True:
        ahead = Outlook(nature.runs, model, candidates, goals, posterior=posterior)
        if ahead.ratio(ahead.before) < 1:
            return Reached(nature.elapsed_s, len(nature.runs), True, posterior)
        if len(nature.runs) >= MOST_RUNS:
            return Reached(nature.elapsed_s, len(nature.runs), False, posterior)
        if len(candidates) == 1:
            nature.measure(candidates[0])
        else:
            choice = choose_next(ahead, most=MOST_RUNS, seed=seed)
            if not choice.runs:
                return Reached(nature.elapsed_s, len(nature.runs), False, posterior)
            nature.measure(choice.runs[0].candidate)
        base = model.with_effects() if len(nature.runs) < 2 else model
        try:
            posterior = fit_campaign(nature.runs, base, draws=DRAWS, seed=seed)
        except DataError:  # an effect over a covariate that all runs so far have alike
            posterior = fit_campaign(nature.runs, model.with_effects(), draws=DRAWS, seed=seed)


def times(count: int) -> dict[str, float]:
    """Rig time of chosen runs over that of the usual run again and again, both ended once the goal is
    reached, and over that of as many usual runs as the priors ask for."""
    found: dict[str, float] = {}
    model = CampaignModel(names=NAMES, sizes=SIZES)
    candidates, usual = [candidate(span) for span in SPANS], [candidate(USUAL)]
    chosen_s, fixed_s, planned_s, missed, pulls = [], [], [], 0, []
    of: dict[str, list[tuple[float, float, float]]] = {name: [] for name in GOALS}
    asked = {
        name: choose_runs(Outlook([], model, usual, goals), most=500).rig_time_s
        for name, goals in GOALS.items()
    }
    for seed in range(count):
        name = list(GOALS)[seed % len(GOALS)]
        chosen = one_by_one(nature := Nature(seed), model, GOALS[name], candidates, seed)
        fixed = one_by_one(Nature(seed), model, GOALS[name], usual, seed)
        missed += not (chosen.reached and fixed.reached)
        chosen_s.append(chosen.elapsed_s)
        fixed_s.append(fixed.elapsed_s)
        planned_s.append(asked[name])
        of[name].append((chosen.elapsed_s, fixed.elapsed_s, asked[name]))
        assert chosen.posterior is not None
        for place, key in enumerate(NAMES):
            if key in GOALS[name][0].coordinates:
                value, u = chosen.posterior.estimate(Level("contact", key, "sample"))
                pulls.append((value - float(nature.truth[place])) / u)
    for name, rows in of.items():
        a, b, c = np.array(rows).T if rows else np.full((3, 1), np.nan)
        print(
            f"  {name:<28} {np.mean(a) / 60:.0f} min chosen, {np.mean(b) / 60:.0f} usual until reached, "
            f"{np.mean(c) / 60:.0f} usual by the priors"
        )
    # a plan whose number of runs is fixed beforehand, so that it is enough in 95 % of the campaigns
    enough_s = {name: float(np.quantile([row[1] for row in rows], 0.95)) for name, rows in of.items() if rows}
    whole_s = sum(enough_s[name] * len(rows) for name, rows in of.items() if rows)
    found["of_enough"] = float(np.sum(chosen_s) / whole_s)
    print(f"  over usual runs that are enough in 95 % of campaigns: {100 * found['of_enough']:.0f} %")
    found["of_usual"] = float(np.sum(chosen_s) / np.sum(fixed_s))
    found["of_planned"] = float(np.sum(chosen_s) / np.sum(planned_s))
    # a plan of as many as the priors ask for may be too short: the same runs reach it after `fixed_s`
    enough = np.array(fixed_s) <= np.array(planned_s) + 1.0
    found["planned_reaches"] = float(np.mean(enough))
    print(f"  as many usual runs as the priors ask for reach it in {100 * found['planned_reaches']:.0f} %")
    found["median_of_usual"] = float(np.median(np.array(chosen_s) / np.array(fixed_s)))
    found["missed"] = float(missed)
    found["within_2u"] = float(np.mean(np.abs(pulls) < 2))
    print(
        f"  chosen over usual until reached: {100 * found['of_usual']:.0f} % of all time, median "
        f"{100 * found['median_of_usual']:.0f} %; over usual by the priors "
        f"{100 * found['of_planned']:.0f} %; {missed} of {count} not reached; answers "
        f"within 2 u: {100 * found['within_2u']:.0f} %"
    )
    return found


def laws(count: int) -> dict[str, float]:
    """Part of campaigns in which the right one of two forms has the larger evidence after the runs that were
    chosen from the priors."""
    candidates = [candidate(span, waiting_s) for span in SPANS for waiting_s in WAITS_S]
    rests_s = [one.likelihood.covariates["dwell_s"].value for one in candidates]
    slope = BY_WAITING / float(np.log(max(rests_s) / min(rests_s)))
    span_rad = (124 - 30) * 4.848e-6
    found: dict[str, float] = {}
    for case in ("rest or nothing", "rest or first amplitude"):
        against_nothing = case.endswith("nothing")
        effects = (AT_REST,) if against_nothing else (AT_REST, BY_AMPLITUDE)
        model = CampaignModel(names=NAMES, sizes=SIZES, effects=effects)
        ratio = ratio_against_nothing(0.95, SIZES["b"] / BY_WAITING)
        if not against_nothing:
            ratio = ratio_between_forms(0.95)
        goals = [Goal(limit=BY_WAITING / ratio, effect=AT_REST)]
        if not against_nothing:
            goals.append(Goal(limit=OVER_AMPLITUDES / ratio, effect=BY_AMPLITUDE))
        choice, right = choose_runs(Outlook([], model, candidates, goals)), []
        for seed in range(count):
            rests = seed % 2 == 0
            sign = 1 if seed % 4 < 2 else -1
            nature = Nature(
                1000 + seed,
                at_rest=sign * slope if rests else 0.0,
                by_amplitude=0.0 if rests or against_nothing else sign * OVER_AMPLITUDES / span_rad,
            )
            for one in choice.runs:
                nature.measure(one.candidate)
            forms = compare_forms(nature.runs, model.with_effects(), effects)
            gains = [
                0.0 if against_nothing else forms.tried[1].log_bayes_factor,
                forms.tried[0].log_bayes_factor,
            ]
            right.append((gains[1] > gains[0]) == rests)
        found[case] = float(np.mean(right))
        print(
            f"  {case}: right in {100 * found[case]:.0f} % of {count}, by {len(choice.runs)} runs in "
            f"{choice.rig_time_s / 3600:.1f} h; expected {choice.expected:.2f} of the limit"
        )
    return found


PARTS: Parts = {"times": (times, 100), "laws": (laws, 100)}


def run(quick: bool = False, parts: tuple[str, ...] = ()) -> dict[str, Any]:
    """All parts, or those that are named."""
    return run_parts(PARTS, quick=quick, names=parts, least=4)


if __name__ == "__main__":
    run(*words_of(__doc__, PARTS))

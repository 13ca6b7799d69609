"""Which runs a campaign should make next: `rig plan --for`."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from math import inf

import numpy as np

from processing.angle import ARCSEC_RAD
from processing.campaign import (
    CampaignModel,
    CampaignPosterior,
    CandidateRun,
    Choice,
    CompressedRun,
    Outlook,
    choose_next,
    choose_runs,
    fit_campaign,
    to_coordinates,
)
from processing.errors import DataError
from processing.estimate import Estimate
from processing.fit import PlannedLikelihood, planned_likelihood
from rig.campaigns.likelihoods import FoundRun, compressed
from rig.campaigns.stated import StatedCampaign
from rig.campaigns.stated_model import model_of, names_of
from rig.campaigns.targets import Target, goals_of
from rig.plan import Expected
from rig.presentation import Cell, Table
from rig.settings import Configuration

_TOLD = 0.5
"""Relative uncertainty of c above which a run only bounds it."""
_OF_ITS_OWN = ("air", "ageing")
_MISFIT = "misfit"


@dataclass(frozen=True, kw_only=True)
class Within:
    """What a plan may ask for: amplitudes, waiting before a run, samples; time and number of runs."""

    first_arcsec: Sequence[float]
    last_arcsec: Sequence[float]
    waits_s: Sequence[float]
    samples: Sequence[str]
    ready_s: float
    longest_s: float = inf
    most_runs: int = 200


@dataclass(frozen=True)
class PlannedKind:
    """A kind of run: between which amplitudes, after which waiting, on which sample."""

    first_arcsec: float
    last_arcsec: float
    waiting_s: float
    sample: str


@dataclass(frozen=True)
class PlannedCampaign:
    """The chosen runs; `kinds` are those of all candidates, by label and contact, `made` the number of runs
    that have entered, `left_out` those that could not, and why."""

    choice: Choice
    targets: tuple[Target, ...]
    kinds: Mapping[tuple[str, str], PlannedKind]
    within: Within
    seed: int
    made: int
    left_out: tuple[str, ...] = ()

    def kind(self, candidate: CandidateRun) -> PlannedKind:
        """How a candidate is measured."""
        return self.kinds[candidate.label, candidate.contact]


def ready_s(config: Configuration) -> float:
    """What a run costs before its first turning point."""
    if config.start.way == "at once":
        return 0.0
    return config.preflight.duration_s + config.phases.rest_window_s + config.start.patience_s


def plan_campaign(
    expected: Expected,
    stated: StatedCampaign,
    targets: Sequence[Target],
    within: Within,
    found: Sequence[FoundRun] = (),
    *,
    learns: bool = False,
) -> PlannedCampaign:
    """The runs that reach the targets in the least rig time, after those that were found.

    Found runs are of the one sample that is planned for; without any the priors alone say what is known.
    With `learns` a new choice follows after every run, and the first one counts.

    Raises
    ------
    DataError
        No run may be made between these amplitudes.
    """
    reference_rad = stated.reference_arcsec * ARCSEC_RAD
    runs: list[CompressedRun] = []
    left_out: list[str] = []
    for one in found:
        run, problem = compressed(replace(one, contact=within.samples[0]), reference_rad, stated.u)
        if run is None:
            left_out.append(problem)
        else:
            runs.append(run)
    candidates, kinds = _candidates(expected, within, reference_rad, runs)
    values = expected.values
    likelihoods = [one.likelihood for one in candidates]
    names = names_of(stated, runs or likelihoods)
    model = model_of(stated, names, reference_rad, runs or likelihoods)
    beside = [effect for target in targets for effect in target.effects if effect not in model.effects]
    posterior = _posterior(runs, model, stated)
    model = model.with_effects(*model.effects, *dict.fromkeys(beside))
    goals = goals_of(targets, model, values, reference_rad)
    horizon_s = within.longest_s if np.isfinite(within.longest_s) else 86400.0
    ahead = Outlook(runs, model, candidates, goals, posterior=posterior, horizon_s=horizon_s)
    choose = choose_next if learns else choose_runs
    choice = choose(ahead, longest_s=within.longest_s, most=within.most_runs, seed=stated.seed)
    return PlannedCampaign(choice, tuple(targets), kinds, within, stated.seed, len(runs), tuple(left_out))


def _posterior(
    runs: Sequence[CompressedRun], model: CampaignModel, stated: StatedCampaign
) -> CampaignPosterior | None:
    if not runs:
        return None
    try:
        return fit_campaign(runs, model, draws=stated.draws, seed=stated.seed)
    except DataError:
        # the first runs cannot have seen what something depends on; how they scatter is asked for here
        return fit_campaign(runs, model.with_effects(), draws=stated.draws, seed=stated.seed)


def _candidates(
    expected: Expected, within: Within, reference_rad: float, runs: Sequence[CompressedRun]
) -> tuple[list[CandidateRun], dict[tuple[str, str], PlannedKind]]:
    candidates: list[CandidateRun] = []
    kinds: dict[tuple[str, str], PlannedKind] = {}
    problem = "every last amplitude must lie below every first one"
    load_n = expected.pendulum.mass_kg * expected.pendulum.gravity_m_per_s2
    for first, last in product(within.first_arcsec, within.last_arcsec):
        if last >= first:
            continue
        try:
            one = planned_likelihood(
                expected.values, expected.pendulum, expected.conditions, first * ARCSEC_RAD, last * ARCSEC_RAD
            )
        except DataError as error:
            problem = str(error)
            continue
        if one.run.duration_s > expected.longest_s or not one.run.complete:
            problem = (
                f"{first:g} to {last:g} arcsec lasts {one.run.duration_s:.0f} s, session.max_duration_s = "
                f"{expected.longest_s:g}"
                if one.run.complete
                else f"the ground ends a run before {last:g} arcsec"
            )
            continue
        for waiting_s, sample in product(within.waits_s, within.samples):
            waited = f", {waiting_s / 60:g} min after" if waiting_s else ""
            label = f"{first:g} to {last:g} arcsec{waited}"
            likelihood = _likelihood(one, expected.values, reference_rad, label, sample, runs)
            covariates = {
                "first_amplitude_rad": Estimate(first * ARCSEC_RAD, 0.0), "load_n": Estimate(load_n, 0.0),
            }  # fmt: skip
            kinds[label, sample] = PlannedKind(first, last, waiting_s, sample)
            candidates.append(
                CandidateRun(
                    likelihood=replace(likelihood, covariates=covariates),
                    waiting_s=waiting_s,
                    ready_s=within.ready_s,
                )
            )
    if not candidates:
        raise DataError(f"no such run: {problem}")
    return candidates, kinds


def _likelihood(
    one: PlannedLikelihood,
    expected: Mapping[str, float],
    reference_rad: float,
    label: str,
    sample: str,
    runs: Sequence[CompressedRun],
) -> CompressedRun:
    names = [
        name for name in one.names if not (name == "c" and one.run.u["c"] > _TOLD * abs(expected["c"]))
    ]  # fmt: skip
    at = [one.names.index(name) for name in names]
    moved = to_coordinates(names, np.array([expected[name] for name in names]), reference_rad)
    to = moved.by_parameters
    shared = {} if one.by_air is None else {"air": to @ one.by_air[at]}
    # what inputs of the rig do to relative changes is alike in all runs
    for source, by in runs[-1].shared.items() if runs else ():
        if source not in _OF_ITS_OWN and not source.startswith(_MISFIT):
            known = dict(zip(runs[-1].names, by.tolist(), strict=True))
            shared[source] = np.array([known.get(name, 0.0) for name in names])
    return CompressedRun(
        label=label,
        contact=sample,
        names=tuple(names),
        values=moved.values,
        covariance=to @ one.covariance[np.ix_(at, at)] @ to.T,
        shared=shared,
        by_growth=to @ one.by_growth[at],
        duration_s=one.run.duration_s,
    )


def campaign_plan_table(planned: PlannedCampaign) -> Table:
    """A row for every run: what it is, when it begins, and what is left of the goal after it."""
    rows: list[list[Cell]] = []
    shown: list[list[str]] = []
    elapsed_s, several = 0.0, len(planned.within.samples) > 1
    last: PlannedKind | None = None
    for number, one in enumerate(planned.choice.runs, start=1):
        kind = planned.kind(one.candidate)
        elapsed_s += one.candidate.rig_time_s
        rows.append(
            [number, kind.sample, kind.first_arcsec, kind.last_arcsec, kind.waiting_s, elapsed_s, one.after]
        )
        run = f"{one.candidate.label} on {kind.sample}" if several else one.candidate.label
        first = f"{number}"
        if kind == last:
            first = f"{shown.pop()[0].split('-')[0]}-{number}"
        shown.append([first, run, f"{elapsed_s / 60:.0f}", f"{one.after:.2f}"])
        last = kind
    return Table(
        "plan_for",
        f"Runs for {' and '.join(target.text for target in planned.targets)}",
        ("run", "sample", "first_arcsec", "last_arcsec", "waiting_s", "elapsed_s", "of_limit"),
        rows,
        ("run", "amplitudes", "min", "u / limit"),
        shown,
        "\n".join(reasons(planned)),
    )


def kinds_text(choice: Choice) -> str:
    """How many of which kind: `3 of 124 to 8 arcsec, 1 of 60 to 4 arcsec`."""
    labels = [one.candidate.label for one in choice.runs]
    return ", ".join(f"{labels.count(kind)} of {kind}" for kind in dict.fromkeys(labels))


def reasons(planned: PlannedCampaign) -> list[str]:
    """Why these runs, in sentences: for the terminal, and for the plan's file."""
    choice, within = planned.choice, planned.within
    before = f"{planned.made} runs" if planned.made else "priors alone"
    asked = " and ".join(target.text for target in planned.targets)
    said = [f"{line}." for line in planned.left_out]
    if choice.now < 1:
        return [*said, f"No further runs are needed: after {before} u is {choice.now:.2f} of its limit."]
    if choice.floor >= 1:
        said.append(
            f"{asked} cannot be reached: with any number of runs u stays at {choice.floor:.2f} of its limit, "
            "because of what they share (air, lever, masses). Determine these better, or relax the target."
        )
        return said
    hours = choice.rig_time_s / 3600
    bring = (
        f"{len(choice.runs)} runs ({kinds_text(choice)}) in {hours:.1f} h bring it to {choice.expected:.2f}."
    )
    said.append(f"After {before} u is {choice.now:.3g} of its limit; {bring}")
    if not choice.reached:
        said.append(
            f"That is not enough; the limits of {within.longest_s / 3600:g} h and {within.most_runs} runs "
            "allow no more."
        )
    best = ", ".join(f"{label} ({gain:.2g})" for label, gain in choice.gains[:3])
    said.append(f"Largest initial gain per time, as ln u per hour: {best}.")
    if not planned.made:
        said.append(
            "The scatter of runs is assumed from the priors (size in campaign.toml): plan again after a few "
            "runs (--after), which determine it better."
        )
    said.append(
        f"The order is random, in blocks over which each kind is spread evenly (seed {planned.seed})."
    )
    return said

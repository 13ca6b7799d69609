"""From found runs and what is stated to the answer of a campaign."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import sqrt

import numpy as np

from processing.angle import ARCSEC_RAD
from processing.campaign import (
    ORDER,
    POSITIVE,
    CampaignPosterior,
    CompressedRun,
    Effect,
    InParts,
    Level,
    Sampled,
    chance,
    compare_forms,
    find_change,
    fit_campaign,
    here,
    is_limit,
    is_seen,
    parameters,
    predictive_check,
    sample_campaign,
    span_of,
    within,
)
from processing.errors import DataError
from processing.estimate import Estimate
from processing.fit import FitMethod
from processing.surroundings import in_other_unit
from rig.campaigns.contact_values import contact_values
from rig.campaigns.likelihoods import FoundRun, compressed
from rig.campaigns.results import (
    CampaignEffect,
    CampaignResults,
    CampaignRun,
    CampaignSource,
    SamplerFindings,
    likelihood_tree,
)
from rig.campaigns.stated import StatedCampaign, StatedEffect, model_of, names_of, refuse_other_contacts
from rig.presentation import quantity

_BAD = 0.5
_FEW = 0.05
"""Part of the draws that must count."""


@dataclass(frozen=True, repr=False)
class Campaign:
    """The answer, and what figures and tables are drawn from beside it."""

    results: CampaignResults
    posterior: CampaignPosterior
    stated: StatedCampaign

    def __repr__(self) -> str:
        lines = ["campaign"]
        for contact, values in self.results.contacts.items():
            lines += [
                f"  {contact}: {quantity(name).symbol} = "
                f"{quantity(name).text(one.value, one.standard_uncertainty)} {quantity(name).unit}".rstrip()
                for name, one in values.items()
            ]
        return "\n".join(lines)


def answer_of(
    found: Sequence[FoundRun], stated: StatedCampaign, *, sample: bool = False, do: InParts = here
) -> Campaign:
    """The answer of a campaign; with `sample` the posterior is a sampler's. `do` does what can be done in
    parts.

    Raises
    ------
    DataError
        No run can enter, or nothing is known of what is asked for.
    ConfigurationError
        A parameter is stated that there is not.
    """
    reference_rad = stated.reference_arcsec * ARCSEC_RAD
    entered: list[tuple[FoundRun, CompressedRun]] = []
    left_out = []
    for one in found:
        run, problem = compressed(one, reference_rad, stated.u)
        if run is None:
            left_out.append(problem)
        else:
            entered.append((one, run))
    if not entered:
        raise DataError(f"no run can enter the campaign: {'; '.join(left_out)}")
    runs = [run for _, run in entered]
    refuse_other_contacts(stated, runs)
    names = names_of(stated, runs)
    model = model_of(stated, names, reference_rad, runs)
    sampled = sample_campaign(runs, model, seed=stated.seed) if sample else None
    posterior = (
        fit_campaign(runs, model, draws=stated.draws, seed=stated.seed, do=do)
        if sampled is None
        else sampled.posterior
    )
    alone = fit_campaign(runs, model.without_priors(), draws=stated.draws, seed=stated.seed, do=do)
    contacts = contact_values(posterior, alone, [one for one, _ in entered], reference_rad)
    forms = compare_forms(runs, model, stated.candidates, do=do) if stated.candidate else None
    tried = len(stated.effect) + len(stated.candidate)
    effects = tuple(_effect(effect, posterior, alone, tried, runs) for effect in stated.effect)
    candidates = []
    for place, candidate in enumerate(stated.candidate):
        with_it = fit_campaign(
            runs,
            model.with_effects(*model.effects, candidate.effect()),
            draws=stated.draws,
            seed=stated.seed,
            do=do,
        )
        shown = _effect(candidate, with_it, None, tried, runs)
        assert forms is not None
        said = forms.tried[place]
        candidates.append(
            replace(shown, log_bayes_factor=said.log_bayes_factor, probability=said.probability)
        )
    results = CampaignResults(
        parameters=names,
        reference_arcsec=stated.reference_arcsec,
        runs=_runs(entered, posterior, reference_rad),
        contacts=contacts,
        between_runs=_scatters(posterior, "between runs"),
        between_contacts=_scatters(posterior, "between contacts"),
        effects=effects,
        candidates=tuple(candidates),
        nothing=1.0 if forms is None else forms.nothing,
        changes=tuple(find_change(runs, model, name, do=do) for name in stated.change_points),
        shared={
            level.name: posterior.estimate(level) for level in posterior.levels if level.kind == "shared"
        },
        budgets={
            contact: {name: budget_of_level(posterior, name, contact) for name in names}
            for contact in contacts
        },
        draws=len(posterior.weight),
        draws_that_count=posterior.effective,
        predictive_p=predictive_check(posterior, seed=stated.seed),
        sampler=None if sampled is None else _findings(sampled),
        left_out=tuple(left_out),
        warnings=(*_unknown(stated, runs), *_warnings(posterior, alone, sampled)),
        simulated=any(bool(one.run.simulated) for one, _ in entered),
        stated=stated.model_dump(mode="json", exclude_defaults=True),
    )
    return Campaign(results, posterior, stated)


def _effect(
    stated: StatedEffect,
    found: CampaignPosterior,
    alone: CampaignPosterior | None,
    tried: int,
    runs: Sequence[CompressedRun],
) -> CampaignEffect:
    effect: Effect = stated.effect()
    level = Level("effect", effect.label)
    draws = found.draws(level)
    low, high = found.quantiles(draws, (0.025, 0.975))
    value, u = found.moments(draws)
    span = span_of(runs, effect)
    return CampaignEffect(
        label=effect.label,
        parameter=effect.parameter,
        covariate=effect.covariate,
        form=str(effect.form),
        reference=effect.reference,
        slope=Estimate(value, u),
        slope_without_priors=alone.estimate(level) if alone is not None else Estimate(np.nan, np.nan),
        lower_95=low,
        upper_95=high,
        over_span=Estimate(value * span, u * span),
        chance=chance(found, level),
        chance_is_limit=is_limit(found, level),
        seen=is_seen(found, level, tried),
        margin=stated.margin,
        equivalent=np.nan if stated.margin is None else within(found, draws * span, stated.margin),
    )


def _scatters(found: CampaignPosterior, kind: str) -> dict[str, Estimate]:
    return {level.name: found.estimate(level) for level in found.hyper if level.kind == kind}


def _runs(
    entered: Sequence[tuple[FoundRun, CompressedRun]], found: CampaignPosterior, reference_rad: float
) -> tuple[CampaignRun, ...]:
    together, u_together = found.of_runs
    names = found.model.names
    residuals = found.residuals
    out = []
    for row, (source, run) in enumerate(entered):
        fit = source.run.fits[FitMethod.EXACT]
        values = parameters(names, together[row], reference_rad)
        slopes = [values[place] if name in POSITIVE else 1.0 for place, name in enumerate(names)]
        out.append(
            CampaignRun(
                label=run.label,
                contact=run.contact,
                record=source.run.record,
                sha256=source.run.sha256,
                results_sha256=source.results_sha256,
                likelihood=likelihood_tree(run),
                alone={name: fit.estimate(name) for name in names if name in run.names},
                # of b and gamma at a known exponent: that of the coordinate, at the reference amplitude
                together={
                    name: Estimate(float(values[place]), abs(float(slopes[place] * u_together[row, place])))
                    for place, name in enumerate(names)
                },
                residuals={
                    name: float(residuals[row, place])
                    for place, name in enumerate(names)
                    if name in run.names
                },
                bad=float(found.bad[row]),
            )
        )
    return tuple(out)


def _findings(sampled: Sampled) -> SamplerFindings:
    return SamplerFindings(
        worst_r_hat=max(sampled.r_hat.values()),
        fewest_draws=min(sampled.effective.values()),
        settled=sampled.settled,
    )


def _unknown(stated: StatedCampaign, runs: Sequence[CompressedRun]) -> list[str]:
    """Covariates that some runs lack, or have in another unit: an answer that rests on a guess says so."""
    said: list[str] = []
    for covariate in sorted(stated.covariates - {"", ORDER}):
        known = {run.label: run.covariates[covariate].value for run in runs if covariate in run.covariates}
        said += filter(None, [in_other_unit(covariate, known)])
        without = [run.label for run in runs if covariate not in run.covariates]
        if without:
            listed = f"{', '.join(without[:3])}{' ...' if len(without) > 3 else ''}"
            said.append(
                f"{covariate} is not known of {len(without)} of {len(runs)} runs ({listed}): it is taken "
                "to be as in the others, by their mean and scatter"
            )
    return said


def _warnings(found: CampaignPosterior, alone: CampaignPosterior, sampled: Sampled | None) -> tuple[str, ...]:
    said: list[str] = []
    if sampled is not None and not sampled.settled:
        said.append(
            f"the sampler's chains differ (R-hat {max(sampled.r_hat.values()):.2f}): do not trust its answer"
        )
    blind = [run.label for run in found.runs if run.by_growth is None]
    if blind and any(effect.bends_decays for effect in found.model.effects):
        said.append(
            f"{', '.join(blind[:3])}{' ...' if len(blind) > 3 else ''}: their results do not say how "
            "growing friction changes the decay, so it is ignored; rig fit --set fit.u_ageing=0.01 adds it"
        )
    for run, bad in zip(found.runs, found.bad, strict=True):
        if bad > _BAD:
            said.append(f"{run.label} is a bad run with probability {100 * bad:.0f} % and counts for little")
    for one, what in ((found, "the posterior"), (alone, "the answer without priors")):
        if one.effective < _FEW * len(one.h):
            said.append(
                f"{what} is not well described: {one.effective:.0f} of {len(one.h)} draws count; ask for "
                "more draws, or for the sampler"
            )
    wide = [
        level.name
        for level in found.hyper
        if level.kind == "between runs"
        and found.moments(found.draws(level)).value > found.model.size(level.name)
    ]
    if wide:
        said.append(
            f"runs scatter in {', '.join(wide)} more than is usual: look for what differs between them, "
            "or state a larger size"
        )
    return tuple(said)


def budget_of_level(found: CampaignPosterior, name: str, contact: str) -> tuple[CampaignSource, ...]:
    """Parts of a contact's level of a coordinate, largest first.

    Parts of shared inputs and of effects are what would go if each were known. The rest is the runs': their
    own uncertainties, and how they scatter, which more runs make smaller.
    """
    level = Level("contact", name, contact)
    draws = found.draws(level)
    if Level("mean", name) in found.levels:
        draws = draws + found.draws(Level("mean", name))
    variance = found.moments(draws).standard_uncertainty ** 2
    others = [one for one in found.levels if one.kind in ("shared", "effect")]
    parts: dict[str, float] = {}
    rest = variance
    if others:
        table = np.stack([found.draws(one) for one in others], axis=1)
        table = table - found.weight @ table
        centred = draws - found.weight @ draws
        weighted = table * found.weight[:, None]
        slopes = np.linalg.lstsq(weighted.T @ table, weighted.T @ centred, rcond=1e-10)[0]
        rest = float(found.weight @ (centred - table @ slopes) ** 2)
        each = slopes * (weighted.T @ centred)
        for one, part in zip(others, each.tolist(), strict=True):
            parts[one.name] = max(part, 0.0)
    own = [run.u(name) ** 2 for run in found.runs if run.contact == contact and name in run.names]
    scatter = Level("between runs", name)
    between = found.moments(found.draws(scatter) ** 2).value if scatter in found.hyper else 0.0
    swings = 1 / float(np.mean(1 / np.array(own))) if own else 0.0
    if swings + between > 0:
        parts["between runs"] = rest * between / (between + swings)
        parts["swings"] = rest * swings / (between + swings)
    whole = sum(parts.values()) or 1.0
    found_parts = [
        CampaignSource(source=source, contribution=sqrt(part), share=part / whole)
        for source, part in parts.items()
        if part > 0
    ]
    return tuple(sorted(found_parts, key=lambda one: -one.share))

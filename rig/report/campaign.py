"""The fit of a campaign: from runs and the stated campaign to its results."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from math import inf, isfinite, nan

import numpy as np

from processing.ambient import other_unit_warning
from processing.arrays import Floats
from processing.contact import surface_energy
from processing.errors import DataError
from processing.estimate import NOT_DETERMINED, Estimate
from processing.fit import FitMethod
from processing.series import (
    ORDER,
    SEEN,
    CompressedRun,
    EndSide,
    LatentNumber,
    SeriesModel,
    SeriesPosterior,
    find_change,
    fit_series,
    only_bound,
    parameters,
    sample_series,
)
from processing.units import ARCSEC_RAD
from rig.analysis import SURFACE_ENERGY, RunResults
from rig.report.campaign_input import FoundRun, StatedCampaign, StatedEffect, stated_model
from rig.report.likelihoods import (
    CampaignDifference,
    CampaignEffect,
    CampaignResults,
    CampaignRun,
    CampaignValue,
    compress,
)
from rig.terminal import quantity

_MIN_BAD_PROBABILITY = 0.5
_SIMULATED = "SIMULATED: runs come from the simulated rig; nothing was measured"
_MIN_EFFECTIVE_FRACTION = 0.05
"""Fraction of the draws that must be effective."""
_MAX_RELATIVE_WIDTH = 20.0
"""Width of a 68 % band, relative to its median, above which a quantity is not determined."""
_SEED = 8


@dataclass(frozen=True, repr=False)
class Campaign:
    """The results of a campaign, with its posterior and the stated campaign for figures and tables."""

    results: CampaignResults
    posterior: SeriesPosterior
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


def fit_model(found: Sequence[FoundRun], stated: StatedCampaign, *, sample: bool = False) -> Campaign:
    """Fit one model to all runs of a campaign; with `sample` the posterior is sampled by emcee.

    Raises DataError if no run can enter, or the data hold no covariate asked for; ConfigurationError if an
    unknown parameter is stated.
    """
    reference_rad = stated.reference_arcsec * ARCSEC_RAD
    tried = [(one, *compress(one, reference_rad)) for one in found]
    # a run that is left out keeps its place, so that a step stays where it is stated
    entered = [
        (one, replace(run, covariates={**run.covariates, ORDER: float(place)}))
        for place, (one, run, _) in enumerate(tried)
        if run is not None
    ]
    left_out = tuple(problem for _, run, problem in tried if run is None)
    if not entered:
        raise DataError(f"no run can enter the campaign: {'; '.join(left_out)}")
    runs = [run for _, run in entered]
    model = stated_model(stated, reference_rad, runs)

    def fit(of: SeriesModel) -> SeriesPosterior:
        return fit_series(runs, of, draws=stated.draws, seed=stated.seed)

    sampled = sample_series(runs, model, seed=stated.seed) if sample else None
    posterior = fit(model) if sampled is None else sampled.posterior
    without_priors = fit(model.without_priors())
    effects = tuple(_effect(one, posterior, without_priors, stated) for one in stated.effect)
    runs_of_contact: dict[str, list[RunResults]] = {}
    for source, run in entered:
        runs_of_contact.setdefault(run.contact, []).append(source.run)
    contacts = {
        contact: _contact(contact, (posterior, without_priors), own, reference_rad)
        for contact, own in runs_of_contact.items()
    }
    simulated = any(bool(source.run.simulated) for source, _ in entered)
    warnings = [*_covariate_warnings(stated, runs), *_warnings(posterior, without_priors)]
    worst = nan if sampled is None else max(sampled.r_hat.values())
    if sampled is not None and not sampled.converged:
        warnings.append(f"the sampler's chains differ (R-hat {worst:.2f}): do not trust its answer")
    results = CampaignResults(
        parameters=model.names,
        reference_arcsec=stated.reference_arcsec,
        runs=_runs(entered, posterior, reference_rad),
        contacts=contacts,
        differences=_differences(posterior, list(contacts)),
        between_runs=_estimates(posterior, posterior.hyper, "between runs"),
        between_contacts=_estimates(posterior, posterior.hyper, "between contacts"),
        effects=effects,
        changes=tuple(find_change(runs, model, name) for name in stated.change_points),
        shared=_estimates(posterior, posterior.levels, "shared"),
        budgets={
            contact: {
                name: _budget(posterior, name, contact)
                for name in model.names
                if _bounded_side(posterior, contact, name) is None
            }
            for contact in contacts
        },
        draws=len(posterior.weight),
        draws_that_count=posterior.effective,
        worst_r_hat=worst,
        fewest_draws=nan if sampled is None else min(sampled.effective.values()),
        left_out=left_out,
        warnings=(*([_SIMULATED] if simulated else []), *warnings),
        simulated=simulated,
        stated=stated.model_dump(mode="json", exclude_defaults=True),
    )
    return Campaign(results, posterior, stated)


def _estimates(found: SeriesPosterior, levels: Sequence[LatentNumber], kind: str) -> dict[str, Estimate]:
    return {level.name: found.estimate(level) for level in levels if level.kind == kind}


def _effect(
    one: StatedEffect, found: SeriesPosterior, without_priors: SeriesPosterior, stated: StatedCampaign
) -> CampaignEffect:
    effect = one.effect()
    level = LatentNumber("effect", effect.label)
    draws, span = found.draws(level), effect.span(found.runs)
    low, high = found.quantiles(draws, (0.025, 0.975))
    value, u = found.moments(draws)
    by_chance = found.chance(draws)
    return CampaignEffect(
        label=effect.label,
        parameter=effect.parameter,
        covariate=effect.covariate,
        form=str(effect.form),
        reference=effect.reference,
        slope=Estimate(value, u),
        slope_without_priors=without_priors.estimate(level),
        lower_95=low,
        upper_95=high,
        over_span=Estimate(value * span, u * span),
        chance=by_chance,
        # true if less than one effective draw lies on the other side of zero
        chance_is_limit=by_chance <= 1 / found.effective,
        seen=by_chance * len(stated.effect) < SEEN,
        margin=one.margin,
        # a prior within the margin is no evidence: the data have to say it without priors, too
        equivalent=nan
        if one.margin is None
        else min(
            each.below(np.abs(each.draws(level) * span), one.margin) for each in (found, without_priors)
        ),
    )


def _bounded_side(found: SeriesPosterior, contact: str, name: str) -> EndSide | None:
    """The side on which a contact's level is only bounded, if no prior and no other contacts tell it."""
    known = name in found.model.levels or LatentNumber("mean", name) in found.levels
    return None if known else only_bound(found.runs, contact, name)


def _differences(found: SeriesPosterior, contacts: Sequence[str]) -> tuple[CampaignDifference, ...]:
    """Differences of all pairs of contacts, coordinate by coordinate."""
    names, out = found.model.names, []
    pairs = list(combinations(contacts, 2))
    levels = {contact: found.level_draws(contact) for contact in contacts}
    for first, second in pairs:
        for name, draws in zip(names, (levels[first] - levels[second]).T, strict=True):
            low, high = found.quantiles(draws, (0.025, 0.975))
            difference, by_chance = found.moments(draws), found.chance(draws)
            # of a level that is only bounded the data tell no farther end
            of_first, of_second = (_bounded_side(found, one, name) for one in (first, second))
            if of_first is not None or of_second is not None:
                difference = NOT_DETERMINED
            if of_first is EndSide.UPPER or of_second is EndSide.LOWER:
                low, by_chance = -inf, max(by_chance, min(1.0, 2 * (1 - found.below(draws, 0.0))))
            if of_first is EndSide.LOWER or of_second is EndSide.UPPER:
                high, by_chance = inf, max(by_chance, min(1.0, 2 * found.below(draws, 0.0)))
            out.append(
                CampaignDifference(
                    first=first, second=second, parameter=name, difference=difference,
                    lower_95=low, upper_95=high, chance=by_chance,
                    seen=by_chance * len(pairs) * len(names) < SEEN,
                )
            )  # fmt: skip
    return tuple(out)


def _contact(
    contact: str,
    posteriors: tuple[SeriesPosterior, SeriesPosterior],
    runs: Sequence[RunResults],
    reference_rad: float,
) -> dict[str, CampaignValue]:
    """Quantities of a contact by key, at zero effects; the second posterior is without priors."""
    drawn = [_quantities(one, contact, runs, reference_rad) for one in posteriors]
    out = {}
    for name, draws in drawn[0].items():
        low, high = posteriors[0].quantiles(draws, (0.025, 0.975))
        (value, u), without = (
            _median_and_u(one, own[name]) for one, own in zip(posteriors, drawn, strict=True)
        )
        side = _bounded_side(posteriors[0], contact, "c" if name == SURFACE_ENERGY else name)
        if side is not None:
            (value, u), without = NOT_DETERMINED, NOT_DETERMINED
            low, high = (0.0, high) if side is EndSide.UPPER else (low, inf)
        out[name] = CampaignValue(
            value=value, standard_uncertainty=u, lower_95=low, upper_95=high, without_priors=without
        )
    return out


def _quantities(
    found: SeriesPosterior, contact: str, runs: Sequence[RunResults], reference_rad: float
) -> dict[str, Floats]:
    """Draws of all quantities of a contact, by key."""
    names = found.model.names
    out = dict(zip(names, parameters(names, found.level_draws(contact), reference_rad).T, strict=True))
    energy = _energy(found, out["c"], runs) if "c" in out else None
    return out if energy is None else {**out, SURFACE_ENERGY: energy}


def _median_and_u(found: SeriesPosterior, draws: Floats) -> Estimate:
    """Median and half of the 68 % band, robust against outlying draws; NaN if the band is too wide."""
    low, value, high = found.quantiles(draws, (0.1587, 0.5, 0.8413))
    if not isfinite(high - low) or high - low > _MAX_RELATIVE_WIDTH * abs(value):
        return NOT_DETERMINED
    return Estimate(value, 0.5 * (high - low))


def _energy(found: SeriesPosterior, c: Floats, runs: Sequence[RunResults]) -> Floats | None:
    """Draws of the surface energy (Table 2's form); None if no run has a budget of it.

    It is c times a factor of the apparatus. Inputs shared by runs use their draws of the posterior, inputs
    that move no fitted parameter get new draws; each enters once, however many runs there are.
    """
    ratios: list[float] = []
    moved: dict[str, float] = {}
    for run in runs:
        energy, of_c, pendulum = run.budget.get(SURFACE_ENERGY), run.budget.get("c"), run.pendulum
        c_of_run = run.fits[FitMethod.EXACT].estimate("c").value
        if energy is None or of_c is None or pendulum is None or c_of_run == 0:
            continue
        ratios.append(surface_energy(Estimate(1.0, 0.0), pendulum).table2.value)
        for budget, value in ((energy, ratios[-1] * c_of_run), (of_c, -c_of_run)):
            for one in budget.sources:
                if isfinite(one.sensitivity):
                    moved[one.source] = moved.get(one.source, 0.0) + one.sensitivity * one.u_source / value
    if not ratios:
        return None
    rng = np.random.default_rng(_SEED)
    log_energy = np.full(len(c), float(np.mean(np.log(ratios))))
    for source, part in moved.items():
        level = LatentNumber("shared", source)
        draws = found.draws(level) if level in found.levels else rng.standard_normal(len(c))
        log_energy += draws * (part / len(ratios))
    return np.asarray(c * np.exp(log_energy))


def _runs(
    entered: Sequence[tuple[FoundRun, CompressedRun]], found: SeriesPosterior, reference_rad: float
) -> tuple[CampaignRun, ...]:
    values, u_values = found.run_values(reference_rad)
    names, out = found.model.names, []
    for row, (source, run) in enumerate(entered):
        out.append(
            CampaignRun(
                label=run.label,
                contact=run.contact,
                record=source.run.record,
                sha256=source.run.sha256,
                results_sha256=source.results_sha256,
                together={
                    name: Estimate(float(values[row, place]), float(u_values[row, place]))
                    if _bounded_side(found, run.contact, name) is None
                    else NOT_DETERMINED
                    for place, name in enumerate(names)
                },
                residuals={
                    name: float(found.residuals[row, place])
                    for place, name in enumerate(names)
                    if name in run.names
                },
                bad=float(found.bad[row]),
            )
        )
    return tuple(out)


def _names(labels: Sequence[str]) -> str:
    return f"{', '.join(labels[:3])}{' ...' if len(labels) > 3 else ''}"


def _covariate_warnings(stated: StatedCampaign, runs: Sequence[CompressedRun]) -> list[str]:
    """Warnings of covariates that some runs lack or seem to have in another unit."""
    texts: list[str] = []
    for covariate in sorted(stated.covariates - {"", ORDER}):
        known = {run.label: run.covariates[covariate] for run in runs if covariate in run.covariates}
        texts += filter(None, [other_unit_warning(covariate, known)])
        without = [run.label for run in runs if covariate not in run.covariates]
        if without:
            texts.append(
                f"{covariate} is not known of {len(without)} of {len(runs)} runs ({_names(without)}): it is "
                "taken to be as in the others, by their mean and scatter"
            )
    return texts


def _warnings(found: SeriesPosterior, without_priors: SeriesPosterior) -> list[str]:
    texts: list[str] = []
    blind = [run.label for run in found.runs if run.by_growth is None]
    if blind and any(effect.bends_decays for effect in found.model.effects):
        texts.append(
            f"{_names(blind)}: their results do not say how growing friction changes the decay, so it is "
            "ignored; rig fit --set fit.u_ageing=0.01 adds it"
        )
    texts += [
        f"{run.label} is a bad run with probability {100 * bad:.0f} % and counts for little"
        for run, bad in zip(found.runs, found.bad, strict=True)
        if bad > _MIN_BAD_PROBABILITY
    ]
    texts += [
        f"{what} is not well described: {one.effective:.0f} of {len(one.h)} draws count; ask for more draws, "
        "or for the sampler"
        for one, what in ((found, "the posterior"), (without_priors, "the answer without priors"))
        if one.effective < _MIN_EFFECTIVE_FRACTION * len(one.h)
    ]
    between = _estimates(found, found.hyper, "between runs")
    if wide := [name for name, one in between.items() if one.value > found.model.size(name)]:
        texts.append(
            f"runs scatter in {', '.join(wide)} more than is usual: look for what differs between them, "
            "or state a larger size"
        )
    return texts


def _budget(found: SeriesPosterior, name: str, contact: str) -> dict[str, float]:
    """Shares of the variance of a contact's level of a coordinate by source, largest first.

    The part of a shared input or an effect is the variance that would vanish if it were known. The rest
    belongs to the runs: their own uncertainties and their scatter, which more runs reduce.
    """
    draws = found.level_draws(contact)[:, found.model.names.index(name)]
    centred = draws - found.weight @ draws
    rest = float(found.weight @ centred**2)
    others = [one for one in found.levels if one.kind in ("shared", "effect")]
    parts: dict[str, float] = {}
    if others:
        table = np.stack([found.draws(one) for one in others], axis=1)
        table = table - found.weight @ table
        weighted = table * found.weight[:, None]
        slopes = np.linalg.lstsq(weighted.T @ table, weighted.T @ centred, rcond=1e-10)[0]
        rest = float(found.weight @ (centred - table @ slopes) ** 2)
        each = np.maximum(slopes * (weighted.T @ centred), 0.0)
        parts = dict(zip((one.name for one in others), each.tolist(), strict=True))
    own = [run.u(name) for run in found.runs if run.contact == contact and name in run.names]
    scatter = LatentNumber("between runs", name)
    between = found.moments(found.draws(scatter) ** 2).value if scatter in found.hyper else 0.0
    swings = 1 / float(np.mean(1 / np.array(own) ** 2)) if own else 0.0
    if swings + between > 0:
        parts |= {
            "between runs": rest * between / (between + swings),
            "swings": rest * swings / (between + swings),
        }
    whole = sum(parts.values()) or 1.0
    largest_first = sorted(parts.items(), key=lambda one: -one[1])
    return {source: part / whole for source, part in largest_first if part > 0}

"""The fit of a campaign: from runs and the stated campaign to its results."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
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
    SeriesPosterior,
    find_change,
    fit_series,
    only_bound,
    parameters,
    sample_series,
)
from processing.units import ARCSEC_RAD
from rig.analysis import SURFACE_ENERGY, RunResults
from rig.report.campaign_input import CandidateRun, StatedCampaign, StatedEffect, stated_model
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
                f"{quantity(name).text(*value.estimate)} {quantity(name).unit}".rstrip()
                for name, value in values.items()
            ]
        return "\n".join(lines)


def fit_model(
    candidates: Sequence[CandidateRun], stated: StatedCampaign, *, sample: bool = False
) -> Campaign:
    """Fit one model to all runs of a campaign; with `sample` the posterior is sampled by emcee.

    Raises DataError if no run can enter, or if no run has a stated covariate; ConfigurationError if an
    unknown parameter is stated.
    """
    reference_rad = stated.reference_arcsec * ARCSEC_RAD
    members, left_out = [], []
    # a run that is left out still counts in the order, so that a step stays where it is stated
    for order, candidate in enumerate(candidates):
        run, problem = compress(candidate, reference_rad)
        if run is None:
            left_out.append(problem)
        else:
            members.append((candidate, replace(run, covariates={**run.covariates, ORDER: float(order)})))
    if not members:
        raise DataError(f"no run can enter the campaign: {'; '.join(left_out)}")
    runs = [run for _, run in members]
    model = stated_model(stated, reference_rad, runs)

    fit = partial(fit_series, runs, draws=stated.draws, seed=stated.seed)
    sampled = sample_series(runs, model, seed=stated.seed) if sample else None
    posterior = fit(model) if sampled is None else sampled.posterior
    without_priors = fit(model.without_priors())
    effects = tuple(_effect(effect, posterior, without_priors, stated) for effect in stated.effect)
    runs_by_contact: dict[str, list[RunResults]] = {}
    for candidate, run in members:
        runs_by_contact.setdefault(run.contact, []).append(candidate.run)
    contacts = {
        contact: _contact(contact, (posterior, without_priors), contact_runs, reference_rad)
        for contact, contact_runs in runs_by_contact.items()
    }
    is_simulated = any(bool(candidate.run.simulated) for candidate, _ in members)
    warnings = [*_covariate_warnings(stated, runs), *_warnings(posterior, without_priors)]
    worst_r_hat = nan if sampled is None else max(sampled.r_hat.values())
    if sampled is not None and not sampled.converged:
        warnings.append(f"the sampler's chains differ (R-hat {worst_r_hat:.2f}): do not trust its answer")
    results = CampaignResults(
        parameters=model.names,
        reference_arcsec=stated.reference_arcsec,
        runs=_runs(members, posterior, reference_rad),
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
        worst_r_hat=worst_r_hat,
        fewest_draws=nan if sampled is None else min(sampled.effective.values()),
        left_out=tuple(left_out),
        warnings=(*([_SIMULATED] if is_simulated else []), *warnings),
        simulated=is_simulated,
        stated=stated.model_dump(mode="json", exclude_defaults=True),
    )
    return Campaign(results, posterior, stated)


def _estimates(posterior: SeriesPosterior, levels: Sequence[LatentNumber], kind: str) -> dict[str, Estimate]:
    return {level.name: posterior.estimate(level) for level in levels if level.kind == kind}


def _effect(
    stated_effect: StatedEffect,
    posterior: SeriesPosterior,
    without_priors: SeriesPosterior,
    stated: StatedCampaign,
) -> CampaignEffect:
    effect = stated_effect.effect()
    level = LatentNumber("effect", effect.label)
    draws, span = posterior.draws(level), effect.span(posterior.runs)
    low, high = posterior.quantiles(draws, (0.025, 0.975))
    value, u = posterior.moments(draws)
    chance = posterior.chance(draws)
    margin, equivalent = stated_effect.margin, nan
    if margin is not None:
        # a prior within the margin is no evidence: the data must say it without priors, too
        both = (posterior, without_priors)
        equivalent = min(each.below(np.abs(each.draws(level) * span), margin) for each in both)
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
        chance=chance,
        # less than one effective draw lies on the other side of zero
        chance_is_limit=chance <= 1 / posterior.effective,
        seen=chance * len(stated.effect) < SEEN,
        margin=margin,
        equivalent=equivalent,
    )


def _bounded_side(posterior: SeriesPosterior, contact: str, name: str) -> EndSide | None:
    """The side on which a contact's level is only bounded; None if data, prior or other contacts tell it."""
    is_known = name in posterior.model.levels or LatentNumber("mean", name) in posterior.levels
    return None if is_known else only_bound(posterior.runs, contact, name)


def _differences(posterior: SeriesPosterior, contacts: Sequence[str]) -> tuple[CampaignDifference, ...]:
    """Differences of all pairs of contacts, coordinate by coordinate."""
    names, differences = posterior.model.names, []
    pairs = list(combinations(contacts, 2))
    levels = {contact: posterior.level_draws(contact) for contact in contacts}
    for first, second in pairs:
        for name, draws in zip(names, (levels[first] - levels[second]).T, strict=True):
            low, high = posterior.quantiles(draws, (0.025, 0.975))
            difference, chance = posterior.moments(draws), posterior.chance(draws)
            # if a level is only bounded, the data do not determine the other end of the difference
            side_1, side_2 = (_bounded_side(posterior, contact, name) for contact in (first, second))
            if side_1 is not None or side_2 is not None:
                difference = NOT_DETERMINED
            if side_1 is EndSide.UPPER or side_2 is EndSide.LOWER:
                low, chance = -inf, max(chance, min(1.0, 2 * (1 - posterior.below(draws, 0.0))))
            if side_1 is EndSide.LOWER or side_2 is EndSide.UPPER:
                high, chance = inf, max(chance, min(1.0, 2 * posterior.below(draws, 0.0)))
            differences.append(
                CampaignDifference(
                    first=first, second=second, parameter=name, difference=difference,
                    lower_95=low, upper_95=high, chance=chance,
                    seen=chance * len(pairs) * len(names) < SEEN,
                )
            )  # fmt: skip
    return tuple(differences)


def _contact(
    contact: str,
    posteriors: tuple[SeriesPosterior, SeriesPosterior],
    runs: Sequence[RunResults],
    reference_rad: float,
) -> dict[str, CampaignValue]:
    """Quantities of a contact by key, at zero effects; the second posterior is without priors."""
    draws_of_both = [_quantities(posterior, contact, runs, reference_rad) for posterior in posteriors]
    values = {}
    for name, draws in draws_of_both[0].items():
        low, high = posteriors[0].quantiles(draws, (0.025, 0.975))
        (value, u), without = (
            _median_and_u(posterior, quantities[name])
            for posterior, quantities in zip(posteriors, draws_of_both, strict=True)
        )
        side = _bounded_side(posteriors[0], contact, "c" if name == SURFACE_ENERGY else name)
        if side is not None:
            (value, u), without = NOT_DETERMINED, NOT_DETERMINED
            low, high = (0.0, high) if side is EndSide.UPPER else (low, inf)
        values[name] = CampaignValue(
            value=value, standard_uncertainty=u, lower_95=low, upper_95=high, without_priors=without
        )
    return values


def _quantities(
    posterior: SeriesPosterior, contact: str, runs: Sequence[RunResults], reference_rad: float
) -> dict[str, Floats]:
    """Draws of all quantities of a contact, by key."""
    names = posterior.model.names
    draws = dict(zip(names, parameters(names, posterior.level_draws(contact), reference_rad).T, strict=True))
    energy = _energy(posterior, draws["c"], runs) if "c" in draws else None
    return draws if energy is None else {**draws, SURFACE_ENERGY: energy}


def _median_and_u(posterior: SeriesPosterior, draws: Floats) -> Estimate:
    """Median and half of the 68 % band, robust against outlying draws; NaN if the band is too wide."""
    low, value, high = posterior.quantiles(draws, (0.1587, 0.5, 0.8413))
    if not isfinite(high - low) or high - low > _MAX_RELATIVE_WIDTH * abs(value):
        return NOT_DETERMINED
    return Estimate(value, 0.5 * (high - low))


def _energy(posterior: SeriesPosterior, c: Floats, runs: Sequence[RunResults]) -> Floats | None:
    """Draws of the surface energy (Table 2's form); None if no run has a budget of it."""
    # c times a factor of the apparatus, whose inputs enter once, however many runs there are
    ratios: list[float] = []
    shifts: dict[str, float] = {}
    for run in runs:
        energy, budget_c, pendulum = run.budget.get(SURFACE_ENERGY), run.budget.get("c"), run.pendulum
        c_of_run = run.fits[FitMethod.EXACT].estimate("c").value
        if energy is None or budget_c is None or pendulum is None or c_of_run == 0:
            continue
        ratios.append(surface_energy(Estimate(1.0, 0.0), pendulum).table2.value)
        for budget, value in ((energy, ratios[-1] * c_of_run), (budget_c, -c_of_run)):
            for line in budget.sources:
                if isfinite(line.sensitivity):
                    shift = line.sensitivity * line.u_source / value
                    shifts[line.source] = shifts.get(line.source, 0.0) + shift
    if not ratios:
        return None
    rng = np.random.default_rng(_SEED)
    log_energy = np.full(len(c), float(np.mean(np.log(ratios))))
    for source, shift in shifts.items():
        # an input that moves no fitted parameter is not part of the posterior
        level = LatentNumber("shared", source)
        draws = posterior.draws(level) if level in posterior.levels else rng.standard_normal(len(c))
        log_energy += draws * (shift / len(ratios))
    return np.asarray(c * np.exp(log_energy))


def _runs(
    members: Sequence[tuple[CandidateRun, CompressedRun]], posterior: SeriesPosterior, reference_rad: float
) -> tuple[CampaignRun, ...]:
    values, u_values = posterior.run_values(reference_rad)
    names, runs = posterior.model.names, []
    for row, (candidate, run) in enumerate(members):
        numbers = zip(values[row].tolist(), u_values[row].tolist(), strict=True)
        together = dict(zip(names, (Estimate(value, u) for value, u in numbers), strict=True))
        bounded = [name for name in names if _bounded_side(posterior, run.contact, name) is not None]
        residuals = dict(zip(names, posterior.residuals[row].tolist(), strict=True))
        runs.append(
            CampaignRun(
                label=run.label,
                contact=run.contact,
                record=candidate.run.record,
                sha256=candidate.run.sha256,
                results_sha256=candidate.results_sha256,
                together=together | dict.fromkeys(bounded, NOT_DETERMINED),
                residuals={name: residual for name, residual in residuals.items() if name in run.names},
                bad=float(posterior.bad[row]),
            )
        )
    return tuple(runs)


def _names(labels: Sequence[str]) -> str:
    return f"{', '.join(labels[:3])}{' ...' if len(labels) > 3 else ''}"


def _covariate_warnings(stated: StatedCampaign, runs: Sequence[CompressedRun]) -> list[str]:
    """Warnings of covariates that some runs lack or seem to have in another unit."""
    texts: list[str] = []
    for covariate in sorted({effect.covariate for effect in stated.effect} - {"", ORDER}):
        known = {run.label: run.covariates[covariate] for run in runs if covariate in run.covariates}
        texts += filter(None, [other_unit_warning(covariate, known)])
        without = [run.label for run in runs if covariate not in run.covariates]
        if without:
            texts.append(
                f"{covariate} is not known of {len(without)} of {len(runs)} runs ({_names(without)}): it is "
                "taken to be as in the others, by their mean and scatter"
            )
    return texts


def _warnings(posterior: SeriesPosterior, without_priors: SeriesPosterior) -> list[str]:
    texts: list[str] = []
    unknown = [run.label for run in posterior.runs if run.by_growth is None]
    if unknown and any(effect.bends_decays for effect in posterior.model.effects):
        texts.append(
            f"{_names(unknown)}: their results do not say how growing friction changes the decay, so it is "
            "ignored; rig fit --set fit.u_ageing=0.01 adds it"
        )
    texts += [
        f"{run.label} is a bad run with probability {100 * bad:.0f} % and counts for little"
        for run, bad in zip(posterior.runs, posterior.bad, strict=True)
        if bad > _MIN_BAD_PROBABILITY
    ]
    texts += [
        f"{name} is not well described: {each.effective:.0f} of {len(each.h)} draws count; ask for more "
        "draws, or for the sampler"
        for each, name in ((posterior, "the posterior"), (without_priors, "the answer without priors"))
        if each.effective < _MIN_EFFECTIVE_FRACTION * len(each.h)
    ]
    between = _estimates(posterior, posterior.hyper, "between runs")
    if wide := [name for name, u in between.items() if u.value > posterior.model.size(name)]:
        texts.append(
            f"runs scatter in {', '.join(wide)} more than is usual: look for what differs between them, "
            "or state a larger size"
        )
    return texts


def _budget(posterior: SeriesPosterior, name: str, contact: str) -> dict[str, float]:
    """Shares of the variance of a contact's level of a coordinate by source, largest first."""
    # the part of a shared input or an effect would vanish if it were known; the rest, by the runs' own
    # uncertainties and their scatter, falls with their number
    draws = posterior.level_draws(contact)[:, posterior.model.names.index(name)]
    centred = draws - posterior.weight @ draws
    rest = float(posterior.weight @ centred**2)
    inputs = [level for level in posterior.levels if level.kind in ("shared", "effect")]
    variances: dict[str, float] = {}
    if inputs:
        table = np.stack([posterior.draws(level) for level in inputs], axis=1)
        table = table - posterior.weight @ table
        weighted = table * posterior.weight[:, None]
        slopes = np.linalg.lstsq(weighted.T @ table, weighted.T @ centred, rcond=1e-10)[0]
        rest = float(posterior.weight @ (centred - table @ slopes) ** 2)
        removed = np.maximum(slopes * (weighted.T @ centred), 0.0)
        variances = dict(zip((level.name for level in inputs), removed.tolist(), strict=True))
    u_runs = [run.u(name) for run in posterior.runs if run.contact == contact and name in run.names]
    scatter = LatentNumber("between runs", name)
    between = posterior.moments(posterior.draws(scatter) ** 2).value if scatter in posterior.hyper else 0.0
    swings = 1 / float(np.mean(1 / np.array(u_runs) ** 2)) if u_runs else 0.0
    if swings + between > 0:
        variances["between runs"] = rest * between / (between + swings)
        variances["swings"] = rest * swings / (between + swings)
    total = sum(variances.values()) or 1.0
    largest_first = sorted(variances.items(), key=lambda item: -item[1])
    return {source: variance / total for source, variance in largest_first if variance > 0}

"""What a campaign says of each contact: parameters and surface energy, with and without priors."""

from collections.abc import Sequence
from math import isfinite
from typing import Final

import numpy as np

from processing.arrays import Floats
from processing.campaign import CampaignPosterior, Level, parameters
from processing.contact import surface_energy
from processing.estimate import NOT_DETERMINED, Estimate
from processing.fit import FitMethod
from rig.analysis import RunResults
from rig.campaigns.likelihoods import FoundRun
from rig.campaigns.results import CampaignValue

_NOTHING = 20.0
"""Width of a 68 % band over its middle from which on nothing is known."""


def level_draws(found: CampaignPosterior, contact: str) -> Floats:
    """Draws (M, k) of a contact's coordinates where all effects are nought."""
    columns = []
    for name in found.model.names:
        own = found.draws(Level("contact", name, contact))
        mean = Level("mean", name)
        columns.append(own + found.draws(mean) if mean in found.levels else own)
    return np.stack(columns, axis=1)


def contact_values(
    posterior: CampaignPosterior,
    alone: CampaignPosterior,
    found: Sequence[FoundRun],
    reference_rad: float,
) -> dict[str, dict[str, CampaignValue]]:
    """Quantities by contact and key, where all effects are nought; `alone` is without priors."""
    names, out = posterior.model.names, {}
    for contact in dict.fromkeys(run.contact for run in posterior.runs):
        draws = [
            _quantities(one, contact, names, [f.run for f in found if f.contact == contact], reference_rad)
            for one in (posterior, alone)
        ]
        out[contact] = {name: _value(posterior, alone, draws[0][name], draws[1][name]) for name in draws[0]}
    return out


def _quantities(
    found: CampaignPosterior,
    contact: str,
    names: tuple[str, ...],
    runs: Sequence[RunResults],
    reference_rad: float,
) -> dict[str, Floats]:
    """Draws of all quantities of a contact by key, those of the catalogue."""
    physical = parameters(names, level_draws(found, contact), reference_rad)
    out = {name: physical[:, place] for place, name in enumerate(names)}
    if "c" in out:
        energy = energy_draws(found, out["c"], runs)
        if energy is not None:
            out[ENERGY] = energy
    return out


def _value(
    posterior: CampaignPosterior, alone: CampaignPosterior, draws: Floats, of_alone: Floats
) -> CampaignValue:
    low, high = posterior.quantiles(draws, (0.025, 0.975))
    value, u = _middle(posterior, draws)
    return CampaignValue(
        value=value,
        standard_uncertainty=u,
        lower_95=low,
        upper_95=high,
        without_priors=_middle(alone, of_alone),
    )


def _middle(found: CampaignPosterior, draws: Floats) -> Estimate:
    """Median and half of the 68 % band, which a few far draws of a logarithm do not move; NaN where it is
    so wide that nothing is known."""
    low, value, high = found.quantiles(draws, (0.1587, 0.5, 0.8413))
    if not isfinite(high - low) or high - low > _NOTHING * abs(value):
        return NOT_DETERMINED
    return Estimate(value, 0.5 * (high - low))


ENERGY: Final = "surface_energy_table2_j_per_m2"
_SEED = 8


def energy_draws(found: CampaignPosterior, c: Floats, runs: Sequence[RunResults]) -> Floats | None:
    """Draws of the surface energy (Table 2's form); None where no run has its budget.

    It is c times what is known of the apparatus. Inputs that runs share have their own draws, those that do
    not move any fitted parameter get new ones; each enters once, however many runs there are.
    """
    ratios: list[float] = []
    moved: dict[str, list[float]] = {}
    for run in runs:
        energy, of_c, pendulum = run.budget.get(ENERGY), run.budget.get("c"), run.pendulum
        c_of_run = run.fits[FitMethod.EXACT].estimate("c").value
        if energy is None or of_c is None or pendulum is None or c_of_run == 0:
            continue
        ratio = surface_energy(Estimate(1.0, 0.0), pendulum).table2.value
        ratios.append(ratio)
        for budget, value in ((energy, ratio * c_of_run), (of_c, -c_of_run)):
            for one in budget.sources:
                if isfinite(one.sensitivity):
                    part = one.sensitivity * one.u_source / value
                    moved.setdefault(one.source, []).append(part)
    if not ratios:
        return None
    rng = np.random.default_rng(_SEED)
    log_energy = np.full(len(c), float(np.mean(np.log(ratios))))
    for source, parts in moved.items():
        level = Level("shared", source)
        draws = found.draws(level) if level in found.levels else rng.standard_normal(len(c))
        log_energy += draws * (sum(parts) / len(ratios))
    return np.asarray(c * np.exp(log_energy))

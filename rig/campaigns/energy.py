"""The surface energy of a contact from c, with what the rig's inputs do to both."""

from collections.abc import Sequence
from math import isfinite
from typing import Final

import numpy as np

from processing.arrays import Floats
from processing.campaign import CampaignPosterior, Level
from rig.analysis import RunResults

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
        energy, of_c = run.budget.get(ENERGY), run.budget.get("c")
        if energy is None or of_c is None or not energy.value * of_c.value > 0:
            continue
        ratios.append(energy.value / of_c.value)
        for budget, sign in ((energy, 1.0), (of_c, -1.0)):
            for one in budget.sources:
                if isfinite(one.sensitivity):
                    part = sign * one.sensitivity * one.u_source / budget.value
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

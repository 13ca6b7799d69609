"""The budget of a campaign: what limits the answer now."""

from math import sqrt

import numpy as np

from processing.campaign import CampaignPosterior, Level
from rig.campaigns.results import CampaignSource


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

"""The posterior of a campaign: Laplace's method, then draws weighted by how far the density differs."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.special import logsumexp

from processing.arrays import Floats
from processing.campaign.compressed import CompressedRun
from processing.campaign.density import in_parts, log_kinds, spread
from processing.campaign.design import CampaignModel, Design, Level, design_of
from processing.campaign.forms import Effect
from processing.campaign.laplace import likeliest
from processing.campaign.parts import InParts, here
from processing.campaign.weighted_draws import Round, weighted_round
from processing.estimate import Estimate

DRAWS = 1000
ENOUGH = 0.2
"""Part of the draws that count from which on no further round is made."""
_ROUNDS = 4


@dataclass(frozen=True)
class CampaignPosterior:
    """Draws of a campaign's posterior with their weights.

    `h` (M, H) are logarithms of scatters (`hyper`), `w` (M, P) latent numbers (`levels`), `weight` (M,)
    sums to 1. `effective` is the number of equal draws that these are worth.
    """

    runs: tuple[CompressedRun, ...]
    model: CampaignModel
    design: Design
    h: Floats
    w: Floats
    weight: Floats
    log_evidence: float
    u_log_evidence: float

    @property
    def levels(self) -> tuple[Level, ...]:
        return self.design.levels

    @property
    def hyper(self) -> tuple[Level, ...]:
        return self.design.hyper

    @property
    def effective(self) -> float:
        return float(1 / np.sum(self.weight**2))

    def draws(self, level: Level) -> Floats:
        """Draws (M,) of a latent number, or of a scatter."""
        if level in self.levels:
            return np.asarray(self.w[:, self.levels.index(level)])
        return np.exp(self.h[:, self.hyper.index(level)])

    def estimate(self, level: Level) -> Estimate:
        """Mean and standard deviation."""
        return self.moments(self.draws(level))

    def moments(self, found: Floats) -> Estimate:
        """Mean and standard deviation of draws of anything."""
        mean = float(self.weight @ found)
        return Estimate(mean, float(np.sqrt(self.weight @ (found - mean) ** 2)))

    def quantiles(self, found: Floats, at: Sequence[float]) -> list[float]:
        """Quantiles of draws of anything."""
        order = np.argsort(found)
        reached = np.cumsum(self.weight[order]) - 0.5 * self.weight[order]
        return [float(value) for value in np.interp(at, reached, found[order])]

    def below(self, found: Floats, value: float) -> float:
        """Probability that a quantity lies below a value."""
        return float(np.sum(self.weight[found < value]))

    @cached_property
    def bad(self) -> Floats:
        """Probability of every run (R,) to be a bad one."""
        chance = np.zeros(len(self.runs))
        for part in in_parts(self.design, len(self.h)):
            kinds = log_kinds(self.design, self.w[part], spread(self.design, self.h[part], self.w[part]))
            of = logsumexp(kinds, axis=2)
            of = np.exp(of - logsumexp(of, axis=2, keepdims=True))
            chance += self.weight[part] @ (1 - of[:, :, 0])
        return chance

    @cached_property
    def of_runs(self) -> tuple[Floats, Floats]:
        """Values of every run (R, k) as the campaign has them, and their standard uncertainties.

        The run's own scatter is in them; NaN where nothing is known of a coordinate.
        """
        shape = self.design.has.shape
        mean, second = np.zeros(shape), np.zeros(shape)
        for part in in_parts(self.design, len(self.h)):
            of, u2 = _conditional_of_runs(self.design, self.h[part], self.w[part])
            mean += np.einsum("m,mrk->rk", self.weight[part], of)
            second += np.einsum("m,mrk->rk", self.weight[part], of**2 + u2)
        return mean, np.sqrt(np.clip(second - mean**2, 0.0, None))

    @cached_property
    def residuals(self) -> Floats:
        """Deviations (R, k) of the runs' values from the model's, over what run and scatter leave; 0 where
        a run has none."""
        design = self.design
        w = (self.weight @ self.w)[None]
        h = (self.weight @ self.h)[None]
        off = design.y[:, 0] - np.einsum("rkp,p->rk", design.x, w[0])
        inverse = spread(design, h, w).inverse[0, :, 0]
        width = np.sqrt(np.diagonal(np.linalg.inv(inverse), axis1=1, axis2=2))
        return np.asarray(off / width * design.has)


def moved_by(found: CampaignPosterior, effect: Effect, x: Floats) -> Floats:
    """Draws (M, len(x)) of what an effect of the model adds at other values of its covariate."""
    slope = found.draws(Level("effect", effect.label))
    return np.asarray(slope[:, None] * effect.value(x))


def fit_campaign(
    runs: Sequence[CompressedRun],
    model: CampaignModel,
    *,
    draws: int = DRAWS,
    seed: int = 1,
    do: InParts = here,
) -> CampaignPosterior:
    """The posterior of a model over runs.

    The scatters' likeliest values and curvature come from Laplace's method with the latent numbers
    integrated. Draws with heavier tails about them get weights by the exact density; where few count, the
    next round starts from the moments of the one before, and the best one is kept. `do` does what can be
    done in parts.
    """
    design = design_of(runs, model)
    found = likeliest(design, do=do)
    rng = np.random.default_rng(seed)
    centre, covariance = found.h, found.covariance
    best: Round | None = None
    for _ in range(_ROUNDS):
        one = weighted_round(rng, design, found.w, centre, covariance, draws, do)
        best = one if best is None or one.effective > best.effective else best
        if one.effective > ENOUGH * draws or not len(centre):
            break
        # tempered, so that few draws do not make the next round narrow
        soft = np.exp(0.5 * (one.log_ratio - one.log_ratio.max()))
        soft /= soft.sum()
        centre = soft @ one.h
        off = one.h - centre
        covariance = off.T @ (off * soft[:, None]) + 1e-3 * found.covariance
    assert best is not None
    evidence = float(logsumexp(best.log_ratio) - np.log(draws))
    u_evidence = float(np.sqrt(max(np.sum(best.weight**2) - 1 / draws, 0.0)))
    return CampaignPosterior(tuple(runs), model, design, best.h, best.w, best.weight, evidence, u_evidence)


def _conditional_of_runs(design: Design, h: Floats, w: Floats) -> tuple[Floats, Floats]:
    """Means and variances (M, R, k) of the runs' own values for given draws."""
    variance = np.zeros((len(h), design.has.shape[1]))
    inside = design.scatter >= 0
    variance[:, inside] = np.exp(2 * h[:, design.scatter[inside]])
    found = spread(design, h, w)
    kinds = log_kinds(design, w, found)
    chance = np.exp(kinds - logsumexp(kinds, axis=(2, 3), keepdims=True))
    centre = np.einsum("rkp,mp->mrk", design.x, w)
    off = design.y - centre[:, :, None]
    moved = variance[:, None, None, :] * np.einsum("mrskl,mrsl->mrsk", found.inverse, off)
    # a bad run is as wide as its kind, both what it measured and how it scatters
    parts = np.sum(chance, axis=3)
    widths = np.sum(chance * design.worse**2, axis=(2, 3))[..., None]
    mean = np.einsum("mrs,mrsk->mrk", parts, moved)
    second = np.einsum("mrs,mrsk->mrk", parts, moved**2)
    inner = np.diagonal(found.inverse, axis1=-2, axis2=-1)
    left = variance[:, None, :] - variance[:, None, :] ** 2 * np.einsum("mrs,mrsk->mrk", parts, inner)
    return centre + mean, np.maximum(widths * left + second - mean**2, 0.0)

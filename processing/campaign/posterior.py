"""The posterior of a campaign: Laplace's method, then draws weighted by how far the density differs."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.optimize import minimize
from scipy.special import gammaln, logsumexp

from processing.arrays import Floats
from processing.campaign.compressed import CompressedRun
from processing.campaign.density import (
    Conditional,
    conditional,
    log_density,
    log_kinds,
    log_marginal,
    spread,
)
from processing.campaign.design import CampaignModel, Design, Level, design_of
from processing.campaign.forms import Effect
from processing.errors import DataError
from processing.estimate import Estimate

DRAWS = 1000
FEW = 0.1
"""Part of the draws that must count, else a sampler should be asked."""
_TAILS = 6.0
_TAILS_OF_LEVELS = 30.0
_TOGETHER = 4_000_000
"""Numbers of one array: draws are made in parts."""
_NARROW, _WIDE = 1e-3, 8.0
_STEP = 2e-3
_OUTER, _INNER = 0.1, 0.02
"""Steps of second derivatives, over which what Laplace's method leaves out is seen as it is."""
_LARGEST_U = 1.5
"""Of a logarithm of a scatter, which the data may leave open towards nought."""


class Laplace(NamedTuple):
    """Likeliest scatters, inverse curvature there, latent numbers, and log evidence by Laplace's method."""

    h: Floats
    covariance: Floats
    w: Floats
    log_evidence: float


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
        for part in _parts(self.design, len(self.h)):
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
        for part in _parts(self.design, len(self.h)):
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
    runs: Sequence[CompressedRun], model: CampaignModel, *, draws: int = DRAWS, seed: int = 1
) -> CampaignPosterior:
    """The posterior of a model over runs.

    The scatters' likeliest values and curvature come from Laplace's method with the latent numbers
    integrated. Draws with heavier tails about them get weights by the exact density; a second round starts
    from the first one's moments where few of it count.
    """
    design = design_of(runs, model)
    found = laplace(design)
    rng = np.random.default_rng(seed)
    centre, covariance = found.h, found.covariance
    for _ in range(3):
        h, log_h = _draw_t(rng, centre, covariance, draws, _TAILS)
        w, log_w = _draw_levels(rng, design, h, found.w)
        log_target = np.concatenate([log_density(design, h[part], w[part]) for part in _parts(design, draws)])
        log_ratio = log_target - log_h - log_w
        log_ratio = np.where(np.isfinite(log_ratio), log_ratio, -np.inf)
        weight = np.exp(log_ratio - logsumexp(log_ratio))
        if 1 / np.sum(weight**2) > FEW * 2 * draws or not len(centre):
            break
        # tempered, so that few draws do not make the next round narrow
        soft = np.exp(0.5 * (log_ratio - log_ratio.max()))
        soft /= soft.sum()
        centre = soft @ h
        covariance = (h - centre).T @ ((h - centre) * soft[:, None]) + 1e-3 * found.covariance
    evidence = float(logsumexp(log_ratio) - np.log(draws))
    u_evidence = float(np.sqrt(max(np.sum(weight**2) - 1 / draws, 0.0)))
    return CampaignPosterior(tuple(runs), model, design, h, w, weight, evidence, u_evidence)


def laplace(design: Design, start: Floats | None = None) -> Laplace:
    """Likeliest scatters with the latent numbers integrated, and their curvature; `start` are logarithms of
    scatters from which to begin.

    Raises
    ------
    DataError
        The density has no maximum that can be found.
    """
    begin = np.log(0.2 * design.scales) if start is None else start
    w = design.prior_mean
    last = [w]
    if not len(begin):
        value, inner = log_marginal(design, np.zeros((1, 0)), w)
        return Laplace(np.zeros(0), np.zeros((0, 0)), inner.w[0], float(value[0]))
    steps = _STEP * np.eye(len(begin))

    def fall(h: Floats) -> tuple[float, Floats]:
        around = np.concatenate([h[None], h + steps, h - steps])
        value, inner = log_marginal(design, around, last[0])
        last[0] = inner.w[0]
        ahead, behind = np.split(value[1:], 2)
        return -float(value[0]), -(ahead - behind) / (2 * _STEP)

    low, high = np.log(_NARROW * design.scales), np.log(_WIDE * design.scales)
    solved = minimize(fall, np.clip(begin, low, high), jac=True, method="L-BFGS-B",
                      bounds=list(zip(low, high, strict=True)), options={"maxiter": 200})  # fmt: skip
    if not np.all(np.isfinite(solved.x)) or not np.isfinite(solved.fun):
        raise DataError("the campaign's likelihood has no maximum: state priors, or leave effects out")
    h = np.asarray(solved.x, dtype=np.float64)
    curvature = _curvature(design, h, last[0])
    values, vectors = np.linalg.eigh(curvature)
    covariance = (vectors / np.maximum(values, _LARGEST_U**-2)) @ vectors.T
    log_det = float(np.sum(np.log(np.maximum(values, _LARGEST_U**-2))))
    evidence = -float(solved.fun) + 0.5 * len(h) * float(np.log(2 * np.pi)) - 0.5 * log_det
    return Laplace(h, covariance, last[0], evidence)


def _curvature(design: Design, h: Floats, w: Floats) -> Floats:
    """Second derivatives of minus the log marginal by the logarithms of the scatters."""
    size, grid, both = len(h), _OUTER * np.eye(len(h)), np.array([1.0, -1.0])
    gradients = []
    for sign in (1, -1):
        # (centre, ahead or behind, direction, coordinate)
        around = (h + sign * grid)[:, None, None] + _INNER * both[:, None, None] * np.eye(size)
        around = around.reshape(-1, size)
        value = np.concatenate(
            [log_marginal(design, around[part], w)[0] for part in _parts(design, len(around))]
        )
        ahead, behind = np.moveaxis(value.reshape(size, 2, size), 1, 0)
        gradients.append((ahead - behind) / (2 * _INNER))
    found = -(gradients[0] - gradients[1]) / (2 * _OUTER)
    return np.asarray(0.5 * (found + found.T))


def weighted_levels(
    rng: np.random.Generator, design: Design, h: Floats, start: Floats
) -> tuple[Floats, Floats]:
    """Latent numbers for draws of the scatters from their marginal density, and the weights of both."""
    w, log_w = _draw_levels(rng, design, h, start)
    log_ratio = [
        log_density(design, h[part], w[part]) - log_marginal(design, h[part], start)[0] - log_w[part]
        for part in _parts(design, len(h))
    ]
    whole = np.concatenate(log_ratio)
    return w, np.exp(whole - logsumexp(whole))


def _draw_t(
    rng: np.random.Generator, centre: Floats, covariance: Floats, draws: int, tails: float
) -> tuple[Floats, Floats]:
    """Student's t in several dimensions: draws and log density."""
    size = len(centre)
    if not size:
        return np.zeros((draws, 0)), np.zeros(draws)
    factor = np.linalg.cholesky(covariance)
    stretch = np.sqrt(tails / rng.chisquare(tails, draws))
    z = rng.standard_normal((draws, size)) * stretch[:, None]
    log_det = float(np.sum(np.log(np.diag(factor))))
    return centre + z @ factor.T, _log_t(np.sum(z**2, axis=1), size, tails) - log_det


def _log_t(squared: Floats, size: int, tails: float) -> Floats:
    constant = gammaln(0.5 * (tails + size)) - gammaln(0.5 * tails) - 0.5 * size * np.log(tails * np.pi)
    return np.asarray(constant - 0.5 * (tails + size) * np.log1p(squared / tails))


def _draw_levels(rng: np.random.Generator, design: Design, h: Floats, start: Floats) -> tuple[Floats, Floats]:
    """Latent numbers about the likeliest ones for each draw of the scatters, and their log density."""
    size, out, log_out = design.x.shape[2], [], []
    for part in _parts(design, len(h)):
        inner: Conditional = conditional(design, h[part], start)
        factor = np.linalg.cholesky(inner.curvature)
        stretch = np.sqrt(_TAILS_OF_LEVELS / rng.chisquare(_TAILS_OF_LEVELS, len(inner.w)))
        z = rng.standard_normal(inner.w.shape) * stretch[:, None]
        out.append(inner.w + np.linalg.solve(np.swapaxes(factor, 1, 2), z[..., None])[..., 0])
        log_det = np.sum(np.log(np.diagonal(factor, axis1=1, axis2=2)), axis=1)
        log_out.append(_log_t(np.sum(z**2, axis=1), size, _TAILS_OF_LEVELS) + log_det)
    return np.concatenate(out), np.concatenate(log_out)


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


def _parts(design: Design, draws: int) -> list[slice]:
    """Draws in parts whose largest arrays are of a bearable size."""
    runs, subs, size = design.y.shape
    each = runs * size * max(subs * size * (1 + len(design.blurred_by)), design.x.shape[2])
    width = max(1, _TOGETHER // max(each, 1))
    return [slice(begin, begin + width) for begin in range(0, draws, width)]

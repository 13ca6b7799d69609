"""Draws about Laplace's maximum, weighted by how far the density there differs from that of the draws."""

from typing import NamedTuple

import numpy as np
from scipy.special import gammaln, logsumexp

from processing.arrays import Floats
from processing.campaign.density import Conditional, conditional, in_parts, log_density, log_marginal
from processing.campaign.design import Design
from processing.campaign.parts import InParts, here

_TAILS = 6.0
_TAILS_OF_LEVELS = 30.0


class Round(NamedTuple):
    """Draws about a centre, and how far the density there differs from that of the draws."""

    h: Floats
    w: Floats
    log_ratio: Floats

    @property
    def weight(self) -> Floats:
        return np.asarray(np.exp(self.log_ratio - logsumexp(self.log_ratio)))

    @property
    def effective(self) -> float:
        return float(1 / np.sum(self.weight**2))


def weighted_round(
    rng: np.random.Generator,
    design: Design,
    start: Floats,
    centre: Floats,
    covariance: Floats,
    draws: int,
    do: InParts = here,
) -> Round:
    h, log_h = _draw_t(rng, centre, covariance, draws, _TAILS)
    w, log_w = _draw_levels(rng, design, h, start, do)
    densities = do(log_density, design, [(h[part], w[part]) for part in in_parts(design, draws)])
    log_ratio = np.concatenate(densities) - log_h - log_w
    return Round(h, w, np.where(np.isfinite(log_ratio), log_ratio, -np.inf))


def weighted_levels(
    rng: np.random.Generator, design: Design, h: Floats, start: Floats
) -> tuple[Floats, Floats]:
    """Latent numbers for draws of the scatters from their marginal density, and the weights of both."""
    w, log_w = _draw_levels(rng, design, h, start, here)
    log_ratio = [
        log_density(design, h[part], w[part]) - log_marginal(design, h[part], start)[0] - log_w[part]
        for part in in_parts(design, len(h))
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


def _draw_levels(
    rng: np.random.Generator, design: Design, h: Floats, start: Floats, do: InParts
) -> tuple[Floats, Floats]:
    """Latent numbers about the likeliest ones for each draw of the scatters, and their log density."""
    size, parts = design.x.shape[2], []
    for part in in_parts(design, len(h)):
        count = len(h[part])
        stretch = np.sqrt(_TAILS_OF_LEVELS / rng.chisquare(_TAILS_OF_LEVELS, count))
        parts.append((h[part], start, rng.standard_normal((count, size)) * stretch[:, None]))
    w, log_w = zip(*do(_levels_about, design, parts), strict=True)
    return np.concatenate(w), np.concatenate(log_w)


def _levels_about(design: Design, h: Floats, start: Floats, z: Floats) -> tuple[Floats, Floats]:
    inner: Conditional = conditional(design, h, start)
    factor = np.linalg.cholesky(inner.curvature)
    w = inner.w + np.linalg.solve(np.swapaxes(factor, 1, 2), z[..., None])[..., 0]
    log_det = np.sum(np.log(np.diagonal(factor, axis1=1, axis2=2)), axis=1)
    return w, _log_t(np.sum(z**2, axis=1), z.shape[1], _TAILS_OF_LEVELS) + log_det

"""The posterior density of a campaign, for many draws at once.

Latent numbers are linear: given the scatters and which runs are bad, all is normal and analytic. Logarithms
of scatters are `h` (M, H), latent numbers `w` (M, P).
"""

from typing import NamedTuple

import numpy as np
from scipy.special import log_ndtr, logsumexp

from processing.arrays import Floats
from processing.campaign.design import Design

_LOG_2PI = float(np.log(2 * np.pi))
_STEPS = 60
_SETTLED = 1e-7
_TOGETHER = 4_000_000
"""Numbers of one array: draws are made in parts."""


class Spread(NamedTuple):
    """Inverse (M, R, S, k, k) and log determinant (M, R, S) of what a run's values scatter by."""

    inverse: Floats
    log_det: Floats


def spread(design: Design, h: Floats, w: Floats | None) -> Spread:
    """Of the runs' own covariances, the scatter between runs, and what uncertain covariates leave."""
    variance = np.zeros((len(h), design.has.shape[1]))
    inside = design.scatter >= 0
    variance[:, inside] = np.exp(2 * h[:, design.scatter[inside]])
    diagonal = variance[:, None, :] * design.has
    whole = design.covariance + diagonal[:, :, None, :, None] * np.eye(design.has.shape[1])
    if w is not None and len(design.blurred_by):
        blur = design.blurred * w[:, design.blurred_by, None, None]
        whole = whole + np.einsum("merk,merl->mrkl", blur, blur)[:, :, None]
    # Cholesky's factor also tells a covariance that is none
    factor = np.linalg.cholesky(whole)
    log_det = 2 * np.sum(np.log(np.diagonal(factor, axis1=-2, axis2=-1)), axis=-1)
    return Spread(np.asarray(np.linalg.inv(whole), dtype=np.float64), np.asarray(log_det))


def prior_precision(design: Design, h: Floats) -> Floats:
    """Of the latent numbers (M, P)."""
    u = np.tile(design.prior_u, (len(h), 1))
    varies = design.varies >= 0
    u[:, varies] = np.exp(h[:, design.varies[varies]])
    return u**-2


def log_prior(design: Design, h: Floats, w: Floats) -> Floats:
    """Of scatters and latent numbers (M,)."""
    precision = prior_precision(design, h)
    of_w = 0.5 * np.sum(np.log(precision) - _LOG_2PI - precision * (w - design.prior_mean) ** 2, axis=1)
    # half-normal over the scatter itself; dh is its logarithm's
    ratio = h - np.log(design.scales)
    of_h = np.sum(0.5 * np.log(2 / np.pi) + ratio - 0.5 * np.exp(2 * ratio), axis=1)
    return np.asarray(of_w + of_h)


def log_kinds(design: Design, w: Floats, found: Spread) -> Floats:
    """Log likelihood (M, R, S, K) of every run, by sub-likelihood and by whether it is bad."""
    runs, entries, size = design.x.shape
    seen = (w @ design.x.reshape(runs * entries, size).T).reshape(len(w), runs, entries)
    off = design.y - seen[:, :, None]
    squared = np.sum((found.inverse @ off[..., None])[..., 0] * off, axis=-1)[..., None]
    known = design.has.sum(axis=1)[:, None, None]
    one = -0.5 * (squared / design.worse**2 + found.log_det[..., None] + known * _LOG_2PI)
    one -= known * np.log(design.worse)
    return np.asarray(one + design.log_share[..., None] + design.log_kind)


def log_of_bounds(design: Design, h: Floats, w: Floats) -> tuple[Floats, Floats, Floats]:
    """Log likelihood of the censored values (M, B), and its first two derivatives by what is censored."""
    bounds = design.bounds
    width2 = np.tile(bounds.softness**2, (len(h), 1))
    place = design.scatter[bounds.coordinate]
    width2[:, place >= 0] += np.exp(2 * h[:, place[place >= 0]])
    width = np.sqrt(width2)
    z = bounds.sign * (bounds.limit - w @ bounds.x.T) / width
    value = log_ndtr(z)
    hazard = np.exp(-0.5 * z**2 - 0.5 * _LOG_2PI - value)
    slope = -bounds.sign * hazard / width
    return value, slope, -hazard * (z + hazard) / width2


def log_density(design: Design, h: Floats, w: Floats, found: Spread | None = None) -> Floats:
    """Log of prior times likelihood (M,)."""
    known = spread(design, h, w) if found is None else found
    of_runs = logsumexp(log_kinds(design, w, known), axis=(2, 3)).sum(axis=1)
    return np.asarray(log_prior(design, h, w) + of_runs + log_of_bounds(design, h, w)[0].sum(axis=1))


class Conditional(NamedTuple):
    """Likeliest latent numbers (M, P) for given scatters, and the curvature there (M, P, P)."""

    w: Floats
    curvature: Floats
    spread: Spread


def conditional(design: Design, h: Floats, start: Floats) -> Conditional:
    """By iteration over which runs are bad: each step is a linear one with the weights of the one before."""
    w = np.broadcast_to(start, (len(h), len(design.prior_mean))).copy()
    precision = prior_precision(design, h)
    blurs = len(design.blurred_by) > 0
    found = spread(design, h, w)
    curvature = np.empty(0)
    for _ in range(_STEPS):
        kinds = log_kinds(design, w, found)
        chance = np.exp(kinds - logsumexp(kinds, axis=(2, 3), keepdims=True))
        weighted = np.sum(chance / design.worse**2, axis=3)[..., None, None] * found.inverse
        per_run = weighted.sum(axis=2)
        pulled = (weighted @ design.y[..., None])[..., 0].sum(axis=2)
        times_x = per_run @ design.x
        count, size = design.x.shape[0] * design.x.shape[1], design.x.shape[2]
        curvature = design.x.reshape(count, size).T @ times_x.reshape(len(h), count, size)
        right = pulled.reshape(len(h), count) @ design.x.reshape(count, size)
        right = right + precision * design.prior_mean
        places = np.arange(size)
        curvature[:, places, places] += precision
        if len(design.bounds.limit):
            _, slope, second = log_of_bounds(design, h, w)
            x = design.bounds.x
            curvature = curvature + np.einsum("bp,mb,bq->mpq", x, -second, x)
            right = right + (slope - second * (w @ x.T)) @ x
        after = np.linalg.solve(curvature, right[..., None])[..., 0]
        step = np.einsum("mp,mpq,mq->m", after - w, curvature, after - w)
        w = after
        if blurs:
            found = spread(design, h, w)
        if np.all(step < _SETTLED):
            break
    return Conditional(w, curvature, found)


def log_marginal(design: Design, h: Floats, start: Floats) -> tuple[Floats, Conditional]:
    """Log density of the scatters with the latent numbers integrated, by Laplace's method (M,)."""
    inner = conditional(design, h, start)
    factor = np.linalg.cholesky(inner.curvature)
    log_det = 2 * np.sum(np.log(np.diagonal(factor, axis1=-2, axis2=-1)), axis=-1)
    value = log_density(design, h, inner.w, inner.spread)
    return np.asarray(value + 0.5 * design.x.shape[2] * _LOG_2PI - 0.5 * log_det), inner


def in_parts(design: Design, draws: int) -> list[slice]:
    """Draws in parts whose largest arrays are of a bearable size."""
    runs, subs, size = design.y.shape
    each = runs * size * max(subs * size * (1 + len(design.blurred_by)), design.x.shape[2])
    width = max(1, _TOGETHER // max(each, 1))
    return [slice(begin, begin + width) for begin in range(0, draws, width)]

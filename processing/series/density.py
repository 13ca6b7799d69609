"""The posterior density of a series for many draws at once, its maximum, and the evidence of effects.

The model is linear in the latent numbers: given the scatters and the bad runs, their density is normal.
Arguments are `h` (M, H), logarithms of scatters, and `w` (M, P), latent numbers, of M draws.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from processing.arrays import Floats
from processing.errors import DataError
from processing.series.model import Design, SeriesModel, design_of
from processing.series.runs import ORDER, CompressedRun, Effect, Form, covariate_of

_LOG_2PI = float(np.log(2 * np.pi))
_MAX_NEWTON_STEPS = 60
_TOLERANCE = 1e-7
_MAX_ARRAY_SIZE = 4_000_000
"""Most numbers of one array: more draws are computed in parts."""
_MIN_SCATTER, _MAX_SCATTER = 1e-5, 8.0
"""Range of the scatters searched, over their stated sizes: without priors these are far too large."""
_DERIVATIVE_STEP = 2e-3
_OUTER_STEP, _INNER_STEP = 0.1, 0.02
"""Steps of second derivatives, so wide that the density's departure from a parabola shows in them."""
_MAX_LOG_SCATTER_U = 1.5
"""Largest standard uncertainty of a scatter's logarithm, which the data may leave open towards zero."""


class Spread(NamedTuple):
    """Inverse (M, R, k, k) and log determinant (M, R) of the covariance of the runs' values."""

    inverse: Floats
    log_det: Floats


def between_runs(design: Design, h: Floats) -> Floats:
    """Variances (M, k) between runs."""
    return np.asarray(np.exp(2 * h[:, : design.y.shape[1]]))


def spread(design: Design, h: Floats, w: Floats | None = None) -> Spread:
    """The covariance of the runs' values: their own, scatter between runs, and by unknown covariates."""
    diagonal = between_runs(design, h)[:, None, :] * design.has
    covariance = design.covariance + diagonal[..., None] * np.eye(design.has.shape[1])
    if w is not None and len(design.blurred_by):
        blur = design.blurred * w[:, design.blurred_by, None, None]
        covariance = covariance + np.einsum("merk,merl->mrkl", blur, blur)
    # Cholesky's factor also fails for a matrix that is no covariance
    return Spread(np.asarray(np.linalg.inv(covariance), dtype=np.float64), log_determinant(covariance))


def log_determinant(matrices: Floats) -> Floats:
    """ln det (...,) of positive definite matrices (..., n, n)."""
    factor = np.linalg.cholesky(matrices)
    return np.asarray(2 * np.sum(np.log(np.diagonal(factor, axis1=-2, axis2=-1)), axis=-1))


def _prior_precision(design: Design, h: Floats) -> Floats:
    """Inverse prior variances (M, P) of the latent numbers."""
    return np.where(design.varies >= 0, np.exp(h[:, design.varies]), design.prior_u) ** -2


def _log_prior(design: Design, h: Floats, w: Floats) -> Floats:
    """Log prior density (M,) of scatters and latent numbers."""
    precision = _prior_precision(design, h)
    of_w = 0.5 * np.sum(np.log(precision) - _LOG_2PI - precision * (w - design.prior_mean) ** 2, axis=1)
    # half-normal in the scatter, written as a density of its logarithm h
    ratio = h - np.log(design.scales)
    of_h = np.sum(0.5 * np.log(2 / np.pi) + ratio - 0.5 * np.exp(2 * ratio), axis=1)
    return np.asarray(of_w + of_h)


def log_kinds(design: Design, w: Floats, of_runs: Spread) -> Floats:
    """Log likelihood (M, R, K) of every run by kind (good, or bad by a factor)."""
    residuals = design.y - np.tensordot(w, design.x, (1, 2))
    chi2 = np.sum((of_runs.inverse @ residuals[..., None])[..., 0] * residuals, axis=-1)[..., None]
    known = design.has.sum(axis=1)[:, None]
    log_normal = -0.5 * (chi2 / design.worse**2 + of_runs.log_det[..., None] + known * _LOG_2PI)
    return np.asarray(log_normal - known * np.log(design.worse) + design.log_kind)


def chances(kinds: Floats) -> Floats:
    """Probabilities (M, R, K) of every run's kinds."""
    from scipy.special import logsumexp

    return np.asarray(np.exp(kinds - logsumexp(kinds, axis=2, keepdims=True)))


def _log_of_bounds(design: Design, h: Floats, w: Floats) -> tuple[Floats, Floats, Floats]:
    """Log likelihood of the censored values (M, B), its first two derivatives with respect to the model's."""
    from scipy.special import log_ndtr

    bounds = design.bounds
    width2 = bounds.softness**2 + between_runs(design, h)[:, bounds.coordinate]
    width = np.sqrt(width2)
    z = bounds.sign * (bounds.limit - w @ bounds.x.T) / width
    value = log_ndtr(z)
    hazard = np.exp(-0.5 * z**2 - 0.5 * _LOG_2PI - value)
    return value, -bounds.sign * hazard / width, -hazard * (z + hazard) / width2


def log_density(design: Design, h: Floats, w: Floats, of_runs: Spread | None = None) -> Floats:
    """Log of prior times likelihood (M,)."""
    from scipy.special import logsumexp

    of_runs = spread(design, h, w) if of_runs is None else of_runs
    log_likelihood = logsumexp(log_kinds(design, w, of_runs), axis=2).sum(axis=1)
    return np.asarray(_log_prior(design, h, w) + log_likelihood + _log_of_bounds(design, h, w)[0].sum(axis=1))


def conditional(design: Design, h: Floats, start: Floats) -> tuple[Floats, Floats, Spread]:
    """Likeliest latent numbers (M, P) for given scatters, the curvature there (M, P, P), and the spread.

    Each step of an iteration solves linearly for the latent numbers, with the runs weighted by their
    probabilities to be bad after the last step.
    """
    w = np.broadcast_to(start, (len(h), len(design.prior_mean))).copy()
    precision = _prior_precision(design, h)
    of_runs, curvature = spread(design, h, w), np.empty(0)
    places = np.arange(w.shape[1])
    flat, x = design.x.reshape(-1, len(places)), design.bounds.x
    for _ in range(_MAX_NEWTON_STEPS):
        chance = chances(log_kinds(design, w, of_runs))
        weighted = np.sum(chance / design.worse**2, axis=2)[..., None, None] * of_runs.inverse
        weighted_y = (weighted @ design.y[..., None])[..., 0]
        curvature = flat.T @ (weighted @ design.x).reshape(len(h), *flat.shape)
        right = weighted_y.reshape(len(h), -1) @ flat + precision * design.prior_mean
        curvature[:, places, places] += precision
        if len(design.bounds.limit):
            _, slope, second = _log_of_bounds(design, h, w)
            curvature = curvature + np.einsum("bp,mb,bq->mpq", x, -second, x)
            right = right + (slope - second * (w @ x.T)) @ x
        next_w = np.linalg.solve(curvature, right[..., None])[..., 0]
        change = np.einsum("mp,mpq,mq->m", next_w - w, curvature, next_w - w)
        w = next_w
        if len(design.blurred_by):
            of_runs = spread(design, h, w)
        if np.all(change < _TOLERANCE):
            break
    return w, curvature, of_runs


def log_marginal(design: Design, h: Floats, start: Floats) -> tuple[Floats, Floats]:
    """Log density of the scatters with the latent numbers integrated, by Laplace's method (M,), and the
    likeliest latent numbers (M, P)."""

    def integrated(h: Floats) -> tuple[Floats, Floats]:
        w, curvature, of_runs = conditional(design, h, start)
        value = log_density(design, h, w, of_runs)
        return value + 0.5 * w.shape[1] * _LOG_2PI - 0.5 * log_determinant(curvature), w

    value, w = in_parts(design, integrated, h)
    return value, w


def in_parts(
    design: Design, function: Callable[..., tuple[Floats, ...]], *draws: Floats
) -> tuple[Floats, ...]:
    """Results of a function of draws, called for parts of them so that no array exceeds `_MAX_ARRAY_SIZE`."""
    runs, size = design.y.shape
    numbers_per_draw = runs * size * max(size * (1 + len(design.blurred_by)), design.x.shape[2])
    length = max(1, _MAX_ARRAY_SIZE // max(numbers_per_draw, 1))
    begins = range(0, len(draws[0]), length)
    results = [function(*(array[begin : begin + length] for array in draws)) for begin in begins]
    return tuple(np.concatenate(arrays) for arrays in zip(*results, strict=True))


class Laplace(NamedTuple):
    """Likeliest scatters, inverse curvature there, latent numbers, and log evidence by Laplace's method."""

    h: Floats
    covariance: Floats
    w: Floats
    log_evidence: float


def likeliest(design: Design, start: Floats | None = None) -> Laplace:
    """Likeliest scatters with the latent numbers integrated, and their curvature; `start` are logarithms of
    scatters from which to begin. Raises DataError where no maximum can be found."""
    from scipy.optimize import minimize

    begin = np.log(0.2 * design.scales) if start is None else start
    size, w = len(begin), design.prior_mean

    def fall(h: Floats) -> tuple[float, Floats]:
        nonlocal w
        value, latent = log_marginal(design, np.concatenate([h[None], *_around(h, _DERIVATIVE_STEP)]), w)
        w = latent[0]
        ahead, behind = np.split(value[1:], 2)
        return -float(value[0]), -(ahead - behind) / (2 * _DERIVATIVE_STEP)

    low, high = np.log(_MIN_SCATTER * design.scales), np.log(_MAX_SCATTER * design.scales)
    solved = minimize(fall, np.clip(begin, low, high), jac=True, method="L-BFGS-B",
                      bounds=list(zip(low, high, strict=True)), options={"maxiter": 200})  # fmt: skip
    if not np.all(np.isfinite(solved.x)) or not np.isfinite(solved.fun):
        raise DataError("the likelihood of the series has no maximum: state priors, or leave effects out")
    h = np.asarray(solved.x, dtype=np.float64)
    # gradients ahead and behind in every direction
    trials = np.concatenate([inner for outer in np.concatenate(_around(h, _OUTER_STEP))
                             for inner in _around(outer, _INNER_STEP)])  # fmt: skip
    value = log_marginal(design, trials, w)[0].reshape(2, size, 2, size)
    gradient = (value[:, :, 0] - value[:, :, 1]) / (2 * _INNER_STEP)
    curvature = -(gradient[0] - gradient[1]) / (2 * _OUTER_STEP)
    values, vectors = np.linalg.eigh(0.5 * (curvature + curvature.T))
    values = np.maximum(values, _MAX_LOG_SCATTER_U**-2)
    evidence = -float(solved.fun) + 0.5 * size * _LOG_2PI - 0.5 * float(np.sum(np.log(values)))
    return Laplace(h, (vectors / values) @ vectors.T, w, evidence)


def _around(h: Floats, step: float) -> tuple[Floats, Floats]:
    """Points one step ahead and behind in every direction."""
    steps = step * np.eye(len(h))
    return h + steps, h - steps


SEEN = 0.05
"""Chance, shared between all effects that were tried, below which an effect is reported as seen."""
ABSENT = 0.95
"""Probability that an effect is smaller than what matters, above which it is reported as absent."""
_MIN_RUNS_PER_SIDE = 2
"""Fewest runs on either side of a change."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ChangePoint:
    """A change of a parameter between two runs of a series."""

    parameter: str
    probability: float
    """Probability of a change anywhere against none. Both have equal prior probabilities, so that the choice
    among all runs is allowed for."""
    first_run: int
    """Likeliest number, from 0, of the first run with another value."""
    at_least: int
    """Lower end of the 95 % interval of this number."""
    at_most: int


def find_change(runs: Sequence[CompressedRun], model: SeriesModel, parameter: str) -> ChangePoint:
    """The likeliest change of a parameter along the series, of runs in their order. Raises DataError for
    fewer than four runs."""
    from scipy.special import logsumexp

    if len(runs) < 2 * _MIN_RUNS_PER_SIDE:
        raise DataError(f"{len(runs)} runs: a change needs {_MIN_RUNS_PER_SIDE} on either side")
    first_runs = range(_MIN_RUNS_PER_SIDE, len(runs) - _MIN_RUNS_PER_SIDE + 1)
    order, _ = covariate_of(runs, ORDER)
    steps = [
        Effect(parameter=parameter, covariate=ORDER, form=Form.STEP, reference=float(order[run]))
        for run in first_runs
    ]
    base = likeliest(design_of(runs, model))
    gains = np.array(
        [
            likeliest(design_of(runs, model.with_effects(step)), base.h).log_evidence - base.log_evidence
            for step in steps
        ]
    )
    no_change = float(np.exp(-logsumexp([0.0, *(gains - np.log(len(gains)))])))
    share = np.exp(gains - logsumexp(gains))
    low, high = np.searchsorted(np.cumsum(share), (0.025, 0.975))
    return ChangePoint(
        parameter=parameter, probability=1 - no_change, first_run=first_runs[int(np.argmax(share))],
        at_least=first_runs[int(low)], at_most=first_runs[min(int(high), len(first_runs) - 1)],
    )  # fmt: skip

"""Laplace's method over the scatters: where their marginal density is largest, and how it falls off."""

from typing import NamedTuple

import numpy as np
from scipy.optimize import minimize

from processing.arrays import Floats
from processing.campaign.density import in_parts, log_marginal
from processing.campaign.design import Design
from processing.campaign.parts import InParts, here
from processing.errors import DataError

_NARROW, _WIDE = 1e-5, 8.0
"""Scatters that are looked at, over their stated sizes: without priors these are far too large."""
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


def likeliest(design: Design, start: Floats | None = None, do: InParts = here) -> Laplace:
    """Likeliest scatters with the latent numbers integrated, and their curvature; `start` are logarithms of
    scatters from which to begin, `do` does what can be done in parts.

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
        value, last[0] = _marginal(design, around, last[0], do)
        ahead, behind = np.split(value[1:], 2)
        return -float(value[0]), -(ahead - behind) / (2 * _STEP)

    low, high = np.log(_NARROW * design.scales), np.log(_WIDE * design.scales)
    solved = minimize(fall, np.clip(begin, low, high), jac=True, method="L-BFGS-B",
                      bounds=list(zip(low, high, strict=True)), options={"maxiter": 200})  # fmt: skip
    if not np.all(np.isfinite(solved.x)) or not np.isfinite(solved.fun):
        raise DataError("the campaign's likelihood has no maximum: state priors, or leave effects out")
    h = np.asarray(solved.x, dtype=np.float64)
    curvature = _curvature(design, h, last[0], do)
    values, vectors = np.linalg.eigh(curvature)
    covariance = (vectors / np.maximum(values, _LARGEST_U**-2)) @ vectors.T
    log_det = float(np.sum(np.log(np.maximum(values, _LARGEST_U**-2))))
    evidence = -float(solved.fun) + 0.5 * len(h) * float(np.log(2 * np.pi)) - 0.5 * log_det
    return Laplace(h, covariance, last[0], evidence)


def _marginal(design: Design, h: Floats, start: Floats, do: InParts) -> tuple[Floats, Floats]:
    """Log marginal densities (M,), and the likeliest latent numbers of the first."""
    done = do(_marginal_part, design, [(h[part], start) for part in in_parts(design, len(h))])
    return np.concatenate([value for value, _ in done]), done[0][1]


def _marginal_part(design: Design, h: Floats, start: Floats) -> tuple[Floats, Floats]:
    value, inner = log_marginal(design, h, start)
    return value, inner.w[0]


def _curvature(design: Design, h: Floats, w: Floats, do: InParts) -> Floats:
    """Second derivatives of minus the log marginal by the logarithms of the scatters."""
    size, grid, both = len(h), _OUTER * np.eye(len(h)), np.array([1.0, -1.0])
    gradients = []
    for sign in (1, -1):
        # (centre, ahead or behind, direction, coordinate)
        around = (h + sign * grid)[:, None, None] + _INNER * both[:, None, None] * np.eye(size)
        around = around.reshape(-1, size)
        value, _ = _marginal(design, around, w, do)
        ahead, behind = np.moveaxis(value.reshape(size, 2, size), 1, 0)
        gradients.append((ahead - behind) / (2 * _INNER))
    found = -(gradients[0] - gradients[1]) / (2 * _OUTER)
    return np.asarray(0.5 * (found + found.T))

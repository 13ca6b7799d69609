"""The posterior of a series: weighted draws about the maximum by Laplace's method, or a sampler's (emcee).

Chains of emcee walk over the scatters alone, with the latent numbers integrated: over both the density is a
funnel, in which walkers avoid small and large scatters (measured: a scatter between contacts came out a
quarter too small, with R-hat 1.01).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np

from processing.arrays import Floats
from processing.errors import optional_module
from processing.estimate import Estimate
from processing.series.density import (
    between_runs,
    chances,
    conditional,
    in_parts,
    likeliest,
    log_density,
    log_determinant,
    log_kinds,
    log_marginal,
    spread,
)
from processing.series.model import Design, LatentNumber, SeriesModel, design_of
from processing.series.runs import (
    POSITIVE,
    CompressedRun,
    at_own_exponent,
    parameters,
)

DRAWS = 1000
_ENOUGH_SHARE = 0.2
"""Effective share of the draws above which no further round is made."""
_MAX_ITERATIONS = 4
_SCATTER_DOF, _LATENT_DOF = 6.0, 30.0
"""Degrees of freedom of Student's t from which scatters and latent numbers are drawn."""
_MAX_R_HAT = 1.05
"""R-hat below which chains agree."""
_ENSEMBLES = 4
_BURN_IN_SHARE = 0.3
_MAX_LOG_SCATTER_CHANGE = 12.0
"""Largest distance of a walker from the likeliest scatters, in their logarithms."""
_MAX_DRAWS = 4000


@dataclass(frozen=True)
class SeriesPosterior:
    """Draws of a series' posterior with their weights."""

    runs: tuple[CompressedRun, ...]
    model: SeriesModel
    design: Design
    h: Floats
    """Logarithms (M, H) of the scatters `hyper`."""
    w: Floats
    """Latent numbers (M, P), `levels`."""
    weight: Floats
    """Weights (M,), whose sum is 1."""

    @property
    def levels(self) -> tuple[LatentNumber, ...]:
        return self.design.levels

    @property
    def hyper(self) -> tuple[LatentNumber, ...]:
        return self.design.hyper

    @property
    def effective(self) -> float:
        """Number of equally weighted draws with the same information."""
        return float(1 / np.sum(self.weight**2))

    def draws(self, level: LatentNumber) -> Floats:
        """Draws (M,) of a latent number, or of a scatter."""
        if level in self.levels:
            return np.asarray(self.w[:, self.levels.index(level)])
        return np.exp(self.h[:, self.hyper.index(level)])

    def level_draws(self, contact: str) -> Floats:
        """Draws (M, k) of a contact's coordinates where all effects are zero."""
        columns = []
        for name in self.model.names:
            own, mean = self.draws(LatentNumber("contact", name, contact)), LatentNumber("mean", name)
            columns.append(own + self.draws(mean) if mean in self.levels else own)
        return np.stack(columns, axis=1)

    def estimate(self, level: LatentNumber) -> Estimate:
        """Mean and standard deviation."""
        return self.moments(self.draws(level))

    def moments(self, draws: Floats) -> Estimate:
        """Mean and standard deviation of draws (M,) of any quantity."""
        mean = float(self.weight @ draws)
        return Estimate(mean, float(np.sqrt(self.weight @ (draws - mean) ** 2)))

    def quantiles(self, draws: Floats, probabilities: Sequence[float]) -> list[float]:
        """Quantiles of draws (M,) of any quantity."""
        order = np.argsort(draws)
        cumulated = np.cumsum(self.weight[order]) - 0.5 * self.weight[order]
        return [float(value) for value in np.interp(probabilities, cumulated, draws[order])]

    def below(self, draws: Floats, value: float) -> float:
        """Probability that a quantity lies below a value."""
        return float(np.sum(self.weight[draws < value]))

    def chance(self, draws: Floats) -> float:
        """Two-sided tail probability of zero by draws of an effect or a difference, at least one draw's."""
        positive = 1 - self.below(draws, 0.0)
        return float(max(2 * min(positive, 1 - positive), 1 / self.effective))

    @cached_property
    def bad(self) -> Floats:
        """Probability (R,) of each run to be bad."""
        (chance,) = in_parts(self.design, partial(_bad_chances, self.design), self.h, self.w)
        return np.asarray(self.weight @ chance)

    def run_values(self, reference_rad: float) -> tuple[Floats, Floats]:
        """Parameters (R, k) of the runs by the series as a whole, and their standard uncertainties."""
        names = self.model.names
        slopes = at_own_exponent(names, reference_rad)
        run_posteriors = partial(_run_posteriors, self.design, slopes)
        means, u2 = in_parts(self.design, run_posteriors, self.h, self.w)
        mean = np.einsum("m,mrk->rk", self.weight, means)
        deviations = means @ slopes.T - mean @ slopes.T
        u = np.sqrt(np.einsum("m,mrk->rk", self.weight, deviations**2 + u2))
        values = parameters(names, mean, reference_rad)
        return values, np.where([name in POSITIVE for name in names], np.abs(values), 1.0) * u

    @cached_property
    def residuals(self) -> Floats:
        """Deviations (R, k) of the runs' values from the model's, over their uncertainty and scatter; 0 where
        a run has no value."""
        w, h = (self.weight @ self.w)[None], (self.weight @ self.h)[None]
        inverse = spread(self.design, h, w).inverse[0]
        width = np.sqrt(np.diagonal(np.linalg.inv(inverse), axis1=1, axis2=2))
        return np.asarray((self.design.y - self.design.x @ w[0]) / width * self.design.has)


def _bad_chances(design: Design, h: Floats, w: Floats) -> tuple[Floats]:
    """Probabilities (M, R) of the runs to be bad, by draw."""
    chance = chances(log_kinds(design, w, spread(design, h, w)))
    return (1 - chance[..., 0],)


def _run_posteriors(design: Design, slopes: Floats, h: Floats, w: Floats) -> tuple[Floats, Floats]:
    """Means (M, R, k) of the runs' own coordinates by draw, and the variances (M, R, k) of `slopes` (k, k)
    times these."""
    of_runs, variance = spread(design, h, w), between_runs(design, h)[:, None]
    chance = chances(log_kinds(design, w, of_runs))
    centre = np.tensordot(w, design.x, (1, 2))
    offset = variance * np.einsum("mrkl,mrl->mrk", of_runs.inverse, design.y - centre)
    # the factor of a bad run's kind widens both its own uncertainty and its scatter
    factor2, weighted = np.sum(chance * design.worse**2, axis=2)[..., None], slopes * variance
    reduction = np.einsum("mak,mrkl,mal->mra", weighted, of_runs.inverse, weighted, optimize=True)
    return centre + offset, np.maximum(factor2 * (variance @ (slopes**2).T - reduction), 0.0)


def fit_series(
    runs: Sequence[CompressedRun], model: SeriesModel, *, draws: int = DRAWS, seed: int = 1
) -> SeriesPosterior:
    """The posterior of a model over runs.

    The scatters' likeliest values and curvature come from Laplace's method with the latent numbers
    integrated. Draws with heavier tails about them get weights by the exact density; where their effective
    number is small, another round starts from the moments of the last. The best round is returned.
    """
    design = design_of(runs, model)
    maximum = likeliest(design)
    rng = np.random.default_rng(seed)
    centre, covariance = maximum.h, maximum.covariance
    best: SeriesPosterior | None = None
    for _ in range(_MAX_ITERATIONS):
        z, log_z = _students(rng, (draws, len(centre)), _SCATTER_DOF)
        h = centre + z @ np.linalg.cholesky(covariance).T
        log_h = log_z - 0.5 * log_determinant(covariance)
        posterior, log_ratio = _weighted(rng, runs, model, design, maximum.w, h, log_h)
        best = posterior if best is None or posterior.effective > best.effective else best
        if posterior.effective > _ENOUGH_SHARE * draws:
            break
        # tempered, so that few draws do not make the next round narrow
        tempered = _weights(0.5 * log_ratio)
        centre = tempered @ h
        deviations = h - centre
        covariance = deviations.T @ (deviations * tempered[:, None]) + 1e-3 * maximum.covariance
    assert best is not None
    return best


def _weights(log_ratio: Floats) -> Floats:
    from scipy.special import logsumexp

    return np.asarray(np.exp(log_ratio - logsumexp(log_ratio)))


def _weighted(
    rng: np.random.Generator,
    runs: Sequence[CompressedRun],
    model: SeriesModel,
    design: Design,
    start: Floats,
    h: Floats,
    log_h: Floats,
) -> tuple[SeriesPosterior, Floats]:
    """The posterior by draws of the scatters `h` with the log density `log_h`, the latent numbers drawn about
    their likeliest ones, and the logarithms of its weights before normalisation."""

    def draws_of_levels(h: Floats) -> tuple[Floats, Floats]:
        z, log_z = _students(rng, (len(h), len(start)), _LATENT_DOF)
        w, curvature, _ = conditional(design, h, start)
        factor = np.swapaxes(np.linalg.cholesky(curvature), 1, 2)
        w = w + np.linalg.solve(factor, z[..., None])[..., 0]
        return w, log_density(design, h, w) - log_z - 0.5 * log_determinant(curvature)

    w, log_ratio = in_parts(design, draws_of_levels, h)
    log_ratio = np.where(np.isfinite(log_ratio - log_h), log_ratio - log_h, -np.inf)
    return SeriesPosterior(tuple(runs), model, design, h, w, _weights(log_ratio)), log_ratio


def _students(rng: np.random.Generator, shape: tuple[int, int], dof: float) -> tuple[Floats, Floats]:
    """Draws of Student's t in several dimensions, and their log density."""
    from scipy.special import gammaln

    draws, size = shape
    stretch = np.sqrt(dof / rng.chisquare(dof, draws))
    z = rng.standard_normal(shape) * stretch[:, None]
    constant = gammaln(0.5 * (dof + size)) - gammaln(0.5 * dof) - 0.5 * size * np.log(dof * np.pi)
    return z, np.asarray(constant - 0.5 * (dof + size) * np.log1p(np.sum(z**2, axis=1) / dof))


@dataclass(frozen=True)
class SampledPosterior:
    """A posterior by a sampler."""

    posterior: SeriesPosterior
    r_hat: Mapping[LatentNumber, float]
    """Ratio of variation of all draws of each scatter to that within independent halves of ensembles."""
    effective: Mapping[LatentNumber, float]
    """Number of independent draws of each scatter."""

    @property
    def converged(self) -> bool:
        """Whether all chains agree."""
        return max(self.r_hat.values()) < _MAX_R_HAT


def sample_series(
    runs: Sequence[CompressedRun], model: SeriesModel, *, steps: int = 1000, seed: int = 1
) -> SampledPosterior:
    """Draws of the full posterior by four independent ensembles of walkers about Laplace's maximum.

    Raises ConfigurationError where emcee is not installed.
    """
    emcee = optional_module("emcee", "--sample", "emcee", "series", "leave it out")
    design = design_of(runs, model)
    maximum, rng = likeliest(design), np.random.default_rng(seed)
    size = len(maximum.h)
    # walkers move in coordinates z in which the maximum is a sphere
    factor = np.linalg.cholesky(maximum.covariance)

    def log_posterior(z: Floats) -> Floats:
        h = maximum.h + z @ factor.T
        value = np.full(len(z), -np.inf)
        near = np.all(np.abs(h - maximum.h) < _MAX_LOG_SCATTER_CHANGE, axis=1)
        if np.any(near):
            value[near] = log_marginal(design, h[near], maximum.w)[0]
        return np.where(np.isfinite(value), value, -np.inf)

    walkers = max(2 * size + 2, 10)
    chains, times = [], []
    for _ in range(_ENSEMBLES):
        sampler = emcee.EnsembleSampler(walkers, size, log_posterior, vectorize=True)
        sampler.random_state = np.random.RandomState(int(rng.integers(2**31))).get_state()
        sampler.run_mcmc(rng.standard_normal((walkers, size)), steps, progress=False)
        chains.append(maximum.h + sampler.get_chain(discard=int(_BURN_IN_SHARE * steps)) @ factor.T)
        by_scatter = np.moveaxis(chains[-1], 2, 0)
        times.append([emcee.autocorr.integrated_time(chain, tol=0) for chain in by_scatter])
    walks = np.array(chains)
    flat = walks.reshape(-1, size)
    h = flat[:: max(1, len(flat) // _MAX_DRAWS)]
    log_h = log_marginal(design, h, maximum.w)[0]
    posterior, _ = _weighted(rng, runs, model, design, maximum.w, h, log_h)
    effective = len(flat) / np.maximum(np.mean(times, axis=0).ravel(), 1.0)
    return SampledPosterior(
        posterior,
        {level: split_r_hat(walks[..., place]) for place, level in enumerate(design.hyper)},
        dict(zip(design.hyper, effective.tolist(), strict=True)),
    )


def split_r_hat(chains: Floats) -> float:
    """R-hat of independent ensembles (chains, steps, walkers), each cut into halves.

    The walkers of an ensemble depend on each other, so that only ensembles and halves are compared.
    """
    half = chains.shape[1] // 2
    halves = np.concatenate([chains[:, :half], chains[:, half : 2 * half]])
    within = float(np.mean(halves.var(axis=(1, 2))))
    return float(np.sqrt(1 + np.var(halves.mean(axis=(1, 2)), ddof=1) / within)) if within > 0 else 1.0

"""The full posterior of a campaign by emcee, with what says whether its chains have settled.

Chains walk over the scatters, with the latent numbers integrated: with them the density is a funnel, in
which walkers stay away from small and from large scatters (measured: a scatter between contacts came out a
quarter too small, with R-hat 1.01). Latent numbers are drawn for each scatter, with weights by the exact
density.
`emcee` comes with the extra `series`.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from processing.arrays import Floats
from processing.campaign.compressed import CompressedRun
from processing.campaign.density import log_marginal
from processing.campaign.design import CampaignModel, Level, design_of
from processing.campaign.laplace import likeliest
from processing.campaign.posterior import CampaignPosterior
from processing.campaign.weighted_draws import weighted_levels
from processing.errors import ConfigurationError

SETTLED = 1.05
"""R-hat below which chains tell the same."""
_CHAINS = 4
_BURNT = 0.3
_LONGEST_LOG_SCATTER = 12.0
_KEPT = 4000


@dataclass(frozen=True)
class Sampled:
    """A posterior by a sampler.

    `r_hat` and `effective` are by level: the ratio of scatters between and within independent halves of
    ensembles, and the number of independent draws. `settled` says whether all chains tell the same.
    """

    posterior: CampaignPosterior
    r_hat: Mapping[Level, float]
    effective: Mapping[Level, float]

    @property
    def settled(self) -> bool:
        return max(self.r_hat.values()) < SETTLED


def sample_campaign(
    runs: Sequence[CompressedRun], model: CampaignModel, *, steps: int = 1000, seed: int = 1
) -> Sampled:
    """Draws of the full posterior by four independent ensembles of walkers.

    They begin about Laplace's maximum, in coordinates in which it is a sphere.

    Raises
    ------
    ConfigurationError
        emcee is not installed.
    """
    try:
        import emcee
    except ImportError:
        raise ConfigurationError(
            "the sampler needs emcee: pip install 'optical-pendulum-rig[series]', or leave it out"
        ) from None
    design = design_of(runs, model)
    found = likeliest(design)
    rng = np.random.default_rng(seed)
    size = len(found.h)
    if not size:
        raise ConfigurationError("the sampler explores scatters, and the model has none: leave it out")
    factor = np.linalg.cholesky(found.covariance)

    def log_posterior(at: Floats) -> Floats:
        h = found.h + at @ factor.T
        value = np.full(len(at), -np.inf)
        good = np.all(np.abs(h - found.h) < _LONGEST_LOG_SCATTER, axis=1)
        if np.any(good):
            value[good] = log_marginal(design, h[good], found.w)[0]
        return np.where(np.isfinite(value), value, -np.inf)

    walkers = max(2 * size + 2, 10)
    chains = []
    for _ in range(_CHAINS):
        sampler = emcee.EnsembleSampler(walkers, size, log_posterior, vectorize=True)
        sampler.random_state = np.random.RandomState(int(rng.integers(2**31))).get_state()
        sampler.run_mcmc(rng.standard_normal((walkers, size)), steps, progress=False)
        chains.append(found.h + sampler.get_chain(discard=int(_BURNT * steps)) @ factor.T)
    there = np.array(chains)
    flat = there.reshape(-1, size)
    h = flat[:: max(1, len(flat) // _KEPT)]
    w, weight = weighted_levels(rng, design, h, found.w)
    return Sampled(
        CampaignPosterior(tuple(runs), model, design, h, w, weight, np.nan, np.nan),
        {level: split_r_hat(there[..., place]) for place, level in enumerate(design.hyper)},
        {level: effective_draws(there[..., place]) for place, level in enumerate(design.hyper)},
    )


def split_r_hat(chains: Floats) -> float:
    """R-hat of independent ensembles (chains, steps, walkers), each cut into halves.

    The walkers of an ensemble know of each other: only ensembles and halves are compared.
    """
    half = chains.shape[1] // 2
    parts = np.concatenate([chains[:, :half], chains[:, half : 2 * half]])
    means = parts.mean(axis=(1, 2))
    within = float(np.mean(parts.var(axis=(1, 2))))
    return float(np.sqrt(1 + np.var(means, ddof=1) / within)) if within > 0 else 1.0


def effective_draws(chains: Floats) -> float:
    """Number of independent draws, by the autocorrelation of each walker up to Sokal's window."""
    ensembles, steps, walkers = chains.shape
    series = chains.transpose(0, 2, 1).reshape(-1, steps)
    series = series - chains.mean()
    padded = np.fft.rfft(series, 2 * steps, axis=1)
    power = np.fft.irfft(np.abs(padded) ** 2, axis=1)[:, :steps].mean(axis=0)
    if not power[0] > 0:
        return float(ensembles * steps * walkers)
    times = 2 * np.cumsum(power / power[0]) - 1
    window = np.flatnonzero(np.arange(steps) >= 5 * times)
    time = float(times[window[0]]) if len(window) else float(times[-1])
    return float(ensembles * steps * walkers / max(time, 1.0))


def predictive_check(found: CampaignPosterior, *, seed: int = 1) -> float:
    """Chance that runs made up by the posterior scatter as much about their model as the real ones do.

    Bayes's p by the sum of squares of all runs. Near 0 the model lacks something, near 1 the uncertainties
    are too large.
    """
    rng = np.random.default_rng(seed)
    design = found.design
    which = rng.choice(len(found.h), size=min(400, len(found.h)), p=found.weight)
    # which likelihoods are bad is part of the model: a copy has its own
    kinds = np.exp(design.log_kind)
    more = 0
    for place in which.tolist():
        h, w = found.h[[place]], found.w[[place]]
        variance = np.zeros(design.has.shape[1])
        inside = design.scatter >= 0
        variance[inside] = np.exp(2 * h[0, design.scatter[inside]])
        whole = design.covariance[:, 0] + (variance * design.has)[:, :, None] * np.eye(len(variance))
        off = design.y[:, 0] - design.x @ w[0]
        real = np.einsum("rk,rk->r", off, np.linalg.solve(whole, off[..., None])[..., 0])
        worse = rng.choice(design.worse, size=len(real), p=kinds / kinds.sum())
        copies = worse**2 * rng.chisquare(design.has.sum(axis=1))
        # of each run at most so much: a bad one is named elsewhere
        most = 30.0
        more += bool(np.minimum(copies, most).sum() >= np.minimum(real, most).sum())
    return more / len(which)

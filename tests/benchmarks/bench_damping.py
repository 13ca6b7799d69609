"""Time constants at every amplitude: error over the best possible one, and how often it is covered."""

from typing import Any

import numpy as np

from processing.arrays import Floats
from processing.damping import amplitude_at, fit_damping
from tests.processing.test_damping import KINDS, NOISE, T, true_amplitude


def run(quick: bool = False) -> dict[str, Any]:
    """For each kind of damping 400 decays (`quick`: 40), at five amplitudes."""
    seeds = 40 if quick else 400
    results: dict[str, Any] = {}
    for kind, parts in KINDS.items():
        truth = true_amplitude(parts)
        amplitudes = np.geomspace(1.0, truth[-1], 5)
        rate = parts[0] / amplitudes + parts[1] + parts[2] * amplitudes
        bound_s = _bound_s(parts, amplitudes, rate)
        errors, covered, right, floors = [], [], 0, 0
        wanted = [part > 0 for part in parts]
        for seed in range(seeds):
            noise = NOISE * np.random.default_rng(seed).standard_normal(len(T))
            found = fit_damping(T, truth + noise, np.full(len(T), NOISE), floor=True)
            tau_s, u_tau_s = found.time_constant_s(amplitudes)
            errors.append(tau_s - 1.0 / rate)
            covered.append(np.abs(tau_s - 1.0 / rate) < u_tau_s)
            right += [name in found.needed for name in ("constant", "linear", "quadratic")] == wanted
            floors += bool(np.isfinite(found.floor))
        ratio = np.sqrt(np.mean(np.square(errors), axis=0)) / bound_s
        results[kind] = {
            "bound, % of tau": (100.0 * bound_s * rate).round(3).tolist(),
            "error / bound": ratio.round(3).tolist(),
            "covered, %": (100.0 * np.mean(covered, axis=0)).round(1).tolist(),
            "parts right, %": 100.0 * right / seeds,
            "floors invented": floors,
        }
    return results


def _bound_s(parts: tuple[float, float, float], amplitudes: Floats, rate: Floats) -> Floats:
    """Least standard deviation of tau of any estimator without bias (Cramer and Rao), all parts unknown."""
    at, step = np.array([1.0, *parts]), 1e-6
    ahead, behind = (
        np.array([amplitude_at(T, *(at + moved * way)) for way in np.eye(4)]) for moved in (step, -step)
    )
    slopes = (ahead - behind).T / (2.0 * step * NOISE)
    covariance = np.linalg.inv(slopes.T @ slopes)[1:, 1:]
    powers = np.stack([1.0 / amplitudes, np.ones_like(amplitudes), amplitudes])
    return np.asarray(np.sqrt(np.einsum("ik,ij,jk->k", powers, covariance, powers)) / rate**2)

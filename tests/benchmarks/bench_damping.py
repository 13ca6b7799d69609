"""Time constants at every amplitude: how often they are covered."""

from typing import Any

import numpy as np

from processing.damping import fit_damping
from tests.processing.test_damping import KINDS, NOISE, T, true_amplitude


def run(quick: bool = False) -> dict[str, Any]:
    """For each kind of damping 400 decays (`quick`: 40), at five amplitudes."""
    seeds = 40 if quick else 400
    results: dict[str, Any] = {}
    for kind, parts in KINDS.items():
        truth = true_amplitude(parts)
        amplitudes = np.geomspace(1.0, truth[-1], 5)
        rate = parts[0] / amplitudes + parts[1] + parts[2] * amplitudes
        covered, right = [], 0
        wanted = [part > 0 for part in parts]
        for seed in range(seeds):
            noise = NOISE * np.random.default_rng(seed).standard_normal(len(T))
            found = fit_damping(T, truth + noise, np.full(len(T), NOISE))
            tau_s, u_tau_s = found.time_constant_s(amplitudes)
            covered.append(np.abs(tau_s - 1.0 / rate) < u_tau_s)
            right += [name in found.needed for name in ("constant", "linear", "quadratic")] == wanted
        results[kind] = {
            "covered, %": (100.0 * np.mean(covered, axis=0)).round(1).tolist(),
            "parts right, %": 100.0 * right / seeds,
        }
    return results

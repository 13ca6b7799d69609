"""Bias and coverage of every calibrated quantity, on simulated rigs drawn anew for every seed.

Run as ``python -m tests.benchmarks.bench_calibration [--quick]`` from the repository.
"""

import json
import math
import sys
from typing import Any

import numpy as np

from tests.calibration.simulated_rig import deviations


def run(quick: bool = False) -> dict[str, Any]:
    """Mean and spread of the error in standard uncertainties, share within one; 200 seeds (40 quick)."""
    seeds = 40 if quick else 200
    rows = [deviations(seed) for seed in range(seeds)]
    u_mean, u_inside = 1 / math.sqrt(seeds), math.sqrt(0.6827 * 0.3173 / seeds)
    found: dict[str, Any] = {"seeds": seeds, "u_mean": u_mean, "u_inside": u_inside}
    print(
        f"{'quantity':22} mean error/u  spread/u  within 1 u   "
        f"(u of mean {u_mean:.3f}, of share {u_inside:.3f})"
    )
    for name in rows[0]:
        z = np.array([row[name] for row in rows])
        found[name] = {
            "mean": float(z.mean()),
            "spread": float(z.std(ddof=1)),
            "within_1u": float(np.mean(np.abs(z) < 1)),
            "largest": float(np.abs(z).max()),
        }
        print(f"{name:22} {z.mean():+12.3f} {z.std(ddof=1):9.3f} {np.mean(np.abs(z) < 1):11.3f}")
    return found


if __name__ == "__main__":
    print(json.dumps(run(quick="--quick" in sys.argv), indent=1))

"""Bias and coverage of calibrated quantities on random simulated rigs, and of measurements made with them.

Run as ``python -m tests.benchmarks calibration [--quick]``.
"""

import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from tests.benchmarks.coverage import coverage
from tests.calibration.ladders import LADDERS, pull
from tests.calibration.simulated_rig import deviations
from tests.rig.prepare.calibrated_measurement import measure

FRAME_RATES_HZ = (25.0, 60.0)


def _table(rows: Sequence[Mapping[str, float]]) -> dict[str, Any]:
    """Mean and spread of deviations in standard uncertainties, share within one."""
    found: dict[str, Any] = {"seeds": len(rows)}
    for name in rows[0]:
        z = np.array([row[name] for row in rows])
        found[name] = {
            "mean": float(z.mean()),
            "spread": float(z.std(ddof=1)),
            "within_1u": float(np.mean(np.abs(z) < 1)),
            "largest": float(np.abs(z).max()),
        }
    return found


def end_to_end(rate_hz: float, seeds: int) -> dict[str, Any]:
    """Measurements whose lever, axes and clock come from simulated calibration records alone."""
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        for seed in range(seeds):
            found = measure(seed, Path(folder) / str(seed), rate_hz=rate_hz)
            rows.append({name: (value - truth) / u for name, (value, u, truth) in found.items()})
    return _table(rows)


def measurements(seeds: int) -> dict[str, Any]:
    """Measurements at each frame rate."""
    return {f"{rate:g}": end_to_end(rate, seeds) for rate in FRAME_RATES_HZ}


def ladders(seeds: int) -> dict[str, Any]:
    """Ladders of tilts that something may have bent: coverage of the scale at zero."""
    found = {}
    for name in LADDERS:
        pulls, relative, _ = zip(*(pull(name, seed) for seed in range(seeds)), strict=True)
        z = np.abs(pulls)
        found[name] = {key: of_all[0] for key, of_all in coverage(np.array(pulls)[:, None]).items()}
        found[name] |= {"beyond_3u": float(np.mean(z > 3)), "relative_u": float(np.median(relative))}
    return found


def run(quick: bool = False) -> dict[str, Any]:
    """600 and 200 seeds (40 and 12 quick)."""
    return {
        "quantities": _table([deviations(seed) for seed in range(40 if quick else 600)]),
        "ladders": ladders(40 if quick else 400),
        "end_to_end": measurements(12 if quick else 200),
    }

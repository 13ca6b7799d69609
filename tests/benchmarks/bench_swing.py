"""Swing detector: scatter against the Cramer-Rao bound and the claimed uncertainty.

Run as ``python -m tests.benchmarks swing [--quick]``.
"""

import math
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from tests.processing.swing.truth import Record, damped_sinusoid, detect, errors, rms

FRAMES_PER_S = (30.0, 60.0, 100.0, 200.0, 500.0)
BANDS_PX = ((300.0, 100.0), (100.0, 30.0), (30.0, 10.0), (10.0, 3.0))
HALF_CYCLES = 164


def gathered(runs: int, make: Callable[[np.random.Generator], Record]) -> np.ndarray:
    """Columns: true amplitude, errors over u (A, t), errors over CRLB (A, t)."""
    rows = []
    for number in range(runs):
        record = make(np.random.default_rng([2023, number]))
        e = errors(record, detect(record))
        true = record.turn_amplitude[e.index]
        rows.append(np.column_stack([true, e.amplitude, e.time, e.amplitude_to_crlb, e.time_to_crlb]))
    return np.concatenate(rows)


def figures(rows: np.ndarray) -> dict[str, float]:
    """The numbers of one table row; `scatter` is their statistical error."""
    return {
        "amplitude_rms_over_crlb": rms(rows[:, 3]),
        "time_rms_over_crlb": rms(rows[:, 4]),
        "amplitude_actual_over_claimed": rms(rows[:, 1]),
        "time_actual_over_claimed": rms(rows[:, 2]),
        "swings": len(rows),
        "scatter": 1.0 / math.sqrt(2.0 * len(rows)),
    }


def accuracy(runs: int) -> dict[str, Any]:
    """Damped sinusoid from 300 px to 3 px at each frame rate: whole runs and bands of amplitude."""
    found: dict[str, Any] = {}
    for frames_per_s in FRAMES_PER_S:
        decay = partial(
            damped_sinusoid, first=300.0, last=3.0, half_cycles=HALF_CYCLES, frames_per_s=frames_per_s
        )
        rows = gathered(runs, decay)
        here: dict[str, Any] = {"whole run": figures(rows)}
        for high, low in BANDS_PX:
            band = (rows[:, 0] <= high) & (rows[:, 0] > low)
            here[f"{high:g} to {low:g} px"] = figures(rows[band])
        found[f"{frames_per_s:g} frames/s"] = here
    return found


def run(quick: bool = False) -> dict[str, Any]:
    """Measure everything; `quick` with a tenth of the runs."""
    return {"accuracy": accuracy(4 if quick else 40)}

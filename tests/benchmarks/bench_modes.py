"""False detections of a fast mode: runs of noise about a swing that has none."""

from typing import Any

import numpy as np

from processing.swing import separate_modes

RUNS, LOOKS = 1000, 30
"""Looks of a run that share no samples: a quarter of an hour at six periods each."""
SECONDS, RATE_HZ, NOISE = 24.0, 10.0, 0.02


def shown(run: int) -> bool:
    """Whether a run shows a fast mode in any of its looks."""
    t = np.arange(round(SECONDS * RATE_HZ)) / RATE_HZ
    times_ns = np.round(1e9 * t).astype(np.int64)
    u = np.full(len(t), NOISE)
    rng = np.random.default_rng([run, 77])
    for _ in range(LOOKS):
        x, y = NOISE * rng.standard_normal((2, len(t)))
        y += 20.0 * np.exp(-0.002 * t) * np.cos(1.55 * t + rng.uniform(0.0, 6.3))
        modes = separate_modes(times_ns, x, y, u, u, 2.0 * np.pi / 1.55)
        if modes is not None and modes.fast is not None:
            return True
    return False


def run(quick: bool = False) -> dict[str, Any]:
    """A thousand runs, of which one may show a mode that is not there; 50 if quick."""
    runs = 50 if quick else RUNS
    return {"runs": runs, "false_detections": sum(map(shown, range(runs)))}

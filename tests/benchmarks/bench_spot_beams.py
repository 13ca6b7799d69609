"""Real beams, moved by known amounts with fresh noise: what the tracker finds, and what it claims.

Run as ``python -m tests.benchmarks spot_beams`` from the repository. Needs the folder of real data.
"""

import math
from pathlib import Path
from typing import Any

import numpy as np

from processing.spot import SpotFlag, SpotTracker
from tests.processing.spot.moved_beams import COMPACT, RealBeam
from tests.shared_data import SHARED_DATA

_REACH_PX = 30.0


def beam(path: Path, frames: int) -> dict[str, Any]:
    """One row: a beam that swings while its model is chosen, then appears at any place within the reach."""
    rng = np.random.default_rng(5)
    real = RealBeam(path)
    tracker = SpotTracker(real.sensor)
    chosen_after = 0
    while tracker.model is None:
        phase = 0.06 * chosen_after
        tracker.track(real.frame(_REACH_PX * math.sin(phase), 3.0 * math.cos(0.7 * phase), rng))
        chosen_after += 1
    truth = rng.uniform(-_REACH_PX, _REACH_PX, (frames, 2))
    spots = [tracker.track(real.frame(x, y, rng)) for x, y in truth]
    found = np.array([(spot.x_px, spot.y_px) for spot in spots])
    claimed = np.array([(spot.u_x_px, spot.u_y_px) for spot in spots]).mean(axis=0)
    errors = found - truth
    scatter = errors.std(axis=0, ddof=1)
    bound = real.bound_px()
    return {
        "name": path.name,
        "model": str(tracker.model),
        "chosen_after": chosen_after,
        "frames": frames,
        "poor": sum(bool(spot.flags & SpotFlag.POOR_FIT) for spot in spots),
        "lost": sum(bool(spot.flags & SpotFlag.LOST) for spot in spots),
        "chi2_per_dof": float(np.mean([spot.chi2_per_dof for spot in spots])),
        "scatter_over_u": (scatter / claimed).tolist(),
        "scatter_over_bound": (scatter / bound).tolist(),
        "moved_as": [1.0 + float(np.polyfit(truth[:, k], errors[:, k], 1)[0]) for k in (0, 1)],
    }


def run(quick: bool = False) -> dict[str, Any]:
    """All images of one compact beam."""
    return {"beams": [beam(SHARED_DATA / "beams" / name, 30 if quick else 300) for name in COMPACT]}

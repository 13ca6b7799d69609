"""Spot tracker against the Cramer-Rao bound.

Run as ``python -m tests.benchmarks spot_accuracy [--quick]``.
"""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from processing.spot import SpotTracker
from tests.processing.spot.frames import (
    EIGHT_BIT,
    TWELVE_BIT,
    bound_px,
    errors_px,
    exposed,
    light,
    side_of,
)

Make = Callable[[float, float, np.random.Generator], NDArray[Any]]


def point(
    sigma: float, peak: float, bits: int, frames: int, prnu: float = 0.0, told: bool = False
) -> dict[str, Any]:
    """RMS over the bound, claimed over actual, mean error of one kind of frame.

    The bound is that of such frames, uneven pixels included.
    `told`: the tracker's sensor model has the PRNU.
    """
    sensor, scale = (EIGHT_BIT, 1) if bits == 8 else (TWELVE_BIT, 16)
    rng = np.random.default_rng([int(10 * sigma), int(peak), bits, int(1000 * prnu)])
    n = side_of(sigma)
    truth = n / 2 + rng.uniform(-0.5, 0.5, (frames, 2))
    tracker = SpotTracker(replace(sensor, prnu=prnu) if told else sensor)
    spots = [
        tracker.track(exposed(light((n, n), x, y, sigma, scale * peak), rng, sensor=sensor, prnu=prnu))
        for x, y in truth
    ]
    errors = errors_px(spots, truth)
    claimed = np.array([(spot.u_x_px, spot.u_y_px) for spot in spots])
    rms = math.sqrt(np.mean(errors**2))
    bound = bound_px((n, n), n / 2, n / 2, sigma, scale * peak, sensor, prnu)
    return {
        "sigma_px": sigma,
        "peak_8bit_dn": peak,
        "bits": bits,
        "prnu": prnu,
        "rms_over_bound": rms / bound,
        "claimed_over_actual": 1.0 / math.sqrt(np.mean((errors / claimed) ** 2)),
        "bias_mpx": 1e3 * float(errors.mean()),
    }


def points_told(frames: int) -> list[dict[str, Any]]:
    """Of these the tracker's sensor model knows all; what it does not know its uncertainties cannot hold."""
    points = [
        point(sigma, peak, bits, frames) for bits in (8, 12) for sigma in (3, 6, 12) for peak in (20, 80, 200)
    ]
    return points + [point(6, peak, 8, frames, prnu=0.01, told=True) for peak in (20, 80, 200)]


def run(quick: bool = False) -> dict[str, Any]:
    """All points; numbers as plain values."""
    return {"points": points_told(400 if quick else 10_000)}

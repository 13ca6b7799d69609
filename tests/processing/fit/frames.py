"""Paths as a camera's frames show them, and what the detector makes of them as a whole."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from processing.deflections import Deflections, slow_deflections
from processing.swing import (
    HarmonicsMeasurement,
    PieceHarmonics,
    TurningPoints,
    half_cycles_of_blocks,
    turning_points,
)
from tests.processing.fit.decays import ARCSEC
from tests.processing.fit.driven import driven_path


def seen_in_frames(
    path_rad: NDArray[np.float64], noise_rad: float, seed: int | list[int], frames_per_s: float = 25.0
) -> Deflections:
    """A path, one position a frame, with noise, whose size is stated."""
    times_ns = np.rint(np.arange(len(path_rad)) * 1e9 / frames_per_s).astype(np.int64)
    noise = noise_rad * np.random.default_rng(seed).standard_normal(len(path_rad))
    return slow_deflections(times_ns, path_rad + noise, noise_rad)


def points_and_harmonics(samples: Deflections) -> tuple[TurningPoints, PieceHarmonics]:
    """Turning points of the detector, and the waveform between them."""
    half_cycles = half_cycles_of_blocks([samples])
    watch = HarmonicsMeasurement(half_cycles)
    watch.update(samples)
    return turning_points(half_cycles), watch.harmonics()


def seen_decay(
    *contact: Any, noise_seed: int | list[int], noise_rad: float = 0.005 * ARCSEC, **path: Any
) -> tuple[TurningPoints, PieceHarmonics]:
    """Turning points and waveform of `driven_path` (its arguments) in 25 frames a second."""
    path_rad = driven_path(*contact, frames_per_s=25.0, **path)[2]
    return points_and_harmonics(seen_in_frames(path_rad, noise_rad, noise_seed))

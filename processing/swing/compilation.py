"""Compiles the kernels before a measurement begins."""

import numpy as np

from processing.swing.detector import swings_of
from processing.swing.modes import separate_modes
from processing.ticks import nanoseconds

_FRAMES_PER_S, _SECONDS, _RATE, _LOSS = 20.0, 60.0, 1.5, 0.01


def compile_kernels() -> None:
    """Run every compiled kernel of this package once, so that numba compiles it or loads it from its cache.

    This takes about 10 s on the first run after an installation and a few tenths of a second later. Call
    it before a measurement: compilation during the first swing would block the processing of samples.
    """
    time_s = np.arange(0.0, _SECONDS, 1.0 / _FRAMES_PER_S)
    phase = _RATE * time_s
    # dry friction: in each half-cycle the motion is a cosine about a displaced centre, so that the amplitude
    # falls by a constant step; this makes the detector use the anharmonic terms as well
    halves = np.floor(phase / np.pi)
    centre = _LOSS * np.where(halves % 2 == 0, -1.0, 1.0)
    deflection = (1.0 - 2.0 * _LOSS * halves - _LOSS) * np.cos(phase) + centre
    times_ns = nanoseconds(time_s)
    u = np.full(len(time_s), 1e-5)
    swings_of(times_ns, deflection, u)
    separate_modes(times_ns[:200], 0.1 * np.cos(5.0 * phase[:200]), deflection[:200], u[:200], u[:200])

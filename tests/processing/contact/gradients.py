"""Gradients of a law's turning points against differences."""

import numpy as np
from numpy.typing import NDArray

from processing.contact import Law


def assert_gradients(
    law: Law,
    at: NDArray[np.float64],
    index: NDArray[np.int64],
    steps: NDArray[np.float64],
    *,
    rtol: float,
    atol: float = 0.0,
    of_largest: float = 2e-4,
) -> None:
    """Those with respect to the map's parameters at `at` whose step is not 0."""
    found = law.turning_points(at, index)
    assert np.all(np.isfinite(found.time))
    for place in np.flatnonzero(steps):
        step = np.where(np.arange(len(at)) == place, steps, 0.0)
        high, low = law.turning_points(at + step, index), law.turning_points(at - step, index)
        for gradient, above, below in (
            (found.amplitude_gradient, high.amplitude, low.amplitude),
            (found.time_gradient, high.time, low.time),
        ):
            numeric = (above - below) / (2 * steps[place])
            floor = atol + of_largest * np.abs(numeric).max()
            np.testing.assert_allclose(gradient[:, place], numeric, rtol=rtol, atol=floor)

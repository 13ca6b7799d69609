"""Names for what the fitting kernels share: parameters, working arrays, windows, and the result of a fit."""

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

Floats = NDArray[np.float64]

AMPLITUDE, X, Y, SIGMA_X, SIGMA_Y, BACKGROUND, COVARIANCE, SECOND_AMPLITUDE, SECOND_X, SECOND_Y = range(10)
"""Places of the fitted parameters, px and DN.

The spot's covariance matrix is [[sigma_x^2, c], [c, sigma_y^2]] with c in `COVARIANCE`, so that
`SIGMA_X` and `SIGMA_Y` are the standard deviations along the pixel axes, also of a tilted spot. A
second spot has the same shape as the first.
"""

PARAMETERS = 10
UPRIGHT = 6
"""Number of parameters of one upright spot: the first six."""
TILTED = 7
"""Number of parameters of one tilted spot: the first seven."""

GATE = 25.0
"""Squared residual, in variances of the pixel, above which a pixel counts as an outlier."""

REACH = 4.5
"""Half-width of the fitted window in standard deviations of the spot."""


class Window(NamedTuple):
    """Pixels x0 <= x < x1, y0 <= y < y1 of an image."""

    x0: int
    y0: int
    x1: int
    y1: int


class Place(NamedTuple):
    """Where an image lies on the sensor: the sensor coordinates of its first pixel, the sensor's size."""

    origin_x: int
    origin_y: int
    sensor_nx: int
    sensor_ny: int


class Workspace(NamedTuple):
    """Arrays that a fit works in."""

    parameters: Floats
    """(PARAMETERS,) improved in place."""
    information: Floats
    """(PARAMETERS, PARAMETERS) Fisher information at the last step."""
    factor: Floats
    """(PARAMETERS, PARAMETERS) its lower Cholesky factor."""


class Fitted(NamedTuple):
    """How a fit ended; the parameters themselves are in the workspace."""

    done: bool
    """False: it did not converge, or this kind of fit does not suit the spot."""
    chi2: float
    pixels: int
    """Pixels that were kept."""
    saturated: int
    """Pixels left out because the model expects them at full scale."""
    outliers: int
    """Pixels left out because of their residual."""
    size: int
    """Order of the information matrix: UPRIGHT or PARAMETERS."""
    tilted: bool
    two: bool
    """Whether the covariance, and a second spot, were fitted."""


WORKSPACE_SHAPE = (1 + 2 * PARAMETERS, PARAMETERS)


@njit(cache=True, nogil=True, error_model="numpy")
def workspace_of(array: Floats) -> Workspace:
    """`Workspace` in an array of WORKSPACE_SHAPE.

    It comes from Python as one array because every argument costs time in the call.
    """
    return Workspace(array[0], array[1 : 1 + PARAMETERS], array[1 + PARAMETERS : 1 + 2 * PARAMETERS])


@njit(cache=True, nogil=True, error_model="numpy")
def as_kind(fitted: Fitted, size: int, tilted: bool, two: bool) -> Fitted:
    """The same result under another kind of spot."""
    return Fitted(
        fitted.done, fitted.chi2, fitted.pixels, fitted.saturated, fitted.outliers, size, tilted, two
    )

"""Data shared by the fitting kernels: parameter indices, working arrays, windows and the result of a fit."""

import math
from typing import NamedTuple

from processing.arrays import Floats
from processing.kernel import kernel

AMPLITUDE, X, Y, SIGMA_X, SIGMA_Y, BACKGROUND, COVARIANCE, SECOND_AMPLITUDE, SECOND_X, SECOND_Y = range(10)
"""Indices of the fitted parameters; positions and sigmas in px, amplitudes and background in DN.

The covariance matrix of the spot's light distribution is [[sigma_x^2, c], [c, sigma_y^2]], with c (px^2) at
the index `COVARIANCE`. `SIGMA_X` and `SIGMA_Y` are therefore the standard deviations along the pixel
axes even when the spot is tilted. A second spot is given the same shape as the first.
"""

PARAMETERS = 10
UPRIGHT = 6
"""Number of parameters of one upright spot: the first six."""
TILTED = 7
"""Number of parameters of one tilted spot: the first seven."""

GATE = 25.0
"""A pixel is an outlier if its squared residual exceeds this many times its variance."""

REACH = 4.5
"""Half-width of the fitted window in standard deviations of the spot."""


class Window(NamedTuple):
    """Pixels x0 <= x < x1, y0 <= y < y1 of an image."""

    x0: int
    y0: int
    x1: int
    y1: int


class Place(NamedTuple):
    """Position of an image on the sensor: sensor coordinates of its first pixel, and the sensor's size."""

    origin_x: int
    origin_y: int
    sensor_nx: int
    sensor_ny: int


class HalfPlane(NamedTuple):
    """Pixels (i, j) with ``along_x i + along_y j > distance``: those that an obstacle hides."""

    along_x: float
    along_y: float
    distance: float


class Workspace(NamedTuple):
    """Parameters and working arrays of a fit."""

    parameters: Floats
    """(PARAMETERS,) fitted parameters; the fit updates them in place."""
    information: Floats
    """(PARAMETERS, PARAMETERS) Fisher information at the last step."""
    factor: Floats
    """(PARAMETERS, PARAMETERS) its lower Cholesky factor."""


class Fitted(NamedTuple):
    """Result of a fit; the parameters themselves are in the workspace."""

    done: bool
    """False if the fit did not converge or this kind of fit does not suit the spot."""
    chi2: float
    pixels: int
    """Number of pixels used."""
    saturated: int
    """Number of pixels left out because the model expects them at full scale."""
    outliers: int
    """Number of pixels left out because of their residual."""
    size: int
    """Order of the information matrix: UPRIGHT or PARAMETERS."""
    tilted: bool
    two: bool
    """`tilted`: the covariance was fitted. `two`: a second spot was fitted."""


WORKSPACE_SHAPE = (1 + 2 * PARAMETERS, PARAMETERS)


@kernel
def nothing_hidden() -> HalfPlane:
    """A half-plane without pixels."""
    return HalfPlane(0.0, 0.0, math.inf)


@kernel
def workspace_of(array: Floats) -> Workspace:
    """`Workspace` made of views of an array of WORKSPACE_SHAPE.

    Python passes one array because every argument of a compiled function adds to the time of the call.
    """
    return Workspace(array[0], array[1 : 1 + PARAMETERS], array[1 + PARAMETERS : 1 + 2 * PARAMETERS])


@kernel
def misfit_limit(pixels: float) -> float:
    """Chi-square per degree of freedom above which so many pixels show that a Gaussian is not all.

    Chi-square of n pixels has the standard deviation sqrt(2 n). A further 5 % is allowed for a beam that is
    not exactly Gaussian.
    """
    return 1.05 + 6.0 * math.sqrt(2.0 / max(pixels, 1.0))


@kernel
def poor_fit_limit(pixels: float) -> float:
    """Chi-square per degree of freedom above which a model does not fit so many pixels (flag POOR_FIT)."""
    return 1.3 + 6.0 * math.sqrt(2.0 / max(pixels, 1.0))


@kernel
def as_kind(fitted: Fitted, size: int, tilted: bool, two: bool) -> Fitted:
    """The same result with `size`, `tilted` and `two` replaced."""
    return Fitted(
        fitted.done, fitted.chi2, fitted.pixels, fitted.saturated, fitted.outliers, size, tilted, two
    )

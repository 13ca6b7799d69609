"""Values that fitting kernels share: parameters, windows, results, memory between frames, small matrices."""

import math
from enum import IntFlag
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

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


class Placement(NamedTuple):
    """Sensor coordinates of an image's first pixel, and the sensor's size."""

    origin_x: int
    origin_y: int
    sensor_nx: int
    sensor_ny: int


class HalfPlane(NamedTuple):
    """Half-plane of pixels (i, j) that an obstacle hides: ``normal_x i + normal_y j > distance``.

    (`normal_x`, `normal_y`) is the unit vector across the edge, from light to darkness.
    """

    normal_x: float
    normal_y: float
    distance: float


class Workspace(NamedTuple):
    """Parameters and working arrays of a fit."""

    parameters: Floats
    """(PARAMETERS,) fitted parameters; the fit updates them in place."""
    information: Floats
    """(PARAMETERS, PARAMETERS) Fisher information at the last step."""
    factor: Floats
    """(PARAMETERS, PARAMETERS) lower Cholesky factor of the information."""


class SpotFit(NamedTuple):
    """Result of a fit; the parameters themselves are in the workspace."""

    converged: bool
    """False if the fit did not converge or its model does not suit the spot."""
    chi2: float
    pixels: int
    """Number of pixels used."""
    saturated: int
    """Number of pixels left out because the model expects them at full scale."""
    outliers: int
    """Number of pixels left out because of their residual."""
    size: int
    """Order of the information matrix: UPRIGHT, TILTED or PARAMETERS."""
    tilted: bool
    """Whether the covariance was fitted."""
    has_second: bool
    """Whether a second spot was fitted."""


WORKSPACE_SHAPE = (1 + 2 * PARAMETERS, PARAMETERS)


@kernel
def nothing_hidden() -> HalfPlane:
    """A half-plane without pixels."""
    return HalfPlane(0.0, 0.0, math.inf)


@kernel
def workspace_of(array: Floats) -> Workspace:
    """`Workspace` of views of an array of WORKSPACE_SHAPE.

    Python passes one array because every argument of a compiled function adds to the time of the call.
    """
    return Workspace(array[0], array[1 : 1 + PARAMETERS], array[1 + PARAMETERS : 1 + 2 * PARAMETERS])


@kernel
def chi2_limit(pixels: float) -> float:
    """Chi-square per degree of freedom of `pixels` pixels above which a beam is not one Gaussian.

    Chi-square of n pixels has the standard deviation sqrt(2 n). A further 5 % is allowed for a beam that is
    not exactly Gaussian.
    """
    return 1.05 + 6.0 * math.sqrt(2.0 / max(pixels, 1.0))


@kernel
def poor_fit_limit(pixels: float) -> float:
    """Chi-square per degree of freedom of `pixels` pixels above which a fit has the flag POOR_FIT."""
    return 1.3 + 6.0 * math.sqrt(2.0 / max(pixels, 1.0))


@kernel
def as_kind(fit: SpotFit, size: int, tilted: bool, has_second: bool) -> SpotFit:
    """Copy of a result with the last three fields replaced."""
    return SpotFit(fit.converged, fit.chi2, fit.pixels, fit.saturated, fit.outliers, size, tilted, has_second)


HAS_LAST_SPOT = 0
"""Index of the first entry of a tracker's memory: 1.0 while a spot is being followed, else 0.0.

The names below are indices of further entries, which a search sets before they are read.
"""
LAST = 1
"""First of the PARAMETERS of the last frame's spot; positions are in sensor coordinates."""
DISPLACEMENT_X, DISPLACEMENT_Y = LAST + PARAMETERS, LAST + PARAMETERS + 1
"""Displacement of the spot between the last two frames, px."""
IS_TILTED, HAS_SECOND = LAST + PARAMETERS + 2, LAST + PARAMETERS + 3
"""1.0 if the last spot was fitted as tilted; 1.0 if it was fitted with a second spot."""
TILT_HINTS = LAST + PARAMETERS + 4
"""Number of consecutive frames in which the upright fit found a significant tilt."""
SINGLE_ONLY = LAST + PARAMETERS + 5
"""1.0 if a search does not look for a second spot."""
POOR_FRAMES = LAST + PARAMETERS + 6
"""Number of consecutive frames with the flag POOR_FIT."""
_SIZE = LAST + PARAMETERS + 7


def empty_memory() -> Floats:
    """Memory before the first frame."""
    return np.zeros(_SIZE)


@kernel
def expect(memory: Floats, placement: Placement, p: Floats) -> None:
    """Write the last spot's parameters into `p`, displaced once more by its last displacement.

    Positions in `p` are relative to the image's first pixel.
    """
    for k in range(PARAMETERS):
        p[k] = memory[LAST + k]
    p[X] += memory[DISPLACEMENT_X] - placement.origin_x
    p[Y] += memory[DISPLACEMENT_Y] - placement.origin_y
    p[SECOND_X] += memory[DISPLACEMENT_X] - placement.origin_x
    p[SECOND_Y] += memory[DISPLACEMENT_Y] - placement.origin_y


@kernel
def remember(memory: Floats, placement: Placement, p: Floats, fit: SpotFit, followed: bool) -> None:
    """Store the fitted spot. After a search the displacement is unknown and is set to zero."""
    x = p[X] + placement.origin_x
    y = p[Y] + placement.origin_y
    if followed:
        memory[DISPLACEMENT_X] = x - memory[LAST + X]
        memory[DISPLACEMENT_Y] = y - memory[LAST + Y]
    else:
        memory[DISPLACEMENT_X] = 0.0
        memory[DISPLACEMENT_Y] = 0.0
    for k in range(PARAMETERS):
        memory[LAST + k] = p[k]
    memory[LAST + X] = x
    memory[LAST + Y] = y
    memory[LAST + SECOND_X] = p[SECOND_X] + placement.origin_x
    memory[LAST + SECOND_Y] = p[SECOND_Y] + placement.origin_y
    memory[HAS_LAST_SPOT] = 1.0
    memory[IS_TILTED] = 1.0 if fit.tilted else 0.0
    memory[HAS_SECOND] = 1.0 if fit.has_second else 0.0


@kernel
def cholesky(matrix: Floats, size: int, factor: Floats) -> bool:
    """Lower factor L, L L^T = matrix, of the first `size` rows; False if it is not positive definite."""
    for k in range(size):
        for m in range(k + 1):
            total = matrix[k, m]
            for n in range(m):
                total -= factor[k, n] * factor[m, n]
            if k == m:
                if not total > 1e-14 * matrix[k, k]:
                    return False
                factor[k, k] = math.sqrt(total)
            else:
                factor[k, m] = total / factor[m, m]
    return True


@kernel
def solve(factor: Floats, size: int, right: Floats, solution: Floats) -> None:
    """Solution of (L L^T) x = right: forward, then backward substitution."""
    for k in range(size):
        total = right[k]
        for n in range(k):
            total -= factor[k, n] * solution[n]
        solution[k] = total / factor[k, k]
    for k in range(size - 1, -1, -1):
        total = solution[k]
        for n in range(k + 1, size):
            total -= factor[n, k] * solution[n]
        solution[k] = total / factor[k, k]


@kernel
def inverse_diagonal(factor: Floats, size: int, index: int) -> float:
    """Element (index, index) of the inverse matrix: the squared norm of column `index` of L^-1."""
    column = np.zeros(size)
    total = 0.0
    for k in range(index, size):
        value = 1.0 if k == index else 0.0
        for n in range(index, k):
            value -= factor[k, n] * column[n]
        column[k] = value / factor[k, k]
        total += column[k] * column[k]
    return total


Image = NDArray[np.uint8] | NDArray[np.uint16]
"""Pixel values in DN, shape (ny, nx)."""


class SpotFlag(IntFlag):
    """Problems found with a spot, or a model other than one Gaussian, one bit each; 0 if there are none."""

    SATURATED = 1
    """Pixels are at full scale. Those that the model expects at full scale were left out."""
    EDGE = 2
    """The spot is cut by the edge of the sensor."""
    LOST = 4
    """No spot: position and uncertainties are NaN."""
    LOW_SNR = 8
    """The amplitude is less than about five times the noise of one pixel."""
    POOR_FIT = 16
    """The residuals are larger than the noise: the model does not describe the beam."""
    OUTLIERS = 32
    """Single pixels (hot pixels, cosmic rays) were left out because of their residuals."""
    MULTIPLE = 64
    """A second spot overlaps the first; the brighter one is reported."""
    LEARNED = 128
    """The beam's own profile, learned from earlier frames, was fitted, with a plane as the background."""
    CUT = 256
    """An obstacle hides a part of the spot; the rest of it was fitted."""


class Spot(NamedTuple):
    """Spot of one frame; if it is lost, every field but `flags` is NaN.

    The centre of pixel (0, 0) is at (0.0, 0.0); x points right, y down.
    """

    x_px: float
    y_px: float
    u_x_px: float
    u_y_px: float
    """Standard uncertainties: square roots of the diagonal of the inverse Fisher information, multiplied by
    sqrt(max(1, chi2_per_dof)). If the residuals have a shape (the beam is not Gaussian), the variance of
    their scatter from pixel to pixel replaces chi2_per_dof. If the width of the spot has changed, the shift
    that the cause of the change may have made is added."""
    sigma_x_px: float
    """Standard deviation of the light along the first principal axis; with the flag LEARNED that of the
    Gaussian that fits the beam best."""
    sigma_y_px: float
    """The same along the second principal axis."""
    rotation_rad: float
    """Angle of the first principal axis, from x towards y."""
    amplitude_dn: float
    background_dn: float
    chi2_per_dof: float
    flags: int
    """A `SpotFlag`."""


SPOT_DTYPE = np.dtype([(name, np.float64) for name in Spot._fields[:-1]] + [("flags", np.int64)])
"""Row of a table of spots, with the fields of `Spot`."""

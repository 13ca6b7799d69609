"""The laser spot in one frame: position, size, uncertainties, flags."""

from enum import IntFlag
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.uint8] | NDArray[np.uint16]
"""Pixel values in DN, shape (ny, nx)."""


class SpotFlag(IntFlag):
    """Problems found with a spot, or a model other than one Gaussian, one bit each; 0 if there are none."""

    SATURATED = 1
    """Pixels are at full scale; where the model expects them there, they were left out."""
    EDGE = 2
    """The spot is cut by the edge of the sensor."""
    LOST = 4
    """No spot: position and uncertainties are NaN."""
    LOW_SNR = 8
    """The amplitude is less than about five times the noise of one pixel."""
    POOR_FIT = 16
    """The residuals are larger than the noise: the beam is not what the model says."""
    OUTLIERS = 32
    """Single pixels (hot pixels, cosmic rays) were left out because of their residuals."""
    MULTIPLE = 64
    """A second spot overlaps the first; the brighter one is reported."""
    LEARNED = 128
    """Fitted with the beam's own profile, learned from frames before, and a background that is a plane."""
    CUT = 256
    """An obstacle hides a part of the spot: what it leaves was fitted."""


class Spot(NamedTuple):
    """Spot of one frame. The centre of pixel (0, 0) is at (0.0, 0.0); x points right, y down.

    `u_x_px` and `u_y_px` are standard uncertainties: square roots of the diagonal of the inverse Fisher
    information, times sqrt(max(1, chi2_per_dof)). Where the residuals have a shape (a beam that is no
    Gaussian), their scatter from pixel to pixel stands for chi2_per_dof; where the spot is wider or narrower
    than it was at first, what that may have done to its place is added.

    `sigma_x_px` is the standard deviation of the light along the principal axis at the angle `rotation_rad`
    from x towards y, `sigma_y_px` that along the other; with the flag LEARNED they are those of the Gaussian
    that fits the beam best. If the spot is lost, every field but `flags` is NaN.
    """

    x_px: float
    y_px: float
    u_x_px: float
    u_y_px: float
    sigma_x_px: float
    sigma_y_px: float
    rotation_rad: float
    amplitude_dn: float
    background_dn: float
    chi2_per_dof: float
    flags: int


SPOT_DTYPE = np.dtype([(name, np.float64) for name in Spot._fields[:-1]] + [("flags", np.int64)])
"""Row of a table of spots, with the fields of `Spot`."""

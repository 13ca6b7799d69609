"""The laser spot in one frame: position, size, uncertainties, flags."""

from enum import IntFlag
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.uint8] | NDArray[np.uint16]
"""Pixels (ny, nx)."""


class SpotFlag(IntFlag):
    """What was found wrong with a spot; 0 where nothing was."""

    SATURATED = 1
    """Pixels that the model expects at full scale were left out."""
    EDGE = 2
    """The spot is cut by the edge of the sensor."""
    LOST = 4
    """No spot: position and uncertainties are NaN."""
    LOW_SNR = 8
    """The amplitude is less than about five times the noise of one pixel."""
    POOR_FIT = 16
    """The residuals are larger than noise explains: the beam is not the model's."""
    OUTLIERS = 32
    """Single pixels (hot, cosmic) were gated out."""
    MULTIPLE = 64
    """A second spot overlaps or competes; the brighter one is reported."""


class Spot(NamedTuple):
    """Spot of one frame. Pixel (0, 0) has its centre at (0.0, 0.0); x to the right, y down.

    `u_x_px` and `u_y_px` are standard uncertainties: the inverse Fisher matrix's diagonal, times
    sqrt(max(1, chi2_per_dof)). `sigma_x_px` is the standard deviation along the axis that lies at
    `rotation_rad` from x towards y. A lost spot has NaN everywhere but in `flags`.
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
"""One row of a table of spots: the fields of `Spot`."""

"""Check that the pendulum is at rest, for calibrations that require it."""

import numpy as np
from numpy.typing import NDArray

from calibration.oscillation import strongest_oscillation
from processing.errors import DataError

_VISIBLE_PX = 0.05
"""Smallest amplitude of a swing that is rejected; the limits below must be exceeded too."""
_TIMES_NOISE = 3.0
"""Smallest amplitude relative to the standard deviation of the residuals."""


def require_rest(
    times_s: NDArray[np.float64], x_px: NDArray[np.float64], y_px: NDArray[np.float64], what: str
) -> None:
    """Check that the pendulum does not swing in a record.

    It swings if, after subtraction of a straight line, a sinusoid with a period above 0.2 s explains more
    than half of the variance of a coordinate, with an amplitude above 0.05 px and above three times the
    standard deviation of the residuals.

    Parameters
    ----------
    times_s : (n,), s, ascending
    x_px, y_px : (n,), px
        Positions of the spot; no NaN.
    what
        The record as it is named at the beginning of the message.

    Raises
    ------
    DataError
        The pendulum swings.
    """
    for name, values in (("x", x_px), ("y", y_px)):
        line = np.polyval(np.polyfit(times_s - times_s[0], values, 1), times_s - times_s[0])
        flat = values - line
        fit = strongest_oscillation(times_s, flat, float(times_s[-1] - times_s[0]))
        loud = fit.amplitude > max(_VISIBLE_PX, _TIMES_NOISE * fit.noise)
        if loud and fit.explained > 0.5 and fit.period_s > 0.2:
            raise DataError(
                f"{what}: the pendulum swings by {fit.amplitude:.3g} px in {name} with a period of "
                f"{fit.period_s:.3g} s where it should rest; clamp it or let it come to rest"
            )

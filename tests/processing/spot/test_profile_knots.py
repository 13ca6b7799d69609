"""Coefficients of a learned profile, for spots of every size."""

import numpy as np
import pytest

from processing.spot.fit_values import REACH
from processing.spot.profile import MARGIN_PX, _to_spline


@pytest.mark.parametrize("sigma_px", [2.0, 7.9, 8.1, *np.linspace(8.2, 9.6, 57), 8.47542047015753, 20.0])
def test_the_spline_of_a_spot_is_the_spot(sigma_px: float) -> None:
    """Also where two knots lie between the same grid points, as for 8.4754 px."""
    half = int(np.ceil(REACH * sigma_px)) + MARGIN_PX
    grid = np.arange(-half, half + 1, dtype=np.float64)
    spot = np.exp(-0.5 * (grid / sigma_px) ** 2)
    coefficients = _to_spline(len(grid), sigma_px) @ spot
    again = (np.roll(coefficients, 1) + 4.0 * coefficients + np.roll(coefficients, -1)) / 6.0
    assert again[1:-1] == pytest.approx(spot[1:-1], abs=2e-5)

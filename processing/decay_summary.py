"""Mean period and mean logarithmic decrement of a decay, for any kind of pendulum."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from processing.errors import DataError
from processing.swing import TurningPoints

_FEWEST = 4


@dataclass(frozen=True, slots=True)
class DecaySummary:
    """Means over a decay with standard uncertainties.

    `period_s` is twice the slope of turning time against half-cycle, `decrement` the logarithmic decrement of
    a full period, from the slope of ln(amplitude). Both uncertainties are multiplied by
    sqrt(max(1, chi2/dof)), which enlarges them if period or decrement change with the amplitude.
    """

    half_cycles: int
    initial_amplitude: float
    final_amplitude: float
    period_s: float
    u_period_s: float
    period_chi2_per_dof: float
    decrement: float
    u_decrement: float
    decrement_chi2_per_dof: float


def summarise_decay(points: TurningPoints) -> DecaySummary:
    """Weighted straight lines through turning times and ln(amplitude) against the half-cycle's index.

    Raises DataError for fewer than four turning points.
    """
    if len(points) < _FEWEST:
        raise DataError(
            f"{len(points)} usable half-cycles, at least {_FEWEST} are needed for a period and a decrement"
        )
    half_s, u_half_s, period_chi2 = _slope(points.index, points.time_s, points.u_time_s)
    slope, u_slope, decrement_chi2 = _slope(
        points.index, np.log(points.amplitude), points.u_amplitude / points.amplitude
    )
    return DecaySummary(
        half_cycles=len(points),
        initial_amplitude=float(points.amplitude[0]),
        final_amplitude=float(points.amplitude[-1]),
        period_s=2.0 * half_s,
        u_period_s=2.0 * u_half_s,
        period_chi2_per_dof=period_chi2,
        decrement=-2.0 * slope,
        u_decrement=2.0 * u_slope,
        decrement_chi2_per_dof=decrement_chi2,
    )


def _slope(
    index: NDArray[np.int64], values: NDArray[np.float64], u_values: NDArray[np.float64]
) -> tuple[float, float, float]:
    """Slope of a weighted straight line, its standard uncertainty, and chi2 per degree of freedom."""
    x = index.astype(np.float64)
    weight = 1.0 / u_values**2
    mean_x = np.average(x, weights=weight)
    mean_y = np.average(values, weights=weight)
    spread = float(np.sum(weight * (x - mean_x) ** 2))
    slope = float(np.sum(weight * (x - mean_x) * (values - mean_y))) / spread
    residual = (values - mean_y - slope * (x - mean_x)) / u_values
    chi2_per_dof = float(residual @ residual) / (len(x) - 2)
    return slope, float(np.sqrt(max(1.0, chi2_per_dof) / spread)), chi2_per_dof

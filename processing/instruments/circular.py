"""Dependence of the period on the amplitude, compared with the circular error of the ideal pendulum.

The turning times, whose errors are independent, are fitted by sums of half periods:

    t_k = t_0 + (T0/2) sum over the half-cycles before k of [1 + f (T_ideal(A)/T0 - 1)]

with A^2 the mean square of the amplitudes at both ends and T_ideal = T0 (2/pi) K(sin A/2), about T0 (1 +
A^2/16). f = 1 is the ideal pendulum; f > 1 is Mendeleev's observation that the period decreases faster with
decreasing amplitude.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from processing.arrays import Floats
from processing.decay_summary import full_periods
from processing.errors import DataError
from processing.estimate import Estimate
from processing.swing import TurningPoints

_FEWEST = 8


_TELLING = 0.5
"""Standard uncertainty of the factor above which 1 cannot be told from 0."""


class CircularError(NamedTuple):
    """Result of the fit, and the measured periods with those of the ideal pendulum of the same T0.

    `factor` is f. `sentence` states whether it differs from 1 by more than two standard uncertainties, where
    these tell 1 from 0. The arrays have one entry per full period: amplitude, period, its uncertainty, ideal
    period, and its approximation with alpha^2/16.
    """

    period0_s: Estimate
    factor: Estimate
    chi2_per_dof: float
    amplitude_rad: Floats
    period_s: Floats
    u_period_s: Floats
    law_s: Floats
    sixteenth_s: Floats

    @property
    def sentence(self) -> str:
        """Comparison of the factor with 1, in words."""
        f, u = self.factor
        if abs(f - 1) <= 2 * u and u > _TELLING:
            return (
                "the swings are too small, or too few, to show the circular error: "
                f"{f:.4g} ± {u:.2g} times alpha^2/16"
            )
        if abs(f - 1) <= 2 * u:
            return f"the period follows the circular-error law: {f:.4g} ± {u:.2g} times alpha^2/16"
        faster = "faster" if f > 1 else "more slowly"
        return (
            f"the period falls with the amplitude {faster} than the circular-error law: "
            f"{f:.4g} ± {u:.2g} times alpha^2/16"
        )


def ideal_excess(amplitude_rad: ArrayLike) -> Floats:
    """T(A)/T0 - 1 of the ideal pendulum, exact: (2/pi) K(sin A/2) - 1; amplitudes of any shape."""
    from scipy.special import ellipkm1

    cosine = np.cos(0.5 * np.asarray(amplitude_rad, dtype=np.float64))
    excess: Floats = 2 / math.pi * ellipkm1(cosine**2) - 1
    return excess


def circular_error(points: TurningPoints) -> CircularError:
    """Fit T0 and the factor of the circular error to all turning times.

    Amplitudes of missing turning points are interpolated. Raises DataError for fewer than eight turning
    points, or if all amplitudes are equal.
    """
    if len(points) < _FEWEST:
        raise DataError(
            f"{len(points)} usable turning points, at least {_FEWEST} are needed for the law of the period"
        )
    index = np.arange(points.index[0], points.index[-1] + 1)
    amplitude = np.exp(np.interp(index, points.index, np.log(points.amplitude)))
    square = 0.5 * (amplitude[1:] ** 2 + amplitude[:-1] ** 2)
    summed = np.concatenate(([0.0], np.cumsum(ideal_excess(np.sqrt(square)))))
    where = points.index - points.index[0]
    design = np.column_stack([np.ones(len(where)), where.astype(np.float64), summed[where]])
    weighted = design / points.u_time_s[:, np.newaxis]
    scale = np.linalg.norm(weighted, axis=0)
    if not scale[2] > 0 or np.linalg.cond(weighted / scale) > 1e7:
        raise DataError("the amplitudes are too much alike to tell how the period depends on them")
    solution, _, _, _ = np.linalg.lstsq(weighted / scale, points.time_s / points.u_time_s, rcond=None)
    residual = points.time_s / points.u_time_s - weighted / scale @ solution
    chi2_per_dof = float(residual @ residual) / (len(points) - 3)
    covariance = np.linalg.inv((weighted / scale).T @ (weighted / scale)) * max(1.0, chi2_per_dof)
    covariance /= np.outer(scale, scale)
    values = solution / scale
    half_s, slope_s = float(values[1]), float(values[2])
    by = np.array([0.0, -slope_s / half_s**2, 1 / half_s])
    factor = Estimate(slope_s / half_s, float(np.sqrt(by @ covariance @ by)))
    period0 = Estimate(2 * half_s, 2 * math.sqrt(covariance[1, 1]))
    periods = full_periods(points)
    at = points.amplitude[periods.where]
    return CircularError(
        period0,
        factor,
        chi2_per_dof,
        at,
        periods.period_s,
        periods.u_period_s,
        period0.value * (1 + ideal_excess(at)),
        period0.value * (1 + at**2 / 16),
    )

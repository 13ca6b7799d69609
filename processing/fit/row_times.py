"""An unstated rolling shutter, by the swing's second harmonic and by turning times that alternate.

Rows that are exposed in turn delay a spot by its place. Turning points lie on rows above and below that of
rest, so their times alternate by an amount that is proportional to the amplitude; nothing that the pendulum
does alternates so. What is found is taken off the times: the parameters are then those of a stated shutter.
Where the half-cycles were fitted with what a shutter does to them, their times do not alternate; the swing
then has a second harmonic in quadrature that goes with the square of the amplitude, as nothing else does.
"""

from dataclasses import dataclass, replace
from math import inf, nan
from typing import Annotated

import numpy as np
from scipy.special import erfc

from processing.arrays import Floats
from processing.contact import PendulumOnBall
from processing.errors import DataError
from processing.fit.exact_model import ExactModel
from processing.fit.exact_sensitivities import by_times
from processing.fit.result import FitResult
from processing.fit_method import FitMethod
from processing.number_text import with_uncertainty
from processing.quantity import Quantity
from processing.swing import ORDERS, SwingHarmonics, TurningPoints

_SECOND = ORDERS.index(2)
_FEWEST = 8
CERTAIN = 1e-6
"""Chance of so large an alternation, below which it is called a shutter's."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Alternation:
    """How late turning points on one side are, over their amplitude; those on the other side are as early.

    `chance` is that of an alternation at least so large where there is none.
    """

    delay_s_per_rad: Annotated[float, Quantity("", "delay over the amplitude", unit="s/rad")] = nan
    u_delay_s_per_rad: Annotated[float, Quantity("", "its standard uncertainty", unit="s/rad")] = inf
    chance: float = nan

    @property
    def seen(self) -> bool:
        return self.chance < CERTAIN

    @property
    def taken_off_text(self) -> str:
        """Of turning times that were corrected, in one line."""
        size, u = abs(self.delay_s_per_rad), self.u_delay_s_per_rad
        return (
            "turning times at the two ends alternate as with a rolling shutter, but none is stated "
            f"({with_uncertainty(size, u)} s/rad): this was subtracted; state shutter.row_time_s"
        )

    def text(self, rad_per_px: float) -> str:
        """Of a second harmonic, in one line; `rad_per_px` is the tilt that moves the spot by a pixel."""
        size, u = (1e6 * abs(value) * rad_per_px for value in (self.delay_s_per_rad, self.u_delay_s_per_rad))
        return (
            f"the swing's second harmonic is that of rows exposed in turn, {with_uncertainty(size, u)} µs "
            "a row along the swing, beyond what shutter.row_time_s states: rig calibrate shutter measures it"
        )


def delay_of_rows(harmonics: SwingHarmonics, period_s: float) -> Alternation:
    """The delay by the place of the spot that the swing's second harmonic shows.

    A delay by k phi makes ``-(k w A^2 / 2) sin(2 w t)`` of A cos(w t). A friction that differs between both
    directions makes one that goes with the friction, A^p: it is fitted beside.
    """
    amplitude, sine = harmonics.amplitude, harmonics.sine[:, _SECOND]
    if len(amplitude) < _FEWEST:
        return Alternation()
    u = np.sqrt(harmonics.covariance_sine[:, _SECOND, _SECOND])
    terms = np.column_stack([-np.pi / period_s * amplitude**2, amplitude]) / u[:, None]
    size = np.linalg.norm(terms, axis=0)
    covariance = np.linalg.inv((terms / size).T @ (terms / size)) / np.outer(size, size)
    found = covariance @ (terms.T @ (sine / u))
    left = sine / u - terms @ found
    # the ground's part is in what the pieces scatter
    scatter = max(1.0, float(left @ left) / (len(left) - 2))
    delay, u_delay = float(found[0]), float(np.sqrt(scatter * covariance[0, 0]))
    return Alternation(
        delay_s_per_rad=delay,
        u_delay_s_per_rad=u_delay,
        chance=float(erfc(abs(delay) / u_delay / np.sqrt(2.0))),
    )


def sides(points: TurningPoints) -> Floats:
    """1 and -1 for the half-cycles at one end of the swing and at the other."""
    return np.asarray(1.0 - 2.0 * (points.index % 2))


def alternation_of(points: TurningPoints, pendulum: PendulumOnBall | None, fit: FitResult) -> Alternation:
    """The alternation of the times of an exact fit of these points, beside its parameters.

    Raises DataError for another method.
    """
    if fit.method is not FitMethod.EXACT:
        raise DataError("the alternation of turning times is of an exact fit")
    model, columns = ExactModel.of(points, pendulum, fit)
    residuals, jacobian = model(columns)
    by_delay = by_times(model, columns, sides(model.points) * model.points.amplitude)
    good = np.isfinite(residuals) & np.isfinite(jacobian).all(axis=1) & np.isfinite(by_delay)
    residuals, jacobian, by_delay = residuals[good], jacobian[good], by_delay[good]
    norm = np.linalg.norm(jacobian, axis=0)
    norm[norm == 0] = 1.0
    directions = np.linalg.qr(jacobian / norm)[0]
    by_delay = by_delay - directions @ (directions.T @ by_delay)
    power = float(by_delay @ by_delay)
    if not power > 0:
        return Alternation()
    delay = float(by_delay @ residuals) / power
    left = residuals - directions @ (directions.T @ residuals) - delay * by_delay
    # what alternates is no noise, and a fit may have taken it for some
    scatter = max(1.0, float(left @ left) / (len(left) - jacobian.shape[1] - 1))
    u = float(np.sqrt(scatter / power))
    return Alternation(
        delay_s_per_rad=delay, u_delay_s_per_rad=u, chance=float(erfc(abs(delay) / u / np.sqrt(2.0)))
    )


def without_alternation(points: TurningPoints, found: Alternation) -> TurningPoints:
    """The turning points with their times as a shutter that exposes all rows at once would give them."""
    delay_s = found.delay_s_per_rad * sides(points) * points.amplitude
    return replace(points, time_s=points.time_s - delay_s)

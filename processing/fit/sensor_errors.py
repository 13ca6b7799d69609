"""Errors of the sensor that many turning points share: of position, of the row time, of all amplitudes.

A fixed-pattern position error moves the amplitudes of all half-cycles that pass it. Residuals of whole cycles
find it but for the part that looks like a motion (`processing.position_map`); of that part, the fitted law
finds what no decay could be.

Rows that are exposed in turn delay a spot by its place. Turning points lie on rows above and below that of
rest, so their times alternate by an amount that is proportional to the amplitude, which no motion of the
pendulum does. The alternation is taken off the times: the parameters are then those of a stated shutter.
Where the half-cycles were fitted with a shutter's effect, their times do not alternate; the swing then has a
second harmonic in quadrature proportional to the square of the amplitude, which nothing else makes.
"""

from dataclasses import dataclass, replace
from math import erfc, inf, nan, sqrt
from typing import Annotated, NamedTuple

import numpy as np

from processing.arrays import Floats
from processing.fit.reported import RigQuantities
from processing.fit.result import FIXED_PATTERN
from processing.fit.terms import LinearisedFit, Term, TermSolution, solve
from processing.number_text import with_uncertainty
from processing.quantity import Quantity
from processing.swing import ORDERS, SwingHarmonics, TurningPoints

_FELT = 1e-3
"""Largest error of an amplitude, in its uncertainties, below which a coordinate keeps its prior."""
_SECOND = ORDERS.index(2)
_FEWEST = 8
CERTAIN = 1e-6
"""Chance of so large an alternation, below which it is called a shutter's."""


class PositionErrorFit(NamedTuple):
    """Position errors that amplitudes share, by a fit.

    `values` (m,) and `covariance` (m, m) are those of the coordinates, whose prior is 0 with the variance 1.
    `of_parameters` (values, m) are their changes of the fit's values, see `FitResult.terms`.
    """

    values: Floats
    covariance: Floats
    of_parameters: Floats


def fit_position_errors(at: LinearisedFit, errors: Floats) -> PositionErrorFit:
    """Errors and parameters that describe the turning points best together, near an exact fit.

    `errors` (points, m) are those of the amplitudes for each of m independent coordinates of variance 1.
    """
    errors = errors[: len(at.points)]
    felt = np.max(np.abs(errors) / at.points.u_amplitude[:, None], axis=0) > _FELT
    by_errors = -at.by_points(amplitude=errors[:, felt])
    noise = 1.0
    for _ in range(2):
        # the scatter that position errors do not explain is noise
        found = solve(
            at.residuals / noise, at.jacobian / noise, [Term(FIXED_PATTERN, by_errors / noise, 1.0)]
        )
        noise *= found.scatter(at.fit.dof)
    values, covariance = np.zeros(len(felt)), np.eye(len(felt))
    values[felt], covariance[np.ix_(felt, felt)] = found.values, found.covariance
    return PositionErrorFit(values, covariance, at.to_physical @ found.by @ found.root)


def sensor_derivatives(at: LinearisedFit, rig: RigQuantities) -> dict[str, Floats]:
    """Derivatives (parameters,) of the contact parameters by row time and common amplitude, if uncertain.

    Turning points at the two ends of the swing lie on rows above and below that of rest: a row time wrong by
    d delays those at one end by d times their distance in rows, and advances the others as much. Full periods
    keep their lengths but for friction. Which end comes first is not known, and so the sign is not either. An
    error that all amplitudes share makes each as much too small.
    """
    points, out = at.points, {}
    if rig.row_time_s.u > 0:
        rows = np.tan(2.0 * points.amplitude) * rig.arm_m.value / rig.pitch_m.value
        rows *= np.cos(rig.slow_angle_rad.value) * sides(points)
        out["row_time_s"] = at.moved_by(at.by_points(time_s=rows[:, None]))[:, 0]
    if rig.common_amplitude_rad.u > 0:
        ones = np.ones((len(points), 1))
        out["common_amplitude_rad"] = at.moved_by(at.by_points(amplitude=ones))[:, 0]
    return out


def amplitude_error_effects(at: LinearisedFit, errors: Floats) -> Floats:
    """Changes (parameters,) of the contact parameters by one standard uncertainty of errors that amplitudes
    share, all coordinates together.

    `errors` are those of `fit_position_errors`. The signs are those of the coordinate that changes the
    parameters most.
    """
    moved = at.moved_by(at.by_points(amplitude=errors[: len(at.points)]))
    u = np.linalg.norm(moved, axis=1)
    main = np.linalg.svd(moved / np.where(u > 0, u, 1.0)[:, None], full_matrices=False)[0][:, 0]
    return np.asarray(np.copysign(u, main))


@dataclass(frozen=True, slots=True, kw_only=True)
class Alternation:
    """Delay of turning points on one side over their amplitude; those on the other side are as much early.

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
        """Remark, in one line, on turning times that were corrected."""
        size, u = abs(self.delay_s_per_rad), self.u_delay_s_per_rad
        return (
            "turning times at the two ends alternate as with a rolling shutter, but none is stated "
            f"({with_uncertainty(size, u)} s/rad): this was subtracted; state shutter.row_time_s"
        )

    def text(self, rad_per_px: float) -> str:
        """Remark, in one line, on a second harmonic; `rad_per_px` is the tilt that moves the spot by 1 px."""
        size, u = (1e6 * abs(value) * rad_per_px for value in (self.delay_s_per_rad, self.u_delay_s_per_rad))
        return (
            f"the swing's second harmonic is that of rows exposed in turn, {with_uncertainty(size, u)} µs "
            "a row along the swing, beyond what shutter.row_time_s states: rig calibrate shutter measures it"
        )


def row_delay(harmonics: SwingHarmonics, period_s: float) -> Alternation:
    """Delay in proportion to the place of the spot, from the swing's second harmonic.

    A delay by k phi makes ``-(k w A^2 / 2) sin(2 w t)`` of A cos(w t). A friction that differs between both
    directions makes a second harmonic proportional to the friction, A^p, which is fitted as well.
    """
    amplitude, sine = harmonics.amplitude, harmonics.sine[:, _SECOND]
    if len(amplitude) < _FEWEST:
        return Alternation()
    u = np.sqrt(harmonics.covariance_sine[:, _SECOND, _SECOND])
    friction, delay = amplitude / u, np.pi / period_s * amplitude**2 / u
    # the scatter of the pieces contains the ground's part
    return _alternation(solve(sine / u, friction[:, None], [Term("delay", delay)]), len(sine) - 2)


def sides(points: TurningPoints) -> Floats:
    """1 for the half-cycles at one end of the swing, -1 for those at the other."""
    return np.asarray(1.0 - 2.0 * (points.index % 2))


def time_alternation(at: LinearisedFit) -> Alternation:
    """Alternation of the turning times, estimated together with the parameters of an exact fit."""
    by_delay = -at.by_points(time_s=(sides(at.points) * at.points.amplitude)[:, None])
    found = at.solved(Term("delay", by_delay))
    # the scatter is that without the alternation, which the fit may have taken for noise
    return _alternation(found, len(found.left) - at.jacobian.shape[1] - 1)


def _alternation(found: TermSolution, dof: int) -> Alternation:
    delay = float(found.values[0])
    u = sqrt(found.covariance[0, 0]) * found.scatter(dof)
    if not u < inf:
        return Alternation()
    return Alternation(delay_s_per_rad=delay, u_delay_s_per_rad=u, chance=erfc(abs(delay) / u / sqrt(2.0)))


def without_alternation(points: TurningPoints, found: Alternation) -> TurningPoints:
    """The turning points with the times that a shutter exposing all rows at once would give."""
    delay_s = found.delay_s_per_rad * sides(points) * points.amplitude
    return replace(points, time_s=points.time_s - delay_s)

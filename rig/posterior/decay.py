"""What a fit while the run goes on says of each half-cycle, for who draws it."""

from collections.abc import Sequence

import numpy as np

from processing.contact import AMPLITUDE, TIME, PendulumOnBall, turning_points_of
from processing.fit import FitResult
from processing.periods import full_periods
from processing.swing import Swing, TurningPoints
from rig.instrument import FittedDecay

_MOST = 300
"""Half-cycles that are told: more than a chart has pixels for are no news."""


def fitted_decay(
    swings: Sequence[Swing], points: TurningPoints, fit: FitResult, pendulum: PendulumOnBall
) -> FittedDecay:
    """The exact fit beside its data: `points` are the unflagged `swings` in true time."""
    times_ns = np.array([swing.turn_time_ns for swing in swings if not swing.flags], dtype=np.int64)
    index = points.index - points.index[0]
    start = fit.estimate(AMPLITUDE.key).value
    amplitude, time_s = turning_points_of(fit.parameters, pendulum, start, int(index[-1]))
    fitted, time_s = amplitude[index], time_s[index] + fit.estimate(TIME.key).value
    periods = full_periods(points)
    at = periods.where
    fitted_period_s = time_s[at + 1] - time_s[at - 1]
    left = (points.amplitude - fitted) / points.u_amplitude
    left_of_period = (periods.period_s - fitted_period_s) / periods.u_period_s
    # where the law says that friction holds it, it says nothing of the motion
    few = np.flatnonzero(np.isfinite(left))[_every(len(left))]
    few_periods = np.flatnonzero(np.isfinite(left_of_period))[_every(len(at))]
    return FittedDecay(
        times_ns[few].tolist(),
        fitted[few].tolist(),
        left[few].tolist(),
        times_ns[at][few_periods].tolist(),
        fitted_period_s[few_periods].tolist(),
        left_of_period[few_periods].tolist(),
    )


def _every(count: int) -> slice:
    return slice(None, None, -(-count // _MOST) or 1)

"""Scatter of a least-squares fit to a driven pendulum, although the fit takes its errors as independent.

A drive moves all turning points after it: the errors are sums of steps. The covariance of the fitted
values follows from how they depend on each measured amplitude and time, and from how a step at one
turning point moves the later ones.
"""

import numpy as np
from numpy.typing import NDArray

from processing.contact import PendulumOnBall
from processing.fit.exact_model import ExactModel
from processing.fit.result import FitResult
from processing.swing import TurningPoints

Array = NDArray[np.float64]


def driven_covariance(
    by_amplitude: Array,
    by_time: Array,
    points: TurningPoints,
    pendulum: PendulumOnBall | None,
    exact: FitResult,
) -> Array:
    """Covariance of values that depend linearly on the turning points.

    Parameters
    ----------
    by_amplitude, by_time
        (half-cycles, values) derivatives of the values by the measured amplitudes and times.
    points
        The turning points that `exact` was fitted to.
    exact
        The exact fit of them, which knows how strongly the ground drove the pendulum.
    """
    assert exact.ground is not None
    noise, rate = exact.ground.noise, 2 * np.pi / exact.mean_period_s.value
    model, columns = ExactModel.of(points, pendulum, exact)
    _, _, amplitude_jacobian, time_jacobian = model.curve(columns)
    # what a change of the first amplitude makes of the later amplitudes and times
    amplitude_slope = _to_the_end(amplitude_jacobian[:, -3])
    time_slope = _to_the_end(time_jacobian[:, -3] / model.reference)

    def after(values: Array) -> Array:
        """Sums over a turning point and all later ones."""
        return np.asarray(np.cumsum(values[::-1], axis=0)[::-1])

    times = after(by_time)
    amplitudes = after(by_amplitude * amplitude_slope[:, None]) + after(by_time * time_slope[:, None])
    amplitudes = (amplitudes - times * time_slope[:, None]) / amplitude_slope[:, None]
    steps = noise.step * np.sqrt(np.diff(points.index, prepend=points.index[0]))
    parts = (
        by_amplitude * (noise.scale * points.u_amplitude)[:, None],
        by_time * (noise.scale * points.u_time_s)[:, None],
        amplitudes * steps[:, None],
        times * (steps / (rate * points.amplitude))[:, None],
    )
    return np.asarray(sum(np.einsum("ij,ik->jk", part, part) for part in parts))


def _to_the_end(values: Array) -> Array:
    """The last finite value goes on: a free decay may end before a driven one."""
    reached = int(np.count_nonzero(np.isfinite(values)))
    out = values.copy()
    out[reached:] = values[reached - 1]
    return out

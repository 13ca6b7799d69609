"""One half-swing of any law as a function of the amplitude at which it begins, with derivatives.

A law's map runs a free decay from its first turning point. Where the ground moves the pendulum, the amplitude
leaves the free decay, and what is needed is the loss and the duration of one half-swing from any amplitude. A
free decay that begins above all measured amplitudes passes through all of them in small steps; the losses and
durations of its half-swings are values of these functions, and the rows of its gradients give their slopes:

    G(A_i) = A_(i+1),    dG/dA = (dA_(i+1)/dA_0) / (dA_i/dA_0)
    dG/dq at fixed A = dA_(i+1)/dq - dG/dA dA_i/dq

and likewise for the duration. Between the amplitudes of the decay the functions are interpolated.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from processing.arrays import Floats, Ints
from processing.contact.law import HalfSwings


class OneHalfSwing(NamedTuple):
    """Loss and duration of a half-swing at falling amplitudes.

    Amplitudes and losses are in units of the reference, durations in units of T0. `loss_slope` and
    `duration_slope` are derivatives by the amplitude; `loss_gradient` and `duration_gradient`, shape
    ``(amplitudes, parameters)``, are those by the map's parameters at fixed amplitude. The map's last
    parameter, the first amplitude, is none of a half-swing: its column is zero.
    """

    amplitude: Floats
    loss: Floats
    loss_slope: Floats
    loss_gradient: Floats
    duration: Floats
    duration_slope: Floats
    duration_gradient: Floats


def tabulated_half_swing(
    half_swing_map: Callable[[Floats, Ints], HalfSwings], parameters: Floats, highest: float, count: int
) -> OneHalfSwing:
    """The functions at the amplitudes of a free decay.

    Parameters
    ----------
    half_swing_map, parameters
        The law's map and its parameters, the first amplitude last.
    highest
        Amplitude at which the decay begins, in units of the reference.
    count
        Number of half-swings; fewer are returned if the pendulum stops before.
    """
    start = parameters.copy()
    start[-1] = highest
    found = half_swing_map(start, np.arange(count + 1, dtype=np.int64))
    reached = int(np.count_nonzero(np.isfinite(found.time)))
    amplitude, time = found.amplitude[:reached], found.time[:reached]
    amplitude_gradient, time_gradient = found.amplitude_gradient[:reached], found.time_gradient[:reached]
    by_first = amplitude_gradient[:, -1]
    slope = by_first[1:] / by_first[:-1]
    duration_slope = np.diff(time_gradient[:, -1]) / by_first[:-1]
    loss_gradient = slope[:, None] * amplitude_gradient[:-1] - amplitude_gradient[1:]
    duration_gradient = np.diff(time_gradient, axis=0) - duration_slope[:, None] * amplitude_gradient[:-1]
    loss_gradient[:, -1] = duration_gradient[:, -1] = 0.0
    return OneHalfSwing(
        amplitude[:-1],
        -np.diff(amplitude),
        1.0 - slope,
        loss_gradient,
        np.diff(time),
        duration_slope,
        duration_gradient,
    )

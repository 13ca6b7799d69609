"""Losses of a decay: logarithmic decrement, quality factor."""

from dataclasses import dataclass

import numpy as np

from processing.arrays import Floats
from processing.contact.laws.paper import turning_points_of
from processing.contact.parameters import ContactParameters, PendulumOnBall
from processing.errors import DataError
from processing.swing import TurningPoints


@dataclass(frozen=True)
class CycleLosses:
    """Losses over whole cycles as a function of the amplitude in the middle of each (rad).

    `log_decrement` is ln(A_i/A_(i+2)), `quality` is pi divided by it.
    The `u_` are standard uncertainties. For a decrement comparable to its uncertainty, that of Q has no
    meaning; it is infinite if the decrement is not positive.
    """

    amplitude_rad: Floats
    log_decrement: Floats
    u_log_decrement: Floats
    quality: Floats
    u_quality: Floats


def _losses(middle: Floats, decrement: Floats, u_decrement: Floats) -> CycleLosses:
    lossy = decrement > 0
    safe = np.where(lossy, decrement, 1.0)
    return CycleLosses(
        middle,
        decrement,
        u_decrement,
        np.where(lossy, np.pi / safe, np.nan),
        np.where(lossy, np.pi * u_decrement / safe**2, np.inf),
    )


def measured_losses(points: TurningPoints, *, cycles: int = 1) -> CycleLosses:
    """Losses from the turning points without a model.

    The decrement is averaged over windows of `cycles` whole cycles; its noise is inversely proportional to
    their number. Windows do not overlap; those with a missing end are left out.
    """
    if cycles < 1:
        raise DataError(f"cycles = {cycles}: at least one")
    step = 2 * cycles
    position = {int(index): i for i, index in enumerate(points.index)}
    first, last = [], []
    for index in range(int(points.index[0]), int(points.index[-1]) - step + 1, step):
        if index in position and index + step in position:
            first.append(position[index])
            last.append(position[index + step])
    if not first:
        raise DataError(f"no two turning points {cycles} whole cycles apart")
    a, b = points.amplitude[first], points.amplitude[last]
    u = np.hypot(points.u_amplitude[first] / a, points.u_amplitude[last] / b)
    return _losses(np.sqrt(a * b), np.log(a / b) / cycles, u / cycles)


def model_losses(
    amplitude_rad: Floats, parameters: ContactParameters, pendulum: PendulumOnBall
) -> CycleLosses:
    """Losses by the exact half-swing map for a cycle that starts at each amplitude (n,); uncertainties are 0.

    NaN if friction stops the pendulum before the end of the cycle.
    """
    ends = np.array(
        [turning_points_of(parameters, pendulum, float(a), 2)[0][2] for a in np.atleast_1d(amplitude_rad)]
    )
    start = np.atleast_1d(np.asarray(amplitude_rad, dtype=np.float64))
    return _losses(np.sqrt(start * ends), np.log(start / ends), np.zeros_like(start))

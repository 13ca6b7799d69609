"""Decays of laws, integrated from the equation of motion; nothing of the half-swing map is used.

The laws are stated as their authors state them: springs and sliders one by one, Dahl's differential equation.
Angles in units of the swing, times in units of 1/w0.
"""

import numpy as np
import scipy
from numpy.typing import NDArray

from processing.swing import TurningPoints
from tests.processing.fit.decays import with_noise

Array = NDArray[np.float64]


def dahl_decay(c: float, sigma: float, first: float, count: int) -> tuple[Array, Array]:
    """Turning points (amplitudes, times) of x'' = -x - M, M' = sigma x' (1 - sign(x') M/c)."""
    state, side, now = [first, 0.0, c * np.tanh(first * sigma / c)], -1.0, 0.0
    amplitudes, times = [first], [0.0]
    while len(amplitudes) < count:

        def motion(_: float, state: Array, side: float = side) -> list[float]:
            x, v, moment = state.tolist()
            return [v, -x - moment, sigma * v * (1 - side * moment / c)]

        early, (x, _, moment) = 1e-7, state
        force = -x - moment
        begun = [x + 0.5 * force * early**2, force * early, moment]
        found = scipy.integrate.solve_ivp(
            motion, [0, 20], begun, events=_at_rest, rtol=1e-11, atol=1e-14, max_step=0.05
        )
        state, side = found.y_events[0][0].tolist(), -side
        now += early + float(found.t_events[0][0])
        amplitudes.append(abs(state[0]))
        times.append(now)
    return np.array(amplitudes), np.array(times)


def slider_decay(
    stiffness: Array, slip: Array, constant: float, drag: float, first: float, count: int
) -> tuple[Array, Array]:
    """Turning points with springs in parallel, each with a slider, a constant friction and a drag.

    A spring of stiffness k holds at most k times its angle of slip. At the first reversal each is loaded as
    by a swing from rest.
    """
    amplitudes, times = [first], [0.0]
    loaded = stiffness * np.minimum(first, slip)
    while len(amplitudes) < count:
        start = amplitudes[-1]

        def resistance(s: float, held: Array = loaded) -> Array:
            # towards smaller x every spring unloads by k s until its slider gives way at the other side
            return np.maximum(held - stiffness * s, -stiffness * slip)

        def motion(_: float, state: Array, start: float = start) -> list[float]:
            s, v = state.tolist()
            return [v, (start - s) + float(resistance(s).sum()) - constant - drag * v]

        early = 1e-7
        push = start + float(loaded.sum()) - constant
        found = scipy.integrate.solve_ivp(
            motion, [0, 20], [0.5 * push * early**2, push * early], events=_at_rest, rtol=1e-10, atol=1e-13,
            max_step=0.05,
        )  # fmt: skip
        s = float(found.y_events[0][0][0])
        times.append(times[-1] + early + float(found.t_events[0][0]))
        loaded = -resistance(s)
        amplitudes.append(s - start)
    return np.array(amplitudes), np.array(times)


def _at_rest(_: float, state: Array) -> float:
    return float(state[1])


_at_rest.terminal = True  # type: ignore[attr-defined]


def constant_decay(
    c: float, period0_s: float, initial_rad: float, count: int, u_arcsec: float, seed: int
) -> TurningPoints:
    """Turning points of the equation of motion itself, with noise: arcs of a harmonic oscillation.

    About the shifted rest positions +c and -c, half a period each.
    """
    phi = [initial_rad]
    for _ in range(count - 1):
        rest = c if phi[-1] > 0 else -c
        phi.append(2 * rest - phi[-1])
    time_s = 0.25 + 0.5 * period0_s * np.arange(count)
    return with_noise(time_s, np.abs(np.array(phi)), period0_s, u_arcsec, np.random.default_rng(seed))

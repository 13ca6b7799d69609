"""A pendulum that the ground drives, integrated step by step: no half-swing map, no quadrature, no filter."""

import math
from collections.abc import Callable

import numpy as np
from numba import njit
from numpy.typing import NDArray

from processing.contact.law import ContactParameters, PendulumOnBall
from processing.swing import TurningPoints
from tests.processing.fit.decays import ARCSEC, with_noise

Floats = NDArray[np.float64]

STEPS = 500
"""Steps a half-swing; halving them moves no turning point by a thousandth of 0.005 arcsec."""


@njit(cache=True)
def _acceleration(x: float, v: float, direction: float, law: Floats, push: float) -> float:
    """Eq. 4 with Eqs. 1 and 3 and the air: law = w0^2, b, p, c, n, kappa, R/a, drag, drag32; and a push."""
    size = abs(x)
    elastic = law[5] * size ** (law[4] + 1.0) * (0.5 * math.pi - law[6] * size)
    air = (law[7] + law[8] * math.sqrt(abs(v))) * v
    friction = direction * (law[3] + law[1] * size ** law[2])
    return push + law[0] * (-x + math.copysign(elastic, x) - friction - air)


@njit(cache=True)
def _advance(
    x: float, v: float, direction: float, dt: float, law: Floats, push: float
) -> tuple[float, float]:
    """One step of Runge and Kutta."""
    a1 = _acceleration(x, v, direction, law, push)
    v2 = v + 0.5 * dt * a1
    a2 = _acceleration(x + 0.5 * dt * v, v2, direction, law, push)
    v3 = v + 0.5 * dt * a2
    a3 = _acceleration(x + 0.5 * dt * v2, v3, direction, law, push)
    v4 = v + dt * a3
    a4 = _acceleration(x + dt * v3, v4, direction, law, push)
    return x + dt * (v + 2 * v2 + 2 * v3 + v4) / 6, v + dt * (a1 + 2 * a2 + 2 * a3 + a4) / 6


@njit(cache=True)
def _integrate(
    first: float,
    last: float,
    law: Floats,
    dt: float,
    kick: float,
    rng: np.random.Generator,
    forcing: Floats,
    keep: int,
    path: Floats,
) -> tuple[Floats, Floats]:
    """Turning points (times, deflections) down to `last`; every `keep`-th position goes into `path`.

    `forcing` is an angular acceleration in every step, which acts during it.
    """
    turns, times = np.empty(20_000), np.empty(20_000)
    turns[0], times[0], found = first, 0.0, 1
    x, v, direction, t, steps = first, 0.0, -math.copysign(1.0, first), 0.0, 0
    path[0] = x
    while found < len(turns):
        left = dt
        push = forcing[steps] if steps < len(forcing) else 0.0
        while left > 0.0:
            new_x, new_v = _advance(x, v, direction, left, law, push)
            # friction turns with the velocity: a step ends there; one that crosses zero, where |phi|^p has a
            # kink, ends there too
            if new_v * direction < 0.0:
                part = left * min(max(v / (v - new_v), 0.0), 1.0) if v != new_v else left
                for _ in range(4):
                    mid_x, mid_v = _advance(x, v, direction, part, law, push)
                    part = min(
                        max(part - mid_v / _acceleration(mid_x, mid_v, direction, law, push), 0.0), left
                    )
                x, _ = _advance(x, v, direction, part, law, push)
                v, direction = 0.0, -direction
                t, left = t + part, left - part
                if x * turns[found - 1] < 0.0:
                    turns[found], times[found] = x, t
                    found += 1
            elif x * new_x < 0.0:
                part = left * x / (x - new_x)
                for _ in range(3):
                    mid_x, mid_v = _advance(x, v, direction, part, law, push)
                    part = min(max(part - mid_x / mid_v, 0.0), left)
                x, v = _advance(x, v, direction, part, law, push)
                x = math.copysign(1e-300, new_x)
                t, left = t + part, left - part
            else:
                x, v, t, left = new_x, new_v, t + left, 0.0
        v += kick * rng.standard_normal()
        if v * direction < 0.0:
            # a kick may turn a pendulum that has nearly stopped
            direction = -direction
            if x * turns[found - 1] < 0.0:
                turns[found], times[found] = x, t
                found += 1
        if abs(turns[found - 1]) < last:
            break
        steps += 1
        if steps % keep == 0 and steps // keep < len(path):
            path[steps // keep] = x
    return times[:found], turns[:found]


def driven_path(
    parameters: ContactParameters,
    pendulum: PendulumOnBall,
    *,
    q: float,
    seed: int,
    first_arcsec: float = 124.0,
    last_arcsec: float = 2.0,
    frames_per_s: float | None = None,
    steps: int = STEPS,
    drag32: float = 0.0,
    forcing: Callable[[Floats], Floats] | None = None,
) -> tuple[Floats, Floats, Floats]:
    """True turning times (s) and deflections (rad), and the deflections at so many frames a second from 0.

    `q` is the one-sided density of the white angular acceleration in rad/s^2/sqrt(Hz); `drag32` (s^1.5) that
    of a moment that grows with the 3/2 power of the velocity, ``-m g R drag32 |phi'|^0.5 phi'``. `forcing` is
    another acceleration, in rad/s^2 at times in s.
    """
    kappa = (
        2
        * parameters.gamma_pa
        * pendulum.contact_radius_m**2
        / (pendulum.mass_kg * pendulum.gravity_m_per_s2)
    )
    law = np.array(
        [
            (2 * np.pi / parameters.period0_s) ** 2, parameters.b, parameters.p, parameters.c,
            parameters.n, kappa, pendulum.ball_radius_m / pendulum.contact_radius_m,
            parameters.drag_s, drag32,
        ]
    )  # fmt: skip
    dt, keep, path = 0.5 * parameters.period0_s / steps, 1, np.empty(1)
    if frames_per_s is not None:
        keep = math.ceil(1 / (frames_per_s * dt))
        dt = 1 / (frames_per_s * keep)
        path = np.full(round(5_000 * frames_per_s), np.nan)
    kick = q * math.sqrt(0.5 * dt)
    rng = np.random.default_rng(seed)
    steady = np.empty(0) if forcing is None else forcing((np.arange(round(5_000 / dt)) + 0.5) * dt)
    times, turns = _integrate(
        first_arcsec * ARCSEC, last_arcsec * ARCSEC, law, dt, kick, rng, steady, keep, path
    )
    return times, turns, path[np.isfinite(path)]


def driven_decay(
    parameters: ContactParameters,
    pendulum: PendulumOnBall,
    *,
    q: float,
    noise_arcsec: float,
    seed: int,
    first_arcsec: float = 124.0,
    last_arcsec: float = 2.0,
) -> TurningPoints:
    """Turning points of `driven_path`, measured with the noise that `decays.decay` adds."""
    time, turn, _ = driven_path(
        parameters, pendulum, q=q, seed=seed, first_arcsec=first_arcsec, last_arcsec=last_arcsec
    )
    rng = np.random.default_rng([seed, 77])
    return with_noise(time, np.abs(turn), parameters.period0_s, noise_arcsec, rng)

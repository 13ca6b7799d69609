"""A pendulum that the ground drives, in a world of one's choice, integrated step by step.

Eq. 4 with Eqs. 1 and 3 and the air, and beside them whatever a `World` adds. Nothing is shared with the
analysis: no half-swing map, no quadrature, no filter.
"""

import math
from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from processing.contact.law import ContactParameters, PendulumOnBall
from processing.kernel import kernel
from processing.swing import TurningPoints
from tests.processing.fit.decays import ARCSEC, with_noise

Floats = NDArray[np.float64]

STEPS = 500
"""Steps a half-swing; halving them moves no turning point by a thousandth of 0.005 arcsec."""
RELAXATIONS_S = np.geomspace(0.02, 2000.0, 11)
"""Times of the elements whose sum creeps with the logarithm of time: few are enough to be smooth."""


class World(NamedTuple):
    """What is added to the paper's law, or changes while the pendulum swings.

    `drag32` (s^1.5) is a moment that grows with the 3/2 power of the velocity. `b2`, `p2` are a second power
    of the angle in the friction. b grows by `ageing` from the first turning point to the last of a run of
    `lasting_s`, evenly, and is the stated one in the middle; period and drag grow likewise by `slower` and
    `drag_drift`. At
    `event_s` b grows by the factor 1 + `slip`, the period by 1 + `shifted`, and the velocity by
    `knock_rad_per_s`. `loss_angle` is that of an elastic after-effect, the same at every frequency, in a part
    of the stiffness that relaxes with the logarithm of time.
    """

    drag32: float = 0.0
    b2: float = 0.0
    p2: float = 1.0
    ageing: float = 0.0
    slower: float = 0.0
    lasting_s: float = 1000.0
    event_s: float = math.inf
    slip: float = 0.0
    shifted: float = 0.0
    knock_rad_per_s: float = 0.0
    loss_angle: float = 0.0
    drag_drift: float = 0.0


UNCHANGED = World()


@kernel
def _derivative(
    y: Floats, t: float, direction: float, law: Floats, world: Floats, push: float, out: Floats
) -> None:
    """Of deflection, velocity and the elements' moments, with a push: an angular acceleration."""
    x, v = y[0], y[1]
    size = abs(x)
    aged = t / world[4] - 0.5
    b = law[1] * (1.0 + world[2] * aged)
    w2 = law[0] * (1.0 - 2.0 * world[3] * aged)
    if t >= world[5]:
        b *= 1.0 + world[6]
        w2 *= 1.0 - 2.0 * world[7]
    elastic = law[5] * size ** (law[4] + 1.0) * (0.5 * math.pi - law[6] * size)
    air = (law[7] * (1.0 + law[9] * aged) + law[8] * math.sqrt(abs(v))) * v
    friction = law[3] + b * size ** law[2]
    if world[0] != 0.0:
        friction += world[0] * size ** world[1]
    late = 0.0
    for i in range(2, len(y)):
        # an element of Maxwell: its moment follows the deflection and forgets
        out[i] = world[8] * v - y[i] / world[8 + i - 1]
        late += y[i]
    out[0] = v
    restoring = -x + math.copysign(elastic, x) - direction * friction - late
    out[1] = push + w2 * restoring - law[0] * air


@kernel
def _advance(
    y: Floats, t: float, direction: float, dt: float, law: Floats, world: Floats, push: float, out: Floats
) -> None:
    """One step of Runge and Kutta."""
    n = len(y)
    k1, k2, k3, k4 = np.empty(n), np.empty(n), np.empty(n), np.empty(n)
    _derivative(y, t, direction, law, world, push, k1)
    _derivative(y + 0.5 * dt * k1, t + 0.5 * dt, direction, law, world, push, k2)
    _derivative(y + 0.5 * dt * k2, t + 0.5 * dt, direction, law, world, push, k3)
    _derivative(y + dt * k3, t + dt, direction, law, world, push, k4)
    out[:] = y + dt * (k1 + 2 * k2 + 2 * k3 + k4) / 6


@kernel
def _integrate(
    first: float,
    last: float,
    law: Floats,
    world: Floats,
    elements: int,
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
    y, new = np.zeros(2 + elements), np.zeros(2 + elements)
    y[0] = first
    direction, t, steps, knocked = -math.copysign(1.0, first), 0.0, 0, False
    path[0] = first
    while found < len(turns):
        left = dt
        push = forcing[steps] if steps < len(forcing) else 0.0
        while left > 0.0:
            _advance(y, t, direction, left, law, world, push, new)
            if new[1] * direction < 0.0:
                # the velocity turns over within the step, which ends there
                low, high = 0.0, left
                for _ in range(50):
                    part = 0.5 * (low + high)
                    _advance(y, t, direction, part, law, world, push, new)
                    if new[1] * direction < 0.0:
                        high = part
                    else:
                        low = part
                part = 0.5 * (low + high)
                _advance(y, t, direction, part, law, world, push, new)
                y[:] = new
                y[1], direction = 0.0, -direction
                t, left = t + part, left - part
                if y[0] * turns[found - 1] < 0.0:
                    turns[found], times[found] = y[0], t
                    found += 1
                if part < 1e-9 * dt:
                    left = left - 1e-9 * dt
            elif y[0] * new[0] < 0.0:
                # so does one that crosses zero, where |phi|^p has a kink
                part = left * y[0] / (y[0] - new[0])
                for _ in range(3):
                    _advance(y, t, direction, part, law, world, push, new)
                    part = min(max(part - new[0] / new[1], 0.0), left)
                sign = math.copysign(1e-300, -y[0])
                _advance(y, t, direction, part, law, world, push, new)
                y[:] = new
                y[0] = sign
                t, left = t + part, left - part
            else:
                y[:] = new
                t, left = t + left, 0.0
        y[1] += kick * rng.standard_normal()
        if not knocked and t >= world[5]:
            y[1] += world[len(world) - 1]
            knocked = True
        if y[1] * direction < 0.0:
            direction = -direction
            if y[0] * turns[found - 1] < 0.0:
                turns[found], times[found] = y[0], t
                found += 1
        if abs(turns[found - 1]) < last:
            break
        steps += 1
        if steps % keep == 0 and steps // keep < len(path):
            path[steps // keep] = y[0]
    return times[:found], turns[:found]


def driven_path(
    parameters: ContactParameters,
    pendulum: PendulumOnBall,
    world: World = UNCHANGED,
    *,
    q: float,
    seed: int,
    first_arcsec: float = 124.0,
    last_arcsec: float = 2.0,
    frames_per_s: float | None = None,
    steps: int = STEPS,
    forcing: Callable[[Floats], Floats] | None = None,
) -> tuple[Floats, Floats, Floats]:
    """True turning times (s) and deflections (rad), and the deflections at so many frames a second from 0.

    `q` is the one-sided density of the white angular acceleration in rad/s^2/sqrt(Hz). `forcing` is another
    acceleration, in rad/s^2 at times in s.
    """
    weight = pendulum.mass_kg * pendulum.gravity_m_per_s2
    law = np.array(
        [
            (2 * np.pi / parameters.period0_s) ** 2, parameters.b, parameters.p, parameters.c, parameters.n,
            2 * parameters.gamma_pa * pendulum.contact_radius_m**2 / weight,
            pendulum.ball_radius_m / pendulum.contact_radius_m, parameters.drag_s, world.drag32,
            world.drag_drift,
        ]
    )  # fmt: skip
    elements = len(RELAXATIONS_S) if world.loss_angle else 0
    # a flat spectrum H of relaxation times has the loss angle pi H / 2, and an element H times their spacing
    spacing = math.log(RELAXATIONS_S[1] / RELAXATIONS_S[0])
    stiffness = world.loss_angle * 2 / math.pi * spacing
    added = np.array(
        [
            world.b2, world.p2, world.ageing, world.slower, world.lasting_s, world.event_s, world.slip,
            world.shifted, stiffness, *RELAXATIONS_S, world.knock_rad_per_s,
        ]
    )  # fmt: skip
    dt, keep, path = 0.5 * parameters.period0_s / steps, 1, np.empty(1)
    if frames_per_s is not None:
        keep = math.ceil(1 / (frames_per_s * dt))
        dt = 1 / (frames_per_s * keep)
        path = np.full(round(6_000 * frames_per_s), np.nan)
    kick = q * math.sqrt(0.5 * dt)
    rng = np.random.default_rng(seed)
    steady = np.empty(0) if forcing is None else forcing((np.arange(round(5_000 / dt)) + 0.5) * dt)
    times, turns = _integrate(
        first_arcsec * ARCSEC, last_arcsec * ARCSEC, law, added, elements, dt, kick, rng, steady, keep, path
    )
    return times, turns, path[np.isfinite(path)]


changing_path = partial(driven_path, frames_per_s=25.0, steps=400)
"""Of worlds that change, as the tests and benchmarks of them see it: the steps fix the noise of a seed."""


def driven_decay(
    parameters: ContactParameters,
    pendulum: PendulumOnBall,
    world: World = UNCHANGED,
    *,
    noise_arcsec: float,
    seed: int,
    **path: Any,
) -> TurningPoints:
    """Turning points of `driven_path` (its arguments), with the noise that `decays.decay` adds."""
    time, turn, _ = driven_path(parameters, pendulum, world, seed=seed, **path)
    rng = np.random.default_rng([seed, 77])
    return with_noise(time, np.abs(turn), parameters.period0_s, noise_arcsec, rng)


changing_decay = partial(driven_decay, noise_arcsec=0.005, frames_per_s=25.0, steps=400)
"""The turning points of `changing_path`."""

"""Simulated decays of the paper's three pairs with noise, gaps and outliers."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from processing.contact import turning_points_of
from processing.contact.hertz import MATERIALS, pendulum_on_ball
from processing.contact.law import ContactParameters, PendulumOnBall
from processing.fit import FitResult
from processing.swing import TurningPoints

ARCSEC = np.pi / 648000
PAIRS = ("glass_k8", "silicon", "steel")

_PRINTED = {
    "glass_k8": ContactParameters(37.330e-4, 0.944, 10.510e-9, 0.092, 4.071, 28.97e6),
    "silicon": ContactParameters(7.060e-4, 0.815, 3.840e-9, 0.552, 4.072, 290.69e6),
    "steel": ContactParameters(7.961e-4, 0.850, 6.601e-9, 0.461, 4.049, 95.46e6),
}


def paper_pair(flat: str, drag_s: float = 0.0) -> tuple[ContactParameters, PendulumOnBall]:
    """The paper's parameters (b with its power of ten at -4) and pendulum for a flat."""
    p = _PRINTED[flat]
    pendulum = pendulum_on_ball(0.406, 6.05e-3, MATERIALS["steel"], MATERIALS[flat])
    return ContactParameters(p.b, p.p, p.c, p.n, p.period0_s, p.gamma_pa, drag_s), pendulum


def decay(
    parameters: ContactParameters,
    pendulum: PendulumOnBall,
    *,
    noise_arcsec: float,
    seed: int,
    first_arcsec: float = 124.0,
    last_arcsec: float = 2.0,
    noise_free: bool = False,
) -> TurningPoints:
    """Turning points down to an amplitude, with the noise that a tracked spot gives.

    Amplitudes scatter by `noise_arcsec`, times by the same over the speed that the phase has at
    this amplitude, A w0.
    """
    amplitude, time = turning_points_of(parameters, pendulum, first_arcsec * ARCSEC, 20_000)
    # rounding must not decide over a first amplitude that equals the last
    count = int(np.nonzero(amplitude >= last_arcsec * ARCSEC)[0][-1]) + 1
    amplitude, time = amplitude[:count], time[:count]
    measured = with_noise(time, amplitude, parameters.period0_s, noise_arcsec, np.random.default_rng(seed))
    return replace(measured, time_s=time, amplitude=amplitude) if noise_free else measured


def with_noise(
    time_s: NDArray[np.float64],
    amplitude: NDArray[np.float64],
    period0_s: float,
    noise_arcsec: float,
    rng: np.random.Generator,
) -> TurningPoints:
    """Turning points as a tracked spot gives them: times scatter as amplitudes do, over the speed A w0."""
    count = len(time_s)
    u = np.full(count, noise_arcsec * ARCSEC)
    u_time = u / (amplitude * 2 * np.pi / period0_s)
    return TurningPoints(
        np.arange(count, dtype=np.int64),
        time_s + u_time * rng.standard_normal(count),
        u_time,
        amplitude + u * rng.standard_normal(count),
        u,
    )


def without(points: TurningPoints, missing: NDArray[np.int64]) -> TurningPoints:
    """The same with half-cycles missing."""
    kept = ~np.isin(points.index, missing)
    return TurningPoints(*(getattr(points, name)[kept] for name in points.__slots__))


def first_of(points: TurningPoints, count: int) -> TurningPoints:
    """So many of the first."""
    return without(points, points.index[count:])


def truth(parameters: ContactParameters, names: tuple[str, ...]) -> NDArray[np.float64]:
    return np.array([getattr(parameters, name) for name in names if hasattr(parameters, name)])


def pulls(fit: FitResult, parameters: ContactParameters, *names: str) -> NDArray[np.float64]:
    """Errors of parameters, of all of the contact or of some, in standard uncertainties."""
    estimates = {name: fit.estimate(name) for name in names or fit.contact_names}
    return np.array([(value - getattr(parameters, name)) / u for name, (value, u) in estimates.items()])

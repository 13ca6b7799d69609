"""Rate of a clock and drift of a beam under noise that wanders: error over the claimed uncertainty.

The worlds are sums of steps in time with a rate that is known; nothing of the analysis makes them. Run as
``python -m tests.benchmarks clock [--quick]``.
"""

from collections.abc import Callable
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from calibration import relate_clocks, stability
from rig.prepare.record_calibrations import u_camera_rate
from tests.benchmarks.cases import run_of
from tests.benchmarks.coverage import Case, measure, of_pulls
from tests.rig.analysis.spinning import Held

Array = NDArray[np.float64]
RATE_HZ = 25.0
TRUE_PPM = 40.0


def _arrivals(rng: np.random.Generator, count: int) -> Array:
    """Delays of a usual computer: 20 us, and one frame in 50 much later."""
    late_s = 2e-5 * np.abs(rng.standard_normal(count))
    return np.where(rng.random(count) < 0.02, rng.exponential(5e-3, count), 0.0) + late_s


def _quiet(rng: np.random.Generator, times_s: Array) -> Array:
    return np.zeros(len(times_s))


def _loaded(rng: np.random.Generator, times_s: Array) -> Array:
    """Many frames in a row are late."""
    return np.asarray(lfilter([3e-5], [1.0, -0.98], rng.standard_normal(len(times_s))))


def _random_walk(rng: np.random.Generator, times_s: Array) -> Array:
    """Of the host's phase: 10 us in a second, 0.1 ms in 100 s."""
    return np.asarray(1e-5 * np.sqrt(times_s[1]) * np.cumsum(rng.standard_normal(len(times_s))))


def _hidden_walk(rng: np.random.Generator, times_s: Array) -> Array:
    """One that leaves a third of the variance that the arrivals leave of themselves: the hardest to see."""
    size = 3.4e-7 * 120.0 / times_s[-1]
    return np.asarray(size * np.sqrt(times_s[1]) * np.cumsum(rng.standard_normal(len(times_s))))


def _flicker(rng: np.random.Generator, times_s: Array) -> Array:
    """1/f of the host's phase, as a sum of exponential memories an octave apart."""
    total = np.zeros(len(times_s))
    for octave in range(13):
        kept = np.exp(-(2.0**-octave))
        start = rng.standard_normal()
        driven = np.sqrt(1 - kept**2) * rng.standard_normal(len(times_s))
        total += lfilter([1.0], [1.0, -kept], driven, zi=[kept * start])[0]
    return 2e-5 * total


def _slews(rng: np.random.Generator, times_s: Array) -> Array:
    """A time server's corrections: each 4 to 28 s another rate, of 2 ppm scatter and mean zero."""
    rates = np.zeros(len(times_s))
    at, end = 0.0, times_s[-1]
    while at < end:
        length = rng.uniform(4.0, 28.0)
        rates[(times_s >= at) & (times_s < at + length)] = 2e-6 * rng.standard_normal()
        at += length
    return np.asarray(np.cumsum(rates) * times_s[1])


def _wandering_rate(rng: np.random.Generator, times_s: Array) -> Array:
    """The rate takes steps: 0.03 ppm in a second."""
    rate = np.cumsum(3e-8 * np.sqrt(times_s[1]) * rng.standard_normal(len(times_s)))
    return np.asarray(np.cumsum(rate) * times_s[1])


def _thermal(rng: np.random.Generator, times_s: Array) -> Array:
    """The room's temperature moves the rate by 1 ppm up and down, in half an hour to two hours."""
    period_s, phase = rng.uniform(1800.0, 7200.0), rng.uniform(0.0, 2 * np.pi)
    rate = 1e-6 * np.cos(2 * np.pi * times_s / period_s + phase)
    return np.asarray(np.cumsum(rate) * times_s[1])


WORLDS: dict[str, Callable[[np.random.Generator, Array], Array]] = {
    "white": _quiet,
    "loaded computer": _loaded,
    "random walk": _random_walk,
    "hidden random walk": _hidden_walk,
    "flicker": _flicker,
    "slews": _slews,
    "wandering rate": _wandering_rate,
    "thermal, 1 ppm": _thermal,
}

RATES = ("wandering rate", "thermal, 1 ppm")
"""Worlds in which the rate itself changes."""


def clock_z(world: str, seed: int, duration_s: float) -> tuple[float, float]:
    """Error of the rate over its uncertainty, of the line and of the calibration."""
    rng = np.random.default_rng([seed, 7])
    times_s = np.arange(round(duration_s * RATE_HZ)) / RATE_HZ
    device = np.rint(1e9 * times_s * (1 + 1e-6 * TRUE_PPM)).astype(np.int64) + 10**12
    wander_s = WORLDS[world](rng, times_s)
    off_s = wander_s + _arrivals(rng, len(times_s))
    numbers = np.arange(len(times_s))
    host = np.rint(1e9 * (5.0 + times_s + off_s)).astype(np.int64)
    host = np.maximum.accumulate(host - numbers) + numbers
    found = relate_clocks(device, host, numbers)
    error = found.rate - 1.0 / (1 + 1e-6 * TRUE_PPM)
    # what a rate did during a record is no error of the line through it
    during = (wander_s[-1] - wander_s[0]) / times_s[-1] if world in RATES else 0.0
    return (error - during) / found.u_rate, error / u_camera_rate(found, u_host_rate=0.0)


def _beam(world: str, rng: np.random.Generator, times_s: Array) -> Array:
    """px; shot noise, and what wanders."""
    noise = 0.01 * rng.standard_normal(len(times_s))
    if world == "random walk":
        walk = np.cumsum(rng.standard_normal(len(times_s)))
        return np.asarray(noise + 2e-3 * np.sqrt(times_s[1]) * walk)
    if world == "flicker":
        return np.asarray(noise + 500.0 * _flicker(rng, times_s))
    if world == "air":
        # turbulence that forgets after a second
        kept = np.exp(-times_s[1])
        walk = lfilter([np.sqrt(1 - kept**2)], [1.0, -kept], rng.standard_normal(len(times_s)))
        return np.asarray(noise + 0.02 * walk)
    return noise


BEAMS = ("white", "air", "flicker", "random walk")


def pointing_z(world: str, seed: int, duration_s: float) -> float:
    """Error of the drift over its uncertainty; the true one is 1e-4 px/s."""
    rng = np.random.default_rng([seed, 8])
    times_s = np.arange(round(duration_s * RATE_HZ)) / RATE_HZ
    found = stability(times_s, 1e-4 * times_s + _beam(world, rng, times_s), np.full(len(times_s), 0.01))
    return (found.drift_per_s - 1e-4) / found.u_drift_per_s


def cases() -> list[Case]:
    """Of 120 s, and of 1200 s with fewer seeds."""

    def clock(world: str, duration_s: float, seed: int) -> dict[str, Held]:
        return of_pulls(dict(zip(("line", "calibration"), clock_z(world, seed, duration_s), strict=True)))

    def pointing(world: str, duration_s: float, seed: int) -> dict[str, Held]:
        return of_pulls({"drift": pointing_z(world, seed, duration_s)})

    kinds = [(clock, world) for world in WORLDS] + [(pointing, world) for world in BEAMS]
    return [
        Case(f"{of.__name__}, {world}, {duration_s:g} s", partial(of, world, duration_s), share)
        for duration_s, share in ((120.0, 1.0), (1200.0, 0.3))
        for of, world in kinds
    ]


run = run_of(measure, cases, seeds=200, quick_seeds=20, apart=0)

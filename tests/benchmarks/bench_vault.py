"""The exact fit with an auxiliary seismometer: scatter, coverage, refusals.

Run as ``python -m tests.benchmarks vault [--quick]``. Decays are
integrated step by step, with the ground as a force; the fit shares no formula with that. The recorded
ground is that of two real seismometers at one place: one drives the pendulum, the other, whose response
nobody states, is the seismometer.
"""

import gzip
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import numpy as np

from processing.fit import FitResult, fit_exact
from processing.fit.known_drive import Seismogram
from processing.fit.seismometer import SeismometerUse, fit_with_seismometer
from processing.swing import TurningPoints
from tests.benchmarks.cases import each_seed, run_cases
from tests.benchmarks.coverage import Floats, coverage, rms
from tests.processing.fit.decays import paper_pair, truth, with_noise
from tests.processing.fit.driven import driven_path
from tests.shared_data import SHARED_DATA

FLAT = "glass_k8"
NOISE_ARCSEC = 0.005
SEISMOMETERS = SHARED_DATA / "ground" / "two-seismometers.csv.gz"
SHOWN = ("b", "c", "n", "gamma_pa")
STEP_S = 0.05


class Ground(NamedTuple):
    """What drives a pendulum, and what a seismometer records of it: times, rad/s^2, any unit."""

    time_s: Floats
    drive: Floats
    seismometer: Floats
    seismometer_time_s: Floats | None = None


class Case(NamedTuple):
    """A ground for each seed."""

    name: str
    ground: Callable[[int], Ground]
    last_arcsec: float = 2.0


def white(q: float, noise: float) -> Callable[[int], Ground]:
    """A white drive, and a seismometer with so much white noise of its own."""

    def ground(seed: int) -> Ground:
        rng = np.random.default_rng([seed, 35])
        # a seismometer that begins with the first turning point would lack the first half-swing
        time = np.arange(-30.0, 2500.0, STEP_S)
        drive = q * np.sqrt(0.5 / STEP_S) * rng.standard_normal(len(time))
        own = noise * q * np.sqrt(0.5 / STEP_S) * rng.standard_normal(len(time))
        return Ground(time, drive, 1e9 * (drive + own))

    return ground


def recorded(q: float, *, same: bool = False, late_s: float = 0.0) -> Callable[[int], Ground]:
    """Acceleration by the known seismometer, a random part, up or down, of a density near 0.25 Hz."""
    with gzip.open(SEISMOMETERS) as file:
        time, known, unknown = np.loadtxt(file, delimiter=",", skiprows=1).T
    step_s = float(time[1] - time[0])
    acceleration = np.gradient(known, step_s)
    window = np.hanning(len(time))
    power = 2 * step_s * np.abs(np.fft.rfft(acceleration * window)) ** 2 / np.sum(window**2)
    frequency = np.fft.rfftfreq(len(time), step_s)
    density = np.sqrt(np.mean(power[(frequency > 0.2) & (frequency < 0.3)]))

    def ground(seed: int) -> Ground:
        rng = np.random.default_rng([seed, 36])
        begin_s, sign = rng.uniform(15.0, 560.0), rng.choice([-1.0, 1.0])
        drive = sign * q / density * acceleration
        if rng.integers(2):
            # the other way round in time it is another ground; counts follow velocity, which turns its sign
            drive, seen = drive[::-1], -(known if same else unknown)[::-1]
        else:
            seen = known if same else unknown
        return Ground(time - begin_s, np.ascontiguousarray(drive), seen.copy(), time - begin_s + late_s)

    return ground


def unrelated(q: float) -> Callable[[int], Ground]:
    """The seismometer of another run."""

    def ground(seed: int) -> Ground:
        found, other = white(q, 0.0)(seed), white(q, 0.0)(seed + 100_000)
        return Ground(found.time_s, found.drive, other.seismometer)

    return ground


def cases() -> Iterator[Case]:
    for noise in (0.0, 0.1, 0.3, 1.0):
        yield Case(f"white 1e-7, seismometer noise {noise:g}", white(1e-7, noise))
    yield Case("unrelated, white 1e-7", unrelated(1e-7))
    yield Case("unrelated, white 1e-8", unrelated(1e-8))
    if SEISMOMETERS.exists():
        yield Case("recorded 1e-7, the other sensor", recorded(1e-7))
        yield Case("recorded 3e-7, the other sensor", recorded(3e-7), last_arcsec=4.0)
        yield Case("recorded 1e-7, the same sensor", recorded(1e-7, same=True))
        yield Case("recorded 1e-7, wrong by 200 s", recorded(1e-7, late_s=200.0))


def decay(ground: Ground, seed: int, last_arcsec: float) -> TurningPoints:
    """Turning points of a pendulum on that ground, with noise."""
    parameters, pendulum = paper_pair(FLAT)

    def force(time_s: Floats) -> Floats:
        return np.interp(time_s, ground.time_s, ground.drive, left=0.0, right=0.0)

    time, turn, _ = driven_path(
        parameters, pendulum, q=0.0, seed=seed, forcing=force, last_arcsec=last_arcsec
    )
    rng = np.random.default_rng([seed, 77])
    return with_noise(time, np.abs(turn), parameters.period0_s, NOISE_ARCSEC, rng)


class Run(NamedTuple):
    """The fits of a decay, without and with the seismometer."""

    alone: FitResult
    fit: FitResult
    use: SeismometerUse


def one_run(case: Case, seed: int) -> Run:
    ground = case.ground(seed)
    pendulum = paper_pair(FLAT)[1]
    points = decay(ground, seed, case.last_arcsec)
    alone = fit_exact(points, pendulum, averaged=False)
    times = ground.time_s if ground.seismometer_time_s is None else ground.seismometer_time_s
    seismometer = Seismogram(times, ground.seismometer[:, None], ("Z",))
    found = fit_with_seismometer(points, pendulum, seismometer, alone, averaged=False)
    return Run(alone, found.fit, found.use)


def measure(case: Case, seeds: int, first: int) -> dict[str, Any]:
    """What the seismometer explains, what it saves, and whether intervals and scatter are right with it."""
    runs, failed = each_seed(lambda seed: one_run(case, seed), seeds, first)
    at = [runs[0].alone.names.index(name) for name in SHOWN]
    true = truth(paper_pair(FLAT)[0], runs[0].alone.names)[at]
    alone, fit = (np.array([of.values[at] - true for of in fits]) for fits in _fits(runs))
    u_alone, u = (np.array([of.standard_uncertainty[at] for of in fits]) for fits in _fits(runs))
    return {
        "seeds": seeds,
        "failed": failed,
        "used": sum(run.use.used for run in runs),
        "explained": float(np.median([run.use.explained for run in runs])),
        "gain_of_prediction": np.quantile([run.use.gain_of_prediction for run in runs], (0, 0.5, 1)).tolist(),
        "u_relative": (np.median(u, axis=0) / true).tolist(),
        "saved_u": np.median(u_alone / u, axis=0).tolist(),
        "saved_scatter": (rms(alone) / rms(fit)).tolist(),
        **coverage(fit / u),
        "moved_in_u": np.max(np.abs(fit - alone) / u_alone, axis=0).tolist(),
    }


def _fits(runs: list[Run]) -> tuple[list[FitResult], list[FitResult]]:
    """Without and with the seismometer."""
    return [run.alone for run in runs], [run.fit for run in runs]


def run(quick: bool = False, seeds: int = 100, only: tuple[str, ...] = ()) -> dict[str, Any]:
    """All cases; lists are of b, c, n, gamma."""
    return run_cases(cases(), measure, 3 if quick else seeds, only)

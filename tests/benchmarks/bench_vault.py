"""The exact fit with an auxiliary seismometer: coverage of its intervals.

Run as ``python -m tests.benchmarks vault [--quick]``. Decays are
integrated step by step, with the ground as a force; the fit shares no formula with that. The recorded
ground is that of two real seismometers at one place: one drives the pendulum, the other, whose response
nobody states, is the seismometer.
"""

import gzip
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from processing.fit import fit_exact
from processing.fit.known_drive import Seismogram
from processing.fit.seismometer import fit_with_seismometer
from tests.benchmarks.cases import run_of
from tests.benchmarks.coverage import NOISE_ARCSEC, Case, Floats, measure, of_pulls
from tests.processing.fit.decays import paper_pair, with_noise
from tests.processing.fit.driven import driven_path
from tests.rig.analysis.spinning import Held
from tests.shared_data import SHARED_DATA

PARAMETERS, PENDULUM = paper_pair("glass_k8")
SEISMOMETERS = SHARED_DATA / "ground" / "two-seismometers.csv.gz"
SHOWN = ("b", "c", "n", "gamma_pa")
STEP_S = 0.05


class Ground(NamedTuple):
    """What drives a pendulum, and what a seismometer records of it: times, rad/s^2, any unit."""

    time_s: Floats
    drive: Floats
    seismometer: Floats
    seismometer_time_s: Floats | None = None


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


def case(name: str, ground: Callable[[int], Ground], last_arcsec: float = 2.0) -> Case:
    """Turning points of a pendulum on that ground, with noise, fitted with the seismometer."""

    def found(seed: int) -> dict[str, Held]:
        world = ground(seed)

        def force(time_s: Floats) -> Floats:
            return np.interp(time_s, world.time_s, world.drive, left=0.0, right=0.0)

        time, turn, _ = driven_path(
            PARAMETERS, PENDULUM, q=0.0, seed=seed, forcing=force, last_arcsec=last_arcsec
        )
        rng = np.random.default_rng([seed, 77])
        points = with_noise(time, np.abs(turn), PARAMETERS.period0_s, NOISE_ARCSEC, rng)
        alone = fit_exact(points, PENDULUM, averaged=False)
        times = world.time_s if world.seismometer_time_s is None else world.seismometer_time_s
        seismometer = Seismogram(times, world.seismometer[:, None], ("Z",))
        fit = fit_with_seismometer(points, PENDULUM, seismometer, alone, averaged=False).fit
        off = {shown: fit.estimate(shown).value - getattr(PARAMETERS, shown) for shown in SHOWN}
        return of_pulls({shown: by / fit.estimate(shown).standard_uncertainty for shown, by in off.items()})

    return Case(name, found)


def cases() -> list[Case]:
    noises = (0.0, 0.1, 0.3, 1.0)
    out = [case(f"white 1e-7, seismometer noise {noise:g}", white(1e-7, noise)) for noise in noises]
    out += [case(f"unrelated, white {q:.0e}", unrelated(q)) for q in (1e-7, 1e-8)]
    if SEISMOMETERS.exists():
        out.append(case("recorded 1e-7, the other sensor", recorded(1e-7)))
        out.append(case("recorded 3e-7, the other sensor", recorded(3e-7), last_arcsec=4.0))
        out.append(case("recorded 1e-7, the same sensor", recorded(1e-7, same=True)))
        out.append(case("recorded 1e-7, wrong by 200 s", recorded(1e-7, late_s=200.0)))
    return out


run = run_of(measure, cases, seeds=100, quick_seeds=2)

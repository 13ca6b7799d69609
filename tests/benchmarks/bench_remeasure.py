"""Turning points from samples to parameters: errors in units of what is stated, for many ways to sample.

Run as ``python -m tests.benchmarks remeasure [--quick]``. The
motion is the tests' own integration, and the simulated rig's where there is a drag; a run goes through the
swing detector and is measured again as in a session.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import NamedTuple

import numpy as np

from acquisition.simulation.settings import SimulationSettings
from acquisition.simulation.true_path import true_path, true_turning_points
from processing.contact import ContactParameters, PendulumOnBall
from processing.deflections import DeflectionUnit, slow_deflections
from processing.fit import fit_exact
from processing.swing import half_cycles_of_blocks, turning_points
from rig.analysis import refined_half_cycles
from rig.analysis.ambient import FittedDrag
from rig.settings import FitSettings
from tests.benchmarks.cases import run_of
from tests.benchmarks.coverage import Case, Floats, measure, of_fit, truth_of
from tests.processing.fit.decays import ARCSEC, paper_pair
from tests.processing.fit.driven import driven_path
from tests.rig.analysis.spinning import Held

_MIDDLE_RAD = 60 * ARCSEC
DRAG_S = 1e-3


class Samples(NamedTuple):
    time_s: Floats
    angle_rad: Floats
    parameters: ContactParameters
    pendulum: PendulumOnBall


@cache
def swing(frames_per_s: float, period0_s: float | None = None, p: float | None = None) -> Samples:
    """The paper's glass pair, another period or exponent with the same loss in the middle."""
    parameters, pendulum = paper_pair("glass_k8")
    if p is not None:
        parameters = replace(parameters, b=parameters.b * _MIDDLE_RAD ** (parameters.p - p), p=p)
    if period0_s is not None:
        parameters = replace(parameters, period0_s=period0_s)
    _, _, path = driven_path(parameters, pendulum, q=0.0, seed=1, frames_per_s=frames_per_s)
    return Samples(np.arange(len(path)) / frames_per_s, path, parameters, pendulum)


@cache
def dragged() -> Samples:
    parameters, pendulum = paper_pair("glass_k8", drag_s=DRAG_S)
    contact = truth_of(parameters, drag=True)
    settings = SimulationSettings.model_validate(
        {
            "contact": {**contact, "contact_radius_m": pendulum.contact_radius_m},
            "axes": {"leakage": 0.0, "rest_slow_arcsec": 0.0, "rest_drift_slow_arcsec_per_min": 0.0},
        }
    )
    end_s = float(true_turning_points(settings).time_s[-1])
    path = true_path(settings, end_s, 25.0)
    return Samples(np.asarray(path.times_ns * 1e-9, np.float64), path.y_rad, parameters, pendulum)


def irregular(samples: Samples, rng: np.random.Generator) -> Samples:
    """A third of the samples missing at random, and twenty gaps of 1 to 6 s."""
    kept = rng.random(len(samples.time_s)) > 1 / 3
    for begin_s in rng.uniform(20.0, samples.time_s[-1], 20):
        kept &= (samples.time_s < begin_s) | (samples.time_s > begin_s + rng.uniform(1.0, 6.0))
    return samples._replace(time_s=samples.time_s[kept], angle_rad=samples.angle_rad[kept])


def in_mid_swing(samples: Samples, rng: np.random.Generator) -> Samples:
    """From a random moment of the first period on, with 1 arcsec of a faster mode in it."""
    kept = samples.time_s > rng.uniform(0.0, samples.parameters.period0_s)
    time_s = samples.time_s[kept]
    fast = ARCSEC * np.cos(2 * np.pi * time_s / 0.83 + rng.uniform(0.0, 2 * np.pi)) * np.exp(-time_s / 200)
    return samples._replace(time_s=time_s, angle_rad=samples.angle_rad[kept] + fast)


def untouched(samples: Samples, _: np.random.Generator) -> Samples:
    return samples


def case(
    name: str,
    clean: Callable[[], Samples],
    noise_arcsec: float,
    sampled: Callable[[Samples, np.random.Generator], Samples] = untouched,
    drag: bool = False,
) -> Case:
    """Samples without noise, the noise of each, what is done to them for a seed; cases share their noise."""
    noise = noise_arcsec * ARCSEC

    def found(seed: int) -> dict[str, Held]:
        rng = np.random.default_rng([seed, 15])
        samples = sampled(clean(), rng)
        times_ns = np.rint(samples.time_s * 1e9).astype(np.int64)
        seen_rad = samples.angle_rad + noise * rng.standard_normal(len(times_ns))
        blocks = [slow_deflections(times_ns, seen_rad, noise)]
        refined = refined_half_cycles(
            half_cycles_of_blocks(blocks), blocks, DeflectionUnit.RAD, samples.pendulum, FitSettings(),
            drag=FittedDrag(fitted=drag),
        )  # fmt: skip
        fit = refined.exact or fit_exact(turning_points(refined.half_cycles), samples.pendulum, drag=drag)
        return of_fit(fit, truth_of(samples.parameters, drag))

    return Case(name, found)


def cases() -> list[Case]:
    return [
        *(case(f"25 Hz {noise:g}", lambda: swing(25.0), noise) for noise in (0.03, 0.1, 0.2, 0.5)),
        case("500 Hz 0.0005", lambda: swing(500.0), 0.0005),
        case("irregular 50 Hz", lambda: swing(50.0), 0.02, irregular),
        case("drag 25 Hz", dragged, 0.03, drag=True),
        case("mid-swing 50 Hz", lambda: swing(50.0), 0.02, in_mid_swing),
        case("T0 1.5 s", lambda: swing(50.0, period0_s=1.5), 0.03),
        case("T0 12 s", lambda: swing(25.0, period0_s=12.0), 0.03),
        case("p 0.8", lambda: swing(25.0, p=0.8), 0.03),
        case("p 1.3", lambda: swing(25.0, p=1.3), 0.03),
    ]


run = run_of(measure, cases, seeds=40, quick_seeds=2, apart=0)

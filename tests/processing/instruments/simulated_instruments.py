"""Simulation of every kind of pendulum as configured, its measurement, and the true values.

Samples have white noise of a stated size; detection and reduction are those of the rig. Truths are read
from the simulator's own noise-free turning points and settings.
"""

import math
from collections.abc import Callable, Mapping
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from acquisition.simulation.settings import SimulationSettings
from acquisition.simulation.true_path import (
    TruePath,
    TruePoints,
    noisy,
    true_path,
    true_turning_points,
)
from processing.deflections import Deflections, DeflectionUnit, joined
from processing.estimate import Estimate
from processing.fit.exact import fit_exact
from processing.instruments.crossings import circular_error
from processing.instruments.damping_fit import ValueWithSharedErrors, damping, ratio
from processing.instruments.descriptions import DEGREE_RAD, INSTRUMENTS
from processing.instruments.friction_law import fit_friction_law, herbert_hardness, rolling_friction
from processing.instruments.turning import refined_turning_points
from processing.swing import TurningPoints, half_cycles_of, turning_points
from rig.analysis.passing_deflections import PassingDeflections
from rig.analysis.turning_plane import follow_plane
from rig.instrument import complete, pendulum_on_ball
from rig.settings import load_configuration
from tests.processing.fit.decays import with_noise

CONFIGS = Path(__file__).resolve().parents[3] / "configs" / "instruments"
NOISE_RAD = 2e-5
"""Of a sample: a fiftieth of a pixel on the sensors of the configurations is 5e-6 rad or less."""
POINT_NOISE_ARCSEC = 0.005
_HERBERT_KEPT = 0.3
"""Share of the first amplitude at which its records end: twelve swings and more."""


class Recovered(NamedTuple):
    """A reported value and what the simulator says."""

    estimate: Estimate
    truth: float

    @property
    def pull(self) -> float:
        return (self.estimate.value - self.truth) / self.estimate.standard_uncertainty


class Samples(NamedTuple):
    times_ns: NDArray[np.int64]
    x_rad: NDArray[np.float64]
    y_rad: NDArray[np.float64]
    u_rad: NDArray[np.float64]


@cache
def simulation(name: str, *changes: tuple[str, float]) -> SimulationSettings:
    """The truth of a configuration, its contact changed as stated; axes of the pendulum's own."""
    truth = load_configuration(CONFIGS / f"{name}.toml").simulation
    return truth.model_copy(update={"contact": truth.contact.model_copy(update=dict(changes))})


@cache
def truth_points(settings: SimulationSettings, final_deg: float) -> TruePoints:
    return true_turning_points(settings, final_deg * 3600)


@cache
def _clean(settings: SimulationSettings, duration_s: float) -> TruePath:
    return true_path(settings, duration_s)


def samples(settings: SimulationSettings, final_deg: float, seed: int, noise_rad: float) -> Samples:
    """Noisy deflections of a decay down to an amplitude."""
    points = truth_points(settings, final_deg)
    duration_s = float(points.time_s[-1])
    found = noisy(_clean(settings, duration_s), noise_rad, noise_rad, seed)
    return Samples(found.times_ns, found.x_rad, found.y_rad, np.full(len(found.times_ns), noise_rad))


def detected(found: Samples) -> TurningPoints:
    """Turning points as the rig takes them from samples of a large swing; times from the first sample."""
    half_cycles = half_cycles_of(found.times_ns, found.y_rad, found.u_rad)
    return turning_points(refined_turning_points(found.times_ns, found.y_rad, found.u_rad, half_cycles))


def points_of(
    settings: SimulationSettings, final_deg: float, seed: int, noise_rad: float = NOISE_RAD
) -> TurningPoints:
    return detected(samples(settings, final_deg, seed, noise_rad))


def true_time_s(points: TruePoints, level_deg: float) -> float:
    """When the envelope passes a level, from the simulator's turning points."""
    return float(
        np.interp(-math.log(level_deg * DEGREE_RAD), -np.log(np.abs(points.angle_rad)), points.time_s)
    )


def _levels(kind: str) -> tuple[float, float]:
    description = INSTRUMENTS[kind]
    return description.start_amplitude_rad / DEGREE_RAD, description.end_amplitude_rad / DEGREE_RAD


def _damping_truth(settings: SimulationSettings, start: float, end: float) -> float:
    points = truth_points(settings, 0.8 * end)
    return true_time_s(points, end) - true_time_s(points, start)


def _damped(kind: str, seed: int) -> Mapping[str, Recovered]:
    """Damping time on the sample and its ratio to glass, or, for Kuznetsov, on the sample alone."""
    start, end = _levels(kind)
    sample = simulation(kind)
    found = damping(points_of(sample, 0.9 * end, seed), start * DEGREE_RAD, end * DEGREE_RAD)
    truth_s = _damping_truth(sample, start, end)
    recovered = {"time_s": Recovered(found.time_s, truth_s)}
    if INSTRUMENTS[kind].report == "damping":
        glass = simulation(f"{kind}-glass")
        plate = damping(points_of(glass, 0.9 * end, seed + 1000), start * DEGREE_RAD, end * DEGREE_RAD)
        glass_s = _damping_truth(glass, start, end)
        recovered["ratio"] = Recovered(
            ratio(ValueWithSharedErrors(*found.time_s), ValueWithSharedErrors(*plate.time_s)),
            truth_s / glass_s,
        )
        recovered["glass_time_s"] = Recovered(plate.time_s, glass_s)
    return recovered


def _kuznetsov_two(seed: int) -> Mapping[str, Recovered]:
    # without the constant part friction is a pure power, whose exponent is then known
    pure = simulation("kuznetsov_two", ("c", 0.0))
    law = fit_friction_law(points_of(pure, 2.2, seed))
    return {
        **_damped("kuznetsov_two", seed),
        "exponent": Recovered(law.exponent, pure.contact.p),
        "moment": Recovered(law.moment, pure.contact.b * law.reference_rad**pure.contact.p),
    }


def _kuznetsov_one(seed: int) -> Mapping[str, Recovered]:
    settings = simulation("kuznetsov_one")
    start, end = _levels("kuznetsov_one")
    found = _turning(samples(settings, 0.9 * end, seed, NOISE_RAD), settings)
    noise = found.u_rad
    samples_of_run = Deflections(found.times_ns, found.x_rad, found.y_rad, noise, noise, DeflectionUnit.RAD)
    passing = PassingDeflections([samples_of_run], DeflectionUnit.RAD)
    followed = follow_plane(
        half_cycles_of(found.times_ns, found.y_rad, noise), passing, None, along_line=True
    )
    assert followed.plane is not None
    inside = damping(
        detected(found._replace(y_rad=joined(followed.deflections, DeflectionUnit.RAD).y)),
        start * DEGREE_RAD,
        end * DEGREE_RAD,
    )
    rate = Estimate(followed.plane.mean_rate(), followed.plane.u_mean_rate())
    return {
        "rate_rad_per_s": Recovered(rate, settings.axes.spin_rad_per_s),
        "time_s": Recovered(inside.time_s, _damping_truth(settings, start, end)),
    }


def _turning(found: Samples, settings: SimulationSettings) -> Samples:
    """Axes fixed on the sensor look at a plane that turns."""
    angle = settings.axes.spin_rad_per_s * found.times_ns * 1e-9
    sine, cosine = np.sin(angle), np.cos(angle)
    return found._replace(
        x_rad=found.x_rad * cosine + found.y_rad * sine, y_rad=found.y_rad * cosine - found.x_rad * sine
    )


def _herbert(kind: str, seed: int) -> Mapping[str, Recovered]:
    settings = simulation(kind)
    found = samples(settings, _HERBERT_KEPT * settings.release.amplitude_arcsec / 3600, seed, NOISE_RAD)
    points = detected(found)
    hardness = herbert_hardness(points)
    truth = truth_points(settings, _HERBERT_KEPT * settings.release.amplitude_arcsec / 3600)
    first = int(np.argmin(np.abs(np.abs(truth.angle_rad) - hardness.first_amplitude_rad)))
    size = np.abs(truth.angle_rad)
    assert hardness.ten_swings_s is not None
    return {
        "ten_swings_s": Recovered(
            hardness.ten_swings_s, float(truth.time_s[first + 10] - truth.time_s[first])
        ),
        "first_swing_times_ten_s": Recovered(
            hardness.first_swing_times_ten_s, 10 * float(truth.time_s[first + 1] - truth.time_s[first])
        ),
        "scale_hardness": Recovered(hardness.scale_hardness, 50 * float(1 + size[first + 1] / size[first])),
    }


def _tomlinson(seed: int) -> Mapping[str, Recovered]:
    settings = simulation("tomlinson")
    contact = settings.contact
    lever, radius = Estimate(10e-3, 0.0), Estimate(2e-3, 0.0)
    found = rolling_friction(points_of(settings, 0.1, seed), lever, radius)
    at = found.law.reference_rad
    assert found.coefficient is not None
    size = np.abs(truth_points(settings, 0.08).angle_rad)
    middle = 0.5 * np.log(size[2:] * size[:-2])
    decrement = np.interp(-math.log(at), -middle, np.log(size[:-2] / size[2:]))
    return {
        "exponent": Recovered(found.law.exponent, contact.p),
        "coefficient": Recovered(
            found.coefficient, contact.b * at**contact.p / (contact.p + 1) * lever.value / radius.value
        ),
        "decrement": Recovered(found.decrement, float(decrement)),
    }


def _knife_edge(seed: int) -> Mapping[str, Recovered]:
    # a sharp edge that does not yield is the ideal pendulum, whose law is known
    ideal = simulation("knife_edge", ("gamma_pa", 0.0), ("ball_radius_m", 1e-9))
    found = circular_error(points_of(ideal, 0.5, seed))
    # friction b |phi| takes from the restoring moment inwards and adds to it outwards
    b = ideal.contact.b
    period_s = 0.5 * ideal.contact.period0_s * (1 / math.sqrt(1 - b) + 1 / math.sqrt(1 + b))
    return {
        "period0_s": Recovered(found.period0_s, period_s),
        "factor": Recovered(found.factor, 1.0),
    }


def _contact(kind: str, seed: int) -> Mapping[str, Recovered]:
    """The full model from noisy turning points; the ball's load is its share of the weight."""
    config = complete(load_configuration(CONFIGS / f"{kind}.toml"))
    truth = config.simulation.contact
    pendulum = pendulum_on_ball(config)
    assert pendulum is not None
    turns, rng = truth_points(config.simulation, 2 / 3600), np.random.default_rng(seed)
    angle_rad = np.abs(turns.angle_rad)
    points = with_noise(turns.time_s, angle_rad, truth.period0_s, POINT_NOISE_ARCSEC, rng)
    fit = fit_exact(points, pendulum)
    recovered = {name: Recovered(fit.estimate(name), getattr(truth, name)) for name in ("p", "c")}
    # friction and adhesion at the amplitude where they are known best, clear of the exponents' scatter
    at = math.log(fit.reference_rad)
    for name, power in (("b", "p"), ("gamma_pa", "n")):
        i, j = fit.names.index(name), fit.names.index(power)
        value = fit.values[i]
        by = np.zeros(len(fit.values))
        by[i], by[j] = 1 / value, at
        u = math.sqrt(by @ fit.covariance @ by)
        found = math.log(value) + fit.values[j] * at
        expected = math.log(getattr(truth, name)) + getattr(truth, power) * at
        recovered[f"ln {name} at middle"] = Recovered(Estimate(found, u), expected)
    return recovered


MEASUREMENTS: Mapping[str, Callable[[int], Mapping[str, Recovered]]] = {
    "single_ball": lambda seed: _contact("single_ball", seed),
    "two_ball": lambda seed: _contact("two_ball", seed),
    "herbert": lambda seed: _herbert("herbert", seed),
    "herbert_roller": lambda seed: _herbert("herbert_roller", seed),
    "kuznetsov_one": _kuznetsov_one,
    "kuznetsov_two": _kuznetsov_two,
    "koenig": lambda seed: _damped("koenig", seed),
    "persoz": lambda seed: _damped("persoz", seed),
    "tomlinson": _tomlinson,
    "knife_edge": _knife_edge,
}
"""Kind -> reported quantities of the run with this seed, beside their truths."""

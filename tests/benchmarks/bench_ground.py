"""The exact fit on ground that moves: coverage of its intervals.

Run as ``python -m tests.benchmarks ground [--quick]``. White
drives come from the tests' own integration, the basement and the recorded ground from the simulated rig;
neither shares a formula with the fit. A case named "frames" goes through the swing detector, from 25 tilts a
second with the noise of a tracked spot; the others give the fit true turning points with noise.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from acquisition.simulation.settings import SimulationSettings
from acquisition.simulation.true_path import true_path, true_turning_points
from processing.contact.laws import PAPER
from processing.fit import fit_with_knocks
from processing.swing import TurningPoints, turning_points
from tests.benchmarks.cases import each_seed, run_cases
from tests.benchmarks.coverage import FRAMES_PER_S, in_frames, of_fits
from tests.processing.fit.decays import ARCSEC, PAIRS, paper_pair, truth, with_noise
from tests.processing.fit.driven import World, driven_decay, driven_path
from tests.shared_data import SHARED_DATA

NOISE_ARCSEC = 0.005
GROUND_FILE = SHARED_DATA / "ground" / "ulaanbaatar-lh1.csv"


class Case(NamedTuple):
    """A pair on a ground, and how many seeds of it."""

    name: str
    flat: str
    points: Callable[[int], TurningPoints]
    share: float = 1.0
    averaged: bool = False


def white(flat: str, q: float) -> Case:
    parameters, pendulum = paper_pair(flat)
    return Case(
        f"{flat} q={q:g}",
        flat,
        lambda seed: driven_decay(parameters, pendulum, q=q, noise_arcsec=NOISE_ARCSEC, seed=5000 + seed),
    )


def knocked(flat: str, knock_arcsec: float) -> Case:
    """Of a quiet ground, with one knock at a random time."""
    parameters, pendulum = paper_pair(flat)

    def points(seed: int) -> TurningPoints:
        rng = np.random.default_rng([seed, 77])
        rate_rad_per_s = 2 * np.pi / parameters.period0_s
        knock = knock_arcsec * ARCSEC * rate_rad_per_s * rng.choice([-1.0, 1.0])
        world = World(event_s=rng.uniform(100.0, 600.0), knock_rad_per_s=knock)
        time_s, turn, _ = driven_path(parameters, pendulum, world, q=1e-9, seed=5000 + seed)
        return with_noise(time_s, np.abs(turn), parameters.period0_s, NOISE_ARCSEC, rng)

    return Case(f"{flat} knock of {knock_arcsec:g} arcsec", flat, points)


def white_frames(flat: str, q: float) -> Case:
    parameters, pendulum = paper_pair(flat)

    def points(seed: int) -> TurningPoints:
        _, _, path = driven_path(parameters, pendulum, q=q, seed=5000 + seed, frames_per_s=FRAMES_PER_S)
        return turning_points(in_frames(path, NOISE_ARCSEC, [seed, 78], pendulum).swings)

    return Case(f"{flat} q={q:g} frames", flat, points, 0.15, averaged=True)


def simulated(flat: str, ground: dict[str, Any], run: int) -> SimulationSettings:
    parameters, pendulum = paper_pair(flat)
    contact = {name: getattr(parameters, name) for name in PAPER.names()}
    return SimulationSettings.model_validate(
        {
            "contact": {**contact, "contact_radius_m": pendulum.contact_radius_m},
            "ground": {"mass_centre_height_m": 2e-4, **ground, "seed": run},
            "axes": {"leakage": 0.0, "rest_slow_arcsec": 0.0, "rest_drift_slow_arcsec_per_min": 0.0},
        }
    )


def simulated_case(name: str, flat: str, ground: Callable[[int], dict[str, Any]]) -> Case:
    def points(seed: int) -> TurningPoints:
        time_s, angle_rad = true_turning_points(simulated(flat, ground(seed), seed), run=seed)
        rng = np.random.default_rng([seed, 77])
        return with_noise(time_s, np.abs(angle_rad), paper_pair(flat)[0].period0_s, NOISE_ARCSEC, rng)

    return Case(f"{flat} {name}", flat, points)


def simulated_frames(name: str, flat: str, ground: Callable[[int], dict[str, Any]]) -> Case:
    def points(seed: int) -> TurningPoints:
        settings = simulated(flat, ground(seed), seed)
        end_s = float(true_turning_points(settings, run=seed).time_s[-1])
        path = true_path(settings, end_s, FRAMES_PER_S, run=seed).y_rad
        return turning_points(in_frames(path, NOISE_ARCSEC, [seed, 78], paper_pair(flat)[1]).swings)

    return Case(f"{flat} {name} frames", flat, points, 0.15, averaged=True)


def basement(_: int) -> dict[str, Any]:
    return {"model": "peterson", "between_noise_models": 0.5}


def recorded(seed: int) -> dict[str, Any]:
    """The recorded ground from a random second on: 90 minutes of record, and runs of at most 40."""
    offset_s = float(np.random.default_rng([seed, 5]).integers(0, 2500))
    return {"model": "file", "file": GROUND_FILE, "file_offset_s": offset_s}


def cases() -> list[Case]:
    """Those of the record; the one of a recorded ground only where the record is."""
    out = [white("glass_k8", q) for q in (0.0, 1e-9, 1e-8, 1e-7)]
    out += [simulated_case("basement", flat, basement) for flat in PAIRS]
    if GROUND_FILE.exists():
        out.append(simulated_case("recorded ground", "glass_k8", recorded))
    out += [white_frames("glass_k8", q) for q in (0.0, 1e-8, 1e-7)]
    out += [simulated_frames("basement", flat, basement) for flat in PAIRS]
    return out + [knocked("glass_k8", size) for size in (0.03, 0.3, 3.0)]


def measure(case: Case, seeds: int, first: int) -> dict[str, Any]:
    """Shares of seeds whose intervals hold the truth, and rms errors in units of u."""
    count = max(round(seeds * case.share), 4)
    parameters, pendulum = paper_pair(case.flat)
    names = PAPER.names()
    fits, failed = each_seed(
        lambda seed: fit_with_knocks(case.points(seed), pendulum, averaged=case.averaged), count, first
    )
    grounds = [fit.ground for fit in fits if fit.ground is not None]
    return {
        "seeds": count,
        "failed": failed,
        "called_correlated": sum(bool(fit.whiteness and fit.whiteness.correlated) for fit in fits),
        "knocks": sum(len(fit.changes) for fit in fits),
        "half_cycles_left_out": sum(ground.left_out_half_cycles for ground in grounds),
        "q_median": float(np.median([ground.density_rad_per_s2_rthz.value for ground in grounds])),
        **of_fits(fits, names, truth(parameters, names)),
    }


def run(quick: bool = False, seeds: int = 200, only: tuple[str, ...] = ()) -> dict[str, Any]:
    """All of it; numbers as plain values. The surface energy is proportional to c, and so is its interval."""
    return run_cases(cases(), measure, 4 if quick else seeds, only)

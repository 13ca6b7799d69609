"""The contact's moments without a law: how often bands of 68 % hold the truth, how wide they are, CPU time.

Run as ``python -m tests.benchmarks without_law [--quick]``.
At rest the decays are the tests' own, in the basement those of the simulated rig; the truth is the paper's
law, expressed as the splines are, with no moment proportional to the angle at the reference.
"""

from dataclasses import asdict
from time import process_time
from typing import Any, NamedTuple

import numpy as np

from processing.contact import PendulumOnBall
from processing.contact.law import ContactParameters
from processing.contact.laws import PAPER
from processing.fit import fit_model_free
from processing.fit.law_comparison import FreeMoments
from tests.benchmarks.bench_ground import Case, basement, simulated_case
from tests.benchmarks.cases import each_seed, run_cases
from tests.benchmarks.coverage import Floats
from tests.processing.fit.decays import ARCSEC, PAIRS, decay, paper_pair

ANGLES_ARCSEC = (2.5, 4.0, 6.0, 10.0, 16.0, 25.0, 40.0, 60.0, 90.0, 115.0)
NOISE_ARCSEC = 0.005


def true_moments(found: FreeMoments, parameters: ContactParameters, pendulum: PendulumOnBall) -> np.ndarray:
    """Friction and elastic moment of the paper's law where gravity has all that is proportional there."""
    phi, at = found.phi_rad, found.reference_rad
    weight = pendulum.mass_kg * pendulum.gravity_m_per_s2 * pendulum.ball_radius_m
    every = np.append(phi, at)
    friction, elastic = PAPER.branch_moments(every, -np.ones_like(every), asdict(parameters), pendulum)
    share = elastic[-1] / at
    return np.asarray(np.array([friction[:-1], elastic[:-1] - share * phi]) / (1 - share / weight))


def rest(flat: str) -> Case:
    parameters, pendulum = paper_pair(flat)
    return Case(
        f"{flat} rest", flat, lambda seed: decay(parameters, pendulum, noise_arcsec=NOISE_ARCSEC, seed=seed)
    )


class Found(NamedTuple):
    """Errors over u of both moments (NaN at angles it has not), and how wide the friction's band is."""

    pull: Floats
    width: Floats
    lowest: float
    cpu_s: float


def found_in(case: Case, seed: int) -> Found:
    parameters, pendulum = paper_pair(case.flat)
    angles = np.array(ANGLES_ARCSEC) * ARCSEC
    points = case.points(seed)
    began_s = process_time()
    free = fit_model_free(points, pendulum)
    cpu_s = process_time() - began_s
    seen = (angles > 1.1 * free.points.amplitude.min()) & (angles < free.points.amplitude.max() / 1.05)
    found, everywhere = free.moments(angles), free.moments()
    truth = true_moments(found, parameters, pendulum)
    pull = [
        (found.friction_n_m - truth[0]) / found.u_friction_n_m,
        (found.elastic_n_m - truth[1]) / found.u_elastic_n_m,
    ]
    return Found(
        np.where(seen, pull, np.nan),
        np.where(seen, found.u_friction_n_m / truth[0], np.nan),
        float(np.min(everywhere.friction_n_m / everywhere.u_friction_n_m)),
        cpu_s,
    )


def measure(case: Case, seeds: int, _: int) -> dict[str, Any]:
    """Coverage at all angles and by angle, and the median band over the friction."""
    found, failed = each_seed(lambda seed: found_in(case, seed), seeds)
    pull = np.array([one.pull for one in found])
    inside = np.where(np.isfinite(pull), np.abs(pull) < 1, np.nan)
    by_angle = np.nanmean(inside, axis=0)
    return {
        "seeds": seeds,
        "failed": failed,
        "friction": float(np.nanmean(inside[:, 0])),
        "elastic": float(np.nanmean(inside[:, 1])),
        "friction_by_angle": by_angle[0].round(2).tolist(),
        "elastic_by_angle": by_angle[1].round(2).tolist(),
        "lowest_friction_over_u": min(one.lowest for one in found),
        "u_friction_percent": (100 * np.nanmedian([one.width for one in found], axis=0)).round(3).tolist(),
        "cpu_s": float(np.median([one.cpu_s for one in found])),
    }


def run(quick: bool = False, seeds: int = 200, only: tuple[str, ...] = ()) -> dict[str, Any]:
    """At rest and in the basement, of all pairs."""
    cases = [rest(flat) for flat in PAIRS] + [simulated_case("basement", flat, basement) for flat in PAIRS]
    return run_cases(cases, measure, 5 if quick else seeds, only)

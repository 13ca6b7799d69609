"""The contact's moments without a law: how often bands of 68 % hold the truth, how wide they are, CPU time.

Run as ``python -m tests.benchmarks without_law [--quick]``.
At rest the decays are the tests' own, in the basement those of the simulated rig; the truth is the paper's
law, expressed as the splines are, with no moment proportional to the angle at the reference.
"""

from dataclasses import asdict
from time import process_time
from typing import Any

import numpy as np

from processing.contact import PendulumOnBall
from processing.contact.law import ContactParameters
from processing.contact.laws import PAPER
from processing.errors import RigError
from processing.fit import fit_model_free
from processing.fit.model_free import FreeMoments
from tests.benchmarks.bench_ground import Case, basement, simulated_case
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
    return np.array([friction[:-1], elastic[:-1] - share * phi]) / (1 - share / weight)


def rest(flat: str) -> Case:
    parameters, pendulum = paper_pair(flat)
    return Case(
        f"{flat} rest", flat, lambda seed: decay(parameters, pendulum, noise_arcsec=NOISE_ARCSEC, seed=seed)
    )


def measured(case: Case, seeds: int) -> dict[str, Any]:
    """Coverage at all angles and by angle, and the median band over the friction."""
    parameters, pendulum = paper_pair(case.flat)
    angles = np.array(ANGLES_ARCSEC) * ARCSEC
    pulls, widths, lowest, cpu_s, failed = [], [], [], [], 0
    for seed in range(seeds):
        points = case.points(seed)
        began_s = process_time()
        try:
            free = fit_model_free(points, pendulum)
        except RigError:
            failed += 1
            continue
        cpu_s.append(process_time() - began_s)
        seen = (angles > 1.1 * free.points.amplitude.min()) & (angles < free.points.amplitude.max() / 1.05)
        found = free.moments(angles)
        truth = true_moments(found, parameters, pendulum)
        pull = np.array(
            [
                (found.friction_n_m - truth[0]) / found.u_friction_n_m,
                (found.elastic_n_m - truth[1]) / found.u_elastic_n_m,
            ]
        )
        pulls.append(np.where(seen, pull, np.nan))
        everywhere = free.moments()
        lowest.append(float(np.min(everywhere.friction_n_m / everywhere.u_friction_n_m)))
        widths.append(np.where(seen, found.u_friction_n_m / truth[0], np.nan))
    pull = np.array(pulls)
    inside = np.where(np.isfinite(pull), np.abs(pull) < 1, np.nan)
    by_angle = np.nanmean(inside, axis=0)
    return {
        "seeds": seeds,
        "failed": failed,
        "friction": float(np.nanmean(inside[:, 0])),
        "elastic": float(np.nanmean(inside[:, 1])),
        "friction_by_angle": by_angle[0].round(2).tolist(),
        "elastic_by_angle": by_angle[1].round(2).tolist(),
        "lowest_friction_over_u": float(np.min(lowest)),
        "friction_below_zero": int(np.count_nonzero(np.array(lowest) < 0)),
        "u_friction_percent": (100 * np.nanmedian(widths, axis=0)).round(3).tolist(),
        "cpu_s": float(np.median(cpu_s)),
    }


def run(quick: bool = False, seeds: int = 200, only: tuple[str, ...] = ()) -> dict[str, Any]:
    cases = [rest(flat) for flat in PAIRS] + [simulated_case("basement", flat, basement) for flat in PAIRS]
    result = {}
    for case in cases:
        if not only or any(word in case.name for word in only):
            result[case.name] = measured(case, 5 if quick else seeds)
            print(case.name, result[case.name], flush=True)
    return result

"""The contact's moments without a law: how often bands of 68 % hold the truth.

Run as ``python -m tests.benchmarks without_law [--quick]``.
At rest the decays are the tests' own, in the basement those of the simulated rig; the truth is the paper's
law, expressed as the splines are, with no moment proportional to the angle at the reference.
"""

from dataclasses import asdict
from typing import Any, NamedTuple

import numpy as np

from processing.contact import PendulumOnBall
from processing.contact.law import ContactParameters
from processing.contact.laws import PAPER
from processing.fit import fit_model_free
from processing.fit.law_comparison import FreeMoments
from processing.swing import TurningPoints
from tests.benchmarks.bench_decays import basement, simulated_turns
from tests.benchmarks.cases import each_seed, run_of
from tests.benchmarks.coverage import NOISE_ARCSEC, Floats
from tests.processing.fit.decays import ARCSEC, PAIRS, decay, paper_pair

ANGLES_ARCSEC = (2.5, 4.0, 6.0, 10.0, 16.0, 25.0, 40.0, 60.0, 90.0, 115.0)


def true_moments(found: FreeMoments, parameters: ContactParameters, pendulum: PendulumOnBall) -> np.ndarray:
    """Friction and elastic moment of the paper's law where gravity has all that is proportional there.

    They are those of a fit that knows no T0.
    """
    phi, at = found.phi_rad, found.reference_rad
    weight = pendulum.mass_kg * pendulum.gravity_m_per_s2 * pendulum.ball_radius_m
    every = np.append(phi, at)
    friction, elastic = PAPER.branch_moments(every, -np.ones_like(every), asdict(parameters), pendulum)
    share = elastic[-1] / at
    return np.asarray(np.array([friction[:-1], elastic[:-1] - share * phi]) / (1 - share / weight))


class Case(NamedTuple):
    """A pair, at rest or in the basement."""

    flat: str
    moving: bool

    @property
    def name(self) -> str:
        return f"{self.flat} {'basement' if self.moving else 'rest'}"

    def points(self, seed: int) -> TurningPoints:
        if self.moving:
            return simulated_turns(self.flat, basement)(seed)
        return decay(*paper_pair(self.flat), noise_arcsec=NOISE_ARCSEC, seed=seed)


def held_in(case: Case, seed: int) -> Floats:
    """Whether the bands of both moments hold the truth at each angle; NaN at angles it has not."""
    parameters, pendulum = paper_pair(case.flat)
    angles = np.array(ANGLES_ARCSEC) * ARCSEC
    free = fit_model_free(case.points(seed), pendulum)
    seen = (angles > 1.1 * free.points.amplitude.min()) & (angles < free.points.amplitude.max() / 1.05)
    found = free.moments(angles)
    friction, elastic = true_moments(found, parameters, pendulum)
    inside = [
        np.abs(found.friction_n_m - friction) < found.u_friction_n_m,
        np.abs(found.elastic_n_m - elastic) < found.u_elastic_n_m,
    ]
    return np.where(seen, inside, np.nan)


def measure(case: Case, seeds: int, _: int) -> dict[str, Any]:
    """Coverage at all angles together."""
    found, failed = each_seed(lambda seed: held_in(case, seed), seeds)
    friction, elastic = np.nanmean(found, axis=(0, 2))
    return {"seeds": seeds, "failed": failed, "friction": float(friction), "elastic": float(elastic)}


run = run_of(
    measure,
    lambda: [Case(flat, moving) for moving in (False, True) for flat in PAIRS],
    seeds=200,
    quick_seeds=2,
)

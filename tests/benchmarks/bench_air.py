"""Contact or air: coverage of b, p, c, n, gamma and drag.

Run as ``python -m tests.benchmarks air [--quick]``. Decays
with drag come from the tests' own integration, or from the simulated rig on recorded ground, seen 25 times a
second with 0.005 arcsec; nothing is known of the drag beforehand. Neither shares a formula with the fit.
"""

from typing import Any, NamedTuple

import numpy as np

from acquisition.simulation.settings import SimulationSettings
from acquisition.simulation.true_path import true_path, true_turning_points
from processing.contact.laws import PAPER
from processing.fit import FitResult, fit_exact
from processing.swing import turning_points
from rig.analysis import evidence_of
from rig.analysis.ambient import FittedDrag
from tests.benchmarks.bench_ground import GROUND_FILE, recorded, simulated
from tests.benchmarks.cases import SEEDS_APART, each_seed, run_cases
from tests.benchmarks.coverage import FRAMES_PER_S, Floats, in_frames, of_fits
from tests.processing.fit.decays import paper_pair, truth
from tests.processing.fit.driven import driven_path

NOISE_ARCSEC = 0.005
NAMES = PAPER.names(drag=True)
FLAT = "glass_k8"


class Case(NamedTuple):
    """A drag on a ground; None: the recorded one."""

    drag_s: float
    q: float | None

    @property
    def name(self) -> str:
        return f"drag {1e3 * self.drag_s:g} ms on " + (
            "recorded ground" if self.q is None else f"q={self.q:g}"
        )


def cases() -> list[Case]:
    grounds: list[float | None] = [0.0, 1e-9, 8e-9, 3e-8]
    if GROUND_FILE.exists():
        grounds.append(None)
    return [Case(drag_s, q) for q in grounds for drag_s in (0.0, 0.5e-3, 1.7e-3, 3e-3)]


def path_of(case: Case, seed: int) -> Floats:
    """Deflections in rad at every frame."""
    parameters, pendulum = paper_pair(FLAT, case.drag_s)
    if case.q is not None:
        return driven_path(parameters, pendulum, q=case.q, seed=seed, frames_per_s=FRAMES_PER_S)[2]
    settings = simulated(FLAT, recorded(seed), seed)
    contact = settings.contact.model_copy(update={"drag_s": case.drag_s})
    settings = SimulationSettings.model_validate(settings.model_dump() | {"contact": contact.model_dump()})
    end_s = float(true_turning_points(settings, run=seed).time_s[-1])
    return true_path(settings, end_s, FRAMES_PER_S, run=seed).y_rad


def fitted(case: Case, seed: int, seeds: list[int]) -> FitResult:
    """From frames to parameters as a session does it, with nothing known of the air."""
    pendulum = paper_pair(FLAT)[1]
    settled = in_frames(path_of(case, seed), NOISE_ARCSEC, seeds, pendulum)
    evidence = evidence_of(FittedDrag(), settled.harmonics)
    return fit_exact(turning_points(settled.swings), pendulum, drag=True, evidence=evidence)


def measure(case: Case, seeds: int, first: int) -> dict[str, Any]:
    """Shares of seeds whose intervals hold the truth, and rms errors in units of u."""
    true = truth(paper_pair(FLAT, case.drag_s)[0], NAMES)
    fits, failed = each_seed(
        lambda seed: fitted(case, seed, [seed - first, 78, first // SEEDS_APART]), seeds, first
    )
    relative_u_b = float(np.median([fit.estimate("b").standard_uncertainty for fit in fits]) / true[0])
    return {"seeds": seeds, "failed": failed, "relative_u_b": relative_u_b, **of_fits(fits, NAMES, true)}


def run(quick: bool = False, seeds: int = 100, only: tuple[str, ...] = ()) -> dict[str, Any]:
    """All of it; numbers as plain values."""
    return run_cases(cases(), measure, 3 if quick else seeds, only)

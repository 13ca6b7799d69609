"""Contact or air: coverage of b, p, c, n, gamma and drag, scatter against the bound, and what it costs.

Run as ``python -m tests.benchmarks air [--quick]``. Decays
with drag come from the tests' own integration, or from the simulated rig on recorded ground, seen 25 times a
second with 0.005 arcsec; nothing is known of the drag beforehand. Neither shares a formula with the fit.
"""

from time import process_time
from typing import Any, NamedTuple

import numpy as np

from acquisition.simulation.settings import SimulationSettings
from acquisition.simulation.true_path import true_path, true_turning_points
from processing.arrays import Floats
from processing.contact.laws import PAPER
from processing.deflections import DeflectionUnit
from processing.errors import RigError
from processing.fit import FitResult, fit_exact
from processing.fit.exact_model import ExactModel
from processing.fit.ground import Noise, density_of_step
from processing.swing import TurningPoints, swings_of_blocks, turning_points
from rig.analysis import evidence_of, settled_swings
from rig.analysis.air import FittedDrag
from rig.settings import FitSettings
from tests.benchmarks.bench_ground import GROUND_FILE, recorded, simulated
from tests.benchmarks.bound import bound, true_columns
from tests.benchmarks.cases import chosen
from tests.benchmarks.coverage import coverage, held, lines, named, rms
from tests.processing.fit.decays import ARCSEC, paper_pair, truth
from tests.processing.fit.driven import driven_path
from tests.processing.fit.frames import seen_in_frames

NOISE_ARCSEC, FRAMES_PER_S = 0.005, 25.0
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
    """Deflections in rad at every frame; no two cases share a ground."""
    parameters, pendulum = paper_pair(FLAT, case.drag_s)
    seed += 1000 * cases().index(case)
    if case.q is not None:
        return driven_path(parameters, pendulum, q=case.q, seed=seed, frames_per_s=FRAMES_PER_S)[2]
    settings = simulated(FLAT, recorded(seed), seed)
    contact = settings.contact.model_copy(update={"drag_s": case.drag_s})
    settings = SimulationSettings.model_validate(settings.model_dump() | {"contact": contact.model_dump()})
    end_s = float(true_turning_points(settings, run=seed).time_s[-1])
    return true_path(settings, end_s, FRAMES_PER_S, run=seed).y_rad


class Fitted(NamedTuple):
    """The fit of one decay with waveform and drag, and CPU times: of the whole, and of a fit in vacuum."""

    fit: FitResult
    points: TurningPoints
    cpu_s: float
    vacuum_cpu_s: float


def fitted(case: Case, seed: int) -> Fitted:
    """From frames to parameters as a session does it, with nothing known of the air."""
    path, seeds = path_of(case, seed), [seed, 78, cases().index(case)]
    samples = seen_in_frames(path, NOISE_ARCSEC * ARCSEC, seeds, FRAMES_PER_S)
    swings = swings_of_blocks([samples])
    pendulum = paper_pair(FLAT)[1]
    settled = settled_swings(swings, [samples], DeflectionUnit.RAD, pendulum, FitSettings())
    points, evidence = turning_points(settled.swings), evidence_of(FittedDrag(), settled.harmonics)
    began_s = process_time()
    again = fit_exact(points, pendulum, drag=True, evidence=evidence)
    between_s = process_time()
    fit_exact(points, pendulum)
    return Fitted(again, points, between_s - began_s, process_time() - between_s)


def least(found: Fitted, case: Case) -> Floats:
    """Standard deviations of the Cramer-Rao bound of points and waveform together, at the truth."""
    parameters, pendulum = paper_pair(FLAT, case.drag_s)
    points = found.points.first(found.fit.half_cycles)
    model = ExactModel(points, pendulum, drag=True, evidence=found.fit.evidence)
    columns = true_columns(model, parameters, points)
    assert found.fit.ground is not None
    step = found.fit.ground.noise.step
    if case.q is not None:
        step = case.q / density_of_step(1.0, float(np.diff(points.time_s).mean()))
    here = model.about(columns).on_ground(columns, Noise(step / model.reference))
    return bound(model, columns, here(columns)[1])[: len(NAMES)]


def measure(case: Case, seeds: int) -> dict[str, Any]:
    """Shares of seeds whose intervals hold the truth, and rms errors in units of u and of the bound."""
    expected = truth(paper_pair(FLAT, case.drag_s)[0], NAMES)
    pulls, to_bound, inside, relative, ratio = [], [], [], [], []
    failed = 0
    for seed in range(seeds):
        try:
            found = fitted(case, seed)
            at_best = least(found, case)
        except RigError as error:
            failed += 1
            print(f"  seed {seed}: {error}")
            continue
        off = found.fit.values[: len(NAMES)] - expected
        pulls.append(off / found.fit.standard_uncertainty[: len(NAMES)])
        to_bound.append(off / at_best)
        relative.append(found.fit.standard_uncertainty[0] / expected[0])
        ratio.append(found.cpu_s / found.vacuum_cpu_s)
        inside.append(held(found.fit, NAMES, expected))
    return {
        "case": case.name,
        "seeds": seeds,
        "failed": failed,
        "relative_u_b": float(np.median(relative)),
        "cpu_over_vacuum": float(np.median(ratio)),
        **named(NAMES, {**coverage(pulls, inside), "rms_to_bound": rms(to_bound).tolist()}),
    }


def run(quick: bool = False, seeds: int = 100, only: tuple[str, ...] = ()) -> dict[str, Any]:
    """All of it; numbers as plain values."""
    result: dict[str, Any] = {"cases": []}
    for case in chosen(cases(), only, lambda case: case.name):
        found = measure(case, 3 if quick else seeds)
        result["cases"].append(found)
        print(
            f"{case.name}, {found['seeds']} seeds ({found['failed']} failed), "
            f"u(b)/b {found['relative_u_b']:.2%}, CPU time {found['cpu_over_vacuum']:.1f} of a fit in vacuum",
            *lines(found),
            sep="\n",
            flush=True,
        )
    return result

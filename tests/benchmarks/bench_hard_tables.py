"""Tables that are hard to judge: short runs, a contact that ages, times that jitter; do the intervals hold?

Run as ``python -m tests.benchmarks hard_tables [--quick]``. Decays come from an
integration of the tests' own (`tests.processing.fit.driven`), on quiet ground and in air, seen 25 times a
second with 0.005 arcsec, written as a table and fitted as `rig fit TABLE` does. Counted are values and 95 %
intervals that are shown; a parameter that is only bounded counts where its interval holds the truth.
"""

from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import numpy as np

from processing.contact.laws import PAPER
from processing.deflections import Deflections, DeflectionUnit
from tests.benchmarks.cases import run_cases
from tests.benchmarks.coverage import of_reported
from tests.processing.fit.decays import ARCSEC, paper_pair
from tests.processing.fit.driven import World, changing_path
from tests.rig.analysis.spinning import analysed_table, configuration, held_by

FRAMES_PER_S, NOISE_ARCSEC, Q = 25.0, 0.005, 1e-9
DRAG_S = 1.7e-3
PARAMETERS, PENDULUM = paper_pair("glass_k8", DRAG_S)
NAMES = PAPER.names()


class Case(NamedTuple):
    """A world, how long it is watched, and how far the stated times are off."""

    name: str
    world: World = World()
    lasting_s: float = 600.0
    jitter_s: float = 0.0
    stated: tuple[str, ...] = ()


CASES = (
    Case("short: 75 s", lasting_s=75.0),
    Case("short: 75 s, drag open", lasting_s=75.0, stated=("fit.drag=open",)),
    Case("short: 150 s", lasting_s=150.0),
    Case("ageing: b grows by 1 %", World(ageing=0.01, lasting_s=600.0), stated=("fit.u_ageing=0.01",)),
    Case(
        "ageing: drag drifts by 2 %",
        World(drag_drift=0.02, lasting_s=600.0),
        stated=("fit.u_drag_drift=0.02",),
    ),
    Case("jitter: 1 ms", jitter_s=1e-3),
)


def table(case: Case, seed: int) -> Deflections:
    """Positions at the times at which they were taken, under the times that are stated."""
    path = changing_path(PARAMETERS, PENDULUM, case.world, q=Q, seed=seed, frames_per_s=FRAMES_PER_S)[2]
    path = path[: round(case.lasting_s * FRAMES_PER_S)]
    random = np.random.default_rng([seed, 79])
    times_s = np.arange(len(path)) / FRAMES_PER_S + case.jitter_s * random.standard_normal(len(path))
    x = path + NOISE_ARCSEC * ARCSEC * random.standard_normal(len(path))
    y = NOISE_ARCSEC * ARCSEC * random.standard_normal(len(path))
    u = np.full(len(path), NOISE_ARCSEC * ARCSEC)
    times_ns = np.rint((times_s - times_s.min()) * 1e9).astype(np.int64)
    return Deflections(times_ns, x, y, u, u, DeflectionUnit.RAD)


def measure(case: Case, seeds: int, first: int) -> dict[str, Any]:
    """Shares of seeds whose intervals hold the truth, and rms errors over u, of all that were fitted."""
    config = configuration(*case.stated).model_copy(update={"lever": None, "axes": None})
    true = {name: float(getattr(PARAMETERS, name)) for name in NAMES}
    rows = []
    with TemporaryDirectory() as folder:
        for seed in range(first, first + seeds):
            found = analysed_table(table(case, seed), config, Path(folder) / "t.csv")
            if not found.problem:
                rows.append([held_by(found, name, true[name]) for name in NAMES])
    return of_reported(rows, NAMES, seeds)


def run(quick: bool = False, seeds: int = 20, only: tuple[str, ...] = ()) -> dict[str, Any]:
    """All cases, or those that are named."""
    return run_cases(CASES, measure, 2 if quick else seeds, only)

"""A pendulum that turns about the vertical: coverage of b, p, c, n, T0 and gamma, and what is withheld.

Run as ``python -m tests.benchmarks spin [--quick]``. Decays
of 600 s come from the simulated rig's own integration, turned by 0, 0.2, 1 and 3 degrees a minute in both
directions, as deflections of a record and as a table of two positions, 25 a second with 0.005 arcsec; also
with a fast mode of 6 arcsec and a leakage of 3 %.
"""

from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import numpy as np

from processing.contact.laws import PAPER
from rig.analysis.results import RunResults
from tests.benchmarks.cases import run_cases
from tests.benchmarks.coverage import of_reported
from tests.rig.analysis.spinning import (
    DEG_PER_MIN,
    Spin,
    analysed,
    analysed_table,
    configuration,
    held_by,
    positions,
)

NAMES = PAPER.names()
RATES_DEG_PER_MIN = (0.0, 0.2, -0.2, 1.0, -1.0, 3.0, -3.0)


class Case(NamedTuple):
    """How a turning pendulum is read, and how fast it turns; disturbed by fast mode and leakage, or not."""

    way: str
    rate_deg_per_min: float
    disturbed: bool

    @property
    def name(self) -> str:
        beside = ", fast mode 6 arcsec, leakage 3 %" if self.disturbed else ""
        return f"{self.way} turning by {self.rate_deg_per_min:+g} deg/min{beside}"

    @property
    def spin(self) -> Spin:
        rate = self.rate_deg_per_min * DEG_PER_MIN
        return Spin(rate, leakage=0.03, fast_arcsec=6.0) if self.disturbed else Spin(rate)


def cases() -> list[Case]:
    return [
        Case(way, rate, disturbed)
        for disturbed in (False, True)
        for way in ("record", "table")
        for rate in RATES_DEG_PER_MIN
    ]


def results(case: Case, seed: int, folder: Path) -> RunResults:
    """From positions to results as a session or `rig fit` makes them."""
    seen = positions(case.spin, seed + 1)
    config = configuration()
    if case.way == "table":
        # its axes are stated nowhere: leakage is part of its direction, along which angles are the true ones
        length = float(np.hypot(1.0, case.spin.leakage))
        seen = replace(seen, x=seen.x / length, y=seen.y / length)
        return analysed_table(seen, config.model_copy(update={"lever": None, "axes": None}), folder / "t.csv")
    return analysed(seen, config, folder / "run-1.mcap")


def measure(case: Case, seeds: int, first: int) -> dict[str, Any]:
    """Shares of seeds whose intervals hold the truth, and rms errors over u, of what is not withheld."""
    simulation = configuration().simulation
    assert simulation is not None
    true = {name: float(getattr(simulation.contact, name)) for name in NAMES}
    rows = []
    with TemporaryDirectory() as folder:
        for seed in range(first, first + seeds):
            found = results(case, seed, Path(folder))
            if not found.problem.startswith("withheld"):
                lines = {name: found.budget[name] for name in NAMES}
                pulls = {n: (one.value - true[n]) / one.standard_uncertainty for n, one in lines.items()}
                rows.append([held_by(found, n, true[n])._replace(pull=pull) for n, pull in pulls.items()])
    return of_reported(rows, NAMES, seeds)


def run(quick: bool = False, seeds: int = 20, only: tuple[str, ...] = ()) -> dict[str, Any]:
    """All cases, or those that are named; `failed` are withheld."""
    return run_cases(cases(), measure, 2 if quick else seeds, only)

"""Runs that end by `session.stop_when` still cover: ``python -m tests.benchmarks enough [--quick]``.

The half-cycles come from the tests' own integration of a driven pendulum, without a formula of the fit.
"""

from typing import Any, NamedTuple

import numpy as np

from processing.contact.laws import PAPER
from processing.fit import FitResult, fit_exact
from processing.swing import TurningPoints
from rig.measure import FIRST_HALF_CYCLES
from rig.measure.end_of_run import EndOfRun
from rig.measure.posterior import next_fit_half_cycles
from rig.settings.number_input import stop_conditions
from tests.benchmarks.cases import each_seed
from tests.benchmarks.coverage import of_fits
from tests.processing.fit.decays import paper_pair, truth
from tests.processing.fit.driven import driven_decay


class Stopping(NamedTuple):
    """A pair, its ground (rad/s^2/sqrt(Hz)), when its runs end, and from which half-cycle on it is looked at.

    Earlier looks are far from the end.
    """

    flat: str
    q: float
    when: tuple[str, ...]
    first: int


STOPPING = (
    Stopping("glass_k8", 1.5e-8, ("u(c)/c < 0.10", "u(b)/b < 0.02"), 290),
    Stopping("silicon", 1.5e-8, ("u(b)/b < 0.05",), 290),
    Stopping("steel", 1.5e-8, ("u(c)/c < 0.15", "u(gamma)/gamma < 0.03"), 500),
)
NOISE_ARCSEC = 0.005


def stopped(points: TurningPoints, case: Stopping) -> FitResult | None:
    """The fit at which a run ends by its conditions, looked at as often as a session does."""
    end = EndOfRun(0.0, 1e9, stop_conditions(case.when, drag=False))
    pendulum = paper_pair(case.flat)[1]
    count, near = FIRST_HALF_CYCLES, None
    while count <= len(points):
        if count >= case.first:
            near = fit_exact(points.first(count), pendulum, averaged=False, near=near)
            if end.reason([], 0.0, near.estimates()):
                return near
        count = next_fit_half_cycles(count)
    return None


def stopping(case: Stopping, seeds: int) -> dict[str, Any]:
    """Shares of runs whose intervals hold the truth, errors over u, and where they ended."""
    parameters, pendulum = paper_pair(case.flat)
    names = PAPER.names()

    def one(seed: int) -> FitResult | None:
        points = driven_decay(parameters, pendulum, q=case.q, noise_arcsec=NOISE_ARCSEC, seed=9000 + seed)
        return stopped(points, case)

    found, failed = each_seed(one, seeds)
    fits = [fit for fit in found if fit is not None]
    return {
        "seeds": seeds,
        "failed": failed,
        "reached_the_last_amplitude": len(found) - len(fits),
        "half_cycles": np.percentile([fit.half_cycles for fit in fits], [5, 50, 95]).tolist(),
        **of_fits(fits, names, truth(parameters, names)),
    }


def stoppings(seeds: int) -> dict[str, dict[str, Any]]:
    """Runs that end by their conditions."""
    return {f"{case.flat}, {', '.join(case.when)}": stopping(case, seeds) for case in STOPPING}


def run(quick: bool = False) -> dict[str, Any]:
    """All of it; numbers as plain values."""
    return {"stopping": stoppings(4 if quick else 200)}

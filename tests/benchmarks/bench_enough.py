"""Runs that end by `session.stop_when` still cover: ``python -m tests.benchmarks enough [--quick]``.

The half-cycles come from the tests' own integration of a driven pendulum, without a formula of the fit.
"""

from typing import Any, NamedTuple

import numpy as np

from processing.contact.laws import PAPER
from processing.errors import RigError
from processing.fit import FitResult, fit_exact
from processing.swing import TurningPoints
from rig.measure import FIRST_HALF_CYCLES
from rig.measure.end_of_run import EndLimits, EndOfRun
from rig.measure.posterior import following
from rig.settings.number_input import stop_conditions
from tests.benchmarks.coverage import coverage, held, lines, named
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
    end = EndOfRun(EndLimits(0.0, 1e9, stop_conditions(case.when, drag=False)))
    pendulum = paper_pair(case.flat)[1]
    count, near = FIRST_HALF_CYCLES, None
    while count <= len(points):
        if count >= case.first:
            near = fit_exact(points.first(count), pendulum, averaged=False, near=near)
            if end.reason([], 0.0, near.estimates()):
                return near
        count = following(count)
    return None


def stopping(case: Stopping, seeds: int) -> dict[str, Any]:
    """Shares of runs whose intervals hold the truth, errors over u, and where they ended."""
    parameters, pendulum = paper_pair(case.flat)
    names = PAPER.names()
    true = truth(parameters, names)
    fits, runs, failed = [], [], 0
    for seed in range(seeds):
        points = driven_decay(parameters, pendulum, q=case.q, noise_arcsec=NOISE_ARCSEC, seed=9000 + seed)
        try:
            if (fit := stopped(points, case)) is not None:
                fits.append(fit)
                runs.append(points)
        except RigError:
            failed += 1
    ends = [fit.half_cycles for fit in fits]
    length = int(np.median(ends))
    fixed = [fit_exact(points.first(length), pendulum, averaged=False) for points in runs]
    count = len(names)
    pulls = [(fit.values[:count] - true) / fit.standard_uncertainty[:count] for fit in fits]
    found, at_fixed = (
        named(names, coverage(pulls, [held(fit, names, true) for fit in these])) for these in (fits, fixed)
    )
    return {
        "seeds": seeds,
        "failed": failed,
        "reached_the_last_amplitude": seeds - failed - len(fits),
        "half_cycles": np.percentile(ends, [5, 50, 95]).tolist(),
        **found,
        "one_u_at_a_fixed_length": at_fixed["one_u"],
    }


def stoppings(seeds: int) -> dict[str, dict[str, Any]]:
    """Runs that end by their conditions."""
    out = {}
    for case in STOPPING:
        name = f"{case.flat}, {', '.join(case.when)}"
        found = out[name] = stopping(case, seeds)
        print(f"{name}: {seeds} runs ended after {found['half_cycles']} half-cycles (5, 50, 95 %)")
        print(*lines(found), f"  fixed length {found['one_u_at_a_fixed_length']}", sep="\n", flush=True)
    return out


def run(quick: bool = False) -> dict[str, Any]:
    """All of it; numbers as plain values."""
    return {"stopping": stoppings(4 if quick else 200)}

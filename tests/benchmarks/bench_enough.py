"""Runs that end by `session.stop_when` still cover: ``python -m tests.benchmarks enough [--quick]``.

The half-cycles come from the tests' own integration of a driven pendulum, without a formula of the fit.
"""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from processing.contact import ContactParameters
from processing.contact.laws import PAPER
from processing.errors import RigError
from processing.fit import FitResult, fit_exact
from processing.swing import TurningPoints
from rig.measure.end_of_run import EndLimits, EndOfRun
from rig.posterior import FIRST_HALF_CYCLES
from rig.posterior.posterior import following
from rig.settings.stop_conditions import stop_conditions
from tests.processing.fit.decays import paper_pair
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
    """Shares of runs whose one-u intervals hold the truth, and where they ended."""
    parameters, pendulum = paper_pair(case.flat)
    inside, ends, errors, runs = [], [], [], []
    unended = failed = 0
    for seed in range(seeds):
        points = driven_decay(parameters, pendulum, q=case.q, noise_arcsec=NOISE_ARCSEC, seed=9000 + seed)
        try:
            fit = stopped(points, case)
        except RigError:
            failed += 1
            continue
        if fit is None:
            unended += 1
            continue
        ends.append(fit.half_cycles)
        runs.append(points)
        inside.append(holds(fit, parameters))
        errors.append([pull(fit, name, getattr(parameters, name)) for name in PAPER.names()])
    length = int(np.median(ends))
    fixed = [fit_exact(points.first(length), paper_pair(case.flat)[1], averaged=False) for points in runs]
    return {
        "pair": case.flat,
        "when": list(case.when),
        "seeds": seeds,
        "failed": failed,
        "reached_the_last_amplitude": unended,
        "half_cycles": np.percentile(ends, [5, 50, 95]).tolist(),
        "one_u": by_name(np.mean(inside, axis=0)),
        "one_u_at_a_fixed_length": by_name(np.mean([holds(fit, parameters) for fit in fixed], axis=0)),
        "mean_error_over_u": by_name(np.mean(errors, axis=0)),
    }


def holds(fit: FitResult, parameters: ContactParameters) -> list[bool]:
    """Whether the interval of one u holds the truth, by parameter."""
    found = []
    for name in PAPER.names():
        low, high = fit.interval(name, 0.6827)
        found.append(low <= getattr(parameters, name) <= high)
    return found


def pull(fit: FitResult, name: str, true: float) -> float:
    value, u = fit.estimate(name)
    return (value - true) / u


def by_name(values: Any) -> dict[str, float]:
    return dict(zip(PAPER.names(), np.asarray(values, dtype=np.float64).tolist(), strict=True))


def words(values: Mapping[str, float]) -> str:
    return "  ".join(f"{name} {value:.2f}" for name, value in values.items())


def stoppings(seeds: int) -> list[dict[str, Any]]:
    """Runs that end by their conditions."""
    out = []
    for case in STOPPING:
        found = stopping(case, seeds)
        out.append(found)
        print(
            f"{case.flat}, {', '.join(case.when)}: {found['seeds']} runs ended after "
            f"{found['half_cycles']} half-cycles (5, 50, 95 %)"
        )
        print("  within 1 u   ", words(found["one_u"]))
        print("  fixed length ", words(found["one_u_at_a_fixed_length"]))
        print("  mean error/u ", words(found["mean_error_over_u"]), flush=True)
    return out


def run(quick: bool = False) -> dict[str, Any]:
    """All of it; numbers as plain values."""
    return {"stopping": stoppings(4 if quick else 200)}

"""Runs that end by `session.stop_when` still cover, and a plan says what runs scatter.

Run as ``python -m tests.benchmarks.bench_enough [--quick] [--seeds N] [stopping|plans]`` from the repository.
The half-cycles come from the tests' own integration of a driven pendulum, and from the simulated rig's tilts
in the basement world by way of the swing detector; neither shares a formula with the fit.
"""

import argparse
import json
import sys
from typing import Any, NamedTuple

import numpy as np

from processing.contact.laws import PAPER
from processing.errors import RigError
from processing.fit import FitResult, fit_exact
from processing.swing import TurningPoints
from rig.measure.end_of_run import EndLimits, EndOfRun
from rig.posterior import FIRST_HALF_CYCLES, following
from rig.settings.stop_conditions import stop_conditions
from tests.processing.fit.decays import paper_pair
from tests.processing.fit.driven import driven_decay

NOISE_ARCSEC = 0.005


class Stopping(NamedTuple):
    """A pair, its ground (rad/s^2/sqrt(Hz)), when its runs end, and where the first look is.

    Fits that are far from the end are left out; they would not end a run.
    """

    flat: str
    q: float
    when: tuple[str, ...]
    first: int


STOPPING = (
    Stopping("glass_k8", 1.5e-8, ("u(c)/c < 0.10", "u(b)/b < 0.02"), 240),
    Stopping("silicon", 1.5e-8, ("u(b)/b < 0.05",), 240),
    Stopping("steel", 1.5e-8, ("u(c)/c < 0.15", "u(gamma)/gamma < 0.03"), 420),
)


def stopped(points: TurningPoints, case: Stopping) -> tuple[FitResult | None, int]:
    """The fit at which a run ends by its conditions, looked at as a session does, and how often it looked."""
    end = EndOfRun(EndLimits(0.0, 1e9, stop_conditions(case.when, drag=False)))
    pendulum = paper_pair(case.flat)[1]
    count, near, looks = FIRST_HALF_CYCLES, None, 0
    while count <= len(points):
        if count >= case.first:
            looks += 1
            near = fit_exact(points.first(count), pendulum, averaged=False, near=near)
            estimates = {name: near.estimate(name) for name in near.contact_names}
            if end.reason([], 0.0, estimates):
                return fit_exact(points.first(count), pendulum, averaged=False), looks
        count = following(count)
    return None, looks


def stopping(case: Stopping, seeds: int) -> dict[str, Any]:
    """Shares of runs whose one-u intervals hold the truth, and where they ended."""
    parameters, pendulum = paper_pair(case.flat)
    inside, ends, pulls, first_look, unended, failed = [], [], [], 0, 0, 0
    for seed in range(seeds):
        points = driven_decay(parameters, pendulum, q=case.q, noise_arcsec=NOISE_ARCSEC, seed=9000 + seed)
        try:
            fit, looks = stopped(points, case)
        except RigError:
            failed += 1
            continue
        if fit is None:
            unended += 1
            continue
        first_look += looks == 1
        ends.append(fit.half_cycles)
        row = []
        for name in PAPER.names():
            low, high = fit.interval(name, 0.6827)
            row.append(low <= getattr(parameters, name) <= high)
        inside.append(row)
        pulls.append(
            [
                (e.value - getattr(parameters, n)) / e.standard_uncertainty
                for n, e in fit.estimates().items()
                if n in PAPER.names()
            ]
        )
    shares = np.mean(np.array(inside, dtype=np.float64), axis=0)
    return {
        "pair": case.flat,
        "when": list(case.when),
        "seeds": seeds,
        "failed": failed,
        "reached the last amplitude": unended,
        "ended at the first look": first_look,
        "half_cycles": np.percentile(ends, [5, 50, 95]).tolist(),
        "one_u": dict(zip(PAPER.names(), shares.tolist(), strict=True)),
        "mean_pull": dict(zip(PAPER.names(), np.mean(pulls, axis=0).tolist(), strict=True)),
    }


def run(quick: bool = False, seeds: int = 200, only: tuple[str, ...] = ()) -> dict[str, Any]:
    """All of it; numbers as plain values."""
    out: dict[str, Any] = {}
    if not only or "stopping" in only:
        out["stopping"] = []
        for case in STOPPING:
            found = stopping(case, 4 if quick else seeds)
            out["stopping"].append(found)
            print(
                found["pair"],
                *found["when"],
                f"{found['seeds']} seeds,",
                "half-cycles",
                found["half_cycles"],
                found["failed"],
                found["reached the last amplitude"],
                found["ended at the first look"],
            )
            print("  within 1 u " + " ".join(f"{name} {value:.2f}" for name, value in found["one_u"].items()))
            print(
                "  mean pull  "
                + " ".join(f"{name} {value:+.2f}" for name, value in found["mean_pull"].items()),
                flush=True,
            )
    return out


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("parts", nargs="*", metavar="PART", help="stopping or plans; both without")
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--seeds", type=int, default=200)
    words = parser.parse_args()
    json.dump(run(words.quick, words.seeds, tuple(words.parts)), sys.stderr, indent=1)


if __name__ == "__main__":
    main()

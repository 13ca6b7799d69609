"""Advice for balancing: how many of 100 random starts end in balance, in how many looks.

Run as ``python -m tests.benchmarks.bench_balance [--quick] [--frames N]`` from the repository. A look is
modelled (true path, noise, sensor); with ``--frames`` the first N starts go through the simulated camera, the
tracker and `rig balance` instead.
"""

import argparse
import contextlib
import io
import tempfile
from pathlib import Path
from time import process_time
from typing import Any

import numpy as np

from rig.balance import balance_rig
from rig.balance.balancing import SimulatedOperator
from tests.rig.balance.random_starts import follow, out_of_reach, random_start, true_state

LEAST_OF_100 = 98


def run(*, quick: bool) -> dict[str, Any]:
    """All random starts, and as many with parallel weights."""
    starts, parallel = (20, 5) if quick else (100, 20)
    began_s = process_time()
    with tempfile.TemporaryDirectory() as folder, contextlib.redirect_stderr(io.StringIO()):
        ended = [follow(random_start(k), k, Path(folder) / f"{k}.jsonl") for k in range(starts)]
        starts_alike = {k: random_start(k, parallel=True) for k in range(parallel)}
        lame = [
            follow(start, k, Path(folder) / f"p{k}.jsonl", 3)
            for k, start in starts_alike.items()
            if out_of_reach(start)
        ]
        # these are nearly along one line, and within reach all the same
        narrow = sum(
            follow(random_start(k, apart_deg=15.0), k, Path(folder) / f"n{k}.jsonl").said_unreachable
            for k in range(parallel)
        )
    looks = np.array([end.looks for end in ended])
    turns = sum(end.turns for end in ended)
    found: dict[str, Any] = {
        "starts": starts,
        "converged": sum(end.converged for end in ended),
        "least of 100": LEAST_OF_100,
        "looks median, 90 %, most": [float(np.percentile(looks, q)) for q in (50, 90, 100)],
        "turns": turns,
        "turns that worsened the truth": sum(end.worse for end in ended),
        "turns that put the spot off the sensor": sum(end.off_the_sensor for end in ended),
        "wrongly called out of reach": sum(end.said_unreachable for end in ended),
        "parallel weights, out of reach": len(lame),
        "called so within four looks": sum(end.said_unreachable and end.looks <= 4 for end in lame),
        "called so within four sound looks": sum(
            end.said_unreachable and end.looks - end.rejected <= 4 for end in lame
        ),
        "15 degrees apart, called so": narrow,
        "processor time s": round(process_time() - began_s, 1),
    }
    for name, value in found.items():
        print(f"{name:42} {value}")
    for k, end in enumerate(ended):
        if not end.converged:
            print(f"  start {k}: {end}")
    return found


def through_frames(starts: int) -> int:
    """How many of the first starts `rig balance --follow` ends in balance, from frames on."""
    good = 0
    for k in range(starts):
        start = random_start(k)
        operator = SimulatedOperator(start.config, k, start.weights)
        with tempfile.TemporaryDirectory() as folder:
            words, says = io.StringIO(), io.StringIO()
            with contextlib.redirect_stdout(words), contextlib.redirect_stderr(says):
                status = balance_rig(start.config, Path(folder) / "h.jsonl", 15, k, None, operator)
        state = true_state(operator.simulation)
        turns = words.getvalue().count("turn weight")
        within = max(abs(state[0]), abs(state[1])) <= 10.0 and abs(state[2]) <= 20e-6
        good += status == 0 and within
        rejected = says.getvalue().count("not used")
        print(
            f"start {k}: status {status}, {turns} turns, {rejected} looks rejected,"
            f" X {state[0]:+.1f} Y {state[1]:+.1f} arcsec, height {state[2] * 1e6:+.1f} um",
            flush=True,
        )
    print(f"{good} of {starts} from frames on")
    return good


def main() -> None:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--frames", type=int, default=0, metavar="N")
    words = parser.parse_args()
    if words.frames:
        through_frames(words.frames)
    else:
        run(quick=words.quick)


if __name__ == "__main__":
    main()

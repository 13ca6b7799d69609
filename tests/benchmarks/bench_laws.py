"""Which law is named: true laws in the basement, three laws fitted to each, over many seeds.

Run as ``python -m tests.benchmarks.bench_laws [--seeds N] [CASE...]`` from the repository. The paper's three
pairs move as the simulated rig has them, on a basement's ground; rolling with memory as the tests' own
integration of springs with sliders has it, at rest.
"""

import argparse
import json
from collections import Counter
from time import process_time
from typing import Any

from processing.contact import LAWS
from processing.errors import RigError
from processing.fit import compare_laws
from tests.benchmarks.bench_ground import basement, simulated_case
from tests.processing.contact.laws.test_branches import PENDULUM, masing_points
from tests.processing.fit.decays import PAIRS, paper_pair

TRIED = ("paper", "masing", "dahl")


def named(points: Any, pendulum: Any) -> str:
    """The law that remains alone, or "cannot tell" with all that do."""
    try:
        compared = compare_laws(points, pendulum, [LAWS[name] for name in TRIED])
    except RigError as error:
        return f"no fit: {error}"
    remaining = [trial.law.name for trial in compared.remaining]
    return remaining[0] if len(remaining) == 1 else f"cannot tell {' '.join(sorted(remaining))}"


def run(quick: bool = False, seeds: int = 40, only: tuple[str, ...] = ()) -> dict[str, Any]:
    """Counts of the verdicts for every true law."""
    seeds = 3 if quick else seeds
    result: dict[str, Any] = {}
    for flat in PAIRS:
        name = f"paper, {flat}, basement"
        if only and not any(word in name for word in only):
            continue
        case, pendulum = simulated_case("basement", flat, basement), paper_pair(flat)[1]
        began_s = process_time()
        found = Counter(named(case.points(seed), pendulum) for seed in range(seeds))
        result[name] = {**found, "cpu_s": process_time() - began_s}
        print(name, result[name], flush=True)
    name = "masing, at rest"
    if not only or any(word in name for word in only):
        began_s = process_time()
        points = (masing_points(0.066, 0.944, 1.05e-8, 200, seed) for seed in range(min(seeds, 10)))
        found = Counter(named(one, PENDULUM) for one in points)
        result[name] = {**found, "cpu_s": process_time() - began_s}
        print(name, result[name], flush=True)
    return result


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--seeds", type=int, default=40)
    parser.add_argument("only", nargs="*")
    arguments = parser.parse_args()
    print(json.dumps(run(arguments.quick, arguments.seeds, tuple(arguments.only)), indent=1))

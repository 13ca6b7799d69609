"""Which law is named: true laws in the basement, three laws fitted to each, over many seeds.

Run as ``python -m tests.benchmarks.bench_laws [--seeds N] [--first N] [CASE...]`` from the repository. The
paper's three pairs move as the simulated rig has them, on a basement's ground. Rolling with memory and Dahl's
friction move as the tests' own integrations of springs with sliders and of his equation have them: at rest,
and walking in amplitude and phase as the basement's drive at the swing's frequency lets them.
"""

import argparse
import json
from collections import Counter
from collections.abc import Callable, Iterator
from functools import cache, partial
from time import process_time
from typing import Any

import numpy as np

from processing.contact import LAWS
from processing.errors import RigError
from processing.fit import CONTRADICTED, compare_laws
from processing.fit.ground import step_of_density
from processing.swing import TurningPoints
from tests.benchmarks.bench_ground import basement, simulated_case
from tests.processing.contact.laws.branches import Array, dahl_decay
from tests.processing.contact.laws.test_branches import FIRST, PENDULUM, PERIOD_S, masing_decay, seen
from tests.processing.fit.decays import PAIRS, paper_pair
from tests.processing.fit.test_waveform import FALSE_FRIENDS, chances, distorted, four_minutes

TRIED = ("paper", "masing", "dahl")
BASEMENT = 8.4e-9
"""Drive at the swing's frequency, in rad/s^2/sqrt(Hz)."""


def named(points: Any, pendulum: Any) -> str:
    """The law that remains alone, or "cannot tell" with all that do."""
    try:
        compared = compare_laws(points, pendulum, [LAWS[name] for name in TRIED])
    except RigError as error:
        return f"no fit: {error}"
    remaining = [trial.law.name for trial in compared.remaining]
    return remaining[0] if len(remaining) == 1 else f"cannot tell {' '.join(sorted(remaining))}"


@cache
def at_rest(law: str) -> tuple[Array, Array]:
    """Amplitudes (rad) and times (s) of a decay to about 8 arcsec, or of 600 half-cycles."""
    if law == "masing":
        return masing_decay(0.066, 0.944, 1.05e-8, 400)
    amplitude, time = dahl_decay(0.01, 0.02, 1.0, 300)
    # what the first reversal remembers is not that of a swing, and has faded then
    return amplitude[3:] * FIRST, (time[3:] - time[3]) * PERIOD_S / (2 * np.pi)


def walked(law: str, seed: int, drive: float = BASEMENT) -> TurningPoints:
    """A decay each of whose half-swings is that of its present amplitude, which the ground moves.

    Half-swings follow from those of the decay at rest, between whose amplitudes they are interpolated.
    """
    amplitude, time = at_rest(law)
    step = step_of_density(drive, float(np.diff(time).mean()))
    rng = np.random.default_rng([seed, 81])
    falling = np.log(amplitude[:-1])[::-1]
    ratio, lasts = (amplitude[1:] / amplitude[:-1])[::-1], np.diff(time)[::-1]
    at, now = float(amplitude[0]), 0.0
    amplitudes, times = [at], [now]
    while at > amplitude[-1]:
        kick, delay = step * rng.standard_normal(2)
        now += float(np.interp(np.log(at), falling, lasts)) + delay * PERIOD_S / (2 * np.pi * at)
        at = at * float(np.interp(np.log(at), falling, ratio)) + kick
        amplitudes.append(at)
        times.append(now)
    return seen(np.array(amplitudes), np.array(times), seed)


def cases(only: tuple[str, ...]) -> Iterator[tuple[str, Callable[[int], TurningPoints], Any]]:
    """Name, turning points by seed, and pendulum."""
    found: list[tuple[str, Callable[[int], TurningPoints], Any]] = [
        (f"paper, {flat}, basement", simulated_case("basement", flat, basement).points, paper_pair(flat)[1])
        for flat in PAIRS
    ]
    for law in ("masing", "dahl"):
        found.append((f"{law}, basement", partial(walked, law), PENDULUM))
        found.append((f"{law}, at rest", partial(walked, law, drive=0.0), PENDULUM))
    return ((*case,) for case in found if not only or any(word in case[0] for word in only))


def false_friends(seeds: int) -> dict[str, Any]:
    """By distortion, in how many runs the waveform turns the verdict, names the law, or says nothing."""
    result: dict[str, Any] = {}
    for distortion in FALSE_FRIENDS:
        found: Counter[str] = Counter()
        for seed in range(1, seeds + 1):
            seconds, angle = four_minutes(seed)
            chance = chances(seconds, distorted(distortion, seconds, angle), seed)
            right, wrong = (chance[name] >= CONTRADICTED for name in ("paper", "masing"))
            words = {(True, False): "named", (False, True): "turned", (True, True): "cannot tell"}
            found[words.get((right, wrong), "contradicts both")] += 1
        result[f"{distortion}: paper, glass, waveform"] = dict(found)
        print(distortion, dict(found), flush=True)
    return result


def run(quick: bool = False, seeds: int = 40, only: tuple[str, ...] = (), first: int = 0) -> dict[str, Any]:
    """Counts of the verdicts for every true law."""
    seeds = 3 if quick else seeds
    result: dict[str, Any] = {}
    for name, points, pendulum in cases(only):
        began_s = process_time()
        found = Counter(named(points(seed), pendulum) for seed in range(first, first + seeds))
        result[name] = {**found, "cpu_s": process_time() - began_s}
        print(name, result[name], flush=True)
    if not only or "friends" in only:
        result |= false_friends(min(seeds, 5))
    return result


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--seeds", type=int, default=40)
    parser.add_argument("--first", type=int, default=0, help="first seed")
    parser.add_argument("only", nargs="*")
    arguments = parser.parse_args()
    found = run(arguments.quick, arguments.seeds, tuple(arguments.only), arguments.first)
    print(json.dumps(found, indent=1))

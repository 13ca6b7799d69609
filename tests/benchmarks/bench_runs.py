"""Whole runs: each configuration in configs/ on demand and live, and 20 seeds of the basement to their end.

Run as ``python -m tests.benchmarks runs [--quick]`` from the repository, or ``python -m
tests.benchmarks.bench_runs basement|whole|live...`` for some of the kinds; live runs last as long as the
experiment does, half an hour for most, and wait for frames side by side.

A run is good if the program said so (status 0), the session calls it complete for an end that its
configuration has, a live one took as long as it says it measured, and the fit has finite values that agree
with what was simulated.
"""

import json
import math
import os
import sys
import tempfile
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, NamedTuple

from rig.settings import load_configuration
from tests.rig.command_line import CONFIGS, SMALL, rig_process, set_words

SEEDS = 20
_QUICK_S = 30
_FEWEST_FRAMES, _FEWEST_HALF_CYCLES = 500, 10
_CONTACT = ("b", "p", "c", "n", "period0_s", "gamma_pa")
_FURTHEST_U = 5.0
_MADE_LONGER = {"faults": {"session.max_duration_s": "80"}}
"""Its faults leave too few half-cycles of its 40 s for a fit."""
KINDS = ("basement", "whole", "live")


class Whole(NamedTuple):
    """A run to be made: configuration and keys."""

    name: str
    config: Path
    values: dict[str, str]


class Ended(NamedTuple):
    """How a run ended, what is wrong with it (empty if nothing), and what it measured."""

    name: str
    state: str
    reason: str
    wrong: str
    took_s: float = 0.0
    half_cycles: int = 0
    worst: str = ""
    """The parameter of the contact that is furthest from its true value, in its standard uncertainties."""

    @property
    def good(self) -> bool:
        return not self.wrong


def made(run: Whole) -> Ended:
    """Make it in a process of its own."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name) / "out"
        began_s = time.monotonic()
        done = rig_process("run", run.config, "-o", folder, "--runs", "1", *set_words(run.values))
        took_s = time.monotonic() - began_s
        last = " | ".join(done.stderr.strip().splitlines()[-4:])
        if not (folder / "session.json").exists():
            return Ended(run.name, "not begun", last, "no session", took_s)
        session = json.loads((folder / "session.json").read_text(encoding="utf-8"))
        entry = session["entries"][-1]
        end = Ended(run.name, entry["state"], entry["reason"], "", took_s)
        if not (folder / "results.json").exists():
            return end._replace(wrong=f"status {done.returncode}, no results: {last}")
        results = json.loads((folder / "results.json").read_text(encoding="utf-8"))["runs"]
        # what a configuration does to its run on purpose stands among the run's conditions, as it should
        broken = [one for each in results for one in each["conditions"] if not one["ok"]]
        regular = broken and run.config.stem in _MADE_LONGER if done.returncode == 1 else not done.returncode
        if not regular or entry["state"] != "complete" or len(session["entries"]) != 1:
            return end._replace(wrong=f"status {done.returncode}: {last}")
        if len(results) != 1:
            return end._replace(wrong=f"results of {len(results)} runs")
        return judged(end, results[0], session["configuration"])


def judged(end: Ended, results: dict[str, Any], configuration: dict[str, Any]) -> Ended:
    """The same with what is wrong in the results of a run that calls itself complete."""
    end = end._replace(half_cycles=results["half_cycles"])
    limit_s = configuration["session"]["max_duration_s"]
    own = {"final amplitude reached"} | ({f"time limit of {limit_s:g} s reached"} if limit_s else set())
    if end.reason not in own:
        return end._replace(wrong="not an end of its configuration")
    if results["frames"] < _FEWEST_FRAMES or end.half_cycles < _FEWEST_HALF_CYCLES:
        return end._replace(wrong=f"{results['frames']} frames, {end.half_cycles} half-cycles")
    measured_s = end.half_cycles * configuration["simulation"]["contact"]["period0_s"] / 2
    if configuration["simulation"]["real_time"] and end.took_s < measured_s:
        return end._replace(
            wrong=f"{measured_s:.0f} s of swings in {end.took_s:.0f} s were not made in real time"
        )
    if "exact" not in results["fits"]:
        return end._replace(wrong=f"no fit: {results['problem']}")
    apart: dict[str, float] = {}
    for parameter in _CONTACT:
        found = results["budget"][parameter]
        value, u_value = found["value"], found["standard_uncertainty"]
        if value is None or u_value is None or not (math.isfinite(value) and 0 < u_value < math.inf):
            return end._replace(wrong=f"{parameter} is {value} ± {u_value}")
        apart[parameter] = abs(value - configuration["simulation"]["contact"][parameter]) / u_value
    worst = max(apart, key=lambda parameter: apart[parameter])
    end = end._replace(worst=f"{worst} {apart[worst]:.1f} u")
    return end if apart[worst] < _FURTHEST_U else end._replace(wrong=f"{end.worst} from its true value")


def simulated() -> list[Path]:
    """The configurations that the simulated rig measures; others need a camera or a table."""
    return [path for path in sorted(CONFIGS.glob("*.toml")) if load_configuration(path).simulated]


def _all(runs: Sequence[Whole], at_once: int) -> list[Ended]:
    found = []
    with ThreadPoolExecutor(at_once) as together:
        for end in together.map(made, runs):
            measured = f"{end.took_s:.0f} s, {end.half_cycles} half-cycles, {end.worst}"
            print(f"{end.name:24} {end.state}: {end.reason}; {measured}; {end.wrong or 'good'}", flush=True)
            found.append(end)
    return found


def run(quick: bool = False, seeds: int | None = None, kinds: Sequence[str] = KINDS) -> dict[str, Any]:
    """How many of each kind came to their end with a fit; `quick` cuts runs after half a minute of them.

    Raises
    ------
    RuntimeError
        There is no configuration to be run, or none of some kind was asked for.
    """
    short = {"session.max_duration_s": str(_QUICK_S)} if quick else {}
    configs = simulated()
    seeds = (2 if quick else SEEDS) if seeds is None else seeds
    basement = [
        Whole(
            f"basement, seed {seed}",
            CONFIGS / "basement.toml",
            {**SMALL, "simulation.seed": str(seed)} | short,
        )
        for seed in range(seeds)
    ]
    on_demand = [
        Whole(f"{path.stem}, whole", path, {**SMALL, **_MADE_LONGER.get(path.stem, {}), **short})
        for path in configs
    ]
    live = [
        each._replace(
            name=each.name.replace("whole", "live"), values={**each.values, "simulation.real_time": "true"}
        )
        for each in on_demand
    ]
    processors = os.cpu_count() or 1
    # live runs wait for frames, and take a tenth of a core each
    asked = {"basement": (basement, processors), "whole": (on_demand, processors), "live": (live, len(live))}
    if not kinds or not all(asked[kind][0] for kind in kinds):
        raise RuntimeError(
            f"no runs of {', '.join(kinds) or 'any kind'}: {len(configs)} configurations in {CONFIGS}"
        )
    found = {kind: _all(*asked[kind]) for kind in kinds}
    return {
        kind: {"runs": len(ends), "good": sum(end.good for end in ends)}
        | {"ends": [end._asdict() for end in ends]}
        for kind, ends in found.items()
    }


if __name__ == "__main__":
    print({kind: (each["good"], each["runs"]) for kind, each in run(kinds=sys.argv[1:] or KINDS).items()})

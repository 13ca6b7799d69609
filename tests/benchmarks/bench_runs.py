"""Whole runs: each configuration in configs/ on demand and live, and 20 seeds of the basement to their end.

Run as ``python -m tests.benchmarks runs [--quick]`` from the repository; live runs last as long as the
experiment does, half an hour for most, and wait for frames side by side.
"""

import json
import os
import tempfile
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, NamedTuple

from rig.settings import load_configuration
from tests.rig.command_line import CONFIGS, SMALL, rig_process, set_words

SEEDS = 20
_LIVE_AT_ONCE = 4
_QUICK_S = 30


class Whole(NamedTuple):
    """A run to be made: configuration and keys."""

    name: str
    config: Path
    values: dict[str, str]


class Ended(NamedTuple):
    """How a run ended, and whether there is a fit of it."""

    name: str
    state: str
    reason: str
    fitted: bool

    @property
    def good(self) -> bool:
        return self.state == "complete" and self.fitted


def made(run: Whole) -> Ended:
    """Make it in a process of its own."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name) / "out"
        done = rig_process("run", run.config, "-o", folder, "--runs", "1", *set_words(run.values))
        last = (done.stderr.strip().splitlines() or [""])[-1]
        if not (folder / "session.json").exists():
            return Ended(run.name, "not begun", last, False)
        entry = json.loads((folder / "session.json").read_text(encoding="utf-8"))["entries"][-1]
        results = folder / "results.json"
        fitted = results.exists() and all(
            each["fits"] for each in json.loads(results.read_text(encoding="utf-8"))["runs"]
        )
        return Ended(run.name, entry["state"], entry["reason"], fitted)


def simulated() -> list[Path]:
    """The configurations that the simulated rig measures; others need a camera or a table."""
    return [path for path in sorted(CONFIGS.glob("*.toml")) if load_configuration(path).simulated]


def _all(runs: Sequence[Whole], at_once: int) -> list[Ended]:
    found = []
    with ThreadPoolExecutor(at_once) as together:
        for end in together.map(made, runs):
            print(f"{end.name:32} {end.state}: {end.reason}{'' if end.fitted else ', no fit'}", flush=True)
            found.append(end)
    return found


def run(quick: bool = False, seeds: int | None = None) -> dict[str, Any]:
    """How many of each kind came to their end with a fit; `quick` cuts runs after half a minute of them."""
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
    on_demand = [Whole(f"{path.stem}, whole", path, {**SMALL, **short}) for path in configs]
    live = [
        Whole(f"{path.stem}, live", path, {**SMALL, "simulation.real_time": "true", **short})
        for path in configs
    ]
    processors = os.cpu_count() or 1
    found = {
        "basement seeds": _all(basement, processors),
        "whole": _all(on_demand, processors),
        "live": _all(live, _LIVE_AT_ONCE),
    }
    return {
        kind: {"runs": len(ends), "complete with a fit": sum(end.good for end in ends)}
        | {"others": [end._asdict() for end in ends if not end.good]}
        for kind, ends in found.items()
    }

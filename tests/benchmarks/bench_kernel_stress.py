"""Kernels that are called first by several threads and processes at once, with cold and with warm caches.

Run as ``python -m tests.benchmarks kernel_stress [--quick]`` from the repository, or ``python -m
tests.benchmarks.bench_kernel_stress 500`` for so many rounds. A worker of the tests once ended by a
segmentation fault at the call of a kernel: here each round starts processes that share one cache, empty at
first, then filled, and every process that a signal has ended is told with what it was doing. The rig's own
kernels take a minute to compile: they are called in some rounds, with a cache that the first of these fills.
"""

import os
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path
from typing import Any

PROCESSES, THREADS = 3, 4
_REAL_EVERY = 10
"""Rounds after which the rig's own kernels are loaded, too."""


def together(which: str, cache: Path, seed: int) -> list[tuple[int, str]]:
    """Status and last words of processes that began at the same time with one cache."""
    command = [sys.executable, "-m", "tests.benchmarks.stressed_kernels", which, str(THREADS)]
    running = [
        subprocess.Popen(
            [*command, str(PROCESSES * seed + k)],
            stderr=subprocess.PIPE,
            text=True,
            env={**os.environ, "NUMBA_CACHE_DIR": str(cache)},
        )
        for k in range(PROCESSES)
    ]
    said = [process.communicate()[1] for process in running]
    return [(process.returncode, words[-2000:]) for process, words in zip(running, said, strict=True)]


def stress(rounds: int) -> dict[str, Any]:
    """How many processes came to their end, and what ended the others."""
    ended: Counter[str] = Counter()
    told: list[str] = []
    crashed = 0
    began_s = time.monotonic()
    with tempfile.TemporaryDirectory() as place:
        real = Path(place) / "real"
        for number in range(rounds):
            own = Path(place) / str(number)
            kinds = [("cold", "small", own), ("warm", "small", own)]
            if number % _REAL_EVERY == _REAL_EVERY - 1:
                kinds.append(("real", "real", real))
            for kind, which, cache in kinds:
                for status, words in together(which, cache, number):
                    ended[f"{kind}: {'good' if not status else f'status {status}'}"] += 1
                    # a process that a signal has ended
                    crashed += status < 0
                    if status:
                        told.append(f"round {number}, {kind}: status {status}: {words}")
                        print(told[-1], flush=True)
            if number % 25 == 24:
                print(f"{number + 1} rounds, {time.monotonic() - began_s:.0f} s: {dict(ended)}", flush=True)
    return {
        "rounds": rounds,
        "processes at once": PROCESSES,
        "threads each": THREADS,
        "crashed": crashed,
        "ended": dict(sorted(ended.items())),
        "not good": told,
        "load": os.getloadavg()[0],
    }


def run(quick: bool = False) -> dict[str, Any]:
    """All numbers of this topic."""
    found = stress(5 if quick else 100)
    print({name: value for name, value in found.items() if name != "not good"})
    return found


if __name__ == "__main__":
    print(stress(int(sys.argv[1]) if len(sys.argv) > 1 else 500))

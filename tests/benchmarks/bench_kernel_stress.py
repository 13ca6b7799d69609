"""Kernels that are called first by several threads and processes at once, with cold and with warm caches.

Run as ``python -m tests.benchmarks kernel_stress [--quick]`` from the repository. Each round starts processes
that share one cache, empty at first, then filled, and every process that a signal has ended is told with what
it was doing. The rig's own kernels take a minute to compile: they are called in some rounds, with a cache
that the first of these fills. ``python -m tests.benchmarks.bench_kernel_stress small|real SEED`` is one such
process: it ends with status 0 if all values are those of Python.
"""

import faulthandler
import math
import os
import subprocess
import sys
import tempfile
import threading
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from processing.arrays import Floats
from processing.kernel import kernel

PROCESSES, THREADS = 3, 4
_REAL_EVERY = 10
"""Rounds after which the rig's own kernels are loaded, too."""


@kernel
def _square(x: float) -> float:
    return x * x


@kernel
def _sum_of_squares(values: Floats | NDArray[np.float32]) -> float:
    total = 0.0
    for value in values:
        total += _square(value)
    return total


@kernel(fastmath=True)
def _mean(values: Floats | NDArray[np.float32]) -> float:
    total = 0.0
    for value in values:
        total += value
    return total / len(values)


@kernel
def _scatter(values: Floats | NDArray[np.float32]) -> float:
    mean = _mean(values)
    return math.sqrt(max(_sum_of_squares(values) / len(values) - mean * mean, 0.0))


@kernel
def _turned(values: Floats, out: Floats) -> float:
    for k in range(len(values)):
        out[len(values) - 1 - k] = values[k]
    return _scatter(out)


@kernel
def _levels(image: np.ndarray[tuple[int, int], np.dtype[np.uint8]], level: int) -> int:
    count = 0
    for row in image:
        for value in row:
            if value > level:
                count += 1
    return count


def _small(random: np.random.Generator) -> list[Callable[[], None]]:
    values, image = random.normal(size=1000), random.integers(0, 255, (64, 48), dtype=np.uint8)
    single: NDArray[np.float32] = values.astype(np.float32)

    def near(found: float, wanted: float, within: float = 1e-9) -> None:
        assert math.isclose(found, wanted, rel_tol=within), (found, wanted)

    calls: list[Callable[[], None]] = [
        lambda: near(_sum_of_squares(values), float(np.sum(values**2))),
        lambda: near(_mean(values), float(np.mean(values))),
        lambda: near(_scatter(values), float(np.std(values))),
        lambda: near(_turned(values, np.zeros(1000)), float(np.std(values))),
        # squares of single precision are so, too
        lambda: near(_scatter(single), float(np.std(single)), 1e-5),
        lambda: near(_levels(image, 100), int(np.count_nonzero(image > 100))),
        lambda: near(_levels(image.astype(np.uint16), 100), int(np.count_nonzero(image > 100))),
    ]
    return calls


def _real(_: np.random.Generator) -> list[Callable[[], None]]:
    from processing import swing as swings
    from processing.spot import SensorModel
    from rig.instrument.provenance import compile_tracker

    def follow(full_scale_dn: float) -> None:
        gain_e_per_dn = 10_000.0 / full_scale_dn
        compile_tracker(SensorModel(gain_e_per_dn, read_noise_e=7.0, full_scale_dn=full_scale_dn))

    return [swings.compile_kernels, lambda: follow(255.0), lambda: follow(4095.0)]


def call_together(which: str, seed: int) -> int:
    """Call everything in every thread, each in an order of its own."""
    faulthandler.enable()
    random = np.random.default_rng(seed)
    calls = _small(random) if which == "small" else _real(random)
    together = threading.Barrier(THREADS)
    failures: list[BaseException] = []

    def work(order: list[int]) -> None:
        together.wait()
        try:
            for k in order:
                calls[k]()
        except BaseException as error:
            failures.append(error)

    orders = [random.permutation(len(calls)).tolist() for _ in range(THREADS)]
    working = [threading.Thread(target=work, args=(order,)) for order in orders]
    for thread in working:
        thread.start()
    for thread in working:
        thread.join()
    for failure in failures:
        print(f"{type(failure).__name__}: {failure}", file=sys.stderr)
    return 1 if failures else 0


def together(which: str, cache: Path, seed: int) -> list[tuple[int, str]]:
    """Status and last words of processes that began at the same time with one cache."""
    command = [sys.executable, "-m", "tests.benchmarks.bench_kernel_stress", which]
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


def run(quick: bool = False) -> dict[str, Any]:
    """How many processes of 100 rounds (5 quick) came to their end, and what ended the others."""
    rounds = 5 if quick else 100
    ended: Counter[str] = Counter()
    told: list[str] = []
    crashed = 0
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
    return {
        "rounds": rounds,
        "crashed": crashed,
        "ended": dict(sorted(ended.items())),
        "not good": told,
        "load": os.getloadavg()[0],
    }


if __name__ == "__main__":
    sys.exit(call_together(sys.argv[1], int(sys.argv[2])))

"""CPU time that compiling kernels takes: of a first `rig demo`, until they are ready, and of each.

Run as ``python -m tests.benchmarks.bench_kernels [--quick]`` from the repository. User and system time of
processes of their own, with an empty cache and with a filled one; that of the imports is subtracted. A short
demonstration runs twice: the difference is what its kernels cost, those of the fit among them. Beside it
stands the time of a fixed loop, since other work on the machine slows all of it.
"""

import json
import os
import resource
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

IMPORTS = """
import sys
from processing.spot import SensorModel
from rig.instrument.kernels import prepare_kernels
full_scale = float(sys.argv[1])
sensor = SensorModel(gain_e_per_dn=10_000.0 / full_scale, read_noise_e=7.0, full_scale_dn=full_scale)
"""
PREPARE = IMPORTS + "prepare_kernels(sensor, lambda text: None)"
BY_KERNEL = (
    """
import json, sys, time
from numba.core import event
class Compilations(event.Listener):
    def __init__(self):
        self.begun, self.found = [], []
    def on_start(self, event):
        self.begun.append(time.thread_time())
    def on_end(self, event):
        taken_s = time.thread_time() - self.begun.pop()
        if not self.begun:  # kernels within others count as theirs
            function = event.data["dispatcher"].py_func
            self.found.append([taken_s, f"{function.__module__}.{function.__name__}"])
compilations = Compilations()
"""
    + IMPORTS
    + """
from processing import swing
from rig.instrument.kernels import compile_tracker
with event.install_listener("numba:compile", compilations):
    compile_tracker(sensor)
    swing.compile_kernels()
print(json.dumps(compilations.found))
"""
)
LOOP = "total = 0\nfor i in range(10_000_000): total += i * i % 7"


def cpu_s(program: str, full_scale_dn: float, cache: Path) -> float:
    """User and system time of a program, s."""
    return _used_s(lambda: _run(["-c", program, str(full_scale_dn)], cache))


def demo_s(cache: Path) -> float:
    """User and system time of a short `rig demo`, s."""
    with tempfile.TemporaryDirectory() as folder:
        words = ["demo", "-o", f"{folder}/out", "--set", "session.max_duration_s=70"]
        return _used_s(lambda: _run(["-m", "rig", *words], cache))


def by_kernel(cache: Path) -> list[tuple[float, str]]:
    """CPU seconds of each kernel that is called from Python before a run, with those within it, 8 bit."""
    found: list[tuple[float, str]] = json.loads(_run(["-c", BY_KERNEL, "255"], cache).splitlines()[-1])
    return sorted(found, reverse=True)


def _run(words: list[str], cache: Path) -> str:
    return subprocess.run(
        [sys.executable, *words],
        env={**os.environ, "NUMBA_CACHE_DIR": str(cache), "NUMBA_DISABLE_ERROR_MESSAGE_HIGHLIGHTING": "1"},
        check=True,
        stdout=subprocess.PIPE,
        text=True,
    ).stdout


def _used_s(call: Callable[[], object]) -> float:
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    call()
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def demo() -> dict[str, float]:
    """CPU seconds of a first demonstration, of a later one, and of the fixed loop."""
    with tempfile.TemporaryDirectory() as folder:
        cache = Path(folder)
        first_s, later_s = demo_s(cache), demo_s(cache)
        loop_s = min(cpu_s(LOOP, 0.0, cache) for _ in range(2))
    print(
        f"rig demo, 70 s: {first_s:.1f} s of CPU with an empty cache, {later_s:.1f} s with a filled one: "
        f"kernels {first_s - later_s:.1f} s; {loop_s:.2f} s for 1e7 turns of a loop",
        flush=True,
    )
    return {"first_cpu_s": first_s, "later_cpu_s": later_s, "loop_of_1e7_cpu_s": loop_s}


def run(quick: bool = False) -> dict[str, Any]:
    """CPU seconds for a demonstration, for each kernel, for 8-bit and 12-bit cameras."""
    result: dict[str, Any] = {}
    for name, full_scale_dn in (("8 bit", 255), ("12 bit", 4095))[: 1 if quick else 2]:
        with tempfile.TemporaryDirectory() as folder:
            cache = Path(folder)
            imports_s = min(cpu_s(IMPORTS, full_scale_dn, cache) for _ in range(2))
            cold_s = cpu_s(PREPARE, full_scale_dn, cache) - imports_s
            warm_s = min(cpu_s(PREPARE, full_scale_dn, cache) for _ in range(3)) - imports_s
            loop_s = min(cpu_s(LOOP, full_scale_dn, cache) for _ in range(2))
            files = list(cache.rglob("*.nb?"))
            size = sum(path.stat().st_size for path in files)
        result[name] = {
            "cold_cpu_s": cold_s,
            "warm_cpu_s": warm_s,
            "imports_cpu_s": imports_s,
            "loop_of_1e7_cpu_s": loop_s,
            "cache_files": len(files),
            "cache_bytes": size,
        }
        print(
            f"{name}: {cold_s:.1f} s of CPU with an empty cache, {warm_s:.2f} s with a filled one of "
            f"{size / 1e6:.1f} MB; {imports_s:.1f} s for imports, {loop_s:.2f} s for 1e7 turns of a loop",
            flush=True,
        )
    if not quick:
        result["demo"] = demo()
        with tempfile.TemporaryDirectory() as folder:
            result["kernels, 8 bit"] = by_kernel(Path(folder))
        for taken_s, name in result["kernels, 8 bit"][:12]:
            print(f"  {taken_s:6.2f} s  {name}")
    return result


if __name__ == "__main__":
    json.dump(run("--quick" in sys.argv), sys.stderr, indent=1)

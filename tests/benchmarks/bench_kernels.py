"""CPU time until the kernels are ready, with an empty cache and with a filled one.

Run as ``python -m tests.benchmarks.bench_kernels [--quick]`` from the repository. User and system time of a
process of its own; that of its imports is subtracted. Beside it stands the time of a fixed loop, since
other work on the machine slows both.
"""

import json
import os
import resource
import subprocess
import sys
import tempfile
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
LOOP = "total = 0\nfor i in range(10_000_000): total += i * i % 7"


def cpu_s(program: str, full_scale_dn: float, cache: Path) -> float:
    """User and system time of a program, s."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run(
        [sys.executable, "-c", program, str(full_scale_dn)],
        env={**os.environ, "NUMBA_CACHE_DIR": str(cache)},
        check=True,
    )
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def run(quick: bool = False) -> dict[str, Any]:
    """CPU seconds for 8-bit and 12-bit cameras."""
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
    return result


if __name__ == "__main__":
    json.dump(run("--quick" in sys.argv), sys.stderr, indent=1)

"""The memory of a writer does not grow during a long run."""

import os
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[3]
MANY_SPOTS = 90_000
"""Of the 5 million of a day: a spot that stayed in memory would cost at least 8 bytes."""
FLUSH_SPOTS = 35
"""Spots between two flushes, 0.6 s, when the 5 million of a day are spread over 24 h."""
ALLOWED_BYTES_PER_SPOT = 60.0
"""The library keeps about 650 bytes for each chunk of both files, 37 bytes a spot: 190 MB a day."""

PROGRAM = """
import ctypes, resource, sys, gc
from contextlib import suppress
from pathlib import Path
import numpy as np
from acquisition.record.writer import RecordWriter
from processing.deflections import Deflections, DeflectionUnit
from processing.swing import HalfCycle
path, spots, block = Path(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3])
rng = np.random.default_rng(0)
writer = RecordWriter(path, 0, flush_interval_s=1e9)
pixels = rng.integers(0, 255, (8, 8), dtype=np.uint8)
table = [(1.0,) * 10 + (0,)] * block
def record(first, last):
    for start in range(first, last, block):
        times = np.arange(start, start + block) * 17_000_000
        sequences = range(start, start + block)
        noise = rng.normal(size=(4, block))
        writer.write_spots(sequences, times, times, table, Deflections(times, *noise, DeflectionUnit.RAD))
        writer.write_half_cycle(HalfCycle(start, start, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 1, 0))
        writer.write_window(start, int(times[0]), pixels, 0, 0)
        writer.flush()
def resident():
    gc.collect()
    # free memory that glibc has kept, by the moments of the threads, is no memory of the writer
    with suppress(OSError, AttributeError):
        ctypes.CDLL(None).malloc_trim(0)
    with open('/proc/self/statm') as statm:
        return int(statm.read().split()[1]) * resource.getpagesize()
record(0, spots // 10)
before = resident()
record(spots // 10, spots)
print((resident() - before) / (spots - spots // 10))
writer.close()
"""


def bytes_per_spot(path: Path, spots: int, block: int) -> float:
    """Growth of resident memory over the last nine tenths of a recording, flushed after every block."""
    arguments = [sys.executable, "-c", PROGRAM, str(path), str(spots), str(block)]
    # one arena: with more the threads of flushes share the writer's memory, or not, by their moments
    env = {**os.environ, "MALLOC_ARENA_MAX": "1"}
    done = subprocess.run(
        arguments, capture_output=True, text=True, check=True, cwd=ROOT, env=env, timeout=300
    )
    return float(done.stdout)


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="resident memory is read from /proc")
def test_memory_grows_by_the_chunk_index_alone(tmp_path: Path) -> None:
    """In a folder of memory where there is one: thousands of flushes to a busy disk take minutes."""
    shared = Path("/dev/shm")
    with tempfile.TemporaryDirectory(dir=shared if shared.is_dir() else tmp_path) as folder:
        growth = bytes_per_spot(Path(folder) / "run.mcap", 1000 * FLUSH_SPOTS, FLUSH_SPOTS)
    assert growth < ALLOWED_BYTES_PER_SPOT


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="resident memory is read from /proc")
def test_no_spot_stays_in_memory(tmp_path: Path) -> None:
    assert bytes_per_spot(tmp_path / "run.mcap", MANY_SPOTS, 3000) < 4.0

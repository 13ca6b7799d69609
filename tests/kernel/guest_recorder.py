"""In the guest: mounts a drive (DRIVE KIND) and records onto it until the power is cut.

Frames come as from a camera with 100 frames/s; the number of each block's last frame is said once the writer
has it.
"""

import subprocess
import sys
import time
from pathlib import Path

import numpy as np

from acquisition.record.writer import RecordWriter
from processing.deflections import Deflections, DeflectionUnit
from processing.spot import Spot

RATE_HZ = 100.0
BLOCK = 5
HANDED = "HANDED "
FOLDER = Path("/tmp/drive")
RECORD = "run.mcap"


def main() -> None:
    """Do as the command line says; the file system is a module of the kernel."""
    drive, kind = sys.argv[1:]
    FOLDER.mkdir(parents=True, exist_ok=True)
    subprocess.run(["mount", "-t", kind, drive, str(FOLDER)], check=True)
    record(FOLDER / RECORD)


def record(path: Path) -> None:
    """Record until somebody ends this machine."""
    rng = np.random.default_rng(0)
    pixels = rng.poisson(30, (64, 48, 48)).astype(np.uint8)
    spot = Spot(*[1.0] * 10, flags=0)
    writer = RecordWriter(path, time.time_ns(), metadata={"session": {"operator": "test"}})
    start_s, first = time.monotonic(), 0
    while True:
        sequences = list(range(first, first + BLOCK))
        times_ns = np.array(sequences) * round(1e9 / RATE_HZ)
        deflections = Deflections(times_ns, *rng.normal(size=(4, BLOCK)), DeflectionUnit.RAD)
        writer.write_spots(sequences, times_ns.tolist(), times_ns.tolist(), [spot] * BLOCK, deflections)
        for sequence, time_ns in zip(sequences, times_ns.tolist(), strict=True):
            writer.write_window(sequence, time_ns, pixels[sequence % 64], 1, 2)
        first += BLOCK
        print(f"{HANDED}{first - 1}", flush=True)
        time.sleep(max(0.0, start_s + first / RATE_HZ - time.monotonic()))


if __name__ == "__main__":
    main()

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
from tests.acquisition.record.samples import write_frames

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
    writer = RecordWriter(path, time.time_ns(), metadata={"session": {"operator": "test"}})
    start_s, first = time.monotonic(), 0
    while True:
        write_frames(writer, range(first, first + BLOCK), round(1e9 / RATE_HZ), rng, pixels)
        first += BLOCK
        print(f"{HANDED}{first - 1}", flush=True)
        time.sleep(max(0.0, start_s + first / RATE_HZ - time.monotonic()))


if __name__ == "__main__":
    main()

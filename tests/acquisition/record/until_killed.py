"""Records at the speed of a camera with 400 frames/s until it is killed, and reports what was written when.

Each line on stdin is "record report": a process of its own, forked from this one, which has imported
everything already, writes that record. Its number is the answer on stdout. The first line of its report is
"begun"; the others, after a block of frames was handed to the writer: host time in s at which that began,
number of the last frame.
"""

import os
import signal
import sys
import time
from pathlib import Path

import numpy as np

from acquisition.camera import Frame
from acquisition.record.writer import RecordWriter
from tests.acquisition.record.samples import write_frames

BLOCK = 8
INTERVAL_NS = 2_500_000


def main() -> None:
    """Starts a process for each line, until there are no more."""
    signal.signal(signal.SIGCHLD, signal.SIG_IGN)
    for line in sys.stdin:
        record, report = line.split()
        process = os.fork()
        if not process:
            write(Path(record), Path(report))
            os._exit(0)
        print(process, flush=True)


def write(path: Path, report: Path) -> None:
    """Runs for a minute at most, should nobody kill it."""
    said = report.open("w", buffering=1)
    rng = np.random.default_rng(0)
    pixels = rng.poisson(30, (64, 96, 96)).astype(np.uint8)
    writer = RecordWriter(path, time.time_ns(), metadata={"session": {"operator": "test"}})
    start_s = time.monotonic()
    first = 0
    print("begun", file=said)
    while time.monotonic() - start_s < 60.0:
        begun_s = time.monotonic()
        write_frames(writer, range(first, first + BLOCK), INTERVAL_NS, rng, pixels)
        if first % 400 == 0:
            image = rng.poisson(9, (480, 640)).astype(np.uint8)
            writer.write_image(Frame(image, first, first * INTERVAL_NS, 0))
        first += BLOCK
        print(f"{begun_s:.6f} {first - 1}", file=said)
        time.sleep(max(0.0, start_s + first * INTERVAL_NS * 1e-9 - time.monotonic()))


if __name__ == "__main__":
    main()

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
from processing.deflections import Deflections, DeflectionUnit
from processing.spot import Spot

BLOCK = 8
RATE_HZ = 400.0


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
    spot = Spot(*[1.0] * 10, flags=0)
    writer = RecordWriter(path, time.time_ns(), metadata={"session": {"operator": "test"}})
    start_s = time.monotonic()
    first = 0
    print("begun", file=said)
    while time.monotonic() - start_s < 60.0:
        sequences = list(range(first, first + BLOCK))
        begun_s = time.monotonic()
        times = np.array(sequences) * round(1e9 / RATE_HZ)
        values = rng.normal(size=(4, BLOCK))
        deflections = Deflections(times, *values, DeflectionUnit.RAD)
        writer.write_spots(sequences, times.tolist(), times.tolist(), [spot] * BLOCK, deflections)
        for sequence in sequences:
            time_ns = int(times[sequence - first])
            writer.write_window(sequence, time_ns, pixels[sequence % 64], 1, 2)
        if first % 400 == 0:
            writer.write_image(Frame(rng.poisson(9, (480, 640)).astype(np.uint8), first, int(times[0]), 0))
        first += BLOCK
        print(f"{begun_s:.6f} {first - 1}", file=said)
        time.sleep(max(0.0, start_s + first / RATE_HZ - time.monotonic()))


if __name__ == "__main__":
    main()

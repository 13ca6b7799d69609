"""Records at the speed of a camera with 400 frames/s until it is killed, and reports what was written when.

Each line on stdout: host time in s and number of the last frame of a block that was handed to the writer.
"""

import sys
import time
from pathlib import Path

import numpy as np

from acquisition.frame import Frame
from acquisition.record.writer import RecordWriter
from processing.deflections import Deflections, DeflectionUnit
from processing.spot import Spot

BLOCK = 8
RATE_HZ = 400.0


def main(path: Path) -> None:
    """Runs for a minute at most, should nobody kill it."""
    rng = np.random.default_rng(0)
    pixels = rng.poisson(30, (64, 96, 96)).astype(np.uint8)
    spot = Spot(*[1.0] * 10, flags=0)
    writer = RecordWriter(path, time.time_ns(), metadata={"session": {"operator": "test"}})
    start_s = time.monotonic()
    first = 0
    print("begun", flush=True)
    while time.monotonic() - start_s < 60.0:
        sequences = list(range(first, first + BLOCK))
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
        print(f"{time.monotonic():.6f} {first - 1}", flush=True)
        time.sleep(max(0.0, start_s + first / RATE_HZ - time.monotonic()))


if __name__ == "__main__":
    main(Path(sys.argv[1]))

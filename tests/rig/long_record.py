"""A record as long as wanted, in chunks of 0.8 s as `rig run` leaves it, made from deflections."""

import math
from pathlib import Path

import numpy as np

from acquisition.record.writer import RecordWriter
from acquisition.simulation.true_path import true_path
from processing.deflections import Deflections, DeflectionUnit
from processing.spot import Spot
from processing.swing import TurningPointDetector
from rig.instrument import complete, configuration_attachments
from rig.settings import load_configuration

CONFIG = Path(__file__).resolve().parents[2] / "configs" / "demo.toml"
RATE_HZ = 60
FLUSH_SPOTS = 48
START_NS = 5_000_000_000
EPOCH_NS = 1_790_000_000_000_000_000
U_RAD = 2e-8
DEMO_S = 900.0
"""In which the demonstration decays from 124 to 7 arcsec; for other lengths friction is scaled."""
WINDOW = np.zeros((2, 2), dtype=np.uint8)


def make_long_record(path: Path, spots: int, *, windows: bool = True) -> Path:
    """The demonstration's decay, slowed to `spots` frames; windows of four pixels keep the file small."""
    random = np.random.default_rng(1)
    share = DEMO_S * RATE_HZ / spots
    friction = [f"simulation.contact.b={37.33e-4 * share}", f"simulation.contact.c={10.51e-9 * share}"]
    config = complete(load_configuration(CONFIG, friction))
    truth = true_path(config.simulation, spots / RATE_HZ, RATE_HZ)
    metadata = {"frame": {"width_px": "1280", "height_px": "1024"}, "camera": {"full_scale_dn": "255"}}
    detector = TurningPointDetector()
    spot = [Spot(640.0, 512.0, 0.01, 0.01, 9.0, 9.0, 0.0, 200.0, 8.0, 1.0, 0)] * FLUSH_SPOTS
    writer = RecordWriter(
        path,
        EPOCH_NS,
        metadata=metadata,
        attachments=configuration_attachments(config, CONFIG),
        flush_interval_s=math.inf,
    )
    with writer:
        for first in range(0, spots, FLUSH_SPOTS):
            sequences = np.arange(first, min(first + FLUSH_SPOTS, spots))
            times_ns = START_NS + np.round(sequences / RATE_HZ * 1e9).astype(np.int64)
            x, y = (
                values[sequences] + random.normal(0.0, U_RAD, len(sequences))
                for values in (truth.x_rad, truth.y_rad)
            )
            u = np.full(len(y), U_RAD)
            listed = times_ns.tolist()
            deflections = Deflections(times_ns, x, y, u, u, DeflectionUnit.RAD)
            writer.write_spots(sequences.tolist(), listed, listed, spot[: len(y)], deflections)
            for half_cycle in detector.update(times_ns, y, u):
                writer.write_half_cycle(half_cycle)
            if windows:
                for sequence, time_ns in zip(sequences.tolist(), listed, strict=True):
                    writer.write_window(sequence, time_ns, WINDOW, 639, 511)
            writer.flush()
        for half_cycle in detector.finish():
            writer.write_half_cycle(half_cycle)
    return path

"""Small records with messages of every kind; the same seed gives the same record."""

from pathlib import Path
from typing import NamedTuple

import numpy as np

from acquisition.camera import Frame
from acquisition.record.topics import Environment
from acquisition.record.writer import RecordWriter
from processing.balance import Balance, names_with_units
from processing.deflections import Deflections, DeflectionUnit
from processing.spot import Spot, SpotFlag
from processing.swing import HalfCycle

EPOCH_OFFSET_NS = 1_790_000_000_000_000_000
FRAME_NS = 10_000_000
BLOCK = 16
SPOT = Spot(*[1.0] * 10, flags=0)


def sample_balance(rng: np.random.Generator, time_ns: int, unit: DeflectionUnit) -> Balance:
    """Each number is another one."""
    numbers = {name: float(rng.normal()) for name in names_with_units(unit)}
    return Balance(**{**numbers, "time_ns": time_ns, "unit": unit})  # type: ignore[arg-type]


class Expected(NamedTuple):
    """What was handed to the writer."""

    spots: list[Spot]
    deflections: np.ndarray
    windows: list[tuple[int, np.ndarray, tuple[int, int]]]
    half_cycles: list[HalfCycle]
    images: list[Frame]
    balances: list[Balance]


def write_sample(
    path: Path,
    frames: int = 128,
    *,
    seed: int = 1,
    unit: DeflectionUnit = DeflectionUnit.RAD,
    dtype: str = "u1",
    window_px: int = 24,
    flush_interval_s: float = 1e9,
) -> Expected:
    """Write blocks of spots and windows with a swing and a balance each; every 16th spot is lost."""
    rng = np.random.default_rng(seed)
    done = Expected([], rng.normal(0.0, 1e-4, (4, frames)), [], [], [], [])
    attachments = {"configuration.toml": b"[session]\n", "any.bin": bytes(range(256))}
    with RecordWriter(
        path,
        EPOCH_OFFSET_NS,
        metadata={"session": {"operator": "Ä. Tester", "notes": "line 1\nline 2"}},
        attachments=attachments,
        deflection_unit=unit,
        reserve_bytes=64 * 1024,
        flush_interval_s=flush_interval_s,
    ) as writer:
        writer.write_event(0, "start", "first frame")
        writer.write_camera_calibration(0, (48, 64), 86956.5, (31.5, 23.5))
        for first in range(0, frames, BLOCK):
            sequences = list(range(first, min(first + BLOCK, frames)))
            times = np.array(sequences, dtype=np.int64) * FRAME_NS
            spots = [_spot(rng, sequence) for sequence in sequences]
            done.spots.extend(spots)
            columns = done.deflections[:, first : first + len(sequences)]
            hosts = (times + 123).tolist()
            deflections = Deflections(times, *columns, unit)
            writer.write_spots(sequences, times.tolist(), hosts, spots, deflections)
            for sequence, spot in zip(sequences, spots, strict=True):
                pixels = rng.poisson(40, (window_px, window_px)).astype(dtype)
                about_it = spot._replace(rotation_rad=0.0, amplitude_dn=4.0, background_dn=38.0)
                done.windows.append((sequence, pixels, (sequence % 7, 3)))
                writer.write_window(sequence, sequence * FRAME_NS, pixels, sequence % 7, 3, about_it)
            time_ns = int(times[-1])
            half_cycle = HalfCycle(first, time_ns, 1e-6, *rng.normal(size=5).tolist(), (-1) ** first, 0)
            done.half_cycles.append(half_cycle)
            writer.write_half_cycle(half_cycle)
            done.balances.append(sample_balance(rng, time_ns, unit))
            writer.write_balance(done.balances[-1])
            if first % (4 * BLOCK) == 0:
                frame = Frame(rng.poisson(9, (48, 64)).astype(dtype), first, first * FRAME_NS, 0)
                done.images.append(frame)
                writer.write_image(frame)
                writer.write_preview(frame)
                writer.write(Environment(time_ns, 21.5, np.nan, 101325.0))
            writer.flush()
        writer.write_event(frames * FRAME_NS, "stop", "amplitude below 2 arcsec")
    return done


def write_frames(
    writer: RecordWriter, sequences: range, interval_ns: int, rng: np.random.Generator, pixels: np.ndarray
) -> None:
    """Spots and windows of consecutive frames; the windows are taken in turn from a stack (n, ny, nx)."""
    times_ns = [sequence * interval_ns for sequence in sequences]
    values = rng.normal(size=(4, len(sequences)))
    deflections = Deflections(np.array(times_ns), *values, DeflectionUnit.RAD)
    writer.write_spots(sequences, times_ns, times_ns, [SPOT] * len(sequences), deflections)
    for sequence, time_ns in zip(sequences, times_ns, strict=True):
        writer.write_window(sequence, time_ns, pixels[sequence % len(pixels)], 1, 2)


def _spot(rng: np.random.Generator, sequence: int) -> Spot:
    if sequence % 16 == 5:
        return Spot(*[float("nan")] * 10, flags=int(SpotFlag.LOST))
    return Spot(*rng.normal(100.0, 30.0, 10).tolist(), flags=int(SpotFlag.SATURATED) * (sequence % 2))


def same_bits(a: np.ndarray, b: np.ndarray) -> bool:
    """Equal to the last bit, NaN included."""
    return a.shape == b.shape and np.asarray(a, "f8").tobytes() == np.asarray(b, "f8").tobytes()

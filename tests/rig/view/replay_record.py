"""A record of a decay as `rig run` writes it, made quickly from spots instead of frames."""

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from acquisition.record.writer import RecordWriter
from acquisition.simulation.true_path import true_path
from processing.spot import Spot, SpotFlag
from rig.instrument import Pipeline, complete, optics_of
from rig.instrument.provenance import configuration_attachments
from rig.settings import load_configuration

CONFIG = Path(__file__).resolve().parents[3] / "configs" / "demo.toml"
SHAPE = (1024, 1280)
RATE_HZ = 50
START_NS = 5_000_000_000
EPOCH_NS = 1_790_000_000_000_000_000
LOST_FRAME, GAP_FRAME = 400, 700
U_PX = 0.01
WITHOUT_FIT = ("instrument.kind='tomlinson'",)
"""The fit of a contact takes long for a short run."""


def make_record(
    path: Path,
    seconds: float = 60.0,
    *,
    windows: bool = False,
    calibrated: bool = True,
    seed: int = 1,
    overrides: Sequence[str] = (),
    end: str = "stop",
) -> Path:
    """Record `seconds` at 50 frames a second; one frame is missing, the spot of another one is lost.

    Not `calibrated`: deflections are px. `end` is the kind of the last event.

    With `windows` there are pixels for every tenth frame, and for one more that has no spot message.
    """
    config = complete(load_configuration(CONFIG, overrides))
    random = np.random.default_rng(seed)
    sequences = np.delete(np.arange(round(seconds * RATE_HZ)), GAP_FRAME)
    times_s = sequences / RATE_HZ
    lever = config.lever
    assert lever is not None
    truth = true_path(config.simulation, seconds, RATE_HZ)
    px_per_rad = 2.0 * lever.arm_m / lever.pixel_pitch_m
    y_px = 511.5 - px_per_rad * truth.y_rad[sequences] + random.normal(0, U_PX, len(sequences))
    x_px = 639.5 + px_per_rad * truth.x_rad[sequences] + random.normal(0, U_PX, len(sequences))
    if not calibrated:
        config = config.model_copy(update={"lever": None})
    spots = [
        Spot(x, y, U_PX, U_PX, 9.0, 9.0, 0.0, 200.0, 8.0, 1.0, 0)
        for x, y in zip(x_px.tolist(), y_px.tolist(), strict=True)
    ]
    spots[LOST_FRAME] = Spot(*[math.nan] * 10, int(SpotFlag.LOST))
    times_ns = START_NS + np.round(times_s * 1e9).astype(np.int64)
    pipeline = Pipeline(optics_of(config, 255), SHAPE)
    metadata = {
        "frame": {"width_px": str(SHAPE[1]), "height_px": str(SHAPE[0])},
        "camera": {"full_scale_dn": "255"},
    }
    attachments = configuration_attachments(config, CONFIG)
    with RecordWriter(
        path, EPOCH_NS, metadata=metadata, attachments=attachments, deflection_unit=config.deflection_unit
    ) as writer:
        writer.write_event(START_NS, "start", "first frame")
        for first in range(0, len(spots), 25):
            part = slice(first, first + 25)
            deflections = pipeline.deflector(times_ns[part], spots[part])
            half_cycles, balances = pipeline.estimate(deflections)
            listed = times_ns[part].tolist()
            writer.write_spots(sequences[part].tolist(), listed, listed, spots[part], deflections)
            for half_cycle in half_cycles:
                writer.write_half_cycle(half_cycle)
            for balance in balances:
                writer.write_balance(balance)
            if windows:
                _write_windows(writer, sequences[part].tolist(), spots[part])
            writer.flush()
        for half_cycle in pipeline.finish()[0]:
            writer.write_half_cycle(half_cycle)
        writer.write_event(int(times_ns[-1]), end, "time limit")
    return path


def _write_windows(writer: RecordWriter, sequences: list[int], spots: list[Spot]) -> None:
    y, x = np.mgrid[:84, :84]
    for sequence, spot in zip(sequences, spots, strict=True):
        if sequence == GAP_FRAME + 1:
            _write_window(writer, GAP_FRAME, np.zeros((84, 84)), (0, 0))
        if sequence % 10 == 0 and not spot.flags:
            x0, y0 = round(spot.x_px) - 42, round(spot.y_px) - 42
            light = 150 * np.exp(-((x + x0 - spot.x_px) ** 2 + (y + y0 - spot.y_px) ** 2) / (2 * 9.0**2))
            _write_window(writer, sequence, light + 8, (x0, y0))


def _write_window(writer: RecordWriter, sequence: int, image: np.ndarray, origin: tuple[int, int]) -> None:
    time_ns = START_NS + round(sequence / RATE_HZ * 1e9)
    writer.write_window(sequence, time_ns, np.rint(image).astype(np.uint8), *origin)

"""Spots of a record that a calibration is made from."""

import datetime
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from acquisition.record.reader import RecordReader
from processing.errors import DataError
from processing.spot import SpotFlag

Floats = NDArray[np.float64]
_SEGMENTS = 16
_SATURATED = 0.1
"""Part of the spots up to which the others are taken without them."""


@dataclass(frozen=True, slots=True)
class SpotsOfRecord:
    """Frames of a record with a spot; times in s from the first."""

    times_s: Floats
    x_px: Floats
    y_px: Floats
    u_x_px: Floats
    u_y_px: Floats
    began: datetime.datetime


def mean_spot(spots: SpotsOfRecord) -> tuple[float, float, float, float]:
    """Mean position; its uncertainty from segments, which feel slow wandering too, or from the spots."""
    found = []
    for values, u in ((spots.x_px, spots.u_x_px), (spots.y_px, spots.u_y_px)):
        means = np.array([part.mean() for part in np.array_split(values, _SEGMENTS)])
        claimed = float(np.sqrt(np.mean(u**2) / len(u)))
        found.append((float(values.mean()), max(float(means.std(ddof=1)) / math.sqrt(_SEGMENTS), claimed)))
    return found[0][0], found[1][0], found[0][1], found[1][1]


def spots_of_record(record: Path) -> SpotsOfRecord:
    """Whole, unsaturated spots. Raises DataError: fewer than 100 of them, or too much light."""
    with RecordReader(record) as reader:
        table = reader.spots()
        began = utc(reader, int(table["time_ns"][0]) if len(table) else 0)
    bad = SpotFlag.LOST | SpotFlag.SATURATED | SpotFlag.EDGE
    good = table[(table["flags"].astype(np.int64) & int(bad)) == 0] if len(table) else table
    saturated = 0.0
    if len(table):
        saturated = float(np.mean((table["flags"].astype(np.int64) & int(SpotFlag.SATURATED)) != 0))
    if saturated > _SATURATED:
        raise DataError(f"{record}: {100 * saturated:.0f} % of the spots are saturated; use less light")
    if len(good) < 100:
        raise DataError(
            f"{record}: {len(good)} of {len(table)} frames have a whole, unsaturated spot; "
            "at least 100 are needed"
        )
    times_s = (good["time_ns"] - good["time_ns"][0]) * 1e-9
    x_px, y_px, u_x_px, u_y_px = (
        np.asarray(good[name], dtype=np.float64) for name in ("x_px", "y_px", "u_x_px", "u_y_px")
    )
    return SpotsOfRecord(times_s, x_px, y_px, u_x_px, u_y_px, began)


def utc(reader: RecordReader, time_ns: int) -> datetime.datetime:
    """Time of a record's clock in UTC."""
    return datetime.datetime.fromtimestamp((time_ns + reader.epoch_offset_ns) * 1e-9, datetime.UTC)

"""Reads the spots of a record for a calibration."""

import datetime
import math
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from acquisition.record.reader import RecordReader
from processing.deflections import Deflections, DeflectionUnit
from processing.errors import DataError
from processing.spot import SpotFlag

_SEGMENTS = 16  # the scatter of so many means is known to 18 %
_SATURATED = 0.1
"""Largest fraction of saturated spots, which are left out; above it the record is rejected."""


def mean_spot(spots: Deflections) -> tuple[float, float, float, float]:
    """Mean x and y in px, then their standard uncertainties.

    The uncertainties are the larger of those stated by the tracker and those from the scatter of the
    means of segments, which includes a slow drift.
    """
    found = []
    for values, u in ((spots.x, spots.u_x), (spots.y, spots.u_y)):
        means = np.array([part.mean() for part in np.array_split(values, _SEGMENTS)])
        claimed = float(np.sqrt(np.mean(u**2) / len(u)))
        found.append((float(values.mean()), max(float(means.std(ddof=1)) / math.sqrt(_SEGMENTS), claimed)))
    return found[0][0], found[1][0], found[0][1], found[1][1]


def spots_of_record(record: Path) -> tuple[Deflections, datetime.datetime]:
    """Positions of a record's complete, unsaturated spots on the sensor, and the start of the record.

    x and y are in px from the sensor's first pixel, y downward. Raises DataError as `whole_spots`.
    """
    good, began = whole_spots(record)
    x_px, y_px, u_x_px, u_y_px = (good[name].copy() for name in ("x_px", "y_px", "u_x_px", "u_y_px"))
    return Deflections(good["time_ns"].copy(), x_px, y_px, u_x_px, u_y_px, DeflectionUnit.PX), began


def binning_of_record(record: Path) -> int:
    """The camera's binning in a record, twice as many pixels with a colour plane; 1 if it has none."""
    with RecordReader(record) as reader:
        stated = reader.metadata.get("camera_settings", {})
    binning = stated.get("binning", "")
    return (int(binning) if binning.isdecimal() else 1) * (2 if "colour_plane" in stated else 1)


def whole_spots(record: Path) -> tuple[NDArray[Any], datetime.datetime]:
    """The table of a record's complete, unsaturated spots, and the start of the record.

    Raises DataError if there are fewer than 100 such spots, or if more than a tenth of all is saturated.
    """
    with RecordReader(record) as reader:
        table = reader.spots()
        began = reader.utc(int(table["time_ns"][0]) if len(table) else 0)
    bad = SpotFlag.LOST | SpotFlag.SATURATED | SpotFlag.EDGE | SpotFlag.CUT
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
    return good, began

"""Positions against time from a table or a film, and the direction of the swing in two positions."""

import csv
import io
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from acquisition import atomic_write
from processing.arrays import Floats, Ints
from processing.errors import DataError, RecordError
from rig.terminal import translated_file_errors

ANGLE_UNITS: Final = ("rad", "mrad", "urad", "nrad", "mas", "arcsec", "arcmin", "deg")
UNSTATED_UNIT: Final = "unit"
"""Placeholder for the unit of positions if none is stated."""


@dataclass(frozen=True, slots=True)
class Trajectory:
    """One or two positions against time, read from a table or a film."""

    times_ns: Ints
    """Times (n,) since the first sample."""
    positions: tuple[Floats, ...]
    """One or two arrays (n,), in `unit`; NaN where a value is missing."""
    names: tuple[str, ...]
    """The column of each position."""
    unit: str
    scale_rad: float | None
    """Size of the unit in rad; None if it is no angle (volts, px, mm), for which no contact law is fitted."""
    time_unit: str = "s"
    """The unit of the times in the file."""
    time_name: str = ""
    """The column of the times."""
    time_is_assumed: bool = False
    """Whether the unit of the times is assumed, because the file does not state it."""
    understood: tuple[str, ...] = ()
    """Lines on how the file was read, and which rows were left out."""
    first_ns: int = 0
    """The first time of the file, in ns."""
    u_common_over_noise: float = 0.0
    """Standard uncertainty of an error that all amplitudes share, in units of the noise of one position."""
    remedy: str = ""
    """What the user can do if no decay is found."""
    run: str = ""
    """The name of the run, if the file holds several."""


_OUTLIER_DISTANCE = 5.0
"""Distance from rest, in median distances, beyond which a position counts by its direction alone."""
_ITERATIONS = 3
_DRIFT_DEGREE, _MIN_SAMPLES_PER_DEGREE = 3, 8
"""Degree of the polynomial drift of the rest position that is subtracted, and samples for one degree."""


def along_and_across(positions: tuple[Floats, ...]) -> tuple[Floats, Floats]:
    """Positions (n,) along the motion and across it; a single position unchanged, with NaN across.

    (across, along) has the handedness of (first, second), so that the sense of a rotation is kept. Raises
    DataError if there is no sample with both positions.
    """
    if len(positions) == 1:
        return positions[0], np.full(len(positions[0]), np.nan)
    both = np.column_stack(positions)
    good = np.isfinite(both).all(axis=1)
    if not good.any():
        raise DataError("no row of the table has both positions; name other columns with --position")
    centred = both - both[good].mean(axis=0)
    along, _ = _directions(both[good])
    return centred @ along, centred @ np.array([along[1], -along[0]])


def _directions(both: Floats) -> Floats:
    """Unit vectors (2, 2) along and across the motion in the positions `both` (n, 2).

    Subtracting a drift of the rest position does not change the direction of the swing. A wrong value, or one
    that marks a missing value, is far from the rest and counts as one sample.
    """
    time, degree = np.linspace(-1.0, 1.0, len(both)), min(_DRIFT_DEGREE, len(both) // _MIN_SAMPLES_PER_DEGREE)
    trend, weights = np.polynomial.legendre.legvander(time, degree), np.ones(len(both))
    centred = both - np.median(both, axis=0)
    deflection = centred
    for _ in range(_ITERATIONS):
        distance = np.hypot(*deflection.T)
        median_distance = float(np.median(distance)) or 1.0
        weights = np.minimum(1.0, _OUTLIER_DISTANCE * median_distance / np.maximum(distance, 1e-300))
        fit, *_ = np.linalg.lstsq(weights[:, None] * trend, weights[:, None] * centred, rcond=None)
        deflection = centred - trend @ fit
    return np.linalg.svd(weights[:, None] * deflection, full_matrices=False)[2]


POSITIONS_NAME = "positions.csv"


def write_positions(trajectory: Trajectory, folder: Path) -> Path:
    """Write time in s and one or two positions in their unit; returns the file. Raises RecordError."""
    target, rows, unit = folder / POSITIONS_NAME, io.StringIO(), trajectory.unit
    writer = csv.writer(rows, lineterminator="\n")
    writer.writerow(("time_s", *(f"{name} [{unit}]" for name in trajectory.names)))
    for time_ns, *position in zip(trajectory.times_ns.tolist(), *trajectory.positions, strict=True):
        time_s = f"{time_ns // 10**9}.{time_ns % 10**9:09d}"
        writer.writerow((time_s, *(f"{value:.10g}" for value in position)))
    with translated_file_errors(target):
        atomic_write.replace(target, rows.getvalue().encode())
    return target


def read_positions(folder: Path) -> tuple[Floats, tuple[Floats, ...]]:
    """Read time in s and one or two positions, NaN where missing; raises RecordError."""
    path = folder / POSITIONS_NAME
    try:
        table = np.genfromtxt(path, delimiter=",", skip_header=1, encoding="utf-8", ndmin=2)
    except FileNotFoundError:
        raise RecordError(f"{path}: is not there; rig fit TABLE -o {folder} writes it") from None
    except (OSError, ValueError) as error:
        raise RecordError(f"{path}: cannot be read: {str(error).splitlines()[0]}") from None
    if table.shape[1] not in (2, 3):
        raise RecordError(f"{path}: has {table.shape[1]} columns; time and one or two positions are needed")
    return table[:, 0], tuple(table[:, 1:].T)

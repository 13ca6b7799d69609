"""Positions against time from a table or a film, and the direction of the swing in two of them."""

import csv
import io
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from acquisition import atomic_write
from processing.errors import DataError, RecordError
from rig.terminal import translated_file_errors

ANGLES: Final = ("rad", "mrad", "urad", "nrad", "mas", "arcsec", "arcmin", "deg")
NOT_STATED: Final = "unit"
"""Placeholder for the unit of positions if none is stated."""


@dataclass(frozen=True, slots=True)
class Trajectory:
    """One or two positions against time, read from a table or a film."""

    times_ns: NDArray[np.int64]
    """Times (n,) since the first sample."""
    positions: tuple[NDArray[np.float64], ...]
    """One or two arrays (n,), in `unit`; NaN where a value is missing."""
    names: tuple[str, ...]
    """The column of each position."""
    unit: str
    scale_rad: float | None
    """Size of the unit in rad; None if it is no angle (volts, px, mm): then without contact parameters."""
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
    u_common_in_noises: float = 0.0
    """Standard uncertainty of an error that all amplitudes share, in units of the noise of one position."""
    remedy: str = ""
    """What the user can do if no decay is found."""
    run: str = ""
    """The name of the run, if the file holds several."""


Array = NDArray[np.float64]
_OUTLIER_DISTANCE = 5.0
"""Distance from rest, in median distances, beyond which a position counts by its direction alone."""
_ITERATIONS = 3
_DRIFT_DEGREE = 3
"""Degree of the polynomial drift of the rest position that is subtracted."""


def along_and_across(positions: tuple[Array, ...]) -> tuple[Array, Array]:
    """Positions (n,) along the motion and across it; a single position unchanged, with NaN across.

    Across lies to along as the first position to the second, so that a rotation keeps its sense.

    Raises DataError if there is no sample with both positions.
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


def _directions(both: Array) -> Array:
    """Unit vectors along and across the motion (n, 2).

    Subtracting a drift of the rest position does not change the direction of the swing. A wrong value, or one
    that marks a missing value, is far from the rest and counts as one sample.
    """
    time = np.linspace(-1.0, 1.0, len(both))
    trend = np.polynomial.legendre.legvander(time, min(_DRIFT_DEGREE, max(len(both) // 8, 0)))
    middle, weights = np.median(both, axis=0), np.ones(len(both))
    moved = both - middle
    for _ in range(_ITERATIONS):
        distance = np.hypot(*moved.T)
        usual = float(np.median(distance)) or 1.0
        weights = np.minimum(1.0, _OUTLIER_DISTANCE * usual / np.maximum(distance, 1e-300))
        fit, *_ = np.linalg.lstsq(weights[:, None] * trend, weights[:, None] * (both - middle), rcond=None)
        moved = both - middle - trend @ fit
    return np.linalg.svd(weights[:, None] * moved, full_matrices=False)[2]


POSITIONS_NAME = "positions.csv"


def write_positions(trajectory: Trajectory, folder: Path) -> Path:
    """Write time in s and one or two positions in their unit; returns the file. Raises RecordError."""
    target, rows, unit = folder / POSITIONS_NAME, io.StringIO(), trajectory.unit
    writer = csv.writer(rows, lineterminator="\n")
    writer.writerow(("time_s", *(f"{name} [{unit}]" for name in trajectory.names)))
    for time_ns, *place in zip(trajectory.times_ns.tolist(), *trajectory.positions, strict=True):
        time_s = f"{time_ns // 10**9}.{time_ns % 10**9:09d}"
        writer.writerow((time_s, *(f"{value:.10g}" for value in place)))
    with translated_file_errors(target):
        atomic_write.replace(target, rows.getvalue().encode())
    return target


def read_positions(folder: Path) -> tuple[NDArray[np.float64], tuple[NDArray[np.float64], ...]]:
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

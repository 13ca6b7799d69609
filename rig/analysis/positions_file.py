"""positions.csv, which stands beside the results of a table or a film: what they were made from, as read."""

import csv
import io
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from acquisition import atomic_write
from processing.errors import RecordError
from rig.analysis.trajectory import Trajectory

POSITIONS_NAME = "positions.csv"


def write_positions(trajectory: Trajectory, folder: Path) -> Path:
    """Write time in s and one or two positions in their unit; returns the file. Raises RecordError."""
    target, rows, unit = folder / POSITIONS_NAME, io.StringIO(), trajectory.unit
    writer = csv.writer(rows, lineterminator="\n")
    writer.writerow(("time_s", *(f"{name} [{unit}]" for name in trajectory.names)))
    for time_ns, *place in zip(trajectory.times_ns.tolist(), *trajectory.positions, strict=True):
        time_s = f"{time_ns // 10**9}.{time_ns % 10**9:09d}"
        writer.writerow((time_s, *(f"{value:.10g}" for value in place)))
    try:
        atomic_write.replace(target, rows.getvalue().encode())
    except OSError as error:
        raise RecordError(f"{target}: cannot be written: {error.strerror or error}") from None
    return target


def read_positions(folder: Path) -> tuple[NDArray[np.float64], tuple[NDArray[np.float64], ...]]:
    """Time in s, and the one or two positions; NaN where there is none. Raises RecordError."""
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

"""Trajectories from other instruments: a text table of time and one or two positions."""

import gzip
import math
import zlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from processing.angle import ARCSEC_RAD
from processing.errors import ConfigurationError, DataError

_LARGEST_TABLE_BYTES = 1024 * 1024 * 1024
_LONGEST_S = 1e9
_ANGLES_RAD = {
    "rad": 1.0,
    "mrad": 1e-3,
    "urad": 1e-6,
    "nrad": 1e-9,
    "arcsec": ARCSEC_RAD,
    "arcmin": 60.0 * ARCSEC_RAD,
    "deg": math.pi / 180.0,
}


@dataclass(frozen=True, slots=True)
class Trajectory:
    """Time in integer ns from the first sample, positions in the user's unit.

    `scale_rad` is the unit in rad, None where the unit is no angle (volts, px, mm): decay and
    period can then be had, contact parameters not.
    """

    times_ns: NDArray[np.int64]
    positions: tuple[NDArray[np.float64], ...]
    names: tuple[str, ...]
    unit: str
    scale_rad: float | None
    skipped_rows: int


def read_trajectory(path: Path, time: str | None, positions: list[str], unit: str) -> Trajectory:
    """Read a table: tab, comma, semicolon or space separated, .gz too, header lines allowed.

    Parameters
    ----------
    time, positions
        Columns by name (of the last header line) or by number from 1. None and empty: the first
        column is the time, the second the position.
    unit
        An angle (rad, mrad, urad, nrad, arcsec, arcmin, deg) or any other word.

    Raises
    ------
    DataError
        No such file, no numbers, times that do not increase.
    ConfigurationError
        A column that the table does not have.
    """
    header, rows, skipped = _table(path)
    width = len(rows[0])
    t_column = _column(path, header, width, time, default=0)
    p_columns = [_column(path, header, width, name, default=1) for name in positions] or [
        _column(path, header, width, None, default=1)
    ]
    if len(p_columns) > 2:
        raise ConfigurationError(f"--position was given {len(p_columns)} times; one or two columns are used")
    table = np.array(rows, dtype=np.float64)
    times_s = table[:, t_column]
    good = np.isfinite(times_s)
    table, times_s = table[good], times_s[good]
    if len(times_s) < 2:
        raise DataError(f"{path}: {len(times_s)} rows have a time; name the time column with --time")
    if np.abs(times_s).max() > _LONGEST_S:
        raise DataError(f"{path}: a time of {np.abs(times_s).max():g} s; times are in seconds")
    backwards = np.nonzero(np.diff(times_s) <= 0)[0]
    if len(backwards):
        row = int(backwards[0])
        raise DataError(
            f"{path}: time does not increase after {times_s[row]:g} s (row {row + 1}): "
            f"{times_s[row + 1]:g} s follows; sort the rows or name the time column with --time"
        )
    return Trajectory(
        times_ns=np.round((times_s - times_s[0]) * 1e9).astype(np.int64),
        positions=tuple(table[:, column] for column in p_columns),
        names=tuple(header[column] if header else f"column {column + 1}" for column in p_columns),
        unit=unit or "unit",
        scale_rad=_ANGLES_RAD.get(unit),
        skipped_rows=skipped,
    )


def _table(path: Path) -> tuple[list[str], list[list[float]], int]:
    try:
        with gzip.open(path) if path.suffix == ".gz" else path.open("rb") as file:
            raw = file.read(_LARGEST_TABLE_BYTES + 1)
    except FileNotFoundError:
        raise DataError(f"{path}: no such file") from None
    except (OSError, EOFError, zlib.error) as error:
        raise DataError(f"{path}: cannot be read: {error}") from None
    except ValueError as error:
        raise DataError(f"{str(path)!r}: is not the name of a file ({error})") from None
    if len(raw) > _LARGEST_TABLE_BYTES:
        raise DataError(f"{path}: is longer than {_LARGEST_TABLE_BYTES >> 20} MiB; take fewer rows")
    text = raw.decode("utf-8-sig", errors="replace")
    header: list[str] = []
    rows: list[list[float]] = []
    skipped = 0
    for line in text.splitlines():
        cells = _cells(line)
        values = [_number(cell) for cell in cells]
        if not cells or line.lstrip().startswith("#"):
            continue
        if not rows and sum(value is not None for value in values) < 2:
            header = cells
            continue
        if rows and len(values) != len(rows[0]):
            skipped += 1
            continue
        rows.append([math.nan if value is None else value for value in values])
    if len(rows) < 2:
        raise DataError(
            f"{path}: holds {len(rows)} rows of numbers; a table of time and position is expected "
            "(separated by tabs, commas, semicolons or spaces)"
        )
    if len(rows[0]) < 2:
        raise DataError(f"{path}: has one column; time and position are needed")
    return (header if len(header) == len(rows[0]) else []), rows, skipped


def _cells(line: str) -> list[str]:
    for separator in ("\t", ";", ","):
        if separator in line:
            return [cell.strip().strip('"') for cell in line.split(separator)]
    return line.split()


def _number(cell: str) -> float | None:
    try:
        return float(cell)
    except ValueError:
        return None


def _column(path: Path, header: list[str], width: int, name: str | None, default: int) -> int:
    if name is None:
        return default
    if name in header:
        return header.index(name)
    if name.isdecimal() and 1 <= int(name) <= width:
        return int(name) - 1
    known = ", ".join(header) if header else f"1 to {width} (the table has no header line)"
    raise ConfigurationError(f"{path}: has no column {name!r}; columns: {known}")

"""Tables of other instruments: a text table of time and one or two positions, or an envelope."""

import gzip
import math
import re
import zlib
from dataclasses import dataclass, replace
from decimal import Decimal
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from processing.errors import ConfigurationError, DataError
from processing.ticks import seconds
from processing.units import conversion

_LARGEST_TABLE_BYTES = 1024 * 1024 * 1024
_LONGEST_S = 1e9  # thirty years; 64 bits of nanoseconds hold nine times as much
TIME_UNITS = ("ns", "us", "ms", "s", "min", "h")
_EXACT = 2**53
"""Largest whole number of ns that a floating-point number holds."""
_DECIMAL_COMMA = re.compile(r"[+-]?\d+,\d+(?:[eE][+-]?\d+)?")
_WHOLE = re.compile(r"[+-]?\d+")
_SORT = "sort the rows or name the time column with --time"
_NO_COMMAS = (
    "its commas seem to be decimal commas as well as separators, which cannot be told apart: save it with "
    "semicolons or tabs between the columns, or with decimal points"
)
NOT_STATED = "unit"
"""Stands for the unit of positions where none is stated."""
ANGLES = ("rad", "mrad", "urad", "nrad", "arcsec", "arcmin", "deg")


@dataclass(frozen=True, slots=True)
class Trajectory:
    """Time in integer ns from the first sample, positions in the user's unit.

    `scale_rad` is the unit in rad, None where the unit is no angle (volts, px, mm): decay and
    period can then be had, contact parameters not. `time_unit` is that of the table's times,
    `time_name` their column, `first_ns` the first of them as it stands there.
    """

    times_ns: NDArray[np.int64]
    positions: tuple[NDArray[np.float64], ...]
    names: tuple[str, ...]
    unit: str
    scale_rad: float | None
    skipped_rows: int
    time_unit: str = "s"
    time_name: str = ""
    first_ns: int = 0


def read_trajectory(
    path: Path, time: str | None, positions: list[str], unit: str, time_unit: str = ""
) -> Trajectory:
    """Read a table: tab, comma, semicolon or space separated, .gz too, header lines allowed.

    A comma is a decimal comma where tabs or semicolons separate the columns, or spaces do and every word is a
    number with one comma or a whole number.

    Parameters
    ----------
    time, positions
        Columns by name (of the last header line) or by number from 1. None and empty: the first
        column is the time, the second the position.
    unit
        An angle (rad, mrad, urad, nrad, arcsec, arcmin, deg) or any other word.
    time_unit
        ns, us, ms, s, min or h; empty: the one with which the column's name ends (time_ms), else s. Times may
        be absolute: they are read to the ns however large they are.

    Raises
    ------
    DataError
        No such file, no numbers, times that do not increase.
    ConfigurationError
        A column or a unit of time that there is not.
    """
    if time_unit and time_unit not in TIME_UNITS:
        raise ConfigurationError(
            f"--time-unit {time_unit!r} is no unit of time; take one of {', '.join(TIME_UNITS)}"
        )
    if len(positions) > 2:
        raise ConfigurationError(f"--position was given {len(positions)} times; one or two columns are used")
    found = _columns(path, time, positions, time_unit, default=[1])
    return replace(
        found, unit=unit or NOT_STATED, scale_rad=conversion(unit, "rad") if unit in ANGLES else None
    )


def read_columns(path: Path, time: str | None, columns: list[str]) -> Trajectory:
    """Time and any number of columns of a table, all but the time without names; see `read_trajectory`."""
    return _columns(path, time, columns, "", default=None)


def _columns(
    path: Path, time: str | None, positions: list[str], time_unit: str, default: list[int] | None
) -> Trajectory:
    header, rows, skipped = _table(path)
    width = len(rows[0])
    t_column = _column(path, header, width, time, default=0)
    time_unit = time_unit or (_unit_in_name(header[t_column]) if header else "") or "s"
    p_columns = [_column(path, header, width, name, default=1) for name in positions] or (
        default or [column for column in range(width) if column != t_column]
    )
    table = np.array([[_value(row[column]) for column in p_columns] for row in rows], dtype=np.float64)
    remedy = _SORT if not _split_at_decimal_commas(header, rows) else _NO_COMMAS
    times_ns, good, first_ns = _times_ns(path, [row[t_column] for row in rows], time_unit, remedy)
    table = table[good]
    return Trajectory(
        times_ns=times_ns,
        positions=tuple(table.T),
        names=tuple(header[column] if header else f"column {column + 1}" for column in p_columns),
        unit=NOT_STATED,
        scale_rad=None,
        skipped_rows=skipped,
        time_unit=time_unit,
        time_name=header[t_column] if header else f"column {t_column + 1}",
        first_ns=first_ns,
    )


def _unit_in_name(name: str) -> str:
    """The unit of time with which a name ends (time_ms, t [ms], t/ms, t (ms)); empty where it has none."""
    found = re.search(rf"(?:_|[\s/(\[])({'|'.join(TIME_UNITS)})[)\]]?$", name.strip())
    return found[1] if found else ""


def _times_ns(
    path: Path, cells: list[str], unit: str, remedy: str
) -> tuple[NDArray[np.int64], NDArray[np.bool_], int]:
    """Times from the first one in ns, which of the rows have one, and the first one.

    `remedy` is said where they do not increase.
    """
    times = np.array([_value(cell) for cell in cells])
    good = np.isfinite(times)
    times = times[good]
    if len(times) < 2:
        raise DataError(f"{path}: {len(times)} rows have a time; name the time column with --time")
    size_ns = round(conversion(unit, "ns"))
    with np.errstate(over="ignore", invalid="ignore"):
        backwards = np.nonzero(~(np.diff(times) >= 0))[0]
        span_s = (times[-1] - times[0]) * seconds(size_ns)
        exact = not np.abs(times).max() * size_ns < _EXACT
    if not len(backwards) and not span_s <= _LONGEST_S:
        raise DataError(
            f"{path}: the times span {span_s:.3g} s, which no decay lasts; state their unit "
            "(--time-unit ns), or name the time column with --time"
        )
    if not len(backwards):
        if exact:
            whole = [Decimal(cell) * size_ns for cell, kept in zip(cells, good, strict=True) if kept]
            times_ns = np.array([round(value - whole[0]) for value in whole], dtype=np.int64)
        else:
            times_ns = np.round((times - times[0]) * size_ns).astype(np.int64)
        backwards = np.nonzero(np.diff(times_ns) <= 0)[0]
    if len(backwards):
        row = int(backwards[0])
        raise DataError(
            f"{path}: time does not increase after {times[row]:.16g} {unit} (row {row + 1}): "
            f"{times[row + 1]:.16g} {unit} follows; {remedy}"
        )
    return times_ns, good, round(times[0] * size_ns)


def _table(path: Path) -> tuple[list[str], list[list[str]], int]:
    """Header, cells of every row with numbers (a decimal point in each), number of rows left out."""
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
    rows: list[list[str]] = []
    skipped = 0
    for line in text.splitlines():
        cells = _cells(line)
        if not cells or line.lstrip().startswith("#"):
            continue
        if not rows and sum(not math.isnan(_value(cell)) for cell in cells) < 2:
            header = cells
            continue
        if rows and len(cells) != len(rows[0]):
            skipped += 1
            continue
        rows.append(cells)
    if len(rows) < 2:
        raise DataError(
            f"{path}: holds {len(rows)} rows of numbers; a table of time and position is expected "
            "(separated by tabs, commas, semicolons or spaces)"
        )
    if len(rows[0]) < 2:
        raise DataError(f"{path}: has one column; time and position are needed")
    return (header if len(header) == len(rows[0]) else []), rows, skipped


def _split_at_decimal_commas(header: list[str], rows: list[list[str]]) -> bool:
    """Whether a table is likely one whose numbers were split at their decimal commas.

    Then it has two columns for each name, so that no header fits, and nowhere a decimal point.
    """
    return not header and len(rows[0]) >= 4 and not any("." in cell for row in rows[:50] for cell in row)


def _cells(line: str) -> list[str]:
    for separator in ("\t", ";"):
        if separator in line:
            return [_with_point(cell.strip().strip('"')) for cell in line.split(separator)]
    words = line.split()
    commas = [bool(_DECIMAL_COMMA.fullmatch(word)) for word in words]
    if (
        len(words) > 1
        and any(commas)
        and all(comma or _WHOLE.fullmatch(word) for comma, word in zip(commas, words, strict=True))
    ):
        return [_with_point(word) for word in words]
    return [cell.strip().strip('"') for cell in line.split(",")] if "," in line else words


def _with_point(cell: str) -> str:
    """A number with a decimal comma with a point instead; anything else as it is."""
    return cell.replace(",", ".") if _DECIMAL_COMMA.fullmatch(cell) else cell


def _value(cell: str) -> float:
    """A number; NaN for anything else."""
    try:
        return float(cell)
    except ValueError:
        return math.nan


def _column(path: Path, header: list[str], width: int, name: str | None, default: int) -> int:
    if name is None:
        return default
    if name in header:
        return header.index(name)
    if name.isdecimal() and 1 <= int(name) <= width:
        return int(name) - 1
    known = ", ".join(header) if header else f"1 to {width} (the table has no header line)"
    raise ConfigurationError(f"{path}: has no column {name!r}; columns: {known}")

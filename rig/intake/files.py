"""A table's file read as text or as rows of cells: text in any encoding, .gz, .xlsx, .npy, .mat."""

import gzip
import io
import math
import re
import zipfile
import zlib
from datetime import date, datetime, time, timedelta
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from processing.errors import DataError, optional_module
from rig.intake.cell_text import is_missing, is_number, is_timestamp

_MAX_BYTES: Final = 1024 * 1024 * 1024
_JUDGED_CHARACTERS: Final = 4000
_COMPLEX_TYPES: Final = (np.complex64, np.complex128)
_ENCODING_MARKS: Final = ((b"\xff\xfe", "utf-16"), (b"\xfe\xff", "utf-16"), (b"\xef\xbb\xbf", "utf-8-sig"))


class Sheet(NamedTuple):
    """Rows of one sheet as text, and remarks on what a user of the workbook would not expect."""

    rows: list[list[str]]
    remarks: tuple[str, ...] = ()


def read_bytes_of(path: Path) -> bytes:
    """The bytes of a file, unpacked; raises DataError if it cannot be read."""
    try:
        with gzip.open(path) if path.suffix == ".gz" else path.open("rb") as file:
            raw = file.read(_MAX_BYTES + 1)
    except FileNotFoundError:
        raise DataError(f"{path}: no such file") from None
    except (OSError, EOFError, zlib.error) as error:
        raise DataError(f"{path}: cannot be read: {error}") from None
    except ValueError as error:
        raise DataError(f"{str(path)!r}: is not the name of a file ({error})") from None
    if len(raw) > _MAX_BYTES:
        raise DataError(f"{path}: is longer than {_MAX_BYTES >> 20} MiB; take fewer rows")
    return raw


def text_of_file(path: Path, raw: bytes) -> str:
    """Text from UTF-8, from UTF-16 with or without its mark, or from Windows-1252; DataError for no text."""
    text = _decode(raw)
    if "\0" in text[:_JUDGED_CHARACTERS]:
        remedy = "save the table as text (CSV, UTF-8), or as .xlsx, .npy or .mat, with that ending"
        raise DataError(f"{path}: is no text; {remedy}")
    return text


def _decode(raw: bytes) -> str:
    for mark, encoding in _ENCODING_MARKS:
        if raw.startswith(mark):
            return raw.decode(encoding, errors="replace")
    head = raw[:_JUDGED_CHARACTERS]
    # in UTF-16 every second byte of digits and separators is zero
    if len(head) > 3 and head.count(0) > len(head) // 3:
        little = head[1::2].count(0) > head[::2].count(0)
        return raw.decode("utf-16-le" if little else "utf-16-be", errors="replace")
    try:
        return raw.decode("utf-8")
    except UnicodeDecodeError:
        return raw.decode("cp1252", errors="replace")


def binary_rows(path: Path, raw: bytes) -> Sheet | None:
    """Rows of a file that is no text, after a header if it has names; None for a text."""
    name = path.name.lower().removesuffix(".gz")
    if name.endswith(".npy"):
        return Sheet(_rows_of_array(path, raw))
    if name.endswith(".mat"):
        return Sheet(_rows_of_matlab(path, raw))
    if name.endswith((".xlsx", ".xlsm")):
        try:
            return workbook_rows(raw, path)
        except (zipfile.BadZipFile, zlib.error, EOFError, RuntimeError, ValueError) as error:
            raise DataError(f"{path}: cannot be read as a workbook: {error}") from None
    if name.endswith((".xls", ".ods")):
        raise DataError(f"{path}: save it as .xlsx or as text (CSV); {path.suffix} is not read")
    return None


def _rows_of_array(path: Path, raw: bytes) -> list[list[str]]:
    try:
        array = np.load(io.BytesIO(raw), allow_pickle=False)
    # any exception, because Python's parser may raise many kinds for a damaged header
    except Exception as error:
        raise DataError(f"{path}: cannot be read as a .npy array: {error}") from None
    if not isinstance(array, np.ndarray):
        raise DataError(f"{path}: holds several arrays; save one of them (.npy)")
    if array.dtype.names:
        return _with_names({name: array[name] for name in array.dtype.names}, path)
    return _rows_of_matrix(path, "the array", array)


def _rows_of_matlab(path: Path, raw: bytes) -> list[list[str]]:
    from scipy.io import loadmat

    try:
        found = loadmat(io.BytesIO(raw), squeeze_me=True)  # type: ignore[arg-type]
    except NotImplementedError:
        found = _variables_of_hdf5(path, raw)
    # any exception, as above
    except Exception as error:
        raise DataError(f"{path}: cannot be read as a .mat file: {error}") from None
    numbers = {
        name: value
        for name, value in found.items()
        if not name.startswith("__") and isinstance(value, np.ndarray) and value.dtype.kind in "iuf"
    }
    vectors = {name: value for name, value in numbers.items() if value.ndim == 1 and len(value) > 2}
    matrices = {name: value for name, value in numbers.items() if value.ndim == 2}
    if len(matrices) == 1 and not vectors:
        return _rows_of_matrix(path, *next(iter(matrices.items())))
    if complex_ := [name for name, value in found.items() if getattr(value, "dtype", None) in _COMPLEX_TYPES]:
        raise DataError(f"{path}: {complex_[0]} is complex; save its real part")
    if not vectors or matrices:
        others = ", ".join(name for name in found if not name.startswith("__") and name not in numbers)
        raise DataError(
            f"{path}: one matrix, or vectors of equal length, are needed; it holds "
            f"{', '.join(numbers) or 'none'}"
            + (
                f" (no arrays of numbers: {others}; save the fields of a struct as variables)"
                if others
                else ""
            )
        )
    return _with_names(vectors, path)


def _variables_of_hdf5(path: Path, raw: bytes) -> dict[str, Any]:
    """The numeric arrays of a .mat file of version 7.3, which is HDF5 with rows and columns exchanged."""
    what = f"{path}: a .mat file of version 7.3"
    h5py = optional_module("h5py", what, "h5py", "data", "save it with -v7")
    try:
        with h5py.File(io.BytesIO(raw), "r") as file:
            datasets = {name: item for name, item in file.items() if isinstance(item, h5py.Dataset)}
            return {
                name: np.squeeze(np.asarray(item).T)
                for name, item in datasets.items()
                # characters are also stored as whole numbers, and an empty array as its size
                if _matlab_class(item) != "char" and "MATLAB_empty" not in item.attrs
            }
    # any exception, because HDF5 raises many kinds for a damaged file
    except Exception as error:
        raise DataError(f"{path}: cannot be read as a .mat file: {str(error).splitlines()[0]}") from None


def _matlab_class(item: Any) -> str:
    stated = item.attrs.get("MATLAB_class", b"")
    return stated.decode() if isinstance(stated, bytes) else str(stated)


def _rows_of_matrix(path: Path, name: str, array: Any) -> list[list[str]]:
    if array.dtype.kind not in "iuf" or array.ndim not in (1, 2):
        raise DataError(
            f"{path}: {name} has shape {array.shape} and type {array.dtype}; columns of numbers are needed"
        )
    columns = array[:, None] if array.ndim == 1 else array
    # few rows of many values are transposed columns
    if columns.shape[0] <= 4 < columns.shape[1]:
        columns = columns.T
    return [[repr(value) for value in row] for row in columns.tolist()]


def _with_names(columns: dict[str, Any], path: Path) -> list[list[str]]:
    lengths = {name: len(np.atleast_1d(value)) for name, value in columns.items()}
    if len(set(lengths.values())) != 1:
        listed = ", ".join(f"{name} {length}" for name, length in lengths.items())
        raise DataError(
            f"{path}: its vectors have different lengths ({listed}); save those of one measurement"
        )
    return [list(columns), *map(list, zip(*map(_texts, columns.values()), strict=True))]


def _texts(column: Any) -> list[str]:
    """Cells of a column as text: numbers with all digits, moments in ISO 8601."""
    values = np.asarray(column)
    if values.dtype.kind == "M":
        return list(map(str, np.datetime_as_string(values)))
    return [each if isinstance(each, str) else repr(each) for each in values.tolist()]


_FIRST_DAY: Final = datetime(1899, 12, 30)
_FIRST_DAY_1904: Final = datetime(1904, 1, 1)
"""Day 0 of workbooks made on a Mac."""
_DAY_0_BOUNDARY: Final = datetime(1902, 1, 1)
"""A date between the two first days: a workbook whose day 0 is later counts from 1904."""
_HIDDEN_CELLS: Final = re.compile(rb'<(?:row|col)\b[^>]*\bhidden="(?:1|true)"')
_FAR_CELL: Final = re.compile(rb'<c\b[^>]*\br="([A-Z]{3,}\d+)"[^>]*(?<!/)>')
"""A cell with a value in column AAA, the 703rd, or beyond, which needs memory for all cells before it."""
_MIN_SHEET_FRACTION: Final = 0.25
"""Fewest rows of a sheet with a table, as a fraction of the rows of the longest table."""


def workbook_rows(raw: bytes, path: Path) -> Sheet:
    """The first sheet that holds a table of numbers; visible sheets come before hidden ones.

    Raises ValueError if there is none or the file is damaged, and MissingPackage, which names the file
    `path`, if no reader of workbooks is installed.
    """
    what, instead = f"{path}: a workbook", "save it as text (CSV)"
    calamine = optional_module("python_calamine", what, "python-calamine", "data", instead)
    try:
        plain, hides = _without_styles(raw)
        book, unstyled = (calamine.load_workbook(source) for source in (io.BytesIO(raw), plain))
        is_visible = {
            about.name: about.visible == calamine.SheetVisibleEnum.Visible
            for about in book.sheets_metadata
            if about.typ == calamine.SheetTypeEnum.WorkSheet
        }
        sheets = {
            title: _rows(
                book.get_sheet_by_name(title).to_python(skip_empty_area=False),
                unstyled.get_sheet_by_name(title).to_python(skip_empty_area=False),
            )
            for title in is_visible
        }
    except calamine.CalamineError as error:
        raise ValueError(str(error)) from None
    counts = {title: _numeric_rows(rows) for title, rows in sheets.items()}
    # a sheet with a few constants is not the table
    least = max(2, math.ceil(_MIN_SHEET_FRACTION * max(counts.values(), default=0)))
    with_table = [title for title, count in counts.items() if count >= least]
    with_table = [title for title in with_table if is_visible[title]] or with_table
    if not with_table:
        raise ValueError(
            "no sheet holds numbers; the values of formulas are in it once a spreadsheet program saves it"
        )
    title, remarks = with_table[0], []
    if len(with_table) > 1:
        others = ", ".join(repr(other) for other in with_table[1:])
        remarks.append(f"sheet {title!r}, the first that holds a table; {others} not read: save it as a file")
    elif len(sheets) > 1:
        remarks.append(f"sheet {title!r}" + ("" if is_visible[title] else ", which is hidden"))
    if hides:
        remarks.append("rows or columns that the workbook hides are read, too")
    return Sheet(sheets[title], tuple(remarks))


def _without_styles(raw: bytes) -> tuple[io.BytesIO, bool]:
    """The workbook without styles, so that dates are read as numbers of days, and whether it hides rows or
    columns.

    calamine rounds dates to 1 ms, and ends the whole program if it runs out of memory.
    """
    plain, hides = io.BytesIO(), False
    with zipfile.ZipFile(io.BytesIO(raw)) as before, zipfile.ZipFile(plain, "w") as after:
        for entry in before.infolist():
            part = before.read(entry)
            if entry.filename.startswith("xl/worksheets/"):
                hides = hides or _HIDDEN_CELLS.search(part) is not None
                if far := _FAR_CELL.search(part):
                    raise ValueError(f"cell {far[1].decode()} is too far from a table; clear it")
            if entry.filename != "xl/styles.xml":
                after.writestr(entry, part)
    plain.seek(0)
    return plain, hides


def _numeric_rows(rows: list[list[str]]) -> int:
    """Number of rows that may belong to a table: they hold two numbers, or one and nothing else."""
    values = [
        [(is_number(cell) and not is_missing(cell)) or is_timestamp(cell) for cell in row if cell]
        for row in rows
    ]
    return sum(sum(row) > 1 or (len(row) == 1 and all(row)) for row in values)


def _rows(shown: list[list[Any]], stored: list[list[Any]]) -> list[list[str]]:
    """Cells as text from shown and stored values; dates and times are computed from the stored days."""
    cells = [list(zip(*rows, strict=True)) for rows in zip(shown, stored, strict=True)]
    since_1904 = any(
        isinstance(moment, datetime) and _is_number(days) and moment - timedelta(days=days) > _DAY_0_BOUNDARY
        for row in cells
        for moment, days in row
    )
    first_day = _FIRST_DAY_1904 if since_1904 else _FIRST_DAY
    return [[_text(moment, value, first_day) for moment, value in row] for row in cells]


def _text(shown: Any, stored: Any, first_day: datetime) -> str:
    if isinstance(shown, date | time | timedelta) and _is_number(stored):
        # a number of days in double precision resolves microseconds
        moment = first_day + timedelta(microseconds=round(stored * 86_400_000_000))
        return moment.isoformat(sep=" ")
    if isinstance(stored, bool) or (isinstance(stored, float) and stored.is_integer()):
        return str(int(stored))
    return str(stored)


def _is_number(cell: Any) -> bool:
    return isinstance(cell, int | float)

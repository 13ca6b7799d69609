"""Files of tables: text (UTF-8, UTF-16 with a byte-order mark, Windows-1252), .gz, .xlsx, .npy, .mat."""

import gzip
import io
import zlib
from datetime import timedelta
from pathlib import Path
from typing import Any, Final

import numpy as np

from processing.errors import DataError, optional_module
from rig.intake.cell_text import is_missing, is_number, is_timestamp

_MAX_BYTES: Final = 1024 * 1024 * 1024
_NUL_SEARCH_CHARACTERS: Final = 4000
"""Number of characters, from the beginning, among which a NUL shows that a file is no text."""
_BYTE_ORDER_MARKS: Final = ((b"\xff\xfe", "utf-16"), (b"\xfe\xff", "utf-16"), (b"\xef\xbb\xbf", "utf-8-sig"))
_MAX_TRANSPOSED_COLUMNS: Final = 4
"""Most rows of a matrix that are taken for columns if they are longer than that."""

TextRows = tuple[list[list[str]], tuple[str, ...]]
"""Rows of cells, and remarks for the user, such as sheets that were not read."""


def read_bytes_of(path: Path) -> bytes:
    """The bytes of a file, unpacked; raises DataError if it cannot be read."""
    try:
        with gzip.open(path) if path.suffix.lower() == ".gz" else path.open("rb") as file:
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
    """Text from UTF-8, UTF-16 with a byte-order mark, or Windows-1252; DataError for no text."""
    encoding = next((name for mark, name in _BYTE_ORDER_MARKS if raw.startswith(mark)), "")
    try:
        text = raw.decode(encoding, errors="replace") if encoding else raw.decode("utf-8")
    except UnicodeDecodeError:
        text = raw.decode("cp1252", errors="replace")
    if "\0" in text[:_NUL_SEARCH_CHARACTERS]:
        remedy = "save the table as text (CSV, UTF-8), or as .xlsx, .npy or .mat, with that ending"
        raise DataError(f"{path}: is no text; {remedy}")
    # matplotlib writes U+2212 for a minus, word processors an en dash
    return text.translate({0x2212: "-", 0x2013: "-"})


def binary_rows(path: Path, raw: bytes) -> TextRows | None:
    """Rows of a binary table, the first with the names if the file has them; None for text."""
    name = path.name.lower().removesuffix(".gz")
    if name.endswith(".npy"):
        return _rows_of_array(path, raw), ()
    if name.endswith(".mat"):
        return _rows_of_matlab(path, raw), ()
    if name.endswith((".xlsx", ".xlsm")):
        return _rows_of_workbook(path, raw)
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
        return _named_columns({name: array[name] for name in array.dtype.names}, path)
    return _rows_of_matrix(path, "the array", array)


def _rows_of_matlab(path: Path, raw: bytes) -> list[list[str]]:
    from scipy.io import loadmat

    try:
        variables = loadmat(io.BytesIO(raw), squeeze_me=True)  # type: ignore[arg-type]
    except NotImplementedError:
        raise DataError(f"{path}: a .mat file of version 7.3 is not read; save it with -v7") from None
    # any exception, because SciPy's parser may raise many kinds for a damaged file
    except Exception as error:
        raise DataError(f"{path}: cannot be read as a .mat file: {error}") from None
    variables = {name: value for name, value in variables.items() if not name.startswith("__")}
    numbers = {
        name: value
        for name, value in variables.items()
        if isinstance(value, np.ndarray) and value.dtype.kind in "iuf"
    }
    vectors = {name: value for name, value in numbers.items() if value.ndim == 1 and len(value) > 2}
    matrices = {name: value for name, value in numbers.items() if value.ndim == 2}
    if len(matrices) == 1 and not vectors:
        return _rows_of_matrix(path, *next(iter(matrices.items())))
    if not vectors or matrices:
        others = ", ".join(name for name in variables if name not in numbers)
        raise DataError(
            f"{path}: one matrix, or vectors of equal length, are needed; it holds "
            f"{', '.join(numbers) or 'none'}{f' (no arrays of real numbers: {others})' if others else ''}"
        )
    return _named_columns(vectors, path)


def _rows_of_matrix(path: Path, name: str, array: Any) -> list[list[str]]:
    if array.dtype.kind not in "iuf" or array.ndim not in (1, 2):
        raise DataError(
            f"{path}: {name} has shape {array.shape} and type {array.dtype}; columns of numbers are needed"
        )
    columns = array[:, None] if array.ndim == 1 else array
    if columns.shape[0] <= _MAX_TRANSPOSED_COLUMNS < columns.shape[1]:
        columns = columns.T
    return [[repr(value) for value in row] for row in columns.tolist()]


def _named_columns(columns: dict[str, Any], path: Path) -> list[list[str]]:
    lengths = {name: len(np.atleast_1d(value)) for name, value in columns.items()}
    if len(set(lengths.values())) != 1:
        listed = ", ".join(f"{name} {length}" for name, length in lengths.items())
        raise DataError(
            f"{path}: its vectors have different lengths ({listed}); save those of one measurement"
        )
    return [list(columns), *map(list, zip(*map(_column_cells, columns.values()), strict=True))]


def _column_cells(column: Any) -> list[str]:
    """Cells of a column as text: numbers with all digits, moments in ISO 8601."""
    values = np.asarray(column)
    if values.dtype.kind == "M":
        return list(map(str, np.datetime_as_string(values)))
    return [value if isinstance(value, str) else repr(value) for value in values.tolist()]


_MIN_SHEET_FRACTION: Final = 0.25
"""A sheet holds a table if it has at least this fraction of the rows of the longest one."""


def _rows_of_workbook(path: Path, raw: bytes) -> TextRows:
    """The first visible sheet that holds a table of numbers, and a remark on the others."""
    purpose, alternative = f"{path}: a workbook", "save it as text (CSV)"
    calamine = optional_module("python_calamine", purpose, "python-calamine", "data", alternative)
    try:
        book = calamine.load_workbook(io.BytesIO(raw))
        sheets = {
            sheet.name: [
                list(map(_cell_text, row))
                for row in book.get_sheet_by_name(sheet.name).to_python(skip_empty_area=False)
            ]
            for sheet in book.sheets_metadata
            if sheet.typ == calamine.SheetTypeEnum.WorkSheet
            and sheet.visible == calamine.SheetVisibleEnum.Visible
        }
    except calamine.CalamineError as error:
        raise DataError(f"{path}: cannot be read as a workbook: {error}") from None
    counts = {title: _numeric_rows(rows) for title, rows in sheets.items()}
    # a sheet with a few constants is not the table
    min_rows = max(2, _MIN_SHEET_FRACTION * max(counts.values(), default=0))
    titles = [title for title, count in counts.items() if count >= min_rows]
    if not titles:
        raise DataError(
            f"{path}: no visible sheet holds numbers; the values of formulas are in it once a spreadsheet "
            "program saves it"
        )
    title, *others = titles
    if others:
        not_read = f"{', '.join(map(repr, others))} not read: save it as a file"
        return sheets[title], (f"sheet {title!r}, the first that holds a table; {not_read}",)
    return sheets[title], (f"sheet {title!r}",) if len(sheets) > 1 else ()


def _numeric_rows(rows: list[list[str]]) -> int:
    """Number of rows that may belong to a table: they hold two numbers, or one and nothing else."""
    values = [
        [(is_number(cell) and not is_missing(cell)) or is_timestamp(cell) for cell in row if cell]
        for row in rows
    ]
    return sum(sum(row) > 1 or (len(row) == 1 and all(row)) for row in values)


def _cell_text(cell: Any) -> str:
    """A cell as text: dates in ISO 8601, a duration in s."""
    if isinstance(cell, timedelta):
        return repr(cell.total_seconds())
    if isinstance(cell, bool) or (isinstance(cell, float) and cell.is_integer()):
        return str(int(cell))
    return str(cell)

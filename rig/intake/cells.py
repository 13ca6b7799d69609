"""A table's file as a header and rows of cells, with the lines that were left out."""

import csv
import re
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Final

from processing.errors import DataError
from rig.intake.cell_text import NumberFormat, counts_rows, is_timestamp, is_value, number_format, split_unit
from rig.intake.files import binary_rows, read_bytes_of, text_of_file
from rig.intake.units import TIME_NAME, is_time, known_unit, split_name

_COMMENTS: Final = ("#", "%", "//", "!")
_SEPARATORS: Final = {"tabs": "\t", "semicolons": ";", "bars": "|", "commas": ","}
# A sentence above the rows contains commas and blanks, too, but not these marks.
_SURE_MARKS: Final = ("tabs", "semicolons")
_NO_UNIT: Final = ("", "-", "--", "n/a", "none", "ts", "rn")
"""Cells without a unit in a line of units; the last two are Campbell loggers', for times and row numbers."""
_BRACKETED: Final = re.compile(r"\s*[\[({<].*[\])}>]\s*")
_MAX_SAMPLED_LINES: Final = 2000
_BLANKS: Final = re.compile(r"[ \t]+")
_ANY_MARK: Final = re.compile(r"\s*[;,|\t ]\s*")


@dataclass(frozen=True, slots=True)
class Cells:
    """The cells of a table: names and units of the columns, and rows with the numbers of their lines.

    `names` is empty without a header; `units` are those stated in a line of their own or in the cells.
    `left_out` are the numbers of lines with another number of columns. `blocks` holds, for each row, the
    number of its block; blocks are separated by blank lines, comments or a repeated header. `remarks` are
    remarks on the reading.
    """

    names: Sequence[str]
    units: Sequence[str]
    rows: Sequence[Sequence[str]]
    lines: Sequence[int]
    left_out: Sequence[int]
    blocks: Sequence[int]
    separator: str
    number_format: NumberFormat
    remarks: Sequence[str] = ()


def read_cells(path: Path, decimal: str = "") -> Cells:
    """Read a file; `decimal` is the decimal mark if it has to be stated.

    Raises
    ------
    DataError
        The file holds no rows of numbers, or cannot be read.
    ConfigurationError
        The numbers fit two formats.
    """
    raw = read_bytes_of(path)
    binary = binary_rows(path, raw)
    if binary is not None:
        filled = [(number, cells) for number, cells in enumerate(binary.rows, 1) if any(cells)]
        return replace(_cells(path, filled, [], "", decimal), remarks=binary.remarks)
    numbered = [
        (number, line)
        for number, line in enumerate(text_of_file(path, raw).splitlines(), 1)
        if line.strip(" \t;,|")
    ]
    plain = [item for item in numbered if not item[1].lstrip().startswith(_COMMENTS)]
    name, split = _separator([line for _, line in plain])
    comments = [
        split(line.strip().lstrip("#%/! ")) for _, line in numbered if line.lstrip().startswith(_COMMENTS)
    ]
    return _cells(path, [(number, split(line)) for number, line in plain], comments, name, decimal)


def _separator(lines: Sequence[str]) -> tuple[str, Callable[[str], list[str]]]:
    """The separator, by name and as a function: the one that splits most lines into equally many numbers."""
    step = max(len(lines) // _MAX_SAMPLED_LINES, 1)
    sample = lines[::step]
    splitters: dict[str, Callable[[str], list[str]]] = {
        name: _splitter(mark) for name, mark in _SEPARATORS.items()
    }
    splitters |= {
        "blanks": lambda line: _BLANKS.split(line.strip()),
        "mixed marks": lambda line: [cell.strip('"') for cell in _ANY_MARK.split(line.strip()) if cell],
    }
    found: tuple[str, Callable[[str], list[str]]] = ("", lambda line: [line.strip().strip('"')])
    best = (0, 0)
    for name, split in splitters.items():
        all_numbers: Counter[int] = Counter()
        # lines that also contain words
        with_words: Counter[int] = Counter()
        for line in sample:
            cells = split(line)
            values = sum(map(is_value, cells)) if len(cells) > 1 else 0
            if values > 1:
                with_words[len(cells)] += 1
                all_numbers[len(cells)] += values == len(cells)
        rank = (max(all_numbers.values(), default=0), max(with_words.values(), default=0))
        if rank > best:
            best, found = rank, (name, split)
    return found


def _splitter(mark: str) -> Callable[[str], list[str]]:
    def split(line: str) -> list[str]:
        if '"' in line:
            try:
                return [
                    cell.strip() for cell in next(csv.reader([line], delimiter=mark, skipinitialspace=True))
                ]
            except (csv.Error, StopIteration):
                pass
        return [cell.strip() for cell in line.split(mark)]

    return split


def _cells(
    path: Path, numbered: list[tuple[int, list[str]]], comments: list[list[str]], separator: str, decimal: str
) -> Cells:
    counts = [
        (len(cells), len(filled := [cell for cell in cells if cell]), sum(map(is_value, filled)))
        for _, cells in numbered
    ]
    widths = Counter(wide for wide, filled, values in counts if filled == values > 0)
    if not widths:
        # no line holds only numbers: there is a column of words
        widths = Counter(wide for wide, _, values in counts if values > 1)
    width, count = widths.most_common(1)[0] if widths else (0, 0)
    if count < 2:
        raise DataError(
            f"{path}: holds {count} row{'' if count == 1 else 's'} of numbers; a table of time and position "
            "is expected (separated by tabs, commas, semicolons or spaces); name one, or a record (.mcap)"
        )
    fewest = min(2, width)
    numbers_in = [values if wide == width else 0 for wide, _, values in counts]
    # a line above the names may also hold numbers, but fewer
    usual = Counter(values for values in numbers_in if values >= fewest).most_common(1)
    first = next(
        (k for k, values in enumerate(numbers_in) if usual and values >= max(fewest, usual[0][0] / 2)), None
    )
    if first is None:
        raise DataError(
            f"{path}: no row has two numbers; a table of time and position is expected, or the rate of its "
            "rows: --rate HZ"
        )
    header = [cells for _, cells in numbered[:first]]
    repeated_headers = {number for number, cells in numbered[first:] if any(cells) and cells in header}
    body = [(n, cells) for n, cells in numbered[first:] if len(cells) == width and n not in repeated_headers]
    left_out = [n for n, cells in numbered[first:] if len(cells) != width and n not in repeated_headers]
    columns = [list(column) for column in zip(*(cells for _, cells in body), strict=True)]
    names, units = _header(header or comments, columns, separator)
    # drop empty columns: a separator at the end of every line makes one
    used = [k for k in range(width) if any(columns[k])]
    columns, names = [columns[k] for k in used], [names[k] for k in used] if names else []
    units = [units[k] for k in used] if units else [""] * len(used)
    columns, names, units = _joined_moments(columns, names, units)
    for k, column in enumerate(columns):
        unit_in_cells, columns[k] = split_unit(column)
        units[k] = units[k] or unit_in_cells
    numbers = (cell for column in columns for cell in column if not is_timestamp(cell))
    form = number_format(numbers, decimal, str(path))
    columns = [
        [cell if is_timestamp(cell) else form.python_text(cell) for cell in column] for column in columns
    ]
    rows = list(zip(*columns, strict=True))
    lines = [number for number, _ in body]
    return Cells(names, units, rows, lines, left_out, _blocks(lines, left_out), separator, form)


def _blocks(lines: Sequence[int], left_out: Sequence[int]) -> list[int]:
    """The block of each row: a new one begins after lines that hold no row, whole or left out."""
    unread, block, found = set(left_out), 0, [0]
    for before, line in pairwise(lines):
        block += any(between not in unread for between in range(before + 1, line))
        found.append(block)
    return found


def _header(lines: list[list[str]], columns: list[list[str]], separator: str) -> tuple[list[str], list[str]]:
    """Names, and units from a line of their own; both empty if missing.

    A line of comments may follow them, as in files of Origin and Campbell's loggers.
    """
    width = len(columns)
    # neither a line of numbers, nor one of several words above a single column is a header
    fitting = [
        cells
        for number, line in enumerate(lines, 1 - len(lines))
        if (cells := _fitted_to_columns(line, columns, separator if not number else ""))
        and any(any(map(str.isalpha, cell)) for cell in cells)
        and (width > 1 or not set(cells[0]) & set(",;\t"))
    ]
    units_at = [k for k in range(len(fitting)) if len(fitting) > 1 and _is_unit_line(fitting, k)]
    if units_at:
        above, units = (fitting[: units_at[-1]], [cell.strip("()[]{}<> ") for cell in fitting[units_at[-1]]])
        names = _names(above) if above else fitting[units_at[-1] + 1]
        return names, ["" if unit.lower() in _NO_UNIT else unit for unit in units]
    return (_names(fitting) if fitting else []), []


def _fitted_to_columns(cells: list[str], columns: list[list[str]], separator: str) -> list[str]:
    """A header line with a cell for each column; empty if it does not fit. `separator`: of the last line."""
    width = len(columns)
    if len(cells) > width > 1 and not any(cells[width:]):
        cells = cells[:width]
    if len(cells) > width > 1 and separator and all(any(map(str.isalpha, cell)) for cell in cells[:width]):
        # LabVIEW writes the name of a column of comments, which the rows lack
        cells = cells[:width] if separator in _SURE_MARKS or any(map(_is_name, cells[:width])) else cells
    if 1 < len(cells) < width and not any(map(any, columns[len(cells) :])):
        cells = [*cells, *[""] * (width - len(cells))]
    if 1 < len(cells) == width - 1 and counts_rows(columns[0]):
        # R writes a column of row numbers without a name
        cells = ["row", *cells]
    return cells if len(cells) == width else []


def _is_name(name: str) -> bool:
    """Whether a cell is clearly a column's name: it contains a time or a unit."""
    return bool(TIME_NAME.fullmatch(name) or split_name(name).unit)


def _names(lines: list[list[str]]) -> list[str]:
    """The names: the last line that contains a time or a unit, else the last line."""
    words = [cells for cells in lines if all(any(map(str.isalpha, cell)) for cell in cells if cell)]
    return next((cells for cells in reversed(words) if any(map(_is_name, cells))), lines[-1])


def _is_unit_line(lines: list[list[str]], k: int) -> bool:
    """Whether a line holds units: all cells are units, or the cell below a time is, or most have brackets."""
    filled = [cell for cell in lines[k] if cell.lower() not in _NO_UNIT]
    known = [known_unit(cell.strip("()[]{}<> ")) for cell in lines[k]]
    if not filled or not any(known):
        return bool(filled) and k > 0 and all(map(_BRACKETED.fullmatch, filled))
    under = k > 0 and any(
        is_time(unit) and TIME_NAME.fullmatch(name) for unit, name in zip(known, lines[k - 1], strict=True)
    )
    return (
        under
        or 2 * sum(map(bool, map(_BRACKETED.fullmatch, filled))) > len(filled)
        or (sum(map(bool, known)) >= len(filled))
    )


def _joined_moments(
    columns: list[list[str]], names: list[str], units: list[str]
) -> tuple[list[list[str]], list[str], list[str]]:
    """Columns, names and units with a column of dates and a column of times of day joined into moments."""
    for k in range(len(columns) - 1):
        date, clock = columns[k], columns[k + 1]
        if all(is_timestamp(cell) and ":" not in cell for cell in date) and all(
            is_timestamp(cell) and ":" in cell for cell in clock
        ):
            moments = [f"{day} {time}" for day, time in zip(date, clock, strict=True)]
            title = [f"{names[k]} {names[k + 1]}"] if names else []
            return (
                [*columns[:k], moments, *columns[k + 2 :]],
                [*names[:k], *title, *names[k + 2 :]],
                [*units[:k], "", *units[k + 2 :]],
            )
    return columns, names, units

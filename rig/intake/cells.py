"""A table's file as a header and rows of cells, with the lines that were left out."""

import csv
import re
from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Final

from processing.errors import DataError
from rig.intake.cell_text import decimal_mark, is_timestamp, is_value, python_text, split_unit
from rig.intake.files import binary_rows, read_bytes_of, text_of_file
from rig.intake.units import TIME_NAME, known_unit, split_name

_COMMENTS: Final = ("#", "%", "//", "!")
_SEPARATORS: Final = {"tabs": "\t", "semicolons": ";", "bars": "|", "commas": ","}
_NO_UNIT: Final = ("", "-", "--", "n/a", "none", "ts", "rn")
"""Cells without a unit in a line of units; the last two are Campbell loggers', for times and row numbers."""
_BRACKETED: Final = re.compile(r"\s*[\[({<].*[\])}>]\s*")
_MAX_SAMPLED_LINES: Final = 2000
_BLANKS: Final = re.compile(r"[ \t]+")
_Split = Callable[[str], list[str]]


@dataclass(frozen=True, slots=True)
class Cells:
    """The cells of a table."""

    names: Sequence[str]
    """Names of the columns; empty without a header."""
    units: Sequence[str]
    """Units of the columns that are stated in a line of their own or in the cells; else empty text."""
    rows: Sequence[Sequence[str]]
    lines: Sequence[int]
    """The number of each row's line in the file."""
    left_out: Sequence[int]
    """Numbers of the lines that have another number of columns."""
    blocks: Sequence[int]
    """The number of each row's block; blank lines, comments or a repeated header separate blocks."""
    written: str
    """Text on how the file is written: separator, decimal mark, names."""
    remarks: Sequence[str] = ()
    """Further remarks on the reading."""


def read_cells(path: Path) -> Cells:
    """Read a file.

    Raises DataError if it cannot be read or holds no rows of numbers, and ConfigurationError if the numbers
    fit two decimal marks.
    """
    raw = read_bytes_of(path)
    binary = binary_rows(path, raw)
    if binary is not None:
        rows, remarks = binary
        numbered_rows = [(number, cells) for number, cells in enumerate(rows, 1) if any(cells)]
        return _cells(path, numbered_rows, [], "", remarks)
    numbered = [
        (number, line)
        for number, line in enumerate(text_of_file(path, raw).splitlines(), 1)
        if line.strip(" \t;,|")
    ]
    content = [(number, line) for number, line in numbered if not line.lstrip().startswith(_COMMENTS)]
    name, split = _separator([line for _, line in content])
    comments = [
        split(line.strip().lstrip("#%/! ")) for _, line in numbered if line.lstrip().startswith(_COMMENTS)
    ]
    return _cells(path, [(number, split(line)) for number, line in content], comments, name)


def _separator(lines: Sequence[str]) -> tuple[str, _Split]:
    """The separator, by name and as a function: the one that splits most lines into equally many numbers."""
    sample = lines[:: max(len(lines) // _MAX_SAMPLED_LINES, 1)]
    splitters: dict[str, _Split] = {name: _splitter(mark) for name, mark in _SEPARATORS.items()}
    splitters["blanks"] = lambda line: _BLANKS.split(line.strip())
    separator: tuple[str, _Split] = ("", lambda line: [line.strip().strip('"')])
    best = (0, 0)
    for name, split in splitters.items():
        # lines by their number of cells: those of numbers alone, and those with two numbers and any words
        all_numbers, with_words = Counter[int](), Counter[int]()
        for line in sample:
            cells = split(line)
            values = sum(map(is_value, cells)) if len(cells) > 1 else 0
            if values > 1:
                with_words[len(cells)] += 1
                all_numbers[len(cells)] += values == len(cells)
        rank = (max(all_numbers.values(), default=0), max(with_words.values(), default=0))
        if rank > best:
            best, separator = rank, (name, split)
    return separator


def _splitter(mark: str) -> _Split:
    def split(line: str) -> list[str]:
        if '"' in line:
            with suppress(csv.Error, StopIteration):
                cells = next(csv.reader([line], delimiter=mark, skipinitialspace=True))
                return [cell.strip() for cell in cells]
        return [cell.strip() for cell in line.split(mark)]

    return split


def _cells(
    path: Path,
    numbered: list[tuple[int, list[str]]],
    comments: list[list[str]],
    separator: str,
    remarks: Sequence[str] = (),
) -> Cells:
    counts = [
        (len(cells), len(filled := [cell for cell in cells if cell]), sum(map(is_value, filled)))
        for _, cells in numbered
    ]
    widths = Counter(cells for cells, filled, values in counts if filled == values > 0)
    if not widths:
        # no line holds only numbers: there is a column of words
        widths = Counter(cells for cells, _, values in counts if values > 1)
    width, count = widths.most_common(1)[0] if widths else (0, 0)
    if count < 2:
        raise DataError(
            f"{path}: holds {count} row{'' if count == 1 else 's'} of numbers; a table of time and position "
            "is expected (separated by tabs, commas, semicolons or spaces; times as numbers, dates or "
            "h:mm:ss); name one, or a record (.mcap)"
        )
    min_values: float = min(2, width)
    values_in_lines = [values if cells == width else 0 for cells, _, values in counts]
    # a line above the names may also hold numbers, but fewer
    commonest = Counter(values for values in values_in_lines if values >= min_values).most_common(1)
    if commonest:
        min_values = max(min_values, commonest[0][0] / 2)
    first = next((k for k, values in enumerate(values_in_lines) if values >= min_values), None)
    if first is None:
        raise DataError(
            f"{path}: no row has two numbers; a table of time and position is expected, or the rate of its "
            "rows: --rate HZ"
        )
    header = [cells for _, cells in numbered[:first]]
    repeated_headers = {number for number, cells in numbered[first:] if any(cells) and cells in header}
    numbered = [(n, cells) for n, cells in numbered[first:] if n not in repeated_headers]
    body = [(n, cells) for n, cells in numbered if len(cells) == width]
    left_out = [n for n, cells in numbered if len(cells) != width]
    # drop empty columns: a separator at the end of every line makes one
    used = [k for k in range(width) if any(cells[k] for _, cells in body)]
    columns = [[cells[k] for _, cells in body] for k in used]
    names, units = _header(header or comments, used, width)
    for k, column in enumerate(columns):
        unit_in_cells, columns[k] = split_unit(column)
        units[k] = units[k] or unit_in_cells
    numbers = (cell for column in columns for cell in column if not is_timestamp(cell))
    decimal = decimal_mark(numbers, str(path))
    columns = [
        [cell if is_timestamp(cell) else python_text(cell, decimal) for cell in column] for column in columns
    ]
    lines = [number for number, _ in body]
    separator_text = f"columns separated by {separator}" if separator else f"{len(used)} columns"
    names_text = f"names: {', '.join(names)}" if names else "no names"
    written = f"{separator_text}, decimal {'commas' if decimal == ',' else 'points'}; {names_text}"
    rows = list(zip(*columns, strict=True))
    return Cells(names, units, rows, lines, left_out, _blocks(lines, left_out), written, remarks)


def _blocks(lines: Sequence[int], left_out: Sequence[int]) -> list[int]:
    """The block of each row: a new one begins after a line that holds no row, whole or left out."""
    rowless, block, blocks = set(left_out), 0, [0]
    for line, next_line in pairwise(lines):
        block += any(between not in rowless for between in range(line + 1, next_line))
        blocks.append(block)
    return blocks


def _header(lines: list[list[str]], used: Sequence[int], width: int) -> tuple[list[str], list[str]]:
    """Names of the used columns, empty without any, and units from a line of their own.

    A line of comments may follow them, as in files of Origin and Campbell's loggers.
    """
    headings = []
    for line in lines:
        # LabVIEW also names a column of comments, which the rows lack
        cells = [line[k] for k in used] if len(line) >= width else line
        # neither a line of numbers, nor one of several words above a single column is a header
        if (
            len(cells) == len(used)
            and any(any(map(str.isalpha, cell)) for cell in cells)
            and (width > 1 or not set(cells[0]) & set(",;\t"))
        ):
            headings.append(cells)
    unit_lines = [k for k, cells in enumerate(headings) if len(headings) > 1 and _is_unit_line(cells)]
    if not unit_lines:
        return (_names(headings) if headings else []), [""] * len(used)
    last = unit_lines[-1]
    units = [cell.strip("()[]{}<> ") for cell in headings[last]]
    names = _names(headings[:last]) if last else headings[last + 1]
    return names, ["" if unit.lower() in _NO_UNIT else unit for unit in units]


def _names(lines: list[list[str]]) -> list[str]:
    """The last line that names a time or a unit, else the last line."""
    for cells in reversed(lines):
        is_of_words = all(any(map(str.isalpha, cell)) for cell in cells if cell)
        if is_of_words and any(TIME_NAME.fullmatch(cell) or split_name(cell).unit for cell in cells):
            return cells
    return lines[-1]


def _is_unit_line(cells: list[str]) -> bool:
    """Whether a line holds units alone, with or without brackets."""
    filled = [cell for cell in cells if cell.lower() not in _NO_UNIT]
    return bool(filled) and all(_BRACKETED.fullmatch(cell) or known_unit(cell) for cell in filled)

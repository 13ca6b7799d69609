"""A table's file as a header and rows of cells, with the lines that were left out."""

import csv
import re
from collections import Counter
from collections.abc import Callable, Sequence
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
    """The cells of a table: names and units of the columns, and rows with the numbers of their lines.

    `names` is empty without a header; `units` are those stated in a line of their own or in the cells.
    `left_out` are the numbers of lines with another number of columns. `blocks` holds, for each row, the
    number of its block; blocks are separated by blank lines, comments or a repeated header. `written` says
    how the file is written, `remarks` are further remarks on the reading.
    """

    names: Sequence[str]
    units: Sequence[str]
    rows: Sequence[Sequence[str]]
    lines: Sequence[int]
    left_out: Sequence[int]
    blocks: Sequence[int]
    written: str
    remarks: Sequence[str] = ()


def read_cells(path: Path) -> Cells:
    """Read a file.

    Raises
    ------
    DataError
        The file holds no rows of numbers, or cannot be read.
    ConfigurationError
        The numbers fit two decimal marks.
    """
    raw = read_bytes_of(path)
    binary = binary_rows(path, raw)
    if binary is not None:
        rows, remarks = binary
        filled = [(number, cells) for number, cells in enumerate(rows, 1) if any(cells)]
        return _cells(path, filled, [], "", remarks)
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
    return _cells(path, [(number, split(line)) for number, line in plain], comments, name)


def _separator(lines: Sequence[str]) -> tuple[str, _Split]:
    """The separator, by name and as a function: the one that splits most lines into equally many numbers."""
    sample = lines[:: max(len(lines) // _MAX_SAMPLED_LINES, 1)]
    splitters: dict[str, _Split] = {name: _splitter(mark) for name, mark in _SEPARATORS.items()}
    splitters["blanks"] = lambda line: _BLANKS.split(line.strip())
    found: tuple[str, _Split] = ("", lambda line: [line.strip().strip('"')])
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


def _splitter(mark: str) -> _Split:
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
    widths = Counter(wide for wide, filled, values in counts if filled == values > 0)
    if not widths:
        # no line holds only numbers: there is a column of words
        widths = Counter(wide for wide, _, values in counts if values > 1)
    width, count = widths.most_common(1)[0] if widths else (0, 0)
    if count < 2:
        raise DataError(
            f"{path}: holds {count} row{'' if count == 1 else 's'} of numbers; a table of time and position "
            "is expected (separated by tabs, commas, semicolons or spaces; times as numbers, dates or "
            "h:mm:ss); name one, or a record (.mcap)"
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
    # drop empty columns: a separator at the end of every line makes one
    used = [k for k in range(width) if any(cells[k] for _, cells in body)]
    columns = [[cells[k] for _, cells in body] for k in used]
    names, units = _header(header or comments, used, width)
    for k, column in enumerate(columns):
        unit_in_cells, columns[k] = split_unit(column)
        units[k] = units[k] or unit_in_cells
    decimal = decimal_mark(
        (cell for column in columns for cell in column if not is_timestamp(cell)), str(path)
    )
    columns = [
        [cell if is_timestamp(cell) else python_text(cell, decimal) for cell in column] for column in columns
    ]
    lines = [number for number, _ in body]
    separated = f"columns separated by {separator}" if separator else f"{len(used)} columns"
    named = f"names: {', '.join(names)}" if names else "no names"
    written = f"{separated}, decimal {'commas' if decimal == ',' else 'points'}; {named}"
    rows = list(zip(*columns, strict=True))
    return Cells(names, units, rows, lines, left_out, _blocks(lines, left_out), written, remarks)


def _blocks(lines: Sequence[int], left_out: Sequence[int]) -> list[int]:
    """The block of each row: a new one begins after lines that hold no row, whole or left out."""
    unread, block, found = set(left_out), 0, [0]
    for before, line in pairwise(lines):
        block += any(between not in unread for between in range(before + 1, line))
        found.append(block)
    return found


def _header(lines: list[list[str]], used: Sequence[int], width: int) -> tuple[list[str], list[str]]:
    """Names of the used columns, empty without any, and units from a line of their own.

    A line of comments may follow them, as in files of Origin and Campbell's loggers.
    """
    fitting = []
    for line in lines:
        # LabVIEW also names a column of comments, which the rows lack
        cells = [line[k] for k in used] if len(line) >= width else line
        # neither a line of numbers, nor one of several words above a single column is a header
        if (
            len(cells) == len(used)
            and any(any(map(str.isalpha, cell)) for cell in cells)
            and (width > 1 or not set(cells[0]) & set(",;\t"))
        ):
            fitting.append(cells)
    units_at = [k for k, cells in enumerate(fitting) if len(fitting) > 1 and _is_unit_line(cells)]
    if not units_at:
        return (_names(fitting) if fitting else []), [""] * len(used)
    units = [cell.strip("()[]{}<> ") for cell in fitting[units_at[-1]]]
    above = fitting[: units_at[-1]]
    names = _names(above) if above else fitting[units_at[-1] + 1]
    return names, ["" if unit.lower() in _NO_UNIT else unit for unit in units]


def _names(lines: list[list[str]]) -> list[str]:
    """The names: the last line that contains a time or a unit, else the last line."""
    words = [cells for cells in lines if all(any(map(str.isalpha, cell)) for cell in cells if cell)]
    return next(
        (
            cells
            for cells in reversed(words)
            if any(TIME_NAME.fullmatch(cell) or split_name(cell).unit for cell in cells)
        ),
        lines[-1],
    )


def _is_unit_line(cells: list[str]) -> bool:
    """Whether a line holds units alone, with or without brackets."""
    filled = [cell for cell in cells if cell.lower() not in _NO_UNIT]
    return bool(filled) and all(_BRACKETED.fullmatch(cell) or known_unit(cell) for cell in filled)

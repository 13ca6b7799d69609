"""A table's file as a header and rows of cells, and what was left out of it, with the lines."""

import csv
import re
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Final

from processing.errors import DataError
from rig.analysis.tables.files import bytes_of, rows_of, text_of
from rig.analysis.tables.numbers import Writing, is_moment, is_value, unit_behind, writing_of

_COMMENTS: Final = ("#", "%", "//", "!")
_SEPARATORS: Final = {"tabs": "\t", "semicolons": ";", "bars": "|", "commas": ","}
# A sentence has commas and blanks, too, and may stand above the rows.
_IN_NO_SENTENCE: Final = ("tabs", "semicolons")
_LOOKED_AT: Final = 2000
_BLANKS: Final = re.compile(r"[ \t]+")
_ANY: Final = re.compile(r"\s*[;,|\t ]\s*")


@dataclass(frozen=True, slots=True)
class Cells:
    """Names of the columns (empty where there are none), their units where a line of their own or the cells
    state them, and the rows with the numbers of their lines. `left_out` are lines with another number of
    columns. `blocks` number what blank lines or comments part, or the header written again, for each row.
    `said` are lines on how the file was read.
    """

    names: Sequence[str]
    units: Sequence[str]
    rows: Sequence[Sequence[str]]
    lines: Sequence[int]
    left_out: Sequence[int]
    blocks: Sequence[int]
    separator: str
    writing: Writing
    said: Sequence[str] = ()


def read_cells(path: Path, decimal: str = "") -> Cells:
    """Read a file; `decimal` is the decimal mark where it has to be stated.

    Raises
    ------
    DataError
        A file that holds no rows of numbers, or cannot be read.
    ConfigurationError
        Numbers that can be read in two ways.
    """
    raw = bytes_of(path)
    given = rows_of(path, raw)
    if given is not None:
        filled = [(number, cells) for number, cells in enumerate(given.rows, 1) if any(cells)]
        return replace(_cells(path, filled, [], "", decimal), said=given.said)
    numbered = [
        (number, line) for number, line in enumerate(text_of(raw).splitlines(), 1) if line.strip(" \t;,|")
    ]
    plain = [item for item in numbered if not item[1].lstrip().startswith(_COMMENTS)]
    name, split = _separator([line for _, line in plain])
    comments = [
        split(line.strip().lstrip("#%/! ")) for _, line in numbered if line.lstrip().startswith(_COMMENTS)
    ]
    return _cells(path, [(number, split(line)) for number, line in plain], comments, name, decimal)


def _separator(lines: Sequence[str]) -> tuple[str, Callable[[str], list[str]]]:
    """What the columns are separated by: what makes most lines into equally many numbers."""
    step = max(len(lines) // _LOOKED_AT, 1)
    sample = lines[::step]
    ways: dict[str, Callable[[str], list[str]]] = {name: _by(mark) for name, mark in _SEPARATORS.items()}
    ways |= {"blanks": lambda line: _BLANKS.split(line.strip()), "mixed marks": _by_any}
    found: tuple[str, Callable[[str], list[str]]] = ("", lambda line: [line.strip().strip('"')])
    best = (0, 0)
    for name, split in ways.items():
        whole: Counter[int] = Counter()
        # beside words, too
        partly: Counter[int] = Counter()
        for line in sample:
            cells = split(line)
            values = [is_value(cell) for cell in cells]
            if len(cells) > 1 and sum(values) > 1:
                partly[len(cells)] += 1
                whole[len(cells)] += all(values)
        rank = (max(whole.values(), default=0), max(partly.values(), default=0))
        if rank > best:
            best, found = rank, (name, split)
    return found


def _by(mark: str) -> Callable[[str], list[str]]:
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


def _by_any(line: str) -> list[str]:
    return [cell.strip('"') for cell in _ANY.split(line.strip()) if cell]


def _cells(
    path: Path, numbered: list[tuple[int, list[str]]], comments: list[list[str]], separator: str, decimal: str
) -> Cells:
    widths = Counter(len(cells) for _, cells in numbered if any(cells) and all(map(is_value, cells)))
    if not widths:
        # a column of words beside the numbers
        widths = Counter(len(cells) for _, cells in numbered if sum(map(is_value, filter(None, cells))) > 1)
    width, count = widths.most_common(1)[0] if widths else (0, 0)
    if count < 2:
        raise DataError(
            f"{path}: holds {count} row{'' if count == 1 else 's'} of numbers; a table of time and position "
            "is expected (separated by tabs, commas, semicolons or spaces)"
        )
    fewest = min(2, width)
    firsts = (
        place
        for place, (_, cells) in enumerate(numbered)
        if len(cells) == width and sum(map(is_value, filter(None, cells))) >= fewest
    )
    first = next(firsts, None)
    if first is None:
        raise DataError(
            f"{path}: no row has two numbers; a table of time and position is expected, or the rate of its "
            "rows: --rate HZ"
        )
    header = [cells for _, cells in numbered[:first]]
    again = {number for number, cells in numbered[first:] if any(cells) and cells in header}
    body = [(n, cells) for n, cells in numbered[first:] if len(cells) == width and n not in again]
    left_out = [n for n, cells in numbered[first:] if len(cells) != width and n not in again]
    columns = [list(column) for column in zip(*(cells for _, cells in body), strict=True)]
    names, units = _header(header or comments, width, separator)
    # of columns that are empty throughout, a separator at the end of every line makes one
    kept = [k for k in range(width) if any(columns[k])]
    columns, names = [columns[k] for k in kept], [names[k] for k in kept] if names else []
    units = [units[k] for k in kept] if units else [""] * len(kept)
    columns, names, units = _joined_moments(columns, names, units)
    for k, column in enumerate(columns):
        behind, columns[k] = unit_behind(column)
        units[k] = units[k] or behind
    numbers = (cell for column in columns for cell in column if not is_moment(cell))
    writing = writing_of(numbers, decimal, str(path))
    columns = [[cell if is_moment(cell) else writing.plain(cell) for cell in column] for column in columns]
    rows = list(zip(*columns, strict=True))
    lines = [number for number, _ in body]
    return Cells(names, units, rows, lines, left_out, _blocks(lines, left_out), separator, writing)


def _blocks(lines: Sequence[int], left_out: Sequence[int]) -> list[int]:
    """The block of each row: a new one begins behind lines that hold no row, not even a spoilt one."""
    spoilt, block, found = set(left_out), 0, [0]
    for before, line in pairwise(lines):
        block += any(between not in spoilt for between in range(before + 1, line))
        found.append(block)
    return found


def _header(lines: list[list[str]], width: int, separator: str) -> tuple[list[str], list[str]]:
    """Names, and units that have a line of their own below them; both empty where there are none."""
    if lines and len(lines[-1]) > width > 1 and separator in _IN_NO_SENTENCE:
        # LabVIEW names a column of comments, which the rows do not have
        *above, last = lines
        if all(any(map(str.isalpha, cell)) for cell in last[:width]):
            lines = [*above, last[:width]]
    # a line of numbers is no header, nor is one of several words that of a single column
    fitting = [
        cells
        for cells in lines
        if len(cells) == width
        and any(any(map(str.isalpha, cell)) for cell in cells)
        and (width > 1 or not set(cells[0]) & set(",;\t"))
    ]
    if not fitting:
        return [], []
    *before, last = fitting
    if before and sum(_is_unit_cell(cell) for cell in last) * 2 > len(last) and any(map(_bracketed, last)):
        return before[-1], [cell.strip("()[] ") for cell in last]
    from rig.analysis.tables.header_units import known_unit

    if before and all(not cell or known_unit(cell) for cell in last):
        return before[-1], [cell.strip() for cell in last]
    return last, []


def _bracketed(cell: str) -> bool:
    return bool(re.fullmatch(r"[(\[].*[)\]]", cell.strip()))


def _is_unit_cell(cell: str) -> bool:
    return not cell or _bracketed(cell)


def _joined_moments(
    columns: list[list[str]], names: list[str], units: list[str]
) -> tuple[list[list[str]], list[str], list[str]]:
    """Dates in one column and times of day in the next are one column of moments."""
    for k in range(len(columns) - 1):
        date, clock = columns[k], columns[k + 1]
        if all(is_moment(cell) and ":" not in cell for cell in date) and all(
            is_moment(cell) and ":" in cell for cell in clock
        ):
            both = [f"{day} {time}" for day, time in zip(date, clock, strict=True)]
            title = [f"{names[k]} {names[k + 1]}"] if names else []
            return (
                [*columns[:k], both, *columns[k + 2 :]],
                [*names[:k], *title, *names[k + 2 :]],
                [*units[:k], "", *units[k + 2 :]],
            )
    return columns, names, units

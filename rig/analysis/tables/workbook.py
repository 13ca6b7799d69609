"""The first sheet of an .xlsx workbook that holds numbers, as rows of text."""

import io
import math
import re
import zipfile
from datetime import date, datetime, time, timedelta
from typing import Any, Final, NamedTuple

from rig.analysis.tables.numbers import is_missing, is_moment, is_number

_FIRST_DAY: Final = datetime(1899, 12, 30)
_FIRST_DAY_1904: Final = datetime(1904, 1, 1)
"""Day 0 of workbooks that began on a Mac."""
_BETWEEN: Final = datetime(1902, 1, 1)
_HIDDEN: Final = re.compile(rb'<(?:row|col)\b[^>]*\bhidden="(?:1|true)"')
_FAR: Final = re.compile(rb'<c\b[^>]*\br="([A-Z]{3,}\d+)"[^>]*(?<!/)>')
"""A cell with a value in column AAA, the 703rd, or beyond: there is room for all cells before it."""
_SHARE: Final = 0.25
"""Of the rows of the longest table, that another sheet must have to be one too."""


class Sheet(NamedTuple):
    """Rows of one sheet as text, and lines on what a person who sees the workbook would not expect."""

    rows: list[list[str]]
    said: tuple[str, ...] = ()


def rows_of_workbook(raw: bytes) -> Sheet:
    """The first sheet, of those that are seen before those that are hidden, that holds a table of numbers.

    Raises ValueError where there is none, or where the file is damaged.
    """
    try:
        from python_calamine import CalamineError, SheetTypeEnum, SheetVisibleEnum, load_workbook
    except ImportError:
        raise ValueError(
            "that needs calamine: pip install 'optical-pendulum-rig[data]', or save it as text (CSV)"
        ) from None
    try:
        plain, hides = _without_styles(raw)
        book, unstyled = load_workbook(io.BytesIO(raw)), load_workbook(plain)
        seen = {
            about.name: about.visible == SheetVisibleEnum.Visible
            for about in book.sheets_metadata
            if about.typ == SheetTypeEnum.WorkSheet
        }
        read = {
            title: _rows(
                book.get_sheet_by_name(title).to_python(skip_empty_area=False),
                unstyled.get_sheet_by_name(title).to_python(skip_empty_area=False),
            )
            for title in seen
        }
    except CalamineError as error:
        raise ValueError(str(error)) from None
    counts = {title: _of_numbers(rows) for title, rows in read.items()}
    # a few constants above the table, on a sheet of their own, are not the table
    least = max(2, math.ceil(_SHARE * max(counts.values(), default=0)))
    holding = [title for title, count in counts.items() if count >= least]
    holding = [title for title in holding if seen[title]] or holding
    if not holding:
        raise ValueError(
            "no sheet holds numbers; the values of formulas are in it once a spreadsheet program saves it"
        )
    title, said = holding[0], []
    if len(holding) > 1:
        others = ", ".join(repr(other) for other in holding[1:])
        said.append(f"sheet {title!r}, the first that holds a table; {others} not read: save it as a file")
    elif len(read) > 1:
        said.append(f"sheet {title!r}" + ("" if seen[title] else ", which is hidden"))
    if hides:
        said.append("rows or columns that the workbook hides are read, too")
    return Sheet(read[title], tuple(said))


def _without_styles(raw: bytes) -> tuple[io.BytesIO, bool]:
    """The workbook with dates as the days that it stores, and whether it hides rows or columns.

    What is shown as a date calamine rounds to 1 ms; what it cannot hold in memory ends the whole program.
    """
    plain, hides = io.BytesIO(), False
    with zipfile.ZipFile(io.BytesIO(raw)) as before, zipfile.ZipFile(plain, "w") as after:
        for entry in before.infolist():
            part = before.read(entry)
            if entry.filename.startswith("xl/worksheets/"):
                hides = hides or _HIDDEN.search(part) is not None
                if far := _FAR.search(part):
                    raise ValueError(f"cell {far[1].decode()} is too far from a table; clear it")
            if entry.filename != "xl/styles.xml":
                after.writestr(entry, part)
    plain.seek(0)
    return plain, hides


def _of_numbers(rows: list[list[str]]) -> int:
    """Rows that may be of a table: two numbers, or nothing else."""
    values = ([_is_value(cell) for cell in row if cell] for row in rows)
    return sum(sum(row) > 1 or (len(row) == 1 and all(row)) for row in values)


def _is_value(cell: str) -> bool:
    return (is_number(cell) and not is_missing(cell)) or is_moment(cell)


def _rows(shown: list[list[Any]], stored: list[list[Any]]) -> list[list[str]]:
    """Cells as text, from what they show and from what is stored: days where a date or a time is shown."""
    cells = [list(zip(*rows, strict=True)) for rows in zip(shown, stored, strict=True)]
    since_1904 = any(
        isinstance(moment, datetime) and _is_number(days) and moment - timedelta(days=days) > _BETWEEN
        for row in cells
        for moment, days in row
    )
    first_day = _FIRST_DAY_1904 if since_1904 else _FIRST_DAY
    return [[_text(moment, value, first_day) for moment, value in row] for row in cells]


def _text(shown: Any, stored: Any, first_day: datetime) -> str:
    if isinstance(shown, date | time | timedelta) and _is_number(stored):
        # a double of days keeps microseconds, not more
        moment = first_day + timedelta(microseconds=round(stored * 86_400_000_000))
        return moment.isoformat(sep=" ")
    if isinstance(stored, bool) or (isinstance(stored, float) and stored.is_integer()):
        return str(int(stored))
    return str(stored)


def _is_number(cell: Any) -> bool:
    return isinstance(cell, int | float)

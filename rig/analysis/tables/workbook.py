"""The first sheet of an .xlsx workbook that holds numbers, as rows of text. An .xlsx file is XML in a zip
archive.
"""

import io
import math
import re
import zipfile
from datetime import datetime, timedelta
from typing import Final, NamedTuple
from xml.etree import ElementTree

from processing.plain_xml import parsed_xml
from rig.analysis.tables.numbers import is_missing, is_moment, is_number
from rig.analysis.tables.times import placed

_MAIN: Final = "{http://schemas.openxmlformats.org/spreadsheetml/2006/main}"
_RELATION: Final = "{http://schemas.openxmlformats.org/officeDocument/2006/relationships}"
_LARGEST_BYTES: Final = 512 * 1024 * 1024
_DATES: Final = {*range(14, 23), *range(45, 48)}
"""Numbers of Excel's own formats that show dates and times."""
_NO_DATE: Final = re.compile(r'"[^"]*"|\[(?!(?:h+|m+|s+)\])[^\]]*\]|\\.')
"""Text in quotes, colours and such in brackets, which hold elapsed time, too: ``[ss]``."""
_FIRST_DAY: Final = datetime(1899, 12, 30)
_FIRST_DAY_1904: Final = datetime(1904, 1, 1)
"""Day 0 of workbooks that began on a Mac."""
_SHARE: Final = 0.25
"""Of the rows of the longest table, that another sheet must have to be one too."""
_MOST_EMPTY: Final = 10_000
"""Rows without cells, one after another; a file may claim any number."""
_MOST_COLUMNS: Final = 16_384
_YES: Final = ("1", "true")


class Sheet(NamedTuple):
    """Rows of one sheet as text, and lines on what a person who sees the workbook would not expect."""

    rows: list[list[str]]
    said: tuple[str, ...] = ()


class _Read(NamedTuple):
    """A sheet as it stands: its rows, which of them and which columns are hidden, a formula without value."""

    rows: list[list[str]]
    hidden_rows: list[int]
    hidden_columns: list[str]
    unknown_formula: str

    @property
    def of_numbers(self) -> int:
        """Rows that may be of a table: two numbers, or nothing else."""
        values = ([_is_value(cell) for cell in row if cell] for row in self.rows)
        return sum(sum(row) > 1 or (len(row) == 1 and all(row)) for row in values)


def rows_of_workbook(raw: bytes) -> Sheet:
    """The first sheet, of those that are seen before those that are hidden, that holds a table of numbers.

    Raises ValueError where there is none, and for formulas whose values the file does not hold.
    """
    with zipfile.ZipFile(io.BytesIO(raw)) as archive:
        if sum(entry.file_size for entry in archive.infolist()) > _LARGEST_BYTES:
            raise ValueError(f"it unpacks to more than {_LARGEST_BYTES >> 20} MiB")
        names = archive.namelist()
        texts = _shared_texts(archive) if "xl/sharedStrings.xml" in names else []
        dates = _date_styles(archive) if "xl/styles.xml" in names else set()
        first_day, listed = _listed(archive) if "xl/workbook.xml" in names else (_FIRST_DAY, [])
        sheets = listed or [(_place(name), name, False) for name in sorted(names, key=_place) if _place(name)]
        read = [
            (title, hidden, _rows(archive, place, texts, dates, first_day))
            for title, place, hidden in sheets
            if place in names
        ]
    counts = [found.of_numbers for _, _, found in read]
    # a few constants above the table, on a sheet of their own, are not the table
    least = max(2, math.ceil(_SHARE * max(counts, default=0)))
    holding = [each for each, count in zip(read, counts, strict=True) if count >= least]
    holding = [each for each in holding if not each[1]] or holding
    chosen = holding[0] if holding else next((each for each in read if each[2].unknown_formula), None)
    if chosen is None:
        raise ValueError("no sheet holds numbers")
    title, hidden, found = chosen
    if found.unknown_formula:
        raise ValueError(
            f"the formula in {found.unknown_formula} of sheet {title!r} has no value in the file; open it in "
            "a spreadsheet program and save it, or save it as CSV"
        )
    said = []
    if len(holding) > 1:
        others = ", ".join(repr(each[0]) for each in holding[1:])
        said.append(f"sheet {title!r}, the first that holds a table; {others} not read: save it as a file")
    elif len(read) > 1:
        said.append(f"sheet {title!r}" + (", which is hidden" if hidden else ""))
    if found.hidden_rows:
        said.append(f"hidden in the workbook, yet read: {placed(found.hidden_rows)}")
    if found.hidden_columns:
        said.append(f"hidden in the workbook, yet read: column {', '.join(found.hidden_columns)}")
    return Sheet(found.rows, tuple(said))


def _is_value(cell: str) -> bool:
    return (is_number(cell) and not is_missing(cell)) or is_moment(cell)


def _place(name: str) -> str:
    """The number of a sheet that no list names, so written that it sorts; empty: no sheet."""
    found = re.fullmatch(r"xl/worksheets/sheet(\d+)\.xml", name)
    return f"{int(found[1]):06d}" if found else ""


def _listed(archive: zipfile.ZipFile) -> tuple[datetime, list[tuple[str, str, bool]]]:
    """Day 0 of the workbook, and its sheets in order: title, place in the archive, whether it is hidden."""
    book = _tree(archive, "xl/workbook.xml")
    about = book.find(f"{_MAIN}workbookPr")
    since_1904 = about is not None and about.attrib.get("date1904") in _YES
    targets = {}
    if "xl/_rels/workbook.xml.rels" in archive.namelist():
        for each in _tree(archive, "xl/_rels/workbook.xml.rels"):
            target = each.attrib.get("Target", "")
            targets[each.attrib.get("Id", "")] = target[1:] if target.startswith("/") else f"xl/{target}"
    sheets = [
        (
            sheet.attrib.get("name", ""),
            targets.get(sheet.attrib.get(f"{_RELATION}id", ""), ""),
            sheet.attrib.get("state", "visible") != "visible",
        )
        for sheet in book.iter(f"{_MAIN}sheet")
    ]
    return (_FIRST_DAY_1904 if since_1904 else _FIRST_DAY), sheets


def _tree(archive: zipfile.ZipFile, name: str) -> ElementTree.Element:
    try:
        return parsed_xml(archive.read(name))
    except ValueError as error:
        raise ValueError(f"{name}: {error}") from None


def _shared_texts(archive: zipfile.ZipFile) -> list[str]:
    found = _tree(archive, "xl/sharedStrings.xml").findall(f"{_MAIN}si")
    return ["".join(part.text or "" for part in item.iter(f"{_MAIN}t")) for item in found]


def _date_styles(archive: zipfile.ZipFile) -> set[int]:
    """Numbers of the styles that show a number of days as a date or a time."""
    tree = _tree(archive, "xl/styles.xml")
    own = {
        int(item.attrib["numFmtId"])
        for item in tree.iter(f"{_MAIN}numFmt")
        if re.search("[ymdhs]", _NO_DATE.sub("", item.attrib.get("formatCode", "").lower()))
    }
    cells = tree.find(f"{_MAIN}cellXfs")
    shown = [int(item.attrib.get("numFmtId", 0)) for item in (cells if cells is not None else [])]
    return {place for place, number in enumerate(shown) if number in _DATES | own}


def _rows(
    archive: zipfile.ZipFile, sheet: str, texts: list[str], dates: set[int], first_day: datetime
) -> _Read:
    tree = _tree(archive, sheet)
    rows: list[list[str]] = []
    hidden, unknown = [], ""
    for row in tree.iter(f"{_MAIN}row"):
        cells: dict[int, str] = {}
        # empty rows are not stored, but part blocks and count as lines
        number = int(row.attrib.get("r", len(rows) + 1))
        rows += [[]] * min(max(number - len(rows) - 1, 0), _MOST_EMPTY)
        for cell in row.findall(f"{_MAIN}c"):
            reference = cell.attrib.get("r", "")
            place = _column(reference) if reference else len(cells)
            cells[place] = _text(cell, texts, dates, first_day)
            if cell.find(f"{_MAIN}f") is not None and not cells[place] and cell.attrib.get("t", "n") == "n":
                unknown = unknown or reference or f"row {len(rows) + 1}"
        # a cell may have a style and nothing else, in the last column of all
        filled = [place for place, text in cells.items() if text]
        rows.append([cells.get(place, "") for place in range(max(filled, default=-1) + 1)])
        if row.attrib.get("hidden") in _YES:
            hidden.append(len(rows))
    width = max((len(row) for row in rows), default=0)
    columns = [
        str(number)
        for each in tree.iter(f"{_MAIN}col")
        if each.attrib.get("hidden") in _YES
        for number in range(int(each.attrib["min"]), min(int(each.attrib["max"]), width) + 1)
    ]
    return _Read([row + [""] * (width - len(row)) for row in rows], hidden, columns, unknown)


def _column(reference: str) -> int:
    """Number of the column from 0: A1 is 0, AA1 is 26."""
    number = 0
    for letter in re.sub(r"\d", "", reference):
        number = 26 * number + ord(letter) - ord("A") + 1
    if not 0 < number <= _MOST_COLUMNS:
        raise ValueError(f"no sheet has a cell {reference}")
    return number - 1


def _text(cell: ElementTree.Element, texts: list[str], dates: set[int], first_day: datetime) -> str:
    kind = cell.attrib.get("t", "n")
    if kind == "inlineStr":
        return "".join(part.text or "" for part in cell.iter(f"{_MAIN}t"))
    found = cell.find(f"{_MAIN}v")
    value = (found.text or "") if found is not None else ""
    if kind == "s":
        if int(value) >= len(texts):
            raise ValueError(f"cell {cell.attrib.get('r', '')} refers to a text that is missing")
        return texts[int(value)]
    if kind == "n" and value and int(cell.attrib.get("s", 0)) in dates:
        try:
            # a double of days keeps microseconds, not more
            moment = first_day + timedelta(microseconds=round(float(value) * 86_400_000_000))
            return moment.isoformat(sep=" ")
        except OverflowError:
            # no date: the spreadsheet shows none either
            return value
    return "" if kind == "e" else value

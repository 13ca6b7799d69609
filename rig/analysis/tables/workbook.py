"""The first sheet of an .xlsx workbook that holds numbers, as rows of text. An .xlsx file is XML in a zip
archive.
"""

import io
import re
import zipfile
from datetime import datetime, timedelta
from typing import Final
from xml.etree import ElementTree

_MAIN: Final = "{http://schemas.openxmlformats.org/spreadsheetml/2006/main}"
_LARGEST_BYTES: Final = 512 * 1024 * 1024
_DATES: Final = {*range(14, 23), *range(45, 48)}
"""Numbers of Excel's own formats that show dates and times."""
_NO_DATE: Final = re.compile(r'"[^"]*"|\[[^\]]*\]|\\.')
_FIRST_DAY: Final = datetime(1899, 12, 30)


def rows_of_workbook(raw: bytes) -> list[list[str]]:
    """Rows of the first sheet with at least two rows of numbers. Raises ValueError where there is none."""
    with zipfile.ZipFile(io.BytesIO(raw)) as archive:
        if sum(entry.file_size for entry in archive.infolist()) > _LARGEST_BYTES:
            raise ValueError(f"it unpacks to more than {_LARGEST_BYTES >> 20} MiB")
        names = archive.namelist()
        texts = _shared_texts(archive) if "xl/sharedStrings.xml" in names else []
        dates = _date_styles(archive) if "xl/styles.xml" in names else set()
        sheets = [name for name in names if re.fullmatch(r"xl/worksheets/sheet\d+\.xml", name)]
        for sheet in sorted(sheets, key=lambda name: int(re.sub(r"\D", "", name))):
            rows = _rows(archive, sheet, texts, dates)
            if sum(any(re.fullmatch(r"-?[\d.]+(?:E-?\d+)?", cell) for cell in row) for row in rows) > 1:
                return rows
    raise ValueError("no sheet holds numbers")


def _tree(archive: zipfile.ZipFile, name: str) -> ElementTree.Element:
    data = archive.read(name)
    if b"<!DOCTYPE" in data[:1000]:
        raise ValueError(f"{name} declares entities")
    return ElementTree.fromstring(data)


def _shared_texts(archive: zipfile.ZipFile) -> list[str]:
    found = _tree(archive, "xl/sharedStrings.xml").findall(f"{_MAIN}si")
    return ["".join(part.text or "" for part in item.iter(f"{_MAIN}t")) for item in found]


def _date_styles(archive: zipfile.ZipFile) -> set[int]:
    """Numbers of the styles that show a number of days as a date or a time."""
    tree = _tree(archive, "xl/styles.xml")
    own = {
        int(item.attrib["numFmtId"])
        for item in tree.iter(f"{_MAIN}numFmt")
        # text in quotes and brackets shows no part of a date
        if re.search("[ymdhs]", _NO_DATE.sub("", item.attrib.get("formatCode", "").lower()))
    }
    cells = tree.find(f"{_MAIN}cellXfs")
    shown = [int(item.attrib.get("numFmtId", 0)) for item in (cells if cells is not None else [])]
    return {place for place, number in enumerate(shown) if number in _DATES | own}


def _rows(archive: zipfile.ZipFile, sheet: str, texts: list[str], dates: set[int]) -> list[list[str]]:
    rows: list[list[str]] = []
    for row in _tree(archive, sheet).iter(f"{_MAIN}row"):
        cells: dict[int, str] = {}
        for cell in row.findall(f"{_MAIN}c"):
            place = _column(cell.attrib.get("r", "")) if "r" in cell.attrib else len(cells)
            cells[place] = _text(cell, texts, dates)
        rows.append([cells.get(place, "") for place in range(max(cells, default=-1) + 1)])
    width = max((len(row) for row in rows), default=0)
    return [row + [""] * (width - len(row)) for row in rows]


def _column(reference: str) -> int:
    """Number of the column from 0: A1 is 0, AA1 is 26."""
    number = 0
    for letter in re.sub(r"\d", "", reference):
        number = 26 * number + ord(letter) - ord("A") + 1
    return number - 1


def _text(cell: ElementTree.Element, texts: list[str], dates: set[int]) -> str:
    kind = cell.attrib.get("t", "n")
    if kind == "inlineStr":
        return "".join(part.text or "" for part in cell.iter(f"{_MAIN}t"))
    found = cell.find(f"{_MAIN}v")
    value = (found.text or "") if found is not None else ""
    if kind == "s":
        return texts[int(value)]
    if kind == "n" and value and int(cell.attrib.get("s", 0)) in dates:
        # a double of days keeps microseconds, not more
        moment = _FIRST_DAY + timedelta(microseconds=round(float(value) * 86_400_000_000))
        return moment.isoformat(sep=" ")
    return "" if kind == "e" else value

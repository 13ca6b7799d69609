"""Workbooks as spreadsheets keep them: several sheets, hidden parts, formulas, days since 1904."""

import io
import zipfile
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest

from processing.errors import DataError
from rig.analysis.position_table import TableColumns

MAIN = "http://schemas.openxmlformats.org/spreadsheetml/2006/main"
OFFICE = "http://schemas.openxmlformats.org/officeDocument/2006/relationships"
TIME_S = 0.05 * np.arange(100)
X = 10.0 * np.cos(2.0 * np.pi / 2.5 * TIME_S)
ROWS = [("t/s", "x/mm"), *zip(TIME_S.tolist(), X.tolist(), strict=True)]


@dataclass(frozen=True)
class Sheet:
    rows: Sequence[Sequence[object]]
    state: str = "visible"
    hidden_rows: range = range(0)
    hidden_column: int = 0
    numbers: Sequence[int] = field(default_factory=tuple)


def save(path: Path, sheets: dict[str, Sheet], *, since_1904: bool = False, dates: bool = False) -> Path:
    """As Excel does: sheets in the workbook's order, whose files are numbered the other way."""
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w") as archive:
        listed, relations = "", ""
        for k, (title, sheet) in enumerate(sheets.items(), 1):
            file = f"worksheets/sheet{len(sheets) + 1 - k}.xml"
            listed += f'<sheet name="{title}" sheetId="{k}" state="{sheet.state}" r:id="rId{k}"/>'
            relations += f'<Relationship Id="rId{k}" Target="{file}"/>'
            archive.writestr(f"xl/{file}", _xml(sheet, dates))
        archive.writestr(
            "xl/workbook.xml",
            f'<workbook xmlns="{MAIN}" xmlns:r="{OFFICE}"><workbookPr date1904="{int(since_1904)}"/>'
            f"<sheets>{listed}</sheets></workbook>",
        )
        archive.writestr(
            "xl/_rels/workbook.xml.rels", f'<Relationships xmlns="x">{relations}</Relationships>'
        )
        archive.writestr(
            "xl/styles.xml",
            f'<styleSheet xmlns="{MAIN}"><cellXfs><xf numFmtId="0"/>'
            '<xf numFmtId="22"/></cellXfs></styleSheet>',
        )
    path.write_bytes(out.getvalue())
    return path


def _xml(sheet: Sheet, dates: bool) -> str:
    lines = []
    for number, row in zip(sheet.numbers or range(1, len(sheet.rows) + 1), sheet.rows, strict=True):
        cells = ""
        for letter, value in zip("ABC", row, strict=False):
            at = f'r="{letter}{number}"'
            if isinstance(value, str) and value.startswith("="):
                cells += f"<c {at}><f>{value[1:]}</f><v></v></c>"
            elif isinstance(value, str):
                cells += f'<c {at} t="inlineStr"><is><t>{value}</t></is></c>'
            else:
                style = ' s="1"' if dates and letter == "A" else ""
                cells += f"<c {at}{style}><v>{value!r}</v></c>"
        hidden = ' hidden="1"' if number in sheet.hidden_rows else ""
        lines.append(f'<row r="{number}"{hidden}>{cells}</row>')
    k = sheet.hidden_column
    columns = f'<cols><col min="{k}" max="{k}" hidden="1"/></cols>' if k else ""
    return f'<worksheet xmlns="{MAIN}">{columns}<sheetData>{"".join(lines)}</sheetData></worksheet>'


def test_the_first_sheet_that_is_seen_and_holds_a_table_is_read_and_the_others_are_named(
    tmp_path: Path,
) -> None:
    constants = Sheet([("mass/kg", 0.406), ("R/m", 0.006), ("n", 3)])
    hidden = Sheet([("t/s", "x/mm"), *((t, 3.0 * x) for t, x in ROWS[1:])], state="hidden")
    book = {"constants": constants, "old": hidden, "A": Sheet(ROWS), "B": Sheet(ROWS)}
    found = TableColumns().read(save(tmp_path / "decay.xlsx", book))
    np.testing.assert_array_equal(found.positions[0], X)
    assert "sheet 'A', the first that holds a table; 'B' not read: save it as a file" in found.understood
    found = TableColumns().read(save(tmp_path / "hidden.xlsx", {"constants": constants, "old": hidden}))
    assert "sheet 'old', which is hidden" in found.understood


def test_hidden_rows_and_columns_are_read_and_said(tmp_path: Path) -> None:
    sheet = Sheet(ROWS, hidden_rows=range(40, 60), hidden_column=2)
    found = TableColumns().read(save(tmp_path / "decay.xlsx", {"A": sheet}))
    np.testing.assert_array_equal(found.positions[0], X)
    assert "hidden in the workbook, yet read: lines 40 to 59" in found.understood
    assert "hidden in the workbook, yet read: column 2" in found.understood


def test_a_formula_without_a_value_is_named_and_nothing_taken_for_it(tmp_path: Path) -> None:
    for k, name in ((0, "A2"), (1, "B2")):
        rows = [ROWS[0], *(tuple(f"={v}" if j == k else v for j, v in enumerate(row)) for row in ROWS[1:])]
        with pytest.raises(DataError, match=rf"formula in {name} of sheet 'A' has no value.*save it"):
            TableColumns().read(save(tmp_path / "decay.xlsx", {"A": Sheet(rows)}))


def test_days_since_1904_are_those_days(tmp_path: Path) -> None:
    """1 May 2024, 12:00 UTC, with both counts of days."""
    for since_1904, noon in ((False, 45413.5), (True, 43951.5)):
        rows = [("Zeit", "x/mm"), *((noon + t / 86400.0, x) for t, x in ROWS[1:])]
        path = save(tmp_path / "decay.xlsx", {"A": Sheet(rows)}, since_1904=since_1904, dates=True)
        assert TableColumns().read(path).first_ns == 1_714_564_800_000_000_000


def test_runs_are_parted_by_rows_that_are_not_stored(tmp_path: Path) -> None:
    numbers = [*range(1, 102), *range(104, 204)]
    path = save(tmp_path / "decay.xlsx", {"A": Sheet([*ROWS, *ROWS[1:]], numbers=numbers)})
    assert [run.run for run in TableColumns().read_runs(path)] == ["1", "2"]

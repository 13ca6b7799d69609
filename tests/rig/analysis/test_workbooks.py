"""Workbooks as spreadsheets keep them: several sheets, hidden parts, formulas, days since 1904."""

import io
import re
import zipfile
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest

from processing.errors import DataError
from rig.analysis.position_table import TableColumns
from rig.analysis.tables.workbook import rows_of_workbook

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


def changed(path: Path, part: str, before: str, after: str) -> Path:
    """The workbook with another text in one of its parts."""
    with zipfile.ZipFile(path) as archive:
        parts = {name: archive.read(name).decode() for name in archive.namelist()}
    assert before in parts[part]
    parts[part] = parts[part].replace(before, after)
    with zipfile.ZipFile(path, "w") as archive:
        for name, text in parts.items():
            archive.writestr(name, text)
    return path


@pytest.mark.parametrize("form", ["[ss].000", "[h]:mm:ss.000", '[Red]"t = "[mm]:ss.000'])
def test_elapsed_time_is_stored_in_days_whatever_its_format_shows(tmp_path: Path, form: str) -> None:
    rows = [ROWS[0], *((t / 86400.0, x) for t, x in ROWS[1:])]
    path = save(tmp_path / "decay.xlsx", {"A": Sheet(rows)}, dates=True)
    own = f"<numFmts><numFmt numFmtId='164' formatCode='{form}'/></numFmts><cellXfs>"
    changed(path, "xl/styles.xml", "<cellXfs>", own)
    changed(path, "xl/styles.xml", 'numFmtId="22"', 'numFmtId="164"')
    found = TableColumns().read(path)
    np.testing.assert_allclose(1e-9 * found.times_ns, TIME_S, rtol=0.0, atol=1e-6)


@pytest.mark.parametrize(
    ("before", "after"),
    [
        ('<c r="B9">', '<c r="B9" t="s">'),  # a text that is not there
        ('<c r="B9">', '<c r="ZZZZZZ9">'),  # a column that no sheet has
    ],
)
def test_a_damaged_workbook_is_refused_in_one_line(tmp_path: Path, before: str, after: str) -> None:
    path = save(tmp_path / "decay.xlsx", {"A": Sheet([*ROWS[:8], (TIME_S[7], 9), *ROWS[9:]])})
    changed(path, "xl/worksheets/sheet1.xml", before, after)
    with pytest.raises(DataError, match=r"cannot be read as a workbook: .*9") as raised:
        TableColumns().read(path)
    assert "\n" not in str(raised.value)


def test_a_compressed_part_that_is_damaged_is_refused_in_one_line(tmp_path: Path) -> None:
    path = save(tmp_path / "decay.xlsx", {"A": Sheet(ROWS)})
    with zipfile.ZipFile(path) as archive:
        parts = {name: archive.read(name) for name in archive.namelist()}
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in parts.items():
            archive.writestr(name, data)
        start = archive.getinfo("xl/worksheets/sheet1.xml").header_offset + 60
    raw = bytearray(path.read_bytes())
    raw[start : start + 40] = b"\xff" * 40
    path.write_bytes(raw)
    with pytest.raises(DataError, match="cannot be read as a workbook"):
        TableColumns().read(path)


def test_a_number_that_is_shown_as_a_date_that_there_is_not_stays_a_number(tmp_path: Path) -> None:
    """A column of large positions, by mistake in a format of dates: the spreadsheet shows ####."""
    rows = [("x/px", "t/s"), *((x + 4e6, t) for t, x in ROWS[1:])]
    found = TableColumns().read(save(tmp_path / "decay.xlsx", {"A": Sheet(rows)}, dates=True))
    np.testing.assert_array_equal(found.positions[0], X + 4e6)


def test_a_cell_that_has_a_style_and_no_value_makes_no_columns(tmp_path: Path) -> None:
    numbers = [*range(1, 9), *range(10, 102)]
    sheet = '<row r="9"><c r="A9"/><c r="XFD9" s="1"/></row>'
    path = save(tmp_path / "decay.xlsx", {"A": Sheet([*ROWS[:8], *ROWS[9:]], numbers=numbers)})
    changed(path, "xl/worksheets/sheet1.xml", '<row r="10">', f'{sheet}<row r="10">')
    given = rows_of_workbook(path.read_bytes())
    assert {len(row) for row in given.rows} == {2}


def test_rows_and_cells_without_references_follow_one_another(tmp_path: Path) -> None:
    """The references are optional, and some writers leave them out."""
    path = save(tmp_path / "decay.xlsx", {"A": Sheet(ROWS, hidden_rows=range(40, 41))})
    with zipfile.ZipFile(path) as archive:
        sheet = archive.read("xl/worksheets/sheet1.xml").decode()
    changed(path, "xl/worksheets/sheet1.xml", sheet, re.sub(r' r="[A-Z]*\d+"', "", sheet))
    (run,) = TableColumns().read_runs(path)
    np.testing.assert_array_equal(run.positions[0], X)
    assert "hidden in the workbook, yet read: line 40" in run.understood


def test_a_workbook_that_says_that_it_unpacks_to_more_than_memory_holds_is_not_unpacked(
    tmp_path: Path,
) -> None:
    path = save(tmp_path / "decay.xlsx", {"A": Sheet(ROWS)})
    with zipfile.ZipFile(path, "a") as archive:
        archive.writestr("xl/media/image1.png", b"")
        archive.getinfo("xl/media/image1.png").file_size = 600 << 20
    with pytest.raises(DataError, match="unpacks to more than 512 MiB"):
        TableColumns().read(path)


def test_a_part_that_declares_entities_is_refused_by_its_name(tmp_path: Path) -> None:
    path = save(tmp_path / "decay.xlsx", {"A": Sheet(ROWS)})
    changed(path, "xl/worksheets/sheet1.xml", "<worksheet", '<!DOCTYPE w [<!ENTITY a "9">]><worksheet')
    with pytest.raises(DataError, match=r"as a workbook: xl/worksheets/sheet1.xml: .*document type \(w\)"):
        TableColumns().read(path)

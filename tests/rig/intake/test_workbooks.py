"""Workbooks as spreadsheets keep them: several sheets, formulas, days since 1904."""

import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest

from processing.errors import DataError, MissingPackage
from rig.intake import read_seismometer
from rig.intake.table import TableColumns
from tests.rig.intake.table_cases import Sheet, workbook

TIME_S = 0.05 * np.arange(100)
X = 10.0 * np.cos(2.0 * np.pi / 2.5 * TIME_S)
ROWS = [("t/s", "x/mm"), *zip(TIME_S.tolist(), X.tolist(), strict=True)]


def save(path: Path, sheets: dict[str, Sheet], *, since_1904: bool = False, dates: bool = False) -> Path:
    path.write_bytes(workbook(sheets, since_1904=since_1904, dates=dates))
    return path


def test_the_first_sheet_that_is_seen_and_holds_a_table_is_read_and_the_others_are_named(
    tmp_path: Path,
) -> None:
    constants = Sheet([("mass/kg", 0.406), ("R/m", 0.006), ("n", 3)])
    hidden = Sheet([("t/s", "x/mm"), *((t, 3.0 * x) for t, x in ROWS[1:])], state="hidden")
    book = {"constants": constants, "old": hidden, "A": Sheet(ROWS), "B": Sheet(ROWS)}
    found = TableColumns().read(save(tmp_path / "decay.xlsx", book))
    np.testing.assert_array_equal(found.positions[0], X)
    assert "sheet 'A', the first that holds a table; 'B' not read: save it as a file" in found.understood
    with pytest.raises(DataError, match="no visible sheet holds numbers"):
        TableColumns().read(save(tmp_path / "hidden.xlsx", {"old": hidden}))


def test_for_a_formula_without_a_value_nothing_is_taken(tmp_path: Path) -> None:
    for k in (0, 1):
        rows = [ROWS[0], *(tuple(f"={v}" if j == k else v for j, v in enumerate(row)) for row in ROWS[1:])]
        with pytest.raises(DataError, match="no row has two numbers"):
            TableColumns().read(save(tmp_path / "decay.xlsx", {"A": Sheet(rows)}))
    with pytest.raises(DataError, match="the values of formulas are in it once a spreadsheet program saves"):
        TableColumns().read(save(tmp_path / "decay.xlsx", {"A": Sheet([("=1", "=2")] * 9)}))


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


def test_a_damaged_workbook_is_refused_in_one_line(tmp_path: Path) -> None:
    path = save(tmp_path / "decay.xlsx", {"A": Sheet([*ROWS[:8], (TIME_S[7].item(), 9), *ROWS[9:]])})
    changed(path, "xl/worksheets/sheet1.xml", '<c r="B9">', '<c r="B9" t="s">')
    with pytest.raises(DataError, match=r"cannot be read as a workbook: .*string index not found") as raised:
        TableColumns().read(path)
    assert "\n" not in str(raised.value)
    with zipfile.ZipFile(path) as archive:
        start = archive.getinfo("xl/worksheets/sheet1.xml").header_offset + 60
    raw = bytearray(path.read_bytes())
    raw[start : start + 40] = b"\xff" * 40
    path.write_bytes(raw)
    with pytest.raises(DataError, match="cannot be read as a workbook"):
        TableColumns().read(path)


def test_without_calamine_one_line_says_what_to_install(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "python_calamine", None)
    path = save(tmp_path / "decay.xlsx", {"A": Sheet(ROWS)})
    for read in (TableColumns().read, read_seismometer):
        with pytest.raises(
            MissingPackage,
            match=r"decay.xlsx: a workbook needs .* -m pip install python-calamine, or save it as text",
        ):
            read(path)

"""A matrix of tables with known truth: each is understood right, or refused in one line, or what is left out
is counted.
"""

import gzip
import io
import zipfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np

from processing.errors import ConfigurationError, DataError
from rig.analysis.table_fit import AnalysedTable, analyse_trajectory
from rig.intake import SeismometerRecord
from rig.intake.table import TableColumns
from rig.settings import Configuration

MAIN = "http://schemas.openxmlformats.org/spreadsheetml/2006/main"
OFFICE = "http://schemas.openxmlformats.org/officeDocument/2006/relationships"
PACKAGE = "http://schemas.openxmlformats.org/package/2006/relationships"

ROWS = 240
STEP_MS = 50


def analyse_table(
    path: Path,
    config: Configuration | None,
    columns: TableColumns,
    seismometer: SeismometerRecord | None = None,
) -> AnalysedTable:
    """Results of a table that is read by these columns."""
    return analyse_trajectory(path, columns.read(path), config, seismometer=seismometer)


@dataclass(frozen=True)
class TableCase:
    """`content` is the file, `ending` of its name. `scale` is the true unit over that of the truth, 1.

    `lost` rows are left out and counted; `refused` is a part of the line that refuses the table.
    """

    name: str
    content: bytes
    asked: TableColumns = field(default_factory=TableColumns)
    ending: str = "csv"
    unit: str = "unit"
    refused: str = ""
    lost: int = 0
    rows: int = ROWS


@dataclass(frozen=True)
class TableOutcome:
    """What became of a table; `wrong` is what must not be."""

    kind: str
    said: str


def true_ms() -> list[int]:
    """Times of the rows, ms."""
    return [STEP_MS * k for k in range(ROWS)]


def true_values() -> list[float]:
    """Positions of the rows."""
    t = np.array(true_ms()) / 1000.0
    return [round(float(x), 3) for x in 1500.0 * np.exp(-t / 20.0) * np.sin(2.0 * t) + 40.0]


def judged(case: TableCase, folder: Path) -> TableOutcome:
    """Read a table, and compare times and positions of every row."""
    path = folder / f"table.{case.ending}"
    path.write_bytes(case.content)
    try:
        found = case.asked.read(path)
    except (DataError, ConfigurationError) as error:
        one_line = "\n" not in str(error)
        right = one_line and bool(case.refused) and case.refused in str(error)
        return TableOutcome("refused" if right else "wrong", str(error))
    if case.refused:
        return TableOutcome("wrong", "was read: " + "; ".join(found.understood))
    times_s = np.array(true_ms()[: case.rows]) / 1000.0
    values = np.array(true_values())
    which = np.rint(found.times_ns / (1e6 * STEP_MS)).astype(np.int64)
    same = (
        len(found.times_ns) == case.rows - case.lost
        and bool(np.all(which < len(times_s)))
        and np.allclose(found.times_ns * 1e-9, times_s[which], rtol=0, atol=1.1e-6)
        and np.allclose(found.positions[0], values[which], rtol=1e-9, atol=1e-9)
        and found.unit == case.unit
    )
    said = "; ".join(found.understood)
    same &= not case.lost or f"left out: {case.lost} rows" in said
    kind = "wrong" if not same else "counted" if case.lost else "right"
    return TableOutcome(kind, said)


Cell = Callable[[float], str]


def point(digits: int) -> Cell:
    return lambda value: f"{value:.{digits}f}"


def comma(digits: int) -> Cell:
    return lambda value: f"{value:.{digits}f}".replace(".", ",")


def text(
    separator: str = ",",
    header: str | Sequence[str] = (),
    time: Cell | None = None,
    value: Cell | None = None,
    per_s: float = 1.0,
    end: str = "\n",
) -> str:
    """A table of times (in units of which one second has `per_s`) and values."""
    time, value = time or point(3), value or point(3)
    lines = [header] if isinstance(header, str) else list(header)
    lines += [
        f"{time(ms / 1000.0 * per_s)}{separator}{value(x)}"
        for ms, x in zip(true_ms(), true_values(), strict=True)
    ]
    return end.join(lines) + end


def table_matrix() -> list[TableCase]:
    """Every case."""
    return [*_separators(), *_writing(), *_units(), *_loggers(), *_times(), *_files(), *_losses()]


def _case(name: str, content: str | bytes, asked: TableColumns | None = None, **more: Any) -> TableCase:
    data = content.encode() if isinstance(content, str) else content
    return TableCase(name, data, asked or TableColumns(), **more)


def _separators() -> list[TableCase]:
    plain = {
        "tab": "\t",
        "comma": ",",
        "semicolon": ";",
        "blank": " ",
        "blanks": "    ",
        "bar": "|",
        "comma blank": ", ",
    }
    found = [
        _case(f"{name} header {bool(head)}", text(mark, head))
        for name, mark in plain.items()
        for head in ((), f"t{mark}x")
    ]
    rows = text(" ").splitlines()
    mixed = "\n".join(row.replace(" ", "\t" if k % 2 else "  ") for k, row in enumerate(rows))
    trailing = "\n".join(f"{row};" for row in text(";").splitlines())
    leading = "\n".join(f"  {row}" for row in rows)
    quoted = "\n".join('"{}","{}"'.format(*row.split(",")) for row in text(",").splitlines())
    words = "\n".join(f"{row},good" for row in text(",").splitlines())
    return [
        *found,
        _case("tabs and blanks", mixed),
        _case("a separator at each end", trailing),
        _case("blanks before", leading),
        _case("quoted", quoted),
        _case("a column of words", f"t,x,state\n{words}"),
        _case("carriage returns", text(",", end="\r\n")),
        _case("comments", "# made by hand\n# t x\n" + text(" ")),
        _case("percent comments", "% t x\n" + text(" ")),
        _case("many header lines", "Instrument 7\nOperator, A. B.\n\nt,x\n" + text(",")),
    ]


def _writing() -> list[TableCase]:
    return [
        _case("decimal commas, semicolons", text(";", "t;x", comma(3), comma(3))),
        _case("decimal commas, tabs", text("\t", "t\tx", comma(3), comma(3))),
        _case("decimal commas, blanks", text(" ", (), comma(3), comma(3))),
        _case(
            "decimal commas, quoted",
            "\n".join(
                '"{}","{}"'.format(*row.split(";")) for row in text(";", (), comma(3), comma(3)).splitlines()
            ),
        ),
        _case(
            "commas that may stand between thousands",
            "".join(f"{k};{1 + k % 7},{100 + k}\n" for k in range(ROWS)),
            refused="or one with a mark for thousands; write it with a decimal point",
        ),
        _case("exponents", text(",", "t,x", lambda v: f"{v:.9e}", lambda v: f"{v:.12E}")),
        _case("Fortran's exponents", text(" ", (), None, lambda v: f"{v:.12e}".replace("e", "D"))),
        _case("plus signs", text(",", "t,x", None, lambda v: f"{v:+.3f}")),
        _case("points and commas", text(";", "t;x", point(3), comma(3)), refused="has a decimal comma and"),
        _case(
            "degree signs",
            text(";", "t;phi", None, lambda v: f"{v:.3f}°"),
            refused="more than a turn",
            unit="deg",
        ),
        _case("units behind", text(";", "t;x", lambda v: f"{v:.3f} s", lambda v: f"{v:.3f} mm"), unit="mm"),
    ]


def _units() -> list[TableCase]:
    ms = text(";", "t [ms];x", point(0), None, 1000.0)
    return [
        _case("units in a line of their own", "t;x\n(s);(mm)\n" + text(";"), unit="mm"),
        _case(
            "units in a line, bare", "Zeit;Weg\nms;mm\n" + text(";", (), point(0), None, 1000.0), unit="mm"
        ),
        _case("latin-1 µ", text(";", "Zeit [µs];x", point(0), None, 1e6).encode("cp1252")),
        _case(
            "stated unit agrees", text(";", "t;phi [arcsec]"), TableColumns(unit="arcseconds"), unit="arcsec"
        ),
        _case(
            "stated unit contradicts",
            text(";", "t;phi [arcsec]"),
            TableColumns(unit="deg"),
            refused="'phi [arcsec]' says arcsec, --unit says deg",
        ),
        _case(
            "stated time contradicts",
            ms,
            TableColumns(time_unit="s"),
            refused="'t [ms]' says ms, --time-unit says s",
        ),
        _case(
            "unknown unit of position", text(";", "t;x [foo]"), refused="'foo' in 'x [foo]' is not a known"
        ),
        _case("unknown unit, another stated", text(";", "t;x [foo]"), TableColumns(unit="mm"), unit="mm"),
        _case("time in mm", text(";", "a [mm];b [mm]"), refused="which is not a unit of time"),
        _case("too large for radians", text(";", "t;phi [rad]"), refused="more than a turn"),
        _case(
            "no unit of time stated",
            text(";", "t;x"),
            TableColumns(time_unit="parsec"),
            refused="is not a unit of time",
        ),
    ]


def _loggers() -> list[TableCase]:
    """Headers as people, loggers and programs write them: a unit in a name, in a line of its own, unknown."""
    times = {
        ("ms", 1000.0): (
            "time_ms", "t [ms]", "t/ms", "t (ms)", "Zeit in ms", "Zeit [msec]", "milliseconds",
            "Time (milliseconds)",
            "Time (ms) Run #1", "Time(ms)*", "Time (ms) (A)", "time_ms_1", "time_ms.1", "t/ms Run 2",
            "Zeit in ms Messung 1", "Time, ms, Run 1", "Latest: Time (ms)", "timestamp_ms_utc",
            "Zeit [ms, relativ]", "Time ms", "Elapsed (MS)", "Time {ms}", "Time <ms>", "Time (Milliseconds)",
            "Time [Msec]", "Zeit Millisekunden", "ELAPSED_MS",
        ),
        ("ns", 1e9): ("t [ns]",),
        ("us", 1e6): (
            "Zeit [µs]", "Zeit [μs]", "t_usec", "time_us", "t, us", "t [us] A", "Time (µs) #2",
            "Time (μs) #2", "Zeit (Mikrosekunden)", "time_usec_raw",
        ),
        ("s", 1.0): ("Time (s) Run #1", "Zeit (Sekunden)", "Sekunden", "items", "Time (Sec)",
            "Time (s, relative)", "TEMPS", "ELAPSED", "Time_Sec", "TIME (S)"),
        ("min", 1 / 60.0): ("Time (Minutes) Run #1", "time_min", "time_minutes", "Zeit [Minuten]", "t / min"),
        ("h", 1 / 3600.0): ("t/h",),
    }  # fmt: skip
    found = [
        _case(f"{unit}: {name}", text(";", f"{name};x", point(0 if per_s >= 1000 else 12), None, per_s))
        for (unit, per_s), names in times.items()
        for name in names
    ]
    positions = {
        "x [mm]": "mm", "U / V": "V", "x_px": "px", "x (µm)": "um", "phi [arcsec]": "arcsec",
        "phi (″)": "arcsec", "Winkel [Bogensekunden]": "arcsec", "x": "unit",
        "Weg (mm) Messung 1": "mm", "phi (arcsec)*": "arcsec", "x_mm_1": "mm", "omega_rad_per_s": "rad/s",
        "v in m/s": "m/s", "omega/deg/s": "deg/s", "Position (Millimeter)": "mm", "U (V) Ch A": "V",
        "Milliradians": "mrad", "Angle (arcsec) Run #1": "arcsec", "x_1": "unit", "x (1)": "unit",
        "x.1": "unit", "Angle Run 1": "unit", "second derivative": "unit",
    }  # fmt: skip
    found += [
        _case(f"position: {name}", text(";", f"t;{name}"), unit=unit) for name, unit in positions.items()
    ]
    strange = {
        "t [ticks]": "'ticks' in 't [ticks]' is not a known unit of time",
        "Time (ticks) Run #1": "'ticks' in 'Time (ticks) Run #1' is not a known unit of time",
        "time [100 ns]": "'100 ns' in",
        "t (Ms)": "'Ms' in",
        "Zeit in Ticks": "'Ticks' in",
        "time_frames": "is not a known unit of time",
        "Time (ms) (us)": "'(ms) and (us)' in",
        "Time*1000 (s)": "'*1000' in",
        "Time [s] x 10^3": "'x 10^3' in",
        "t_ms_x10": "'x10' in 't_ms_x10' is not a known unit of time",
        "Time (tenths of a second)": "'tenths of a second' in",
        "Zeit in Zehntel Sekunden": "'Zehntel Sekunden' in",
        "temps (millièmes de seconde)": "is not a known unit of time",
        "Timestamp (unix ms)": "'unix ms' in",
    }
    found += [
        _case(f"strange: {name}", text(";", f"{name};x", point(0), None, 1000.0), refused=said)
        for name, said in strange.items()
    ]
    ms = text("\t", (), point(0), None, 1000.0).lstrip()
    heads = {
        "names, units, comments": "Time\tWeg\nms\tmm\nswing 3\tchannel 1\n",
        "names, comments, units": "Time\tWeg\nswing 3\tchannel 1\nms\tmm\n",
        "units, names": "ms\tmm\nTime\tWeg\n",
        "names with units, comments": "Time (ms)\tWeg (mm)\nswing 3\tchannel 1\n",
        "names, units in brackets, empty line": "Time\tWeg\n(ms)\t(mm)\n\n",
        "title, names with units": "pendulum\tlaboratory 3\nTime (ms)\tWeg (mm)\n",
    }
    found += [_case(name, head + ms, unit="mm") for name, head in heads.items()]
    commas = ms.replace("\t", ",").splitlines()
    every = enumerate(zip(true_ms(), true_values(), strict=True))
    both = "".join(f"{k};{t / 1000};{t};{x}\n" for k, (t, x) in every)
    dated = "".join(f"2024-05-01;{row}\n".replace("\t", ";") for row in ms.splitlines())
    day = datetime(2024, 5, 1)
    american = text(",", "Date,n,x", _moments(lambda m: f"{m:%m/%d/%Y %I:%M:%S.%f %p},7", day))
    moments = text(",", (), _moments(lambda m: f'"{m:%Y-%m-%d %H:%M:%S.%f}",7', datetime(2022, 1, 17, 22)))
    return [
        *found,
        _case("rows that end in a comma", "Time (ms),x (mm)\n" + ",\n".join([*commas, ""]), unit="mm"),
        _case("names that end in a comma", "Time (ms),x (mm),\n" + "\n".join(commas), unit="mm"),
        _case("a name more than columns", "Time (ms),x (mm),note\n" + "\n".join(commas), unit="mm"),
        _case(
            "LabVIEW, a column of comments",
            "LabVIEW Measurement\t\nSeparator\tTab\n***End_of_Header***\t\n\t\nChannels\t1\t\nX0\t0,0\t\n"
            "***End_of_Header***\t\t\nX_Value\tx [mm]\tComment\n"
            + text("\t", (), comma(3), comma(3)).lstrip(),
            unit="mm",
        ),
        _case(
            "Campbell, as many columns as its first line",
            '"TOA5","L","CR6","1","S","P","1","D"\n"TIMESTAMP","RECORD","x","a","b","c","d","e"\n'
            '"TS","RN","mm","V","V","V","V","V"\n"","","Smp","Smp","Smp","Smp","Smp","Smp"\n'
            + _counted(moments).replace("\n", ",1,2,3,4,5\n"),
            unit="mm",
        ),
        _case("numbers of rows, two times", "n;time_s;t_ms;x\n" + both),
        _case("a date, and a time", "date;t_ms;x\n" + dated),
        _case("American dates", american, refused="'05/01/2024 12:00:00.000000 AM' is none; write dates as"),
        _case(
            "Campbell, four lines",
            '"TOA5","L","CR6","1","S","P","1","D"\n"TIMESTAMP","RECORD","x"\n"TS","RN","mm"\n"","","Smp"\n'
            + _counted(moments),
            unit="mm",
        ),
    ]  # fmt: skip


def _counted(rows: str) -> str:
    return "".join(row.replace(",7,", f",{k},") + "\n" for k, row in enumerate(rows.strip().splitlines()))


def _moments(form: Callable[[datetime], str], start: datetime) -> Cell:
    return lambda s: form(start + timedelta(milliseconds=round(1000 * s)))


def _times() -> list[TableCase]:
    start = datetime(2024, 5, 1, 12, 0, 0, 250_000, tzinfo=UTC)
    naive = start.replace(tzinfo=None)
    late = datetime(2024, 5, 1, 23, 59, 58)
    since_1970 = text(",", (), lambda s: f"{1_763_800_000_123_456_789 + 1_000_000 * round(1000 * s)}")
    one = "".join(f"{x}\n" for x in true_values())
    restarted = text(",") + text(",")
    return [
        _case("ISO", text(",", "time,x", _moments(lambda m: m.isoformat(), start))),
        _case(
            "ISO with Z", text(",", "time,x", _moments(lambda m: m.isoformat().replace("+00:00", "Z"), start))
        ),
        _case("ISO, a blank in it", text(",", "time,x", _moments(lambda m: m.isoformat(sep=" "), naive))),
        _case("ISO, blanks between", text(" ", (), _moments(lambda m: m.isoformat(sep=" "), naive))),
        _case("German dates", text(";", "Datum;x", _moments(lambda m: f"{m:%d.%m.%Y %H:%M:%S.%f}", naive))),
        _case(
            "date and time apart", text(";", "d;t;x", _moments(lambda m: f"{m:%Y-%m-%d;%H:%M:%S.%f}", naive))
        ),
        _case("time of day over midnight", text(",", "t,x", _moments(lambda m: f"{m:%H:%M:%S.%f}", late))),
        _case("ns since 1970", since_1970, TableColumns(time_unit="ns")),
        _case("ns since 1970, nothing stated", since_1970, refused="which no decay lasts"),
        _case("one column, a rate", one, TableColumns(rate_hz=20.0)),
        _case("one column, named", "x\n" + one, TableColumns(rate_hz=20.0)),
        _case("one column, no rate", one, refused="--rate HZ"),
        _case("a rate and a time", text(), TableColumns(rate_hz=20.0, time="1"), refused="leave --time"),
        _case("a rate, two columns", text(), TableColumns(rate_hz=20.0), refused="--position"),
        _case("a rate, two columns, named", text(), TableColumns(rate_hz=20.0, positions=("2",))),
        _case("time is not first", text(",", "sequence,time_ms,x", lambda s: f"{20 * s:.0f},{1000 * s:.0f}")),
        _case("a stretch", text(), TableColumns(end_s=4.95), rows=100),
        _case("an empty stretch", text(), TableColumns(begin_s=99.0), refused="leaves no rows"),
        _case("times start again", restarted, refused="time does not increase"),
        _case("times start again, a blank line", text(",") + "\n" + text(","), TableColumns(run="2")),
        _case(
            "times start again, none chosen", text(",") + "\n" + text(","), refused="choose one with --run"
        ),
    ]


@dataclass(frozen=True)
class Sheet:
    """One sheet; `numbers` are those of its rows, 1, 2, ... if they are left out."""

    rows: Sequence[Sequence[object]]
    state: str = "visible"
    numbers: Sequence[int] = field(default_factory=tuple)


def workbook(sheets: dict[str, Sheet], *, since_1904: bool = False, dates: bool = False) -> bytes:
    """An .xlsx as Excel writes it: sheets in the workbook's order, whose files are numbered the other way.

    With `dates` the first column is shown as a date.
    """
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w") as archive:
        listed, relations = "", ""
        for k, (title, sheet) in enumerate(sheets.items(), 1):
            file = f"worksheets/sheet{len(sheets) + 1 - k}.xml"
            listed += f'<sheet name="{title}" sheetId="{k}" state="{sheet.state}" r:id="rId{k}"/>'
            relations += f'<Relationship Id="rId{k}" Type="{OFFICE}/worksheet" Target="{file}"/>'
            archive.writestr(f"xl/{file}", _xml(sheet, dates))
        archive.writestr(
            "_rels/.rels",
            f'<Relationships xmlns="{PACKAGE}"><Relationship Id="rId1" '
            f'Type="{OFFICE}/officeDocument" Target="xl/workbook.xml"/></Relationships>',
        )
        archive.writestr(
            "xl/workbook.xml",
            f'<workbook xmlns="{MAIN}" xmlns:r="{OFFICE}"><workbookPr date1904="{int(since_1904)}"/>'
            f"<sheets>{listed}</sheets></workbook>",
        )
        archive.writestr(
            "xl/_rels/workbook.xml.rels",
            f'<Relationships xmlns="{PACKAGE}">{relations}</Relationships>',
        )
        archive.writestr(
            "xl/styles.xml",
            f'<styleSheet xmlns="{MAIN}"><cellXfs><xf numFmtId="0"/>'
            '<xf numFmtId="22"/></cellXfs></styleSheet>',
        )
    return out.getvalue()


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
        lines.append(f'<row r="{number}">{cells}</row>')
    return f'<worksheet xmlns="{MAIN}"><sheetData>{"".join(lines)}</sheetData></worksheet>'


def _files() -> list[TableCase]:
    from scipy.io import savemat

    t, x = np.array(true_ms()) / 1000.0, np.array(true_values())
    pairs = np.column_stack([t, x])

    def npy(array: Any) -> bytes:
        out = io.BytesIO()
        np.save(out, array)
        return out.getvalue()

    def mat(**variables: Any) -> bytes:
        out = io.BytesIO()
        savemat(out, variables)
        return out.getvalue()

    named = np.zeros(ROWS, dtype=[("time_ms", float), ("x_mm", float)])
    named["time_ms"], named["x_mm"] = 1000 * t, x
    days = 45_000.5 + t / 86_400.0
    plain = text(";", "Zeit [µs];x [mm]", point(0), None, 1e6)
    return [
        _case("UTF-16 with its mark", plain.encode("utf-16"), unit="mm"),
        _case("UTF-16 without its mark", plain.encode("utf-16-le"), refused="is no text"),
        _case("UTF-8 with its mark", plain.encode("utf-8-sig"), unit="mm"),
        _case("gzip, a loud ending", gzip.compress(plain.encode()), ending="CSV.GZ", unit="mm"),
        _case("npy, two columns", npy(pairs), ending="npy"),
        _case("npy, two rows", npy(pairs.T), ending="npy"),
        _case("npy, names", npy(named), ending="npy", unit="mm"),
        _case("npy, one column", npy(x), TableColumns(rate_hz=20.0), ending="npy"),
        _case(
            "npy, pictures", npy(np.zeros((3, 4, 5))), ending="npy", refused="columns of numbers are needed"
        ),
        _case("mat, a matrix", mat(data=pairs), ending="mat"),
        _case("mat, vectors", mat(t=t, x=x), ending="mat"),
        _case("mat, unequal vectors", mat(t=t, x=x[:-1]), ending="mat", refused="different lengths"),
        _case(
            "mat 7.3",
            b"MATLAB 7.3".ljust(124) + b"\0\2IM" + bytes(300),
            ending="mat",
            refused="save it with -v7",
        ),
        _case("mat, no mat", b"x" * 300, ending="mat", refused="as a .mat file"),
        _case(
            "xlsx",
            workbook(
                {
                    "empty": Sheet([]),
                    "A": Sheet([("t [s]", "x [mm]"), *zip(t.tolist(), x.tolist(), strict=True)]),
                }
            ),
            ending="xlsx",
            unit="mm",
        ),
        _case(
            "xlsx, dates",
            workbook(
                {"A": Sheet([("Datum", "x"), *zip(days.tolist(), x.tolist(), strict=True)])}, dates=True
            ),
            ending="xlsx",
        ),
        _case("xlsx, no zip", b"no zip", ending="xlsx", refused="cannot be read as a workbook"),
        _case("xls", b"old", ending="xls", refused="save it as .xlsx"),
        _case("empty", b"", refused="holds 0 rows"),
        _case("words alone", b"only words\nand more\n", refused="holds 0 rows"),
    ]


def _losses() -> list[TableCase]:
    rows = text(",").splitlines()
    short, wordy, missing = list(rows), list(rows), list(rows)
    for k in (20, 21, 90):
        short[k] = short[k].split(",")[0]
        wordy[k] = f"bad,{wordy[k].split(',')[1]}"
        missing[k] = f",{missing[k].split(',')[1]}"
    cut = "\n".join([*rows[:-1], rows[-1].split(",")[0] + ","])
    return [
        _case("rows too short", "\n".join(short), lost=3),
        _case("times that are words", "\n".join(wordy), lost=3),
        _case("times that are missing", "\n".join(missing), lost=3),
        _case("a line of words between", "\n".join([*rows[:50], "paused", *rows[50:]])),
        replace(_case("the last row cut off", "\n".join([*rows[:-1], "11."])), lost=1),
        _case("an empty value at the end", cut, TableColumns(end_s=11.9), rows=ROWS - 1),
    ]

"""Runs of an archive that meet a condition: listed, shown, found by words, or for a campaign."""

import datetime
import re
import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import replace
from math import nan
from pathlib import Path
from typing import Any, NamedTuple

from acquisition.record import whole_file
from processing.errors import ConfigurationError, RecordError
from processing.estimate import Determinacy
from rig.archive.catalogue import duckdb_module, reading
from rig.archive.columns import IS_SIMULATED, SHOWN
from rig.presentation import (
    NOT_KNOWN,
    Cell,
    Table,
    plain,
    print_json_line,
    print_tables,
    screen_width,
    with_uncertainty,
)

_DOUBT = " ?"
_SIMULATED = "SIMULATED: "
_BETWEEN = 2
"""Characters between two columns of a table."""
_IMPORTANT = (
    "id", "run", "b", "c", "state", "sample", "began_utc", "p", "n", "humidity_percent", "temperature_c"
)  # fmt: skip
"""Columns that a narrow terminal shows first."""
_SHORTEST = 4
_SHORTENED = 8
"""Characters of a hash that name a run on the screen."""
_WITH_U = "".join(f", u_{name}, verdict_{name}" for name in ("b", "p", "c", "n"))
_SAMPLE = f"case when {IS_SIMULATED} then '{_SIMULATED}' else '' end || coalesce(sample, '')"
_FOUND = (
    f"left(sha256, {_SHORTENED}) as id, began_utc, folder, run, {_SAMPLE} as sample, operator, state, b, p, c"
    f"{_WITH_U}"
)
_NUMBER = "coalesce(try_cast(regexp_extract(run, '[0-9]+$') as bigint), 0)"
_IN_ORDER = """
select sha256, run, coalesce(sample, ''), folder, results from chosen
order by max(began_utc) over (partition by folder order by number, run) nulls last, folder, number, run
"""
_SEARCHED = (
    "lower(concat_ws(' ', strftime(began_utc, '%Y-%m-%d %H:%M:%S'), folder, run, sample, operator, state, "
    "contact_history, noted))"
)


class FoundRuns(NamedTuple):
    """Some of the runs that were found, as text by column, and how many those are."""

    columns: Sequence[str]
    rows: Sequence[Mapping[str, str]]
    found: int
    all: int


class RunWithResults(NamedTuple):
    """A run of the archive; `results` is None where it was not fitted."""

    sha256: str
    run: str
    sample: str
    results: Path | None


def list_runs(
    archive: Path, condition: str, columns: str, output: Path | None, *, json_lines: bool = False
) -> None:
    """Print the runs that meet a condition of SQL (empty: all), or write them to a new CSV file.

    `columns` are expressions of SQL; without any those of `SHOWN`, with the run's name before them, and with
    uncertainties and verdicts of the parameters. With `json_lines` a JSON object a line is printed.

    Raises ConfigurationError for a condition that is no plain one.
    """
    wanted = columns
    if not columns.strip():
        wanted = f"left(sha256, {_SHORTENED}) as id, {', '.join(SHOWN)}"
        if json_lines or output is not None:
            wanted += ", camera"
        else:
            wanted = wanted.replace(" sample,", f" {_SAMPLE} as sample,")
        wanted += _WITH_U
    with reading(archive) as connection:
        found = _selected(connection, wanted, condition)
        names, rows = list(found.columns), found.fetchall()
    if json_lines:
        for row in rows:
            print_json_line("run", dict(zip(names, map(_json_value, row), strict=True)))
        return
    table = _table(names, rows)
    if output is None:
        print_tables([table if columns else narrowed(table, screen_width())])
        return
    try:
        whole_file.write_new(output, f"{table.csv().rstrip()}\n".encode())
    except FileExistsError:
        raise RecordError(f"{output}: exists already and is not overwritten; choose another name") from None
    except OSError as error:
        raise RecordError(f"{output}: cannot be written: {error.strerror or error}") from None


def show_runs(archive: Path, names: Sequence[str]) -> None:
    """Print all that the archive knows of runs."""
    tables = []
    with reading(archive) as connection:
        for run in [run for name in names for run in _named(connection, name)]:
            found = connection.execute(f"select *, {IS_SIMULATED} from runs where sha256 = ?", [run])
            columns = [item[0] for item in found.description]
            *values, simulated = found.fetchone()
            row = dict(zip(columns, values, strict=False))
            texts = [
                (name, _text(value, row.get(f"u_{name}")))
                for name, value in row.items()
                if value not in (None, "") and not name.startswith("u_")
            ]
            title = f"{_SIMULATED if simulated else ''}{Path(row['folder']) / row['record']}"
            tables.append(Table(run[:_SHORTENED], title, (), (), ("", ""), texts, ""))
    print_tables(tables)


def chosen_runs(archive: Path, names: Sequence[str], where: str) -> set[str]:
    """SHA-256 of the runs that are named by the first characters of theirs, or meet a condition."""
    with reading(archive) as connection:
        found = {run for name in names for run in _named(connection, name)}
        if where.strip():
            found |= {sha256 for (sha256,) in _selected(connection, "sha256", where).fetchall()}
    return found


def find_runs(archive: Path, words: str, first: int = 0, most: int = 20) -> FoundRuns:
    """The runs with all these words in folder, run, sample, operator, state or notes, newest first."""
    wanted = words.lower().split()
    where = " and ".join(f"contains({_SEARCHED}, ?)" for _ in wanted) or "true"
    with reading(archive) as connection:
        every, found = connection.execute(
            f"select count(*), count(*) filter (where {where}) from runs", wanted
        ).fetchone()
        rows = connection.execute(
            f"select {_FOUND} from runs where {where} "
            "order by began_utc desc nulls last, sha256 limit ? offset ?",
            [*wanted, most, first],
        )
        table = _table([item[0] for item in rows.description], rows.fetchall())
    texts = [dict(zip(table.head, row, strict=True)) for row in table.shown]
    return FoundRuns(table.head, texts, int(found), int(every))


def runs_in_order(archive: Path, where: str) -> list[RunWithResults]:
    """The runs that meet a condition of SQL (empty: all), earliest first; without a beginning they are last.

    Runs of one session follow each other by their numbers, also where the clock of the day was set back
    between them.
    """
    with reading(archive) as connection:
        found = _selected(connection, f"*, {_NUMBER} as number", where)
        rows = found.query("chosen", _IN_ORDER).fetchall()
    return [
        RunWithResults(sha256, run, sample, Path(folder) / results if results else None)
        for sha256, run, sample, folder, results in rows
    ]


def _named(connection: Any, name: str) -> list[str]:
    """The SHA-256 of the run, or of the session's runs, that a name begins.

    Raises ConfigurationError where none or several are meant.
    """
    if not re.fullmatch(rf"[0-9a-f]{{{_SHORTEST},64}}", name):
        raise ConfigurationError(
            f"{name}: names no run; take {_SHORTEST} or more characters of list's first column"
        )
    found = connection.execute(
        "select sha256, session from runs "
        "where starts_with(sha256, $1) or starts_with(session, $1) order by run",
        [name],
    ).fetchall()
    if not found:
        raise ConfigurationError(f"{name}: no run of the archive begins so; rig archive list names all")
    of_one_session = len({session for _, session in found}) == 1 and found[0][1].startswith(name)
    if len(found) > 1 and not of_one_session:
        raise ConfigurationError(f"{name}: {len(found)} runs begin so; give more characters")
    return [run for run, _ in found]


def _selected(connection: Any, wanted: str, condition: str) -> Any:
    """The result of a query of the runs."""
    duckdb = duckdb_module()
    no_condition = re.match(r"\s*(order\s+by|limit|group\s+by|$)", condition, re.IGNORECASE)
    query = f"select {wanted} from runs {'' if no_condition else 'where '}{condition}"
    try:
        if len(duckdb.extract_statements(query)) != 1:
            raise ConfigurationError(f"condition {condition!r}: is more than one; leave out the semicolon")
        return connection.sql(query)
    except duckdb.OutOfMemoryException:
        # the condition may be right: said by who reads the archive
        raise
    except duckdb.Error as error:
        said = str(error).splitlines()[0].removeprefix("Binder Error: ")
        at_fault = f"condition {condition!r}"
        try:
            connection.sql(f"select {wanted} from runs limit 0")
        except duckdb.Error:
            at_fault = f"columns {wanted!r}"
        raise ConfigurationError(f"{at_fault}: {said}; docs/reference/archive.md lists the columns") from None


def _table(names: Sequence[str], rows: Sequence[Sequence[Any]]) -> Table:
    """For the screen values with uncertainty and doubt in one cell, for the file each in its own."""
    at = {name: place for place, name in enumerate(names)}
    hidden = {at[other] for name in names for other in (f"u_{name}", f"verdict_{name}") if other in at}
    shown_places = [place for place in range(len(names)) if place not in hidden]
    shown = [[_shown(names[place], row, at) for place in shown_places] for row in rows]
    head = [names[place] for place in shown_places]
    cells = [[_cell(value) for value in row] for row in rows]
    summary = f"{len(rows)} run{'s' if len(rows) != 1 else ''}"
    if any(_is_doubtful(names[place], row, at) for place in shown_places for row in rows):
        summary += f"; {_DOUBT.strip()}: the run's data do not determine it; its report gives bounds"
    return Table("runs", "", names, cells, head, shown, summary)


def narrowed(table: Table, width: int) -> Table:
    """A table of the most important columns that so many characters hold; says which it lacks.

    Texts of the sample are broken at spaces.
    """
    columns = dict(zip(table.head, zip(*table.shown, strict=True), strict=True)) if table.shown else {}
    if "sample" in columns:
        longest = max(len(word) for text in ("sample", *columns["sample"]) for word in text.split())
        columns["sample"] = tuple(
            "\n".join(textwrap.wrap(text, max(longest, 20))) for text in columns["sample"]
        )
    needed = {
        name: _BETWEEN + max(len(line) for text in (name, *texts) for line in text.split("\n"))
        for name, texts in columns.items()
    }
    kept = sorted(columns, key=lambda name: (_IMPORTANT.index(name), name))
    while sum(needed[name] for name in kept) > width + _BETWEEN:
        kept.pop()
    head = [name for name in table.head if name in kept]
    if not columns or len(head) == len(columns):
        return table
    note = f"{table.note}\nno room for {', '.join(name for name in columns if name not in kept)}: "
    note += "rig archive show ID, --columns, --json or a wider window"
    simulated = sum(text.startswith(_SIMULATED) for text in columns.get("sample", ()))
    if "sample" not in kept and simulated:
        note = f"{_SIMULATED}{simulated} of the runs\n{note}"
    shown = list(zip(*(columns[name] for name in head), strict=True))
    return replace(table, head=head, shown=shown, note=note)


def _is_doubtful(name: str, row: Sequence[Any], at: Mapping[str, int]) -> bool:
    verdict = row[at[f"verdict_{name}"]] if f"verdict_{name}" in at else None
    return row[at[name]] is not None and verdict not in (None, Determinacy.DETERMINED)


def _shown(name: str, row: Sequence[Any], at: Mapping[str, int]) -> str:
    value = row[at[name]]
    if value is None:
        return NOT_KNOWN
    if f"u_{name}" in at:
        text = _text(value, row[at[f"u_{name}"]])
        return f"{text}{_DOUBT}" if _is_doubtful(name, row, at) else text
    if isinstance(value, datetime.datetime):
        return f"{value:%Y-%m-%d %H:%M}"
    return plain(value, 5) if isinstance(value, float) else str(value)


def _text(value: Any, u: float | None) -> str:
    if isinstance(value, float):
        return plain(value, 6) if u is None else with_uncertainty(value, u)
    return str(value)


def _cell(value: Any) -> Cell:
    if value is None:
        return nan
    return value if isinstance(value, int | float) else str(_json_value(value))


def _json_value(value: Any) -> Any:
    return value.isoformat() if isinstance(value, datetime.datetime | datetime.date) else value

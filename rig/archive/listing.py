"""`rig archive list`: runs that meet a condition, as a table or for other programs."""

import datetime
import json
import re
import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import replace
from math import nan
from pathlib import Path
from typing import Any, Literal

from acquisition.record import whole_file
from processing.errors import ConfigurationError, RecordError
from processing.estimate import Determinacy
from rig.archive.blind import sealed
from rig.archive.columns import IS_SIMULATED, SHOWN
from rig.archive.shelf import as_parquet
from rig.archive.store import Archive, duckdb_module, reads_archive
from rig.presentation import (
    NOT_KNOWN,
    Cell,
    Table,
    plain,
    plain_values,
    print_json_line,
    print_tables,
    say,
    screen_width,
    with_uncertainty,
)

Format = Literal["table", "csv", "json", "parquet"]
_DOUBT = " ?"
_SIMULATED = "SIMULATED: "
_BETWEEN = 2
"""Characters between two columns of a table."""
_IMPORTANT = ("id", "run", "level", "b", "c", "state", "newest", "sample", "began_utc", "p", "n")
"""Columns that a narrow terminal shows first."""
_SHORTENED = 8
"""Characters of a hash that name a run on the screen."""


@reads_archive
def list_runs(
    archive: Path,
    condition: str,
    columns: Sequence[str],
    kind: Format | Literal["lines"],
    output: Path | None,
    *,
    refits: bool = False,
) -> None:
    """Print the runs that meet a condition of SQL (empty: all), or write them to a new file.

    `columns` are expressions of SQL; without any those of `SHOWN`, with the run's name before them, and with
    uncertainties and verdicts of the parameters. The kind `lines` is a JSON object a line.

    Raises ConfigurationError for a condition that is no plain one.
    """
    if kind == "parquet" and output is None:
        raise ConfigurationError("--format parquet needs a file: -o FILE")
    shown = (*SHOWN[:2], "level", "made_utc", *SHOWN[5:-1], "newest") if refits else SHOWN
    wanted = ", ".join(columns) if columns else f"left(sha256, {_SHORTENED}) as id, {', '.join(shown)}"
    if not columns and kind == "table":
        invented = (
            f"case when {IS_SIMULATED} then '{_SIMULATED}' else '' end || coalesce(sample, '') as sample"
        )
        wanted = wanted.replace(" sample,", f" {invented},")
    elif not columns:
        wanted += ", camera"
        # who reads a file does not see what is said on the screen
        wanted += ", true as blind" if sealed(archive) is not None else ""
    if not columns:
        wanted += "".join(f", u_{name}, verdict_{name}" for name in ("b", "p", "c", "n"))
    if (seal := sealed(archive)) is not None:
        how = (
            "a hidden offset is on"
            if seal.key is not None
            else "the key is not here, and nothing is shown of"
        )
        say(f"BLIND: {how} the parameters; rig archive unblind")
    connection = Archive(archive).connection(refits=refits)
    found = selected(connection, wanted, condition, "refits" if refits else "runs")
    names = list(found.columns)
    if kind == "parquet":
        assert output is not None
        write_output(output, as_parquet(found.to_arrow_table()))
        return
    rows = found.fetchall()
    if kind == "lines":
        for row in rows:
            print_json_line("run", dict(zip(names, map(_json_value, row), strict=True)))
        return
    if kind == "json":
        text = json.dumps(
            [plain_values(dict(zip(names, map(_json_value, row), strict=True))) for row in rows], indent=1
        )
    else:
        table = _table(names, rows)
        if kind == "table" and output is None:
            print_tables([table if columns else narrowed(table, screen_width())])
            return
        text = table.csv().rstrip("\n")
    if output is None:
        print(text)
    else:
        write_output(output, f"{text}\n".encode())


def selected(connection: Any, wanted: str, condition: str, table: str = "runs") -> Any:
    """The result of a query of the table, which reads and does nothing else."""
    duckdb = duckdb_module()
    no_condition = re.match(r"\s*(order\s+by|limit|group\s+by|$)", condition, re.IGNORECASE)
    query = f"select {wanted} from {table} {'' if no_condition else 'where '}{condition}"
    try:
        statements = duckdb.extract_statements(query)
        if len(statements) != 1:
            raise ConfigurationError(f"condition {condition!r}: is more than one; leave out the semicolon")
        return connection.sql(query)
    except duckdb.OutOfMemoryException:
        # the condition may be right: said by who reads the archive
        raise
    except duckdb.Error as error:
        said = str(error).splitlines()[0].removeprefix("Binder Error: ")
        at_fault = f"condition {condition!r}"
        try:
            connection.sql(f"select {wanted} from {table} limit 0")
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
    """A table of the most important columns that so many characters hold; says which it lacks."""
    texts = {name: [row[place] for row in table.shown] for place, name in enumerate(table.head)}
    needed = {name: max(map(len, (name, *found))) for name, found in texts.items()}
    if "sample" in needed:
        # it breaks at spaces, and no word of it is broken
        longest = max((len(word) for text in texts["sample"] for word in text.split()), default=0)
        needed["sample"] = max(len("sample"), longest)
    kept, left = set[str](), width
    for name in sorted(table.head, key=_importance):
        if needed[name] <= left:
            kept.add(name)
            left -= needed[name] + _BETWEEN
    shown = [dict(zip(table.head, row, strict=True)) for row in table.shown]
    if "sample" in kept:
        # broken here, so that nothing else has to give way to it
        room = needed["sample"] + max(left + _BETWEEN, 0)
        shown = [{**row, "sample": "\n".join(textwrap.wrap(row["sample"], room))} for row in shown]
    head = [name for name in table.head if name in kept]
    table = replace(table, head=head, shown=[[row[name] for name in head] for row in shown])
    if len(head) == len(texts):
        return table
    lacks = ", ".join(name for name in texts if name not in kept)
    note = f"{table.note}\nno room for {lacks}: rig archive show ID, --columns, --json or a wider window"
    simulated = sum(text.startswith(_SIMULATED) for text in texts.get("sample", ()))
    if "sample" not in kept and simulated:
        note = f"SIMULATED: {simulated} of the runs\n{note}"
    return replace(table, note=note)


def _importance(name: str) -> int:
    return _IMPORTANT.index(name) if name in _IMPORTANT else len(_IMPORTANT)


def _is_doubtful(name: str, row: Sequence[Any], at: Mapping[str, int]) -> bool:
    verdict = row[at[f"verdict_{name}"]] if f"verdict_{name}" in at else None
    return row[at[name]] is not None and verdict not in (None, Determinacy.DETERMINED)


def _shown(name: str, row: Sequence[Any], at: Mapping[str, int]) -> str:
    value = row[at[name]]
    if value is None:
        return NOT_KNOWN
    if f"u_{name}" in at:
        u = row[at[f"u_{name}"]]
        text = with_uncertainty(value, nan if u is None else u)
        return f"{text}{_DOUBT}" if _is_doubtful(name, row, at) else text
    if isinstance(value, datetime.datetime):
        return f"{value:%Y-%m-%d %H:%M}"
    if isinstance(value, list):
        return "; ".join(map(str, value)) or NOT_KNOWN
    return plain(value, 5) if isinstance(value, float) else str(value)


def _cell(value: Any) -> Cell:
    if value is None:
        return nan
    if isinstance(value, list):
        return "; ".join(map(str, value))
    return value if isinstance(value, int | float) else _json_value(value)


def _json_value(value: Any) -> Any:
    if isinstance(value, datetime.datetime | datetime.date):
        return value.isoformat()
    return value


def write_output(path: Path, data: bytes) -> None:
    """Write a file that must not exist. Raises RecordError."""
    try:
        whole_file.write_new(path, data)
    except FileExistsError:
        raise RecordError(f"{path}: exists already and is not overwritten; choose another name") from None
    except OSError as error:
        raise RecordError(f"{path}: cannot be written: {error.strerror or error}") from None

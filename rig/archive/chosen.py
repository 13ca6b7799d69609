"""Runs as a user names them: by the first characters of a hash, or by a condition."""

import re
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from processing.errors import ConfigurationError
from rig.archive.columns import IS_SIMULATED
from rig.archive.listing import selected
from rig.archive.remarks import write_remark
from rig.archive.store import Archive, reads_archive
from rig.presentation import NOT_KNOWN, Table, plain, print_tables, with_uncertainty

if TYPE_CHECKING:
    from rig.rerun import ShowMode

_SHORTEST = 4
_MOST_VIEWED = 24
"""More colours cannot be told apart, and each record is read whole."""


@reads_archive
def remark(
    archive: Path,
    names: Sequence[str],
    where: str = "",
    *,
    add: str = "",
    remove: str = "",
    note: str = "",
) -> str:
    """Add or remove a tag, or write a note, of the runs that are named or meet a condition; says how many.

    A name is the beginning of a run's SHA-256, or of its session's for all of its runs.
    """
    runs = list(chosen_runs(archive, names, where))
    write_remark(archive, runs, add=add, remove=remove, note=note)
    return f"{len(runs)} run{'s' if len(runs) != 1 else ''}"


@reads_archive
def chosen_runs(archive: Path, names: Sequence[str], where: str) -> dict[str, Path]:
    """The records of runs that are named or meet a condition, by their SHA-256."""
    connection = Archive(archive).connection()
    found: dict[str, Path] = {}
    if where.strip():
        rows = selected(connection, "sha256, folder, record", where).fetchall()
        found = {sha256: Path(folder) / record for sha256, folder, record in rows}
    for name in names:
        for run in named(connection, name):
            folder, record = connection.execute(
                "select folder, record from runs where sha256 = ?", [run]
            ).fetchone()
            found[run] = Path(folder) / record
    return found


def simulated_among(archive: Path, runs: Iterable[str]) -> int:
    """How many of these runs, by their SHA-256, come from the simulated rig."""
    connection = Archive(archive).connection()
    question = f"select count(*) from runs where {IS_SIMULATED} and list_contains($1, sha256)"
    return int(connection.execute(question, [list(runs)]).fetchone()[0])


def named(connection: Any, name: str) -> list[str]:
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
    runs = [run for run, _ in found]
    if not runs:
        raise ConfigurationError(f"{name}: no run of the archive begins so; rig archive list names all")
    if len(runs) > 1 and not (len({session for _, session in found}) == 1 and found[0][1].startswith(name)):
        raise ConfigurationError(f"{name}: {len(runs)} runs begin so; give more characters")
    return runs


@reads_archive
def show_runs(archive: Path, names: Sequence[str]) -> None:
    """Print all that the archive knows of runs, and which versions of them it has."""
    connection = Archive(archive).connection()
    for run in [run for name in names for run in named(connection, name)]:
        found = connection.execute("select * from runs where sha256 = ?", [run])
        columns = [item[0] for item in found.description]
        row = dict(zip(columns, found.fetchone(), strict=True))
        rows = [
            (name, value) for name, value in row.items() if value not in (None, "", []) and name != "sealed"
        ]
        texts = [
            (name, _text(value, row.get(f"u_{name}"))) for name, value in rows if not name.startswith("u_")
        ]
        older = connection.execute(
            "select added_utc, results from versions where sha256 = ? order by turn, writer, place", [run]
        ).fetchall()
        question = f"select {IS_SIMULATED} from runs where sha256 = ?"
        (simulated,) = connection.execute(question, [run]).fetchone()
        versions = "; ".join(f"{added:%Y-%m-%d %H:%M} {results or 'not fitted'}" for added, results in older)
        title = f"{'SIMULATED: ' if simulated else ''}{Path(row['folder']) / row['record']}"
        print_tables([Table(run[:8], title, (), (), ("", ""), texts, f"added: {versions}")])


def _text(value: Any, u: float | None) -> str:
    if isinstance(value, float):
        return plain(value, 6) if u is None else with_uncertainty(value, u)
    if isinstance(value, list):
        return "; ".join(value)
    return str(value) or NOT_KNOWN


def view_runs(archive: Path, names: Sequence[str], where: str, mode: "ShowMode", rrd: Path | None) -> None:
    """Show runs that are named or meet a condition in one viewer, or write its file.

    Raises ConfigurationError for none or too many, RecordError for a record that is not here.
    """
    # starts a viewer, which `list` must not wait for
    from rig.view import show_records

    records = list(chosen_runs(archive, names, where).values())
    if not 0 < len(records) <= _MOST_VIEWED:
        raise ConfigurationError(
            f"{len(records)} runs are meant; 1 to {_MOST_VIEWED} can be seen over each other"
        )
    show_records(records, mode=mode, rrd=rrd)
    if rrd is not None:
        print(f"Rerun file   {rrd}")

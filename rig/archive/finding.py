"""Runs of an archive that have some words, page by page, for who shows them."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from rig.archive.columns import IS_SIMULATED
from rig.archive.store import Archive, reads_archive
from rig.presentation import quantity

_PARAMETERS = ("b", "p", "c")
_SEARCHED = (
    "folder, run, sample, operator, state, contact_history, noted, "
    "array_to_string(tags, ' '), array_to_string(notes, ' ')"
)


class FoundRuns(NamedTuple):
    """Some of the runs that were found, as text by column, and how many those are."""

    columns: Sequence[str]
    rows: Sequence[Mapping[str, str]]
    found: int
    all: int


@reads_archive
def find_runs(archive: Path, words: str, first: int = 0, most: int = 20) -> FoundRuns:
    """The runs with all these words in folder, run, sample, operator, state, tags or notes, newest first.

    Raises RigError for an archive that cannot be read. Reads, and changes nothing.
    """
    connection = Archive(archive).connection()
    searched = f"lower(concat_ws(' ', strftime(began_utc, '%Y-%m-%d %H:%M:%S'), {_SEARCHED}))"
    wanted = words.lower().split()
    where = " and ".join(f"contains({searched}, ?)" for _ in wanted) or "true"
    every, found = connection.execute(
        f"select count(*), count(*) filter (where {where}) from runs", wanted
    ).fetchone()
    values = ", ".join(f"{name}, u_{name}, verdict_{name}" for name in _PARAMETERS)
    rows = connection.execute(
        f"select left(sha256, 8), strftime(began_utc, '%Y-%m-%d %H:%M:%S'), folder, run, "
        f"case when {IS_SIMULATED} then 'SIMULATED: ' else '' end || coalesce(sample, ''), operator, state, "
        f"{values} from runs where {where} order by began_utc desc nulls last, sha256 limit ? offset ?",
        [*wanted, most, first],
    ).fetchall()
    fixed = ("run's hash", "begun (UTC)", "folder", "run", "sample", "operator", "record")
    columns = (*fixed, *(quantity(name).label for name in _PARAMETERS))
    return FoundRuns(columns, [_texts(columns, row, len(fixed)) for row in rows], int(found), int(every))


def _texts(columns: Sequence[str], row: Sequence[Any], fixed: int) -> Mapping[str, str]:
    told = ["" if one is None else str(one) for one in row[:fixed]]
    for name, (value, u, verdict) in zip(
        _PARAMETERS, (row[fixed + 3 * k : fixed + 3 * k + 3] for k in range(len(_PARAMETERS))), strict=True
    ):
        known = value is not None and u is not None
        doubt = " ?" if verdict not in (None, "determined") else ""
        told.append(quantity(name).text(value, u) + doubt if known else "")
    return dict(zip(columns, told, strict=True))

"""What a campaign takes of an archive: where the results of runs lie, in the order of their beginnings."""

import datetime
import re
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from rig.archive.blind import sealed
from rig.archive.listing import selected
from rig.archive.store import Archive, reads_archive


class RunWithResults(NamedTuple):
    """A run of the catalogue; `results` is None where it was not fitted."""

    sha256: str
    run: str
    sample: str
    results: Path | None


@reads_archive
def results_of_runs(archive: Path, where: str) -> list[RunWithResults]:
    """The runs that meet a condition of SQL (empty: all), earliest first."""
    connection = Archive(archive).connection()
    found = selected(
        connection, "sha256, run, sample, folder, results, began_utc", where or "true"
    ).fetchall()
    order = in_order([(folder, run, began) for _, run, _, folder, _, began in found])
    return [
        RunWithResults(sha256, run, sample or "", Path(folder) / results if results else None)
        for sha256, run, sample, folder, results, _ in (found[place] for place in order)
    ]


def in_order(runs: Sequence[tuple[str, str, datetime.datetime | None]]) -> list[int]:
    """Places of runs (folder, name, beginning), earliest first; those without a beginning are the last.

    Runs of one session follow each other by their numbers, also where the clock of the day was set back
    between them.
    """
    places = sorted(range(len(runs)), key=lambda place: (runs[place][0], _number(runs[place][1])))
    latest: dict[str, datetime.datetime] = {}
    begins: dict[int, datetime.datetime] = {}
    for place in places:
        folder, _, began = runs[place]
        known = [time for time in (began, latest.get(folder)) if time is not None]
        if known:
            begins[place] = latest[folder] = max(known)
    never = datetime.datetime.max
    return sorted(places, key=lambda place: begins.get(place, never))


def _number(run: str) -> list[tuple[int, str]]:
    """Sorts run-10 after run-9."""
    return [(int(text) if text.isdecimal() else -1, text) for text in re.split(r"(\d+)", run)]


def is_sealed(archive: Path) -> bool:
    """Whether the archive's values are hidden now."""
    return sealed(archive) is not None

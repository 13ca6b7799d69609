"""What a campaign takes of an archive: where the results of runs lie, in the order of their beginnings."""

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
    found.sort(key=lambda row: (row[5] is None, row[5], row[1]))
    return [
        RunWithResults(sha256, run, sample or "", Path(folder) / results if results else None)
        for sha256, run, sample, folder, results, _ in found
    ]


def is_sealed(archive: Path) -> bool:
    """Whether the archive's values are hidden now."""
    return sealed(archive) is not None

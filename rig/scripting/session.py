"""The folder of a session."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from rig.analysis import SessionResults, read_results
from rig.scripting.record import Record, open_record
from rig.scripting.report_figures import figures

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True)
class Session:
    """A session: its folder, its results, and the records from which they were made, in order of the runs."""

    folder: Path
    results: SessionResults
    records: tuple[Record, ...]

    def figures(self, run: int = 1) -> "Mapping[str, Figure]":
        """Figures of one run, counted from 1; see `rig.figures`."""
        return figures(self.folder, run)


def open_session(folder: str | Path) -> Session:
    """Open the folder of a session with its results.json.

    Raises
    ------
    RigError
        There are no results (`rig.fit` makes them), or a record is missing.
    """
    folder = Path(folder)
    results = read_results(folder)
    return Session(folder, results, tuple(open_record(folder / run.record) for run in results.runs))

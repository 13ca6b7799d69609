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
    """A session's folder with its results, and the records that these were made from, in order."""

    folder: Path
    results: SessionResults
    records: tuple[Record, ...]

    def figures(self, run: int = 1) -> "Mapping[str, Figure]":
        """The figures of one run, counted from 1: see `rig.figures`."""
        return figures(self.folder, run)


def open_session(folder: str | Path) -> Session:
    """A session's folder with results.json.

    Raises
    ------
    RigError
        No results (`rig.fit` makes some), or a record that is missing.
    """
    folder = Path(folder)
    results = read_results(folder)
    return Session(folder, results, tuple(open_record(folder / run.record) for run in results.runs))

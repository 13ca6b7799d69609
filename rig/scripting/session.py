"""The folder of a session, and the figures of its report."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from rig.analysis import SessionResults, read_results
from rig.scripting.given import path_of
from rig.scripting.record import Record, open_record

if TYPE_CHECKING:
    from matplotlib.figure import Figure
from typing import TYPE_CHECKING

from rig.report import draw_run, styled

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def figures(source: str | Path, run: int = 1) -> "Mapping[str, Figure]":
    """Figures of one run of a session, by the names that their files have in a report.

    Parameters
    ----------
    source
        Folder of a session, or a results file.
    run
        Number of the run, counted from 1.

    Returns
    -------
    Mapping of str to matplotlib.figure.Figure
        A notebook displays the figures; `savefig` writes them.

    Raises
    ------
    RigError
        There are no results or no such run, or a record is missing.
    """
    with styled():
        return {drawing.name: drawing.figure for drawing in draw_run(path_of(source, "source"), run)}


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
    folder = path_of(folder, "folder")
    results = read_results(folder)
    return Session(folder, results, tuple(open_record(folder / run.record) for run in results.runs))

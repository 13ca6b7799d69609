"""The folder of a session, results files, and the figures of a report."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from processing.errors import ConfigurationError
from rig import analysis
from rig.analysis import SessionResults, TableResults
from rig.report import draw_run, styled
from rig.scripting.given import path_of
from rig.scripting.record import Record, open_record

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
    results = analysis.read_results(folder)
    return Session(folder, results, tuple(open_record(folder / run.record) for run in results.runs))


def read_results(source: str | Path) -> SessionResults:
    """results.json of a session's folder, or a results file: of records, or of the decays of a table.

    Raises
    ------
    RigError
        No such file, or a key that cannot be understood.
    """
    return analysis.read_results(path_of(source, "source"))


def write_results(path: str | Path, results: SessionResults | TableResults) -> None:
    """Write results.json; never over an existing file.

    Raises
    ------
    RigError
        There is a file of that name, it cannot be written, or these are no results of `rig.fit`,
        `rig.fit_table` or `rig.fit_film`.
    """
    if not isinstance(results, SessionResults | TableResults):
        raise ConfigurationError(
            f"results: what rig.fit or rig.fit_table returned is needed, not a {type(results).__name__}"
        )
    analysis.write_results(path_of(path, "path"), results)

"""The folder of a session, results files, and the figures of a report."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from processing.errors import ConfigurationError
from rig import analysis
from rig.analysis import ResultRow, SessionResults, TableResults
from rig.report import draw_run, styled
from rig.scripting.given import path_of
from rig.scripting.record import Record, open_record

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def figures(source: "str | Path | Session | SessionResults", run: int = 1) -> "Mapping[str, Figure]":
    """Figures of one run of a session, by the names that their files have in a report.

    Parameters
    ----------
    source
        Folder of a session, a results file, a session, or what `rig.fit` returned.
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
    if isinstance(source, TableResults):
        raise ConfigurationError(
            "source: figures of a table need its positions: rig fit TABLE -o FOLDER, then rig.figures(FOLDER)"
        )
    if isinstance(source, Session):
        source = source.folder
    found = source if isinstance(source, SessionResults) else path_of(source, "source")
    with styled():
        return {drawing.name: drawing.figure for drawing in draw_run(found, run)}


@dataclass(frozen=True, repr=False)
class Session:
    """A session: its folder, its results, and the records from which they were made, in order of the runs.

    ``session["b"]`` is a row of its table of results: of its series, or of its one run.
    """

    folder: Path
    results: SessionResults
    records: tuple[Record, ...]

    def __getitem__(self, name: str) -> ResultRow:
        return self.results[name]

    def __repr__(self) -> str:
        return f"session {self.folder}\n{self.results!r}"

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

"""Results files."""

from pathlib import Path

from processing.errors import ConfigurationError
from rig import analysis
from rig.analysis import SessionResults, TableResults
from rig.scripting.given import path_of


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

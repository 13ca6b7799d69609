"""The report of a table or a film, with its positions, beside its results."""

from collections.abc import Sequence
from pathlib import Path

from rig.analysis import AnalysedTable, write_positions
from rig.report.session_report import make_report


def make_table_report(table: AnalysedTable, folder: Path) -> Sequence[tuple[str, Path]]:
    """Write positions.csv and the report of the results that are in a folder; what was made, by names.

    Raises RecordError where a file cannot be written.
    """
    return [("positions", write_positions(table.trajectory, folder)), ("report", make_report(folder))]

"""The tables of a session's report as LaTeX, by the names of their files."""

from collections.abc import Mapping
from pathlib import Path

from rig.presentation import Table, latex_table
from rig.report.source import read_source
from rig.report.tables import run_tables, series_tables


def latex_tables(folder: Path) -> Mapping[str, str]:
    """Every table that the report shows, as `run-1-parameters.tex`, and those of a series.

    Raises RecordError for a folder without results, or whose record is missing.
    """
    source = read_source(folder)
    found = dict[str, Table]()
    for number, run in enumerate(source.runs, start=1):
        found |= {f"run-{number}-{each.name}.tex": each for each in run_tables(run, None)}
    if source.series is not None:
        found |= {f"{each.name}.tex": each for each in series_tables(source.series)}
    return {name: latex_table(each, Path(name).stem) for name, each in found.items() if each.shown}

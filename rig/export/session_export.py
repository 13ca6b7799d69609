"""The command `rig export`: writes spots, half-cycles and results, each file with its provenance."""

from pathlib import Path
from typing import Literal

from acquisition.atomic_write import write_new
from processing.errors import ConfigurationError, RecordError
from rig.analysis import TableDecay
from rig.export.nexus import item_name, write_nexus
from rig.export.run import SERIES_NAME, exported_series, read_run, read_table_decay, runs_in, series_in
from rig.export.tables import TABLES, table_path, write_csv, write_parquet
from rig.presentation import say
from rig.report import latex_tables

Format = Literal["csv", "parquet", "hdf5", "latex"]


def export_session(source: Path, kind: Format, output: Path) -> list[Path]:
    """Export a session's folder, that of a table's results, or one record; returns the files made.

    What a record lacks is said on stderr and in every file. CSV and Parquet: `output` is a folder, four
    files a run, and two with what the runs say together. HDF5: `output` is the file, one NXentry a run and
    one for the series. LaTeX: a folder with the tables of the report. Nothing that exists is written over.

    Raises RecordError for a source without records, ConfigurationError for a file that exists.
    """
    if kind == "latex":
        return _export_latex(source, output)
    found = runs_in(source)
    suffix = "csv" if kind == "csv" else "parquet"
    series = series_in(source)
    names = [name for name, _, _ in found]
    made = [table_path(output, name, what, suffix) for name in names for what in TABLES]
    if series is not None:
        names.append(SERIES_NAME)
        made += [table_path(output, SERIES_NAME, what, suffix) for what in ("results", "table")]
    if len(set(made)) < len(made) or (kind == "hdf5" and len(set(map(item_name, names))) < len(names)):
        raise ConfigurationError(f"{source}: has several records of one name; export them one by one")
    for path in [output] if kind == "hdf5" else made:
        if path.exists():
            place = "name" if kind == "hdf5" else "folder"
            raise ConfigurationError(f"{path}: exists already and is not overwritten; choose another {place}")
    folder = source if source.is_dir() else source.parent
    runs = [
        read_table_decay(folder, results, name)
        if isinstance(results, TableDecay)
        else read_run(path, results)
        for name, path, results in found
    ]
    for run in runs:
        for note in run.notes:
            say(f"{run.name}: {note}" if source.is_dir() else note)
    fitted = [(run, results) for run, (_, _, results) in zip(runs, found, strict=True) if results]
    together = None if series is None else exported_series(source, series, fitted)
    try:
        if kind == "hdf5":
            output.parent.mkdir(parents=True, exist_ok=True)
            write_nexus(output, runs, together)
            return [output]
        output.mkdir(parents=True, exist_ok=True)
        write = write_csv if kind == "csv" else write_parquet
        everything = runs if together is None else [*runs, together]
        return [path for run in everything for path in write(output, run)]
    except OSError as error:
        raise RecordError(f"{output}: cannot be written: {error.strerror or error}") from None


def _export_latex(source: Path, output: Path) -> list[Path]:
    """The tables of the report, a file each."""
    made = []
    tables = latex_tables(source)
    if not tables:
        raise RecordError(f"{source}: its results have no tables; rig fit makes some where a run is fitted")
    for name, text in tables.items():
        path = output / name
        try:
            output.mkdir(parents=True, exist_ok=True)
            write_new(path, text.encode())
        except FileExistsError:
            raise ConfigurationError(
                f"{path}: exists already and is not overwritten; choose another folder"
            ) from None
        except OSError as error:
            raise RecordError(f"{path}: cannot be written: {error.strerror or error}") from None
        made.append(path)
    return made

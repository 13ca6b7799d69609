"""`rig export`: writes spots, half-cycles and results, each file with its provenance."""

import json
from collections.abc import Callable, Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Final, Literal, get_type_hints

from acquisition.atomic_write import being_written, write_new
from processing.errors import ConfigurationError, MissingPackage, RecordError
from rig.analysis import ResultRow
from rig.presentation import harmless_text, say, written
from rig.report.nexus import item_name, write_nexus
from rig.report.run import (
    SERIES_NAME,
    ExportData,
    exported_series,
    read_run,
    read_table_decay,
    runs_in,
)
from rig.report.session_report import latex_tables

try:
    import pyarrow as pa
    from pyarrow import csv, parquet
except ImportError:
    raise MissingPackage("rig export", "pyarrow", "data") from None

Format = Literal["csv", "parquet", "hdf5", "latex"]


def export_session(source: Path, kind: Format, output: Path) -> list[Path]:
    """Export a session's folder, that of a table's results, or one record; returns the files made.

    Missing data of a record are noted on stderr and in every file. CSV and Parquet: `output` is a folder with
    three files for each run and one for the series. HDF5: `output` is the file, with one NXentry for each run
    and one for the series. LaTeX: a folder with the tables of the report. No file is overwritten.

    Raises RecordError for a source without records, ConfigurationError for a file that exists.
    """
    if kind == "latex":
        return _export_latex(source, output)
    found, series = runs_in(source)
    suffix = "csv" if kind == "csv" else "parquet"
    names = [name for name, _, _ in found]
    paths = [table_path(output, name, what, suffix) for name in names for what in TABLES]
    if series is not None:
        names.append(SERIES_NAME)
        paths.append(table_path(output, SERIES_NAME, "table", suffix))
    if len(set(paths)) < len(paths) or (kind == "hdf5" and len(set(map(item_name, names))) < len(names)):
        raise ConfigurationError(f"{source}: has several records of one name; export them one by one")
    for path in [output] if kind == "hdf5" else paths:
        if path.exists():
            place = "name" if kind == "hdf5" else "folder"
            raise ConfigurationError(f"{path}: exists already and is not overwritten; choose another {place}")
    folder = source if source.is_dir() else source.parent
    runs = [
        read_table_decay(folder, results, name)
        if results is not None and results.decay is not None
        else read_run(path, results)
        for name, path, results in found
    ]
    for run in runs:
        for note in run.notes:
            say(f"{run.name}: {note}" if source.is_dir() else note)
    fitted = [(run, results) for run, (_, _, results) in zip(runs, found, strict=True) if results]
    series_data = None if series is None else exported_series(source, series, fitted)
    with written(output, "name" if kind == "hdf5" else "folder"):
        if kind == "hdf5":
            output.parent.mkdir(parents=True, exist_ok=True)
            write_nexus(output, runs, series_data)
            return [output]
        output.mkdir(parents=True, exist_ok=True)
        write = write_csv if kind == "csv" else write_parquet
        everything = runs if series_data is None else [*runs, series_data]
        return [path for run in everything for path in write(output, run)]


def _export_latex(source: Path, output: Path) -> list[Path]:
    """Write the tables of the report, each into its own file."""
    paths = []
    tables = latex_tables(source)
    if not tables:
        raise RecordError(f"{source}: its results have no tables; rig fit makes some where a run is fitted")
    for name, text in tables.items():
        path = output / name
        with written(path):
            output.mkdir(parents=True, exist_ok=True)
            write_new(path, text.encode())
        paths.append(path)
    return paths


TABLES = ("spots", "swings", "table")


def write_csv(folder: Path, run: ExportData) -> list[Path]:
    """Write CSV files; lines that begin with ``#`` contain the provenance, followed by one header line.

    Notes on missing data of the record come first.
    """
    lines = [
        *(f"NOTE: {note}" for note in run.notes),
        *(f"{n}: {text}" for n, text in run.provenance.items()),
    ]
    head = "".join(f"# {' '.join(line.split())}\n" for line in lines)
    paths = []
    for path, table in _tables(folder, run, "csv", harmless_text):
        with being_written(path) as beside, beside.open("xb") as file:
            file.write(head.encode())
            csv.write_csv(table, file)
            file.flush()
        paths.append(path)
    return paths


def write_parquet(folder: Path, run: ExportData) -> list[Path]:
    """Write Parquet files; metadata of schema and fields hold provenance, notes (JSON) and units."""
    metadata = {
        b"provenance": json.dumps(dict(run.provenance)).encode(),
        b"notes": json.dumps(list(run.notes)).encode(),
    }
    paths = []
    for path, table in _tables(folder, run, "parquet", str):
        with being_written(path) as beside:
            parquet.write_table(
                table.replace_schema_metadata(metadata), beside, compression="zstd", write_page_checksum=True
            )
        paths.append(path)
    return paths


def _tables(
    folder: Path, run: ExportData, suffix: str, text_of: Callable[[str], str]
) -> Iterator[tuple[Path, pa.Table]]:
    for name, columns in run.columns.items():
        fields = [
            pa.field(key, pa.from_numpy_dtype(values.dtype), metadata={"unit": run.unit_of(key)})
            for key, values in columns.items()
        ]
        table = pa.table(list(columns.values()), schema=pa.schema(fields))
        yield table_path(folder, run.name, name, suffix), table
    if run.rows:
        rows = [
            {key: text_of(cell) if isinstance(cell, str) else cell for key, cell in asdict(row).items()}
            for row in run.rows
        ]
        yield table_path(folder, run.name, "table", suffix), pa.Table.from_pylist(rows, schema=_ROWS)


_ROWS: Final = pa.schema(
    [
        (name, {float: pa.float64(), bool: pa.bool_()}.get(hint, pa.string()))
        for name, hint in get_type_hints(ResultRow).items()
    ]
)


def table_path(folder: Path, run: str, what: str, suffix: str) -> Path:
    """The file of one of `TABLES` of a run."""
    return folder / f"{run}-{what}.{suffix}"

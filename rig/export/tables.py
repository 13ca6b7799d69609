"""Writes CSV and Parquet files: spots, swings and results of each run, and the results of the series."""

import json
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, Final, get_type_hints

import pyarrow as pa
from pyarrow import csv, parquet

from acquisition.atomic_write import being_written
from rig.analysis import ResultRow
from rig.export.run import ExportedResults, ExportedRun, columns_of, flat_results
from rig.presentation import harmless_line, harmless_text

TABLES = ("spots", "swings", "results", "table")


def write_csv(folder: Path, run: ExportedResults) -> list[Path]:
    """Write CSV files; lines that begin with ``#`` contain the provenance, followed by one header line.

    What the record lacks comes first.
    """
    lines = [
        *(f"NOTE: {note}" for note in run.notes),
        *(f"{n}: {text}" for n, text in run.provenance.items()),
    ]
    head = "".join(f"# {harmless_line(' '.join(line.split()))}\n" for line in lines)
    made = []
    for path, table in _tables(folder, run, "csv", harmless_text):
        with being_written(path) as beside, beside.open("xb") as file:
            file.write(head.encode())
            csv.write_csv(table, file)
            file.flush()
        made.append(path)
    return made


def write_parquet(folder: Path, run: ExportedResults) -> list[Path]:
    """Write Parquet files; provenance (JSON), notes on what the record lacks (JSON) and units are in the
    metadata of schema and fields.
    """
    metadata = {
        b"provenance": json.dumps(dict(run.provenance)).encode(),
        b"notes": json.dumps(list(run.notes)).encode(),
    }
    made = []
    for path, table in _tables(folder, run, "parquet", str):
        with being_written(path) as beside:
            parquet.write_table(
                table.replace_schema_metadata(metadata), beside, compression="zstd", write_page_checksum=True
            )
        made.append(path)
    return made


def _tables(
    folder: Path, run: ExportedResults, suffix: str, text_of: Callable[[str], str]
) -> Iterator[tuple[Path, pa.Table]]:
    if isinstance(run, ExportedRun):
        for name, columns in (("spots", columns_of(run.spots)), ("swings", columns_of(run.swings))):
            fields = [
                pa.field(key, pa.from_numpy_dtype(values.dtype), metadata={"unit": run.unit_of(key)})
                for key, values in columns.items()
            ]
            yield (
                table_path(folder, run.name, name, suffix),
                pa.table(list(columns.values()), schema=pa.schema(fields)),
            )
    if run.results:
        rows = flat_results(run.results)
        yield (
            table_path(folder, run.name, "results", suffix),
            pa.table(
                {
                    "name": [text_of(name) for name, _ in rows],
                    "value": pa.array([v if isinstance(v, float) else None for _, v in rows], pa.float64()),
                    "text": [text_of(v) if isinstance(v, str) else "" for _, v in rows],
                    "unit": [text_of(_unit(name, run.units)) for name, _ in rows],
                }
            ),
        )
        # a list of rows, each an object of the same keys
        listed: Any = run.results.get("table", [])
        named = [
            {key: text_of(cell) if isinstance(cell, str) else cell for key, cell in row.items()}
            for row in listed
        ]
        if named:
            yield table_path(folder, run.name, "table", suffix), pa.Table.from_pylist(named, schema=_ROWS)


_ROWS: Final = pa.schema(
    [
        (name, {float: pa.float64(), bool: pa.bool_()}.get(hint, pa.string()))
        for name, hint in get_type_hints(ResultRow).items()
    ]
)


def table_path(folder: Path, run: str, what: str, suffix: str) -> Path:
    """The file of one of `TABLES` of a run."""
    return folder / f"{run}-{what}.{suffix}"


def _unit(name: str, units: Mapping[str, str]) -> str:
    """Of a number, or of the list in which it stands."""
    return units.get(name) or units.get(name.rpartition(".")[0], "")

"""`rig export`: spots, half-cycles and results as CSV, Parquet, NeXus (HDF5) or LaTeX, with provenance."""

import io
import json
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, Literal, get_type_hints

from acquisition.atomic_write import being_written, write_new
from processing.errors import ConfigurationError, MissingPackage, RecordError
from processing.units import in_ascii
from rig.analysis import ResultRow
from rig.report.exported_data import ExportData, exported_data
from rig.report.session_report import latex_tables
from rig.terminal import harmless_text, say, written

Format = Literal["csv", "parquet", "hdf5", "latex"]


def export_session(source: Path, kind: Format, output: Path) -> list[Path]:
    """Export a session's folder, that of a table's results, or one record; returns the files made.

    Missing data of a record are noted on stderr and in every file. CSV and Parquet: `output` is a folder with
    three files for each run and one for the series. HDF5: `output` is the file, with one NXentry for each run
    and one for the series. LaTeX: a folder with the tables of the report. No file is overwritten.

    Raises RecordError for a source without records, ConfigurationError for a file that exists, or if pyarrow
    or h5py is not installed.
    """
    if kind == "latex":
        made: Mapping[Path, bytes] = {output / n: text.encode() for n, text in latex_tables(source).items()}
        if not made:
            raise RecordError(
                f"{source}: its results have no tables; rig fit makes some where a run is fitted"
            )
        for path, content in made.items():
            with written(path):
                output.mkdir(parents=True, exist_ok=True)
                write_new(path, content)
        return list(made)
    exported = exported_data(source)
    if len({_item_name(one.name) if kind == "hdf5" else one.name for one in exported}) < len(exported):
        raise ConfigurationError(f"{source}: has several records of one name; export them one by one")
    tables = [output / f"{one.name}-{name}.{kind}" for one in exported for name in (*one.columns, "table")]
    other = "name" if kind == "hdf5" else "folder"
    for path in [output] if kind == "hdf5" else tables:
        if path.exists():
            raise ConfigurationError(f"{path}: exists already and is not overwritten; choose another {other}")
    for one in exported:
        for note in one.notes if one.columns else ():
            say(f"{one.name}: {note}" if source.is_dir() else note)
    with written(output, other):
        if kind == "hdf5":
            output.parent.mkdir(parents=True, exist_ok=True)
            _write_nexus(output, exported)
            return [output]
        output.mkdir(parents=True, exist_ok=True)
        return [path for one in exported for path in _write_tables(output, one, kind)]


def _write_tables(folder: Path, run: ExportData, kind: Literal["csv", "parquet"]) -> Iterator[Path]:
    """Write the tables of a run or a series; yields their files.

    Of CSV, lines that begin with ``#`` contain the provenance after notes on missing data, followed by one
    header line. Of Parquet, metadata of schema and fields hold provenance, notes (JSON) and units.
    """
    try:
        from pyarrow import csv, parquet
    except ImportError:
        raise MissingPackage("rig export", "pyarrow", "data") from None
    lines = [
        *(f"NOTE: {note}" for note in run.notes),
        *(f"{n}: {text}" for n, text in run.provenance.items()),
    ]
    head = "".join(f"# {' '.join(line.split())}\n" for line in lines).encode()
    metadata = {
        b"provenance": json.dumps(dict(run.provenance)).encode(),
        b"notes": json.dumps(list(run.notes)).encode(),
    }
    for name, table in _tables(run, harmless_text if kind == "csv" else str):
        path = folder / f"{run.name}-{name}.{kind}"
        with being_written(path) as beside:
            if kind == "csv":
                with beside.open("xb") as file:
                    file.write(head)
                    csv.write_csv(table, file)
            else:
                parquet.write_table(
                    table.replace_schema_metadata(metadata),
                    beside,
                    compression="zstd",
                    write_page_checksum=True,
                )
        yield path


def _tables(run: ExportData, text_of: Callable[[str], str]) -> Iterator[tuple[str, Any]]:
    """The columns of a run as Arrow tables, and its table of results; `text_of` is applied to its texts."""
    import pyarrow as pa

    for name, columns in run.columns.items():
        fields = [
            pa.field(key, pa.from_numpy_dtype(values.dtype), metadata={"unit": run.unit_of(key)})
            for key, values in columns.items()
        ]
        yield name, pa.table(list(columns.values()), schema=pa.schema(fields))
    if run.rows:
        types = {float: pa.float64(), bool: pa.bool_()}
        schema = [(name, types.get(hint, pa.string())) for name, hint in get_type_hints(ResultRow).items()]
        rows = [
            {key: text_of(cell) if isinstance(cell, str) else cell for key, cell in asdict(row).items()}
            for row in run.rows
        ]
        yield "table", pa.Table.from_pylist(rows, schema=pa.schema(schema))


_NEXUS_UNITS = {"px": "pixel", "DN": "count", "1": "", "°C": "degC", "%": "percent"}


def _write_nexus(path: Path, exported: Sequence[ExportData]) -> None:
    """Write one file with ``/run_1/{spots,swings,results,provenance}`` and ``/series/{results,provenance}``.

    Field names are the record's. Standard uncertainties ``u_NAME`` are also stored as ``NAME_errors``, which
    NeXus readers expect. Characters that NeXus does not allow in a name become ``_``. Notes on missing data
    of the record are in ``/run_1/lacking``.

    Raises ConfigurationError if h5py is not installed.
    """
    try:
        import h5py
    except ImportError:
        raise MissingPackage("--format hdf5", "h5py", "data") from None
    # made in memory, where it is small beside the runs' arrays: on a full disk HDF5 reports an error for
    # every object that it closes, and may end the process
    image = io.BytesIO()
    with h5py.File(image, "w") as file:
        file.attrs["NX_class"] = "NXroot"
        file.attrs["default"] = _item_name(exported[0].name)
        for one in exported:
            _entry(file, one)
    write_new(path, image.getvalue())


def _item_name(text: str) -> str:
    """A name as NeXus allows it: letters, digits and underscores."""
    return re.sub(r"[^A-Za-z0-9_]", "_", text) or "_"


def _entry(file: Any, run: ExportData) -> None:
    """Write an NXentry with results and provenance of a run or a series, and the columns of a run."""
    about = run.provenance
    entry = _group(file, _item_name(run.name), "NXentry")
    entry["title"] = about.get("session.sample", run.name)
    entry["entry_identifier"] = about["sha256"]
    entry["program_name"] = "optical-pendulum-rig"
    entry["program_name"].attrs["version"] = about.get("versions.optical-pendulum-rig", "")
    note = _group(entry, "provenance", "NXnote")
    note["type"] = "application/json"
    note["description"] = json.dumps(dict(about))
    if run.notes:
        lacking = _group(entry, "lacking", "NXnote")
        lacking["type"] = "text/plain"
        lacking["description"] = "\n".join(run.notes)
    if run.results:
        results = _group(entry, "results", "NXcollection")
        results["json"] = json.dumps(run.results)
        _rows(_group(results, "values", "NXcollection"), run.rows)
    if run.columns:
        entry.attrs["default"] = "swings"
        entry["start_time"], entry["end_time"] = run.began, run.ended
        _describe_rig(entry, about)
        _data(entry, "spots", ("y_rad", "y_deflection_px", "position_1"), run)
        _data(entry, "swings", ("amplitude",), run)


def _describe_rig(entry: Any, about: Mapping[str, str]) -> None:
    """Write instrument, detector, sample and user, as far as the record names them."""
    instrument = _group(entry, "instrument", "NXinstrument")
    instrument["name"] = "optical pendulum"
    detector = _group(instrument, "detector", "NXdetector")
    named = [about[f"camera.{key}"] for key in ("vendor", "model") if f"camera.{key}" in about]
    detector["description"] = " ".join(named) or "camera"
    if "camera.serial" in about:
        detector["serial_number"] = about["camera.serial"]
    sample = _group(entry, "sample", "NXsample")
    sample["name"] = about.get("session.sample", "not stated")
    if "session.contact_history" in about:
        sample["description"] = about["session.contact_history"]
    if "environment.temperature_c" in about:
        sample["temperature"] = float(about["environment.temperature_c"])
        sample["temperature"].attrs["units"] = "degC"
    _group(entry, "user", "NXuser")["name"] = about.get("session.operator", "not stated")


def _group(above: Any, name: str, nexus_class: str) -> Any:
    group = above.create_group(name)
    group.attrs["NX_class"] = nexus_class
    return group


def _data(entry: Any, name: str, signals: tuple[str, ...], run: ExportData) -> None:
    """Write columns as NXdata; the signal is the first that begins like one of `signals`, the axis time."""
    group, columns = _group(entry, name, "NXdata"), run.columns[name]
    signal = next((key for begin in signals for key in columns if key.startswith(begin)), "")
    axis = next((key for key in ("time_ns", "turn_time_ns", "time_s") if key in columns), "")
    if signal and axis:
        group.attrs["signal"] = signal
        group.attrs["axes"] = [axis]
        group.attrs[f"{axis}_indices"] = [0]
    for key, values in columns.items():
        field = group.create_dataset(key, data=values, compression="gzip", shuffle=True)
        _with_unit(field, run.unit_of(key))
    for key in columns:
        if key.startswith("u_") and key[2:] in columns:
            group[f"{key[2:]}_errors"] = group[key]


def _rows(group: Any, rows: Sequence[ResultRow]) -> None:
    """Write the table of results: a group for each fit, with fields for every quantity."""
    for row in rows:
        fit = _item_name(row.fit)
        fit_group = group[fit] if fit in group else _group(group, fit, "NXcollection")
        name = _item_name(row.quantity)
        numbers = {"": row.value, "_errors": row.u_total, "_lower_95": row.lower, "_upper_95": row.upper}
        for suffix, number in numbers.items():
            fit_group[f"{name}{suffix}"] = number
            _with_unit(fit_group[f"{name}{suffix}"], row.unit)
        fit_group[name].attrs["verdict"] = row.verdict.value


def _with_unit(field: Any, unit: str) -> None:
    if unit:
        field.attrs["units"] = _NEXUS_UNITS.get(unit, in_ascii(unit))

"""`rig export`: spots, half-cycles and results as CSV, Parquet, NeXus (HDF5) or LaTeX, with provenance."""

import io
import json
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Literal, get_type_hints

import numpy as np
from numpy.typing import NDArray

from acquisition.atomic_write import atomic_file, write_new
from acquisition.record.digest import cached_sha256, sha256_of, utc
from acquisition.record.reader import RecordReader
from acquisition.record.topics import HALF_CYCLE, SPOT
from processing.deflections import DeflectionUnit
from processing.errors import ConfigurationError, RecordError, optional_module
from processing.units import NS_PER_S, conversion, in_ascii, unit_of_name
from rig.analysis import (
    RESULTS_NAME,
    ResultRow,
    RunResults,
    Series,
    SessionResults,
    TableDecay,
    encoded,
    read_results,
    results_path,
)
from rig.instrument import CONFIGURATION_NAME
from rig.intake import read_positions
from rig.report.tables import run_tables, series_tables
from rig.terminal import Table, harmless_text, latex_table, say, translated_file_errors


@dataclass(frozen=True)
class ExportData:
    """The data exported of a run or a series."""

    name: str
    results: RunResults | Series | None
    """The part of results.json on the run or series; None if the run was not fitted."""
    provenance: Mapping[str, str]
    """Texts by name: hash, complete configuration and metadata of the record."""
    notes: tuple[str, ...] = ()
    """What is missing in the records: truncated or damaged parts."""
    columns: Mapping[str, Mapping[str, NDArray[Any]]] = field(default_factory=dict)
    """Columns of `spots` and `half_cycles` of a run, by the record's names of fields."""
    began: str = ""
    ended: str = ""
    """UTC of the first and the last frame, as ISO 8601."""
    own_units: Mapping[str, str] = field(default_factory=dict)
    """Units of the columns whose names do not end in them."""

    def unit_of(self, column: str) -> str:
        """Unit of a column of `spots` or `half_cycles`."""
        return self.own_units.get(column) or unit_of_name(column)


def _exported_data(source: Path) -> list[ExportData]:
    """The runs in a folder, a results file or a record, and after them their series, if they make one."""
    if not source.is_dir() and source.suffix != ".json":
        # results of a record are those next to it, if any
        runs = read_results(source.parent).runs if results_path(source.parent).exists() else ()
        return [_read_run(source, next((run for run in runs if run.record == source.name), None))]
    folder, results = source if source.is_dir() else source.parent, read_results(source)
    exported = []
    for number, run in enumerate(results.runs, start=1):
        if run.decay is None:
            exported.append(_read_run(folder / run.record, run))
        else:
            suffix = "" if len(results.runs) == 1 else f"-decay-{number}"
            exported.append(_read_table_decay(folder, run, run.decay, f"{run.source_name}{suffix}"))
    series = results.series
    if series is not None:
        exported.append(_exported_series(source, series, list(zip(exported, results.runs, strict=True))))
    return exported


def _read_run(path: Path, results: RunResults | None) -> ExportData:
    with RecordReader(path) as reader:
        provenance = {"record": path.name, "deflection_unit": reader.deflection_unit}
        for section, texts in reader.metadata.items():
            provenance |= {f"{section}.{key}": text for key, text in texts.items() if text}
        configuration = reader.attachments.get(CONFIGURATION_NAME)
        if configuration is not None:
            provenance["configuration"] = json.dumps(json.loads(configuration))
        spots, half_cycles = reader.table(SPOT.topic), reader.table(HALF_CYCLE.topic)
        span_ns = reader.numbers.start_ns, reader.numbers.end_ns
        if len(spots):
            first_ns, last_ns = spots["time_ns"][[0, -1]].tolist()
            span_ns = first_ns + reader.epoch_offset_ns, last_ns + reader.epoch_offset_ns
        began, ended = (utc(time_ns).isoformat() for time_ns in span_ns)
        notes = tuple(reader.doubts())
        has_damage = CONFIGURATION_NAME in reader.numbers.attachments or reader.numbers.damages
        if configuration is None and has_damage:
            notes = (*notes, "the configuration is damaged and not part of this export")
    provenance["sha256"] = cached_sha256(path)
    if results is not None and results.sha256 != provenance["sha256"]:
        raise RecordError(
            f"{path}: differs from the record from which {RESULTS_NAME} was made (other hash); "
            "run rig fit again"
        )
    columns = {"spots": _fields(spots), "swings": _fields(half_cycles)}
    return ExportData(path.stem, results, provenance, notes, columns, began, ended)


def _fields(table: NDArray[Any]) -> dict[str, NDArray[Any]]:
    """The fields of a structured array as contiguous arrays."""
    return {name: np.ascontiguousarray(table[name]) for name in table.dtype.names or ()}


def _exported_series(
    source: Path, series: Series, runs: Sequence[tuple[ExportData, RunResults]]
) -> ExportData:
    """The series of a results file, with the hashes of the file and, in order, of the combined records."""
    runs = series.combined(runs)
    path = results_path(source)
    provenance = {"results": path.name, "sha256": sha256_of(path)}
    samples = {run.provenance.get("session.sample", "") for run, _ in runs}
    if len(samples) == 1 and (sample := samples.pop()):
        provenance["session.sample"] = sample
    for index, (_, run_results) in enumerate(runs):
        provenance[f"runs.{index}"] = f"{run_results.record}, SHA-256 {run_results.sha256}"
    if simulated := sum(bool(run_results.simulated) for _, run_results in runs):
        provenance["simulated"] = f"SIMULATED: {simulated} of {len(runs)} runs"
    notes = tuple(f"{run.name}: {note}" for run, _ in runs for note in run.notes)
    return ExportData("series", series, provenance, notes)


def _read_table_decay(folder: Path, decay: RunResults, table_decay: TableDecay, name: str) -> ExportData:
    """A decay of a table by the results in a folder; angles in rad, other positions in the table's unit."""
    stored = decay.stored
    table_unit = decay.amplitude_unit or "unit"
    is_angle = stored.unit is DeflectionUnit.RAD
    unit, size = ("rad", conversion(table_unit, "rad")) if is_angle else (table_unit, 1.0)
    time_s, positions = read_positions(folder)
    is_inside = (time_s >= table_decay.began_s) & (time_s <= table_decay.ended_s)
    suffix = re.sub(r"\W", "_", unit)
    spots: dict[str, NDArray[Any]] = {"time_s": time_s[is_inside]}
    for number, position in enumerate(positions, start=1):
        spots[f"position_{number}_{suffix}"] = position[is_inside] * size
    provenance = {"table": decay.record, "sha256": decay.sha256, "unit of the table": table_unit}
    provenance |= {f"session.{name}": text for name, text in table_decay.session.items()}
    air = {} if decay.ambient is None else decay.ambient.known()
    provenance |= {f"environment.{name}": f"{value:g}" for name, value in air.items()}
    half_cycles: dict[str, NDArray[Any]] = {
        "index": stored.index,
        "time_s": stored.first_ns / NS_PER_S + stored.time_s,
        "u_time_s": stored.u_time_s,
        f"amplitude_{suffix}": stored.amplitude,
        f"u_amplitude_{suffix}": stored.u_amplitude,
    }
    units = {key: unit for key in (*spots, *half_cycles) if key.endswith(f"_{suffix}")}
    columns = {"spots": spots, "swings": half_cycles}
    return ExportData(name, decay, provenance, columns=columns, own_units=units)


Format = Literal["csv", "parquet", "hdf5", "latex"]


def export_session(source: Path, kind: Format, output: Path) -> list[Path]:
    """Export a session's folder, that of a table's results, or one record; returns the files made.

    Missing data of a record are noted on stderr and in every file but LaTeX's. CSV and Parquet: `output` is a
    folder with up to three files for each run (spots, half-cycles, fit) and one for the series. HDF5:
    `output` is the file, with one NXentry for each run and one for the series. LaTeX: a folder with the
    tables of the report. No file is overwritten.

    Raises RecordError for a source without records, ConfigurationError for a file that exists, or if pyarrow
    or h5py is not installed.
    """
    if kind == "latex":
        texts = {output / name: text for name, text in latex_tables(source).items()}
        if not texts:
            raise RecordError(f"{source}: no run of it has a decay, and so there is no table to export")
        for path, text in texts.items():
            with translated_file_errors(path):
                output.mkdir(parents=True, exist_ok=True)
                write_new(path, text.encode())
        return list(texts)
    exported = _exported_data(source)
    if len({_item_name(data.name) if kind == "hdf5" else data.name for data in exported}) < len(exported):
        raise ConfigurationError(f"{source}: has several records of one name; export them one by one")
    for data in exported:
        for note in data.notes if data.columns else ():
            say(f"{data.name}: {note}" if source.is_dir() else note)
    with translated_file_errors(output, "name" if kind == "hdf5" else "folder"):
        if kind == "hdf5":
            output.parent.mkdir(parents=True, exist_ok=True)
            _write_nexus(output, exported)
            return [output]
        output.mkdir(parents=True, exist_ok=True)
        return [path for data in exported for path in _write_tables(output, data, kind)]


def latex_tables(folder: Path) -> Mapping[str, str]:
    """LaTeX of every table of the report and of the series, by file name (`run-1-parameters.tex`)."""
    results, tables = read_results(folder), dict[str, Table]()
    for number, run in enumerate(results.runs, start=1):
        tables |= {f"run-{number}-{table.name}.tex": table for table in run_tables(run)}
    if results.series is not None:
        tables |= {f"{table.name}.tex": table for table in series_tables(results.series)}
    return {name: latex_table(table, Path(name).stem) for name, table in tables.items() if table.shown}


def _write_tables(folder: Path, run: ExportData, kind: Literal["csv", "parquet"]) -> Iterator[Path]:
    """Write the tables of a run or a series, with notes and provenance in each; yields their files."""
    optional_module("pyarrow", "rig export", "pyarrow", "data")
    from pyarrow import csv, parquet

    notes = [f"NOTE: {note}" for note in run.notes]
    lines = [*notes, *(f"{name}: {text}" for name, text in run.provenance.items())]
    metadata = {"provenance": json.dumps(dict(run.provenance)), "notes": json.dumps(list(run.notes))}
    for name, table in _tables(run, harmless_text if kind == "csv" else str):
        path = folder / f"{run.name}-{name}.{kind}"
        with atomic_file(path) as temporary:
            if kind == "csv":
                with temporary.open("xb") as file:
                    file.write("".join(f"# {' '.join(line.split())}\n" for line in lines).encode())
                    csv.write_csv(table, file)
            else:
                table = table.replace_schema_metadata(metadata)
                parquet.write_table(table, temporary, compression="zstd", write_page_checksum=True)
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
    if run.results is not None and run.results.table:
        types = {float: pa.float64(), bool: pa.bool_()}
        schema = [(name, types.get(hint, pa.string())) for name, hint in get_type_hints(ResultRow).items()]
        rows = [
            {key: text_of(cell) if isinstance(cell, str) else cell for key, cell in asdict(row).items()}
            for row in run.results.table
        ]
        yield "table", pa.Table.from_pylist(rows, schema=pa.schema(schema))


_NEXUS_UNITS = {"px": "pixel", "DN": "count", "1": "", "°C": "degC", "%": "percent"}


def _write_nexus(path: Path, exported: Sequence[ExportData]) -> None:
    """Write one file with ``/run_1/{spots,swings,results,provenance}`` and ``/series/{results, ...}``."""
    h5py = optional_module("h5py", "--format hdf5", "h5py", "data")
    # made in memory, because on a full disk HDF5 reports an error for every object that it closes, and may
    # end the process
    file_buffer = io.BytesIO()
    with h5py.File(file_buffer, "w") as file:
        file.attrs["NX_class"] = "NXroot"
        file.attrs["default"] = _item_name(exported[0].name)
        for data in exported:
            _write_entry(file, data)
    write_new(path, file_buffer.getvalue())


def _item_name(text: str) -> str:
    """A name as NeXus allows it: letters, digits and underscores."""
    return re.sub(r"[^A-Za-z0-9_]", "_", text) or "_"


def _write_entry(file: Any, run: ExportData) -> None:
    """Write an NXentry with results and provenance of a run or a series, and the columns of a run."""
    provenance = run.provenance
    entry = _group(file, _item_name(run.name), "NXentry")
    entry["title"] = provenance.get("session.sample", run.name)
    entry["entry_identifier"] = provenance["sha256"]
    entry["program_name"] = "optical-pendulum-rig"
    entry["program_name"].attrs["version"] = provenance.get("versions.optical-pendulum-rig", "")
    note = _group(entry, "provenance", "NXnote")
    note["type"] = "application/json"
    note["description"] = json.dumps(dict(provenance))
    if run.notes:
        lacking = _group(entry, "lacking", "NXnote")
        lacking["type"] = "text/plain"
        lacking["description"] = "\n".join(run.notes)
    if run.results is not None:
        results = _group(entry, "results", "NXcollection")
        if isinstance(run.results, RunResults):
            results["json"] = json.dumps(encoded(run.results))
        else:
            results["json"] = json.dumps(encoded(SessionResults(runs=(), series=run.results))["series"])
        _write_rows(_group(results, "values", "NXcollection"), run.results.table)
    if run.columns:
        entry.attrs["default"] = "swings"
        entry["start_time"], entry["end_time"] = run.began, run.ended
        _write_rig(entry, provenance)
        _write_columns(entry, "spots", ("y_rad", "y_deflection_px", "position_1"), run)
        _write_columns(entry, "swings", ("amplitude",), run)


def _write_rig(entry: Any, provenance: Mapping[str, str]) -> None:
    """Write instrument, detector, sample and user, as far as the record names them."""
    instrument = _group(entry, "instrument", "NXinstrument")
    instrument["name"] = "optical pendulum"
    detector = _group(instrument, "detector", "NXdetector")
    names = [provenance[f"camera.{key}"] for key in ("vendor", "model") if f"camera.{key}" in provenance]
    detector["description"] = " ".join(names) or "camera"
    if "camera.serial" in provenance:
        detector["serial_number"] = provenance["camera.serial"]
    sample = _group(entry, "sample", "NXsample")
    sample["name"] = provenance.get("session.sample", "not stated")
    if "session.contact_history" in provenance:
        sample["description"] = provenance["session.contact_history"]
    if "environment.temperature_c" in provenance:
        sample["temperature"] = float(provenance["environment.temperature_c"])
        _set_unit(sample["temperature"], "°C")
    _group(entry, "user", "NXuser")["name"] = provenance.get("session.operator", "not stated")


def _group(parent: Any, name: str, nexus_class: str) -> Any:
    group = parent.create_group(name)
    group.attrs["NX_class"] = nexus_class
    return group


def _write_columns(entry: Any, name: str, signals: tuple[str, ...], run: ExportData) -> None:
    """Write columns as NXdata; the signal is the first that begins like one of `signals`, the axis time."""
    group, columns = _group(entry, name, "NXdata"), run.columns[name]
    signal = next((key for start in signals for key in columns if key.startswith(start)), "")
    axis = next((key for key in ("time_ns", "turn_time_ns", "time_s") if key in columns), "")
    if signal and axis:
        group.attrs["signal"] = signal
        group.attrs["axes"] = [axis]
        group.attrs[f"{axis}_indices"] = [0]
    for key, values in columns.items():
        field = group.create_dataset(key, data=values, compression="gzip", shuffle=True)
        _set_unit(field, run.unit_of(key))
    # standard uncertainties have a second name, which NeXus readers expect
    for key in columns:
        if key.startswith("u_") and key[2:] in columns:
            group[f"{key[2:]}_errors"] = group[key]


def _write_rows(group: Any, rows: Sequence[ResultRow]) -> None:
    """Write the table of results: a group for each fit, with fields for every quantity."""
    for row in rows:
        fit = _item_name(row.fit)
        fit_group = group[fit] if fit in group else _group(group, fit, "NXcollection")
        name = _item_name(row.quantity)
        numbers = {"": row.value, "_errors": row.u_total, "_lower_95": row.lower, "_upper_95": row.upper}
        for suffix, number in numbers.items():
            fit_group[f"{name}{suffix}"] = number
            _set_unit(fit_group[f"{name}{suffix}"], row.unit)
        fit_group[name].attrs["verdict"] = row.verdict.value


def _set_unit(field: Any, unit: str) -> None:
    if unit:
        field.attrs["units"] = _NEXUS_UNITS.get(unit, in_ascii(unit))

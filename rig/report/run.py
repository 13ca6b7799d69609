"""The data exported of a record, a table or a series: spots, half-cycles, results, with units."""

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from acquisition.record.digest import cached_sha256, sha256_of, utc
from acquisition.record.reader import RecordReader
from acquisition.record.topics import SPOT, SWING
from processing.deflections import DeflectionUnit
from processing.errors import RecordError
from processing.units import NS_PER_S, conversion, unit_of_name
from rig.analysis import (
    RESULTS_NAME,
    JsonObject,
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

SERIES_NAME = "series"


@dataclass(frozen=True)
class ExportData:
    """The data exported of a run or a series."""

    name: str
    rows: Sequence[ResultRow]
    """The table of results."""
    results: JsonObject
    """Its part of results.json; empty if the run was not fitted."""
    provenance: Mapping[str, str]
    """Texts by name: hash, complete configuration and metadata of the record."""
    notes: tuple[str, ...] = ()
    """What is missing in the records: truncated or damaged parts."""
    columns: Mapping[str, Mapping[str, NDArray[Any]]] = field(default_factory=dict)
    """Columns of `spots` and `swings` of a run, by the record's names of fields."""
    began: str = ""
    ended: str = ""
    """UTC of the first and the last frame, as ISO 8601."""
    own_units: Mapping[str, str] = field(default_factory=dict)
    """Units of the columns whose names do not end in them."""

    def unit_of(self, column: str) -> str:
        """Unit of a column of `spots` or `swings`."""
        return self.own_units.get(column) or unit_of_name(column)


def runs_in(source: Path) -> tuple[list[tuple[str, Path, RunResults | None]], Series | None]:
    """Name, record and results of each run in a folder, a results file or a record, and their series.

    Results of a record are those next to it, if any; a record has no series.
    """
    if source.is_dir() or source.suffix == ".json":
        folder, results = source if source.is_dir() else source.parent, read_results(source)
        is_single = len(results.runs) == 1
        return [
            (_name(run, None if is_single else k), folder / run.record, run)
            for k, run in enumerate(results.runs, start=1)
        ], results.series
    found = None
    if (source.parent / RESULTS_NAME).exists():
        runs = read_results(source.parent).runs
        found = next((run for run in runs if run.record == source.name), None)
    return [(source.stem, source, found)], None


def _name(run: RunResults, decay: int | None) -> str:
    if run.decay is None:
        return Path(run.record).stem
    return run.source_name if decay is None else f"{run.source_name}-decay-{decay}"


def read_run(path: Path, results: RunResults | None) -> ExportData:
    """Read a record; raises RecordError if the results were made from another record."""
    with RecordReader(path) as reader:
        provenance = {"record": path.name, "deflection_unit": reader.deflection_unit}
        for section, texts in reader.metadata.items():
            provenance |= {f"{section}.{key}": text for key, text in texts.items() if text}
        configuration = reader.attachments.get(CONFIGURATION_NAME)
        if configuration is not None:
            provenance["configuration"] = json.dumps(json.loads(configuration))
        spots, swings = reader.table(SPOT.topic), reader.table(SWING.topic)
        began, ended = (utc(time_ns).isoformat() for time_ns in _span_ns(reader, spots))
        notes = tuple(reader.doubts())
        held = reader.numbers
        if configuration is None and (CONFIGURATION_NAME in held.attachments or held.damages):
            notes = (*notes, "the configuration is damaged and not part of this export")
    provenance["sha256"] = cached_sha256(path)
    if results is not None and results.sha256 != provenance["sha256"]:
        raise RecordError(
            f"{path}: differs from the record from which {RESULTS_NAME} was made (other hash); "
            "run rig fit again"
        )
    columns = {"spots": _fields(spots), "swings": _fields(swings)}
    rows, tree = ((), {}) if results is None else (results.table, encoded(results))
    return ExportData(path.stem, rows, tree, provenance, notes, columns, began, ended)


def _span_ns(reader: RecordReader, spots: NDArray[Any]) -> tuple[int, int]:
    """UTC of the first and the last frame; without frames of the first and the last message."""
    if not len(spots):
        return reader.numbers.start_ns, reader.numbers.end_ns
    first_ns, last_ns = int(spots["time_ns"][0]), int(spots["time_ns"][-1])
    return first_ns + reader.epoch_offset_ns, last_ns + reader.epoch_offset_ns


def _fields(table: NDArray[Any]) -> dict[str, NDArray[Any]]:
    """The fields of a structured array as contiguous arrays, in order."""
    return {name: np.ascontiguousarray(table[name]) for name in table.dtype.names or ()}


def exported_series(
    source: Path, series: Series, runs: Sequence[tuple[ExportData, RunResults]]
) -> ExportData:
    """The series of a results file, with the hashes of the file and of the combined records.

    Records are in the order of the series' lists of runs.
    """
    runs = series.combined(runs)
    path = results_path(source)
    about = {"results": path.name, "sha256": sha256_of(path)}
    samples = {run.provenance.get("session.sample", "") for run, _ in runs}
    if len(samples) == 1 and (sample := samples.pop()):
        about["session.sample"] = sample
    about |= {f"runs.{place}": f"{one.record}, SHA-256 {one.sha256}" for place, (_, one) in enumerate(runs)}
    simulated = sum(bool(one.simulated) for _, one in runs)
    if simulated:
        about["simulated"] = f"SIMULATED: {simulated} of {len(runs)} runs"
    is_single = SessionResults(runs=(), series=series)
    notes = tuple(f"{run.name}: {note}" for run, _ in runs for note in run.notes)
    tree = cast(JsonObject, encoded(is_single)["series"])
    return ExportData(SERIES_NAME, series.table, tree, about, notes)


def read_table_decay(folder: Path, decay: RunResults, name: str) -> ExportData:
    """A decay of a table by the results in a folder; angles in rad, other positions in the table's unit.

    Raises RecordError if the positions next to the results cannot be read.
    """
    stored, place = decay.stored, decay.decay or TableDecay()
    own = decay.amplitude_unit or "unit"
    is_angle = stored.unit is DeflectionUnit.RAD
    unit, size = ("rad", conversion(own, "rad")) if is_angle else (own, 1.0)
    time_s, positions = read_positions(folder)
    inside = (time_s >= place.began_s) & (time_s <= place.ended_s)
    suffix = re.sub(r"\W", "_", unit)
    spots: dict[str, NDArray[Any]] = {"time_s": time_s[inside]}
    spots |= {f"position_{k}_{suffix}": each[inside] * size for k, each in enumerate(positions, start=1)}
    provenance = {"table": decay.record, "sha256": decay.sha256, "unit of the table": own}
    provenance |= {f"session.{name}": text for name, text in place.session.items()}
    air = {} if decay.surroundings is None else decay.surroundings.known()
    provenance |= {f"environment.{name}": f"{value:g}" for name, value in air.items()}
    swings: dict[str, NDArray[Any]] = {
        "index": stored.index,
        "time_s": stored.first_ns / NS_PER_S + stored.time_s,
        "u_time_s": stored.u_time_s,
        f"amplitude_{suffix}": stored.amplitude,
        f"u_amplitude_{suffix}": stored.u_amplitude,
    }
    units = {key: unit for key in (*spots, *swings) if key.endswith(f"_{suffix}")}
    columns = {"spots": spots, "swings": swings}
    return ExportData(name, decay.table, encoded(decay), provenance, columns=columns, own_units=units)

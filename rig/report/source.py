"""The data of a report: results, and data from the records or tables that they name."""

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from acquisition.camera import Frame
from acquisition.record.digest import RecordedCamera, cached_sha256
from acquisition.record.reader import RecordReader
from processing.arrays import Floats
from processing.deflections import DeflectionUnit
from processing.errors import RecordError, RigError
from processing.instruments import DEGREE_RAD
from processing.units import NS_PER_S, conversion
from rig.analysis import (
    JsonObject,
    RunResults,
    Series,
    SessionResults,
    TableDecay,
    clock_rate_of,
    read_results,
    results_path,
)
from rig.instrument import CONFIGURATION_NAME, recorded_configuration
from rig.intake import along_and_across, read_positions


class DisplayUnit(NamedTuple):
    """The unit in which a report shows deflections."""

    shown: str
    """Name of the unit."""
    shown_size: float
    """Size of the unit in the unit in which deflections are stored."""


@dataclass(frozen=True)
class ReportTrajectory:
    """Deflections x, y of every frame in `unit`, against time; NaN if the spot was lost."""

    time_s: Floats
    x: Floats
    y: Floats
    unit: DisplayUnit


@dataclass(frozen=True)
class RecordedPicture:
    """One whole frame, and centre and width of the spot in it."""

    frame: Frame
    x_px: float
    y_px: float
    sigma_px: float


@dataclass(frozen=True)
class RunData:
    """The data of one run."""

    title: str
    results: RunResults
    motion: ReportTrajectory
    """The motion; its times, like those of the turning points, count from the first of them."""
    picture: RecordedPicture | None
    provenance: Mapping[str, Mapping[str, str]]
    """Texts by section and key."""
    notes: Sequence[str] = ()

    @property
    def is_table(self) -> bool:
        """Whether the run is a decay of a table or a film, without frames and camera."""
        return self.results.decay is not None


@dataclass(frozen=True)
class ReportSource:
    """The data of a session: its runs, and their series if they make one."""

    folder: Path
    results: tuple[str, str]
    """Name and SHA-256 of the results file."""
    series: Series | None
    runs: Sequence[RunData]


_MAX_LISTED_VALUES = 20
"""Longest list in the provenance; of a longer one the length is stated."""
_MARGIN = 0.05
"""Time before and after a decay that is drawn with it, as a fraction of its duration."""


def read_source(source: Path | SessionResults) -> ReportSource:
    """Read results (of a folder, a file or in memory) and their records.

    Results in memory name their records relative to the working directory. Raises RecordError for a folder
    without results, or if a record is missing.
    """
    if isinstance(source, SessionResults):
        results, folder, name = source, Path.cwd(), ("results", "")
    else:
        results, path = read_results(source), results_path(source)
        folder, name = path.parent, (path.name, cached_sha256(path))
    runs = [
        _read_run(folder, run, number) if run.decay is None else _decay_of_table(folder, results, run, number)
        for number, run in zip(results.numbers, results.runs, strict=True)
    ]
    return ReportSource(folder, name, results.series, runs)


def _read_run(folder: Path, results: RunResults, number: int) -> RunData:
    path = folder / results.record
    notes: list[str] = []
    with RecordReader(path) as reader:
        spots = reader.spots()
        picture = _picture(reader, spots, notes)
        deflections = reader.deflections(spots)
        file = {"record": path.name, **_hashes(results)}
        provenance: dict[str, Mapping[str, str]] = {"file": file, **reader.metadata}
        configuration = reader.attachments.get(CONFIGURATION_NAME)
        rate, began_ns = 1.0, int(spots["time_ns"][0]) if len(spots) else 0
        try:
            rate = clock_rate_of(recorded_configuration(reader))
        except RecordError as error:
            notes.append(f"times are the camera's own: {error}")
        if len(spots):
            file["began"] = f"{reader.utc(began_ns):%Y-%m-%d %H:%M:%S} UTC"
        for note in reader.notes():
            since_ns = note.time_ns - began_ns if len(spots) else 0
            notes.append(f"noted at {since_ns * 1e-9 * rate:.1f} s, {note.event.text}")
        notes += [line for line in reader.doubts() if line not in results.warnings]
    if results.sha256 != cached_sha256(path):
        notes.append("the record is not the one that the results were made from: its hash differs")
    if configuration is not None:
        simulated = RecordedCamera.from_metadata(provenance).simulated
        provenance["configuration"] = configuration_texts(json.loads(configuration), simulated=simulated)
    first_ns = results.stored.first_ns or began_ns
    unit = DisplayUnit(deflections.unit.shown, deflections.unit.shown_size)
    if results.instrument is not None and deflections.unit is DeflectionUnit.RAD:
        unit = DisplayUnit("deg", DEGREE_RAD)
    motion = ReportTrajectory(
        (spots["time_ns"] - first_ns) * 1e-9 * rate,
        deflections.x / unit.shown_size,
        deflections.y / unit.shown_size,
        unit,
    )
    if results.calibration:
        provenance["calibration"] = _flat(results.calibration)
    return RunData(f"Run {number}", results, motion, picture, provenance, notes)


def _hashes(run: RunResults) -> dict[str, str]:
    """SHA-256 of the record or table of a run, and of its other inputs, by name."""
    others = {f"sha256 of {name}": sha256 for name, sha256 in run.inputs_sha256.items()}
    return {"sha256": run.sha256, **others}


def _picture(reader: RecordReader, spots: NDArray[Any], notes: list[str]) -> RecordedPicture | None:
    """The first whole frame with a spot in it; None without one, or if it cannot be read."""
    try:
        for frame in reader.images():
            rows = np.nonzero(spots["sequence"] == frame.sequence)[0]
            if len(rows) and math.isfinite(float(spots["x_px"][rows[0]])):
                row = spots[rows[0]]
                sigma = 0.5 * float(row["sigma_x_px"] + row["sigma_y_px"])
                return RecordedPicture(frame, float(row["x_px"]), float(row["y_px"]), sigma)
    except (RigError, ValueError) as error:
        notes.append(f"no frame could be read: {error}")
    return None


def configuration_texts(tree: JsonObject, *, simulated: bool) -> dict[str, str]:
    """A record's configuration as dotted keys; for a real run without keys of the simulated rig."""
    omitted = () if simulated else ("simulation", "faults")
    return _flat({key: value for key, value in tree.items() if key not in omitted})


def _flat(tree: JsonObject, prefix: str = "") -> dict[str, str]:
    """Nested tables as dotted keys, without empty values."""
    texts: dict[str, str] = {}
    for key, value in tree.items():
        name = f"{prefix}{key}"
        if isinstance(value, dict):
            texts |= _flat(value, f"{name}.")
        elif isinstance(value, list) and all(isinstance(item, dict) for item in value):
            for number, item in enumerate(value, start=1):
                texts |= _flat(item, f"{name}.{number}.") if isinstance(item, dict) else {}
        elif isinstance(value, list) and len(value) > _MAX_LISTED_VALUES:
            texts[name] = f"{len(value)} entries"
        elif value is not None and value != "":
            texts[name] = f"{value:.10g}" if isinstance(value, float) else str(value)
    return texts


def _decay_of_table(folder: Path, table: SessionResults, decay: RunResults, number: int) -> RunData:
    """A decay of a table by its results; the motion is empty, with a note, if it cannot be read."""
    table_decay, stored = decay.decay or TableDecay(), decay.stored
    is_angle = stored.unit is DeflectionUnit.RAD
    unit = DisplayUnit(table.unit, conversion(table.unit, "rad") if is_angle else 1.0)
    notes = [*table.understood]
    try:
        motion = _motion(folder, table_decay, stored.first_ns / NS_PER_S, unit)
    except RigError as error:
        notes.append(f"no motion is drawn: {error}")
        motion = ReportTrajectory(np.empty(0), np.empty(0), np.empty(0), unit)
    file = {"table": decay.record, **_hashes(decay)}
    title = f"Decay {number}" if len(table.runs) > 1 else "Decay"
    return RunData(title, decay, motion, None, {"file": file, "session": table_decay.session}, notes)


def _motion(folder: Path, decay: TableDecay, zero_s: float, unit: DisplayUnit) -> ReportTrajectory:
    """The motion of a table: Y along it, X across it, NaN if only one position was measured."""
    time_s, positions = read_positions(folder)
    margin_s = _MARGIN * (decay.ended_s - decay.began_s)
    is_inside = (time_s >= decay.began_s - margin_s) & (time_s <= decay.ended_s + margin_s)
    along, across = along_and_across(positions)
    return ReportTrajectory(time_s[is_inside] - zero_s, across[is_inside], along[is_inside], unit)

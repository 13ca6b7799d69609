"""What a report is made of: results.json as it stands, and the records that it names."""

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from acquisition.frame import Frame
from acquisition.record.digest import sha256_of
from acquisition.record.reader import RecordReader
from processing.angle import ARCSEC_RAD
from processing.deflections import Deflections
from processing.errors import RecordError, RigError
from processing.fit import measured_again
from processing.swing import KnownMotion, Swing, TurningPoints
from rig.analysis.contact_laws import points_in_true_time
from rig.instrument import CONFIGURATION_NAME, recorded_configuration

Array = NDArray[np.float64]
RESULTS_NAME = "results.json"


@dataclass(frozen=True)
class Motion:
    """Deflection of every frame in `unit` (arcsec, or px without calibration); NaN where lost."""

    time_s: Array
    x: Array
    y: Array
    unit: str


@dataclass(frozen=True)
class Picture:
    """One whole frame and the spot that was found in it."""

    frame: Frame
    x_px: float
    y_px: float
    sigma_px: float


@dataclass(frozen=True)
class RunData:
    """One run: its results, its turning points (times from the first of them), its motion.

    `motion` counts time from the first turning point as well. `flagged` are the half-cycles left
    out of the fits, as (time_s, amplitude) in the motion's unit. `provenance` is text by section
    and key.
    """

    title: str
    results: Mapping[str, Any]
    points: TurningPoints
    motion: Motion
    picture: Picture | None
    flagged: Sequence[tuple[float, float]]
    provenance: Mapping[str, Mapping[str, str]]
    notes: Sequence[str] = ()

    @property
    def unit_rad(self) -> float:
        """What an amplitude is divided by for display."""
        return ARCSEC_RAD if self.motion.unit == "arcsec" else 1.0


@dataclass(frozen=True)
class ReportSource:
    """A session: its runs, its series, and the whole results tree."""

    folder: Path
    results: Mapping[str, Any]
    runs: Sequence[RunData]

    @property
    def series(self) -> Mapping[str, Any]:
        found: Mapping[str, Any] = self.results.get("series") or {}
        return found


def results_path(source: Path) -> Path:
    """A results file as it is named, or the latest of a folder: results-2.json comes after results.json."""
    if not source.is_dir():
        return source
    later = [path for path in source.glob("results-*.json") if path.stem.removeprefix("results-").isdecimal()]
    return max(later, key=lambda path: int(path.stem.removeprefix("results-")), default=source / RESULTS_NAME)


def read_results(folder: Path) -> dict[str, Any]:
    """Results of a folder, or a results file. Raises RecordError in one line."""
    path = results_path(folder)
    try:
        tree = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise RecordError(
            f"{folder}: holds no {RESULTS_NAME}; rig run makes one, rig fit makes one from records"
        ) from None
    except (OSError, UnicodeDecodeError, json.JSONDecodeError) as error:
        raise RecordError(f"{path}: cannot be read: {error}") from None
    if not isinstance(tree, dict) or not isinstance(tree.get("runs"), list) or not tree["runs"]:
        raise RecordError(f"{path}: names no runs; it was not made from records of rig run")
    return tree


def read_source(source: Path) -> ReportSource:
    """Results of a folder (or a results file) and the records they were made from.

    Raises RecordError for a folder without results, or with a record that is not there.
    """
    tree = read_results(source)
    folder = source if source.is_dir() else source.parent
    runs = [_read_run(folder, run, number) for number, run in enumerate(tree["runs"], start=1)]
    return ReportSource(folder, tree, runs)


def _read_run(folder: Path, results: Mapping[str, Any], number: int) -> RunData:
    path = folder / str(results.get("record", ""))
    notes: list[str] = []
    with RecordReader(path) as reader:
        spots = reader.spots()
        swings = reader.swings()
        picture = _picture(reader, spots, notes)
        deflections = reader.deflections(spots)
        provenance: dict[str, Mapping[str, str]] = {
            "file": {"record": path.name, "sha256": str(results.get("sha256", ""))},
            **reader.metadata,
        }
        configuration = reader.attachments.get(CONFIGURATION_NAME)
        rate = _clock_rate(reader, notes)
        if reader.truncated:
            notes.append("the record was cut short")
    if sha256_of(path) != results.get("sha256"):
        notes.append("the record is not the one that the results were made from: its hash differs")
    if configuration is not None:
        provenance["configuration"] = _flat(json.loads(configuration))
    unit = deflections.unit
    first_ns = next((s.turn_time_ns for s in swings if s.flags == 0), None)
    if first_ns is None:
        first_ns = int(spots["time_ns"][0]) if len(spots) else 0
    motion = Motion(
        (spots["time_ns"] - first_ns) * 1e-9 * rate,
        deflections.shown_x,
        deflections.shown_y,
        unit.shown,
    )
    flagged = [
        ((s.turn_time_ns - first_ns) * 1e-9 * rate, s.amplitude / unit.shown_size) for s in swings if s.flags
    ]
    points = _points(swings, deflections, rate, results)
    if results.get("calibration"):
        provenance["calibration"] = _flat(results["calibration"])
    return RunData(f"Run {number}", results, points, motion, picture, flagged, provenance, notes)


def _points(
    swings: Sequence[Swing], deflections: Deflections, rate: float, results: Mapping[str, Any]
) -> TurningPoints:
    """The turning points that were fitted; without a fit, as they were detected."""
    motion = results.get("measured_again_on")
    if motion:
        at = deflections
        swings = measured_again(swings, at.times_ns, at.y, at.u_y, KnownMotion(**motion))
    return points_in_true_time(swings, rate)


def _clock_rate(reader: RecordReader, notes: list[str]) -> float:
    """True seconds per second of the camera's clock, with which the fits counted too."""
    try:
        timebase = recorded_configuration(reader).timebase
    except RecordError as error:
        notes.append(f"times are the camera's own: {error}")
        return 1.0
    return 1.0 if timebase is None else timebase.camera_rate


def _picture(reader: RecordReader, spots: NDArray[Any], notes: list[str]) -> Picture | None:
    """The first whole frame with a spot in it; a record without one is reported without one."""
    try:
        for frame in reader.images():
            rows = np.nonzero(spots["sequence"] == frame.sequence)[0]
            if len(rows) and math.isfinite(float(spots["x_px"][rows[0]])):
                row = spots[rows[0]]
                sigma = 0.5 * float(row["sigma_x_px"] + row["sigma_y_px"])
                return Picture(frame, float(row["x_px"]), float(row["y_px"]), sigma)
    except (RigError, ValueError) as error:
        notes.append(f"no frame could be read: {error}")
    return None


def _flat(tree: Mapping[str, Any], above: str = "") -> dict[str, str]:
    """Nested tables as dotted keys, what is not stated left out."""
    found: dict[str, str] = {}
    for key, value in tree.items():
        name = f"{above}{key}"
        if isinstance(value, dict):
            found |= _flat(value, f"{name}.")
        elif isinstance(value, list) and value and isinstance(value[0], dict):
            for place, item in enumerate(value, start=1):
                found |= _flat(item, f"{name}.{place}.")
        elif value is not None and value != "" and value != {}:
            found[name] = f"{value:.10g}" if isinstance(value, float) else str(value)
    return found


def recorded_results(record: Path, sha256: str) -> tuple[str, Mapping[str, Any] | None]:
    """Name of the newest results file beside a record that knows it, and what it says of it, if any."""
    files = sorted(record.parent.glob("results*.json"), key=lambda path: path.stat().st_mtime, reverse=True)
    for path in files:
        try:
            runs = json.loads(path.read_text(encoding="utf-8"))["runs"]
            found: Mapping[str, Any] | None = next((r for r in runs if r.get("sha256") == sha256), None)
        except (OSError, ValueError, KeyError, TypeError, AttributeError):
            continue
        if found is not None:
            return path.name, found
    return "", None

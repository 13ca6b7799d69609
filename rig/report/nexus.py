"""Export to HDF5 in NeXus layout: an NXentry for each run and the series, NXdata with units."""

import io
import json
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from acquisition.atomic_write import write_new
from processing.errors import MissingPackage
from processing.units import in_ascii
from rig.analysis import ResultRow
from rig.report.run import ExportData

_NEXUS_UNITS = {"px": "pixel", "DN": "count", "1": "", "°C": "degC", "%": "percent"}


def write_nexus(path: Path, runs: Sequence[ExportData], series: ExportData | None = None) -> None:
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
        file.attrs["default"] = item_name(runs[0].name)
        for run in runs:
            _entry(file, run)
        if series is not None:
            _entry_with_results(file, series)
    write_new(path, image.getvalue())


def item_name(text: str) -> str:
    """A name as NeXus allows it: letters, digits and underscores."""
    return re.sub(r"[^A-Za-z0-9_]", "_", text) or "_"


def _entry(file: Any, run: ExportData) -> None:
    about = run.provenance
    entry = _entry_with_results(file, run)
    entry.attrs["default"] = "swings"
    entry["start_time"], entry["end_time"] = run.began, run.ended
    _describe_rig(entry, about)
    _data(entry, "spots", ("y_rad", "y_deflection_px", "position_1"), run)
    _data(entry, "swings", ("amplitude",), run)


def _entry_with_results(file: Any, run: ExportData) -> Any:
    """An NXentry with results and provenance of a run or a series."""
    about = run.provenance
    entry = _group(file, item_name(run.name), "NXentry")
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
    return entry


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
        fit = item_name(row.fit)
        fit_group = group[fit] if fit in group else _group(group, fit, "NXcollection")
        name = item_name(row.quantity)
        numbers = {"": row.value, "_errors": row.u_total, "_lower_95": row.lower, "_upper_95": row.upper}
        for suffix, number in numbers.items():
            fit_group[f"{name}{suffix}"] = number
            _with_unit(fit_group[f"{name}{suffix}"], row.unit)
        fit_group[name].attrs["verdict"] = row.verdict.value


def _with_unit(field: Any, unit: str) -> None:
    if unit:
        field.attrs["units"] = _NEXUS_UNITS.get(unit, in_ascii(unit))

"""Writes HDF5 in NeXus layout: one NXentry per run, NXdata with units, the provenance as NXnote."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from processing.errors import ConfigurationError
from rig.analysis import JsonObject
from rig.export.run import ExportedRun, columns_of, flat_results, unit_of


def write_nexus(path: Path, runs: Sequence[ExportedRun]) -> None:
    """One file: ``/run-1/spots``, ``/run-1/swings``, ``/run-1/results``, ``/run-1/provenance``.

    Field names are the record's. Standard uncertainties ``u_NAME`` are also there as
    ``NAME_errors``, where NeXus readers look for them.

    Raises ConfigurationError if h5py is not installed.
    """
    try:
        import h5py
    except ImportError:
        raise ConfigurationError(
            "HDF5 needs h5py: pip install 'optical-pendulum-rig[export]', or take --format parquet"
        ) from None
    with h5py.File(path, "x") as file:
        file.attrs["NX_class"] = "NXroot"
        file.attrs["default"] = runs[0].name
        for run in runs:
            entry = file.create_group(run.name)
            entry.attrs["NX_class"] = "NXentry"
            entry.attrs["default"] = "swings"
            entry["title"] = run.provenance.get("session.sample", run.name)
            entry["program_name"] = "optical-pendulum-rig"
            entry["program_name"].attrs["version"] = run.provenance.get("versions.optical-pendulum-rig", "")
            slow = "y_rad" if "y_rad" in (run.spots.dtype.names or ()) else "y_deflection_px"
            amplitude = (
                "amplitude_rad" if "amplitude_rad" in (run.swings.dtype.names or ()) else "amplitude_px"
            )
            _data(entry, "spots", columns_of(run.spots), slow, "time_ns")
            _data(entry, "swings", columns_of(run.swings), amplitude, "turn_time_ns")
            note = entry.create_group("provenance")
            note.attrs["NX_class"] = "NXnote"
            note["type"] = "application/json"
            note["data"] = json.dumps(dict(run.provenance))
            if run.results:
                _results(entry, run.results)


def _data(entry: Any, name: str, columns: Mapping[str, NDArray[Any]], signal: str, axis: str) -> None:
    group = entry.create_group(name)
    group.attrs["NX_class"] = "NXdata"
    if signal in columns:
        group.attrs["signal"] = signal
        group.attrs["axes"] = [axis]
    for key, values in columns.items():
        data = group.create_dataset(key, data=values, compression="gzip", shuffle=True)
        if unit_of(key):
            data.attrs["units"] = unit_of(key)
    for key in columns:
        if key.startswith("u_") and key[2:] in columns:
            group[f"{key[2:]}_errors"] = group[key]


def _results(entry: Any, results: JsonObject) -> None:
    group = entry.create_group("results")
    group.attrs["NX_class"] = "NXcollection"
    group["json"] = json.dumps(results)
    for name, value in flat_results(results):
        place = group.require_group("values/" + "/".join(name.split(".")[:-1])) if "." in name else group
        place[name.rsplit(".", 1)[-1]] = value
        parts = [part for part in reversed(name.split(".")) if part not in ("value", "standard_uncertainty")]
        if isinstance(value, float) and parts and unit_of(parts[0]):
            place[name.rsplit(".", 1)[-1]].attrs["units"] = unit_of(parts[0])

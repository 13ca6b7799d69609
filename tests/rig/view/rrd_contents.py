"""Content of an .rrd file, read with Rerun's reader."""

from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from rerun.chunk import RrdReader


def entities(path: Path) -> set[str]:
    """Paths of all entities."""
    return {str(chunk.entity_path) for chunk in RrdReader(path).stream()}


def contents(path: Path) -> dict[tuple[str, str], list[tuple[int | None, Any]]]:
    """Everything that is drawn: times in ns (None: always) and values by entity and component."""
    found: dict[tuple[str, str], list[tuple[int | None, Any]]] = {}
    for chunk in RrdReader(path).stream():
        batch = chunk.to_record_batch()
        times = [None] * batch.num_rows
        if not chunk.is_static:
            times = batch.column("run_time").cast(pa.int64()).to_pylist()
        for name in batch.schema.names:
            if ":" in name:
                rows = zip(times, batch.column(name).to_pylist(), strict=True)
                found.setdefault((str(chunk.entity_path), name), []).extend(rows)
    return {key: sorted(rows, key=lambda row: row[0] or -1) for key, rows in found.items()}


def column(path: Path, entity: str, component: str) -> tuple[np.ndarray[Any, Any], list[Any]]:
    """Times in s, ascending, and values of one component of an entity."""
    times: list[np.ndarray[Any, Any]] = []
    values: list[Any] = []
    for chunk in RrdReader(path).stream():
        batch = chunk.to_record_batch()
        if str(chunk.entity_path) == entity and component in batch.schema.names and not chunk.is_static:
            times.append(batch.column("run_time").cast(pa.int64()).to_numpy() * 1e-9)
            values.extend(batch.column(component).to_pylist())
    if not times:
        return np.empty(0), []
    joined = np.concatenate(times)
    order = np.argsort(joined, kind="stable")
    return joined[order], [values[row] for row in order]


def scalars(path: Path, entity: str) -> tuple[np.ndarray[Any, Any], np.ndarray[Any, Any]]:
    """Times in s and values of a curve."""
    times_s, values = column(path, entity, "Scalars:scalars")
    return times_s, np.array([value[0] for value in values])


def measured(path: Path, entity: str) -> tuple[np.ndarray[Any, Any], ...]:
    """Times in s, values and standard uncertainties of a curve with a band."""
    times_s, values = column(path, entity, "Measurements:values")
    _, variances = column(path, entity, "Measurements:variances")
    return (
        times_s,
        np.array([value[0] for value in values]),
        np.sqrt([variance[0] for variance in variances]),
    )


def static_values(path: Path, entity: str, component: str) -> list[Any]:
    """Values of a component that holds for all times."""
    for chunk in RrdReader(path).stream():
        batch = chunk.to_record_batch()
        if str(chunk.entity_path) == entity and chunk.is_static and component in batch.schema.names:
            found: list[Any] = batch.column(component).to_pylist()[0]
            return found
    return []

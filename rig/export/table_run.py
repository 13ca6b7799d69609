"""Reads a decay of a table or a film to be exported: positions, half-cycles, results, with units."""

import re
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from processing.deflections import DeflectionUnit
from processing.ticks import NS_PER_S
from processing.units import conversion
from rig.analysis import StoredTurningPoints, TableDecay, encoded, read_positions, units_of
from rig.export.run import ExportedRun


def read_table_decay(folder: Path, decay: TableDecay, name: str) -> ExportedRun:
    """A decay of which a folder holds the results; angles in rad, other positions in the table's own unit.

    Raises RecordError where the positions beside the results cannot be read.
    """
    stored = decay.turning_points or StoredTurningPoints()
    own = decay.amplitude_unit or "unit"
    of_angle = stored.unit is DeflectionUnit.RAD
    unit, size = ("rad", conversion(own, "rad")) if of_angle else (own, 1.0)
    time_s, positions = read_positions(folder)
    inside = (time_s >= decay.began_s) & (time_s <= decay.ended_s)
    suffix = re.sub(r"\W", "_", unit)
    columns = {"time_s": time_s[inside]}
    columns |= {f"position_{k}_{suffix}": each[inside] * size for k, each in enumerate(positions, start=1)}
    found = encoded(decay)
    provenance = {"table": decay.record, "sha256": decay.sha256, "unit of the table": own}
    swings = {
        "index": stored.index,
        "time_s": stored.first_ns / NS_PER_S + stored.time_s,
        "u_time_s": stored.u_time_s,
        f"amplitude_{suffix}": stored.amplitude,
        f"u_amplitude_{suffix}": stored.u_amplitude,
    }
    return ExportedRun(
        name,
        found,
        units_of(decay, found),
        provenance,
        spots=_table(columns),
        swings=_table(swings),
        column_units={key: unit for key in (*columns, *swings) if key.endswith(f"_{suffix}")},
    )


def _table(columns: dict[str, NDArray[Any]]) -> NDArray[Any]:
    table = np.empty(
        len(columns[next(iter(columns))]), [(name, each.dtype) for name, each in columns.items()]
    )
    for name, each in columns.items():
        table[name] = each
    return table

"""A decay of a table or a film as a run of a report."""

from pathlib import Path

import numpy as np

from processing.deflections import DeflectionUnit
from processing.errors import RigError
from processing.ticks import NS_PER_S
from processing.units import conversion
from rig.analysis import (
    StoredTurningPoints,
    TableDecay,
    TableResults,
    along_and_across,
    read_positions,
)
from rig.report.run_data import RunData, ShownTrajectory, ShownUnit

_EDGE = 0.05
"""Part of a decay's length that is drawn before and after it."""


def decay_of_table(folder: Path, table: TableResults, number: int) -> RunData:
    """A decay, counted from 1, of the table of which a folder holds the results.

    Its motion is that of positions.csv in the folder; empty where that is not there, with a note.
    """
    decay = table.decays[number - 1]
    stored = decay.turning_points or StoredTurningPoints()
    of_angle = stored.unit is DeflectionUnit.RAD
    unit = ShownUnit(table.unit, conversion(table.unit, "rad") if of_angle else 1.0)
    notes = [*table.understood]
    try:
        motion = _motion(folder, decay, stored.first_ns / NS_PER_S, unit)
    except RigError as error:
        notes.append(f"no motion is drawn: {error}")
        motion = ShownTrajectory(np.empty(0), np.empty(0), np.empty(0), unit)
    file = {
        "table": decay.record,
        "sha256": decay.sha256,
        **{f"sha256 of {name}": value for name, value in decay.inputs_sha256.items()},
    }
    title = f"Decay {number}" if len(table.decays) > 1 else "Decay"
    return RunData(title, decay, stored, motion, None, {"file": file}, None, notes)


def _motion(folder: Path, decay: TableDecay, zero_s: float, unit: ShownUnit) -> ShownTrajectory:
    """Along the motion as Y, across it as X; NaN where only one position was measured."""
    time_s, positions = read_positions(folder)
    edge_s = _EDGE * (decay.ended_s - decay.began_s)
    inside = (time_s >= decay.began_s - edge_s) & (time_s <= decay.ended_s + edge_s)
    along, across = along_and_across(positions)
    return ShownTrajectory(time_s[inside] - zero_s, across[inside], along[inside], unit)

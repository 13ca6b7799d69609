"""Spots and swings as messages, and back."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from acquisition.record.schemas import MessageType, conform
from acquisition.record.topics import SPOT, SPOT_UNCALIBRATED, SWING
from processing.angle import ARCSEC_RAD
from processing.spot import SPOT_DTYPE, Spot
from processing.swing import Swing

Floats = NDArray[np.float64]
_SHOWN_AS = dict(zip(SPOT_UNCALIBRATED.names[-4:], ("x_rad", "y_rad", "u_x_rad", "u_y_rad"), strict=True))


def spot_rows(
    kind: MessageType,
    sequences: Sequence[int],
    device_times_ns: Sequence[int],
    host_times_ns: Sequence[int],
    times_ns: NDArray[np.int64],
    spots: Sequence[Spot],
    deflections: tuple[Floats, Floats, Floats, Floats],
) -> NDArray[Any]:
    """Encoded messages of type `SPOT` or `SPOT_UNCALIBRATED`, a row each.

    `deflections` are x, y and their standard uncertainties, in rad or px as the type has them.
    """
    rows = kind.wire_rows(len(spots))
    rows["sequence"] = sequences
    rows["time_ns"] = times_ns
    rows["device_time_ns"] = device_times_ns
    rows["host_time_ns"] = host_times_ns
    table = np.array(spots, dtype=SPOT_DTYPE)
    for name in Spot._fields:
        rows[name] = table[name]
    columns = list(deflections)
    if kind is SPOT:
        columns += [deflections[0] / ARCSEC_RAD, deflections[1] / ARCSEC_RAD]
    for name, values in zip(kind.names[-len(columns) :], columns, strict=True):
        rows[name] = values
    return rows


def spot_table(table: NDArray[Any]) -> NDArray[Any]:
    """A record's table of spots with the fields of `SPOT`, whichever type and version it had."""
    names = table.dtype.names or ()
    renamed = np.dtype([(_SHOWN_AS.get(name, name), table.dtype[name]) for name in names])
    return conform(table.view(renamed), SPOT.table_dtype)


def encode_swing(kind: MessageType, swing: Swing) -> bytes:
    """Message of type `SWING` or `SWING_UNCALIBRATED`."""
    shown = [2.0 * swing.half_period_s]
    if kind is SWING:
        shown.insert(0, swing.amplitude / ARCSEC_RAD)
    return kind.encode(
        swing.index,
        swing.turn_time_ns,
        swing.u_turn_time_s,
        swing.amplitude,
        swing.u_amplitude,
        swing.half_period_s,
        swing.u_half_period_s,
        swing.centre,
        swing.side,
        swing.flags,
        *shown,
    )


def swings_of(table: NDArray[Any]) -> list[Swing]:
    """Swings from a record's table, whose first fields are those of `Swing` in order."""
    return [Swing(*row[: len(Swing.__dataclass_fields__)]) for row in table.tolist()]

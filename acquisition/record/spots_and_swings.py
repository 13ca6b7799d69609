"""Conversion of spots, swings and balances to messages and back."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from acquisition.record.schemas import MessageType
from acquisition.record.topics import DEFLECTION_FIELDS, SWING
from processing.balance import Balance, names_with_units
from processing.deflections import Deflections, DeflectionUnit
from processing.spot import SPOT_DTYPE, Spot
from processing.swing import Swing
from processing.units import ARCSEC_RAD


def spot_rows(
    kind: MessageType,
    sequences: Sequence[int],
    device_times_ns: Sequence[int],
    host_times_ns: Sequence[int],
    spots: Sequence[Spot],
    deflections: Deflections,
) -> NDArray[Any]:
    """Encoded messages of type `SPOT` or `SPOT_UNCALIBRATED`, one row per frame.

    Parameters
    ----------
    kind
        Message type for the unit of the deflections.
    sequences, device_times_ns, host_times_ns, spots, deflections
        Frame numbers, times, spots and deflections of n frames.
    """
    rows = kind.wire_rows(len(spots))
    rows["sequence"] = sequences
    rows["time_ns"] = deflections.times_ns
    rows["device_time_ns"] = device_times_ns
    rows["host_time_ns"] = host_times_ns
    table = np.array(spots, dtype=SPOT_DTYPE)
    for name in Spot._fields:
        rows[name] = table[name]
    columns = (deflections.x, deflections.y, deflections.u_x, deflections.u_y)
    for name, values in zip(DEFLECTION_FIELDS[deflections.unit], columns, strict=True):
        rows[name] = values
    if deflections.unit is DeflectionUnit.RAD:
        rows["x_arcsec"], rows["y_arcsec"] = deflections.x / ARCSEC_RAD, deflections.y / ARCSEC_RAD
    return rows


def deflections_of(spots: NDArray[Any], unit: DeflectionUnit) -> Deflections:
    """The deflections in a table of spots."""
    # copies, so that the deflections do not keep the whole table in memory
    x, y, u_x, u_y = (np.array(spots[name], dtype=np.float64) for name in DEFLECTION_FIELDS[unit])
    return Deflections(np.array(spots["time_ns"], dtype=np.int64), x, y, u_x, u_y, unit)


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


def encode_balance(kind: MessageType, balance: Balance) -> bytes:
    """Message of type `BALANCE` or `BALANCE_UNCALIBRATED`, as the balance's unit is."""
    return kind.encode(*[getattr(balance, name) for name in names_with_units(balance.unit)])


def balances_of(table: NDArray[Any], unit: DeflectionUnit) -> list[Balance]:
    """Balances from a record's table."""
    names = names_with_units(unit)
    return [
        Balance(**{name: row[key] for name, key in names.items()}, unit=unit)
        for row in (dict(zip(table.dtype.names or (), row, strict=True)) for row in table.tolist())
    ]

"""Balances as messages, and back."""

import math
from typing import Any

from numpy.typing import NDArray

from acquisition.record.schemas import MessageType
from processing.balance import Balance, names_with_units
from processing.deflections import DeflectionUnit


def encode_balance(kind: MessageType, balance: Balance) -> bytes:
    """Message of type `BALANCE` or `BALANCE_UNCALIBRATED`, as the balance's unit is."""
    return kind.encode(*[getattr(balance, name) for name in names_with_units(balance.unit)])


def balances_of(table: NDArray[Any], unit: DeflectionUnit) -> list[Balance]:
    """Balances from a record's table; NaN for a number that the record does not have.

    Older records have the names in rad whatever their `unit` is, which the record states.
    """
    recorded = table.dtype.names or ()
    in_rad = names_with_units(DeflectionUnit.RAD)
    names = {name: key if key in recorded else in_rad[name] for name, key in names_with_units(unit).items()}
    unknown = dict.fromkeys(names, math.nan)
    found = []
    for row in table.tolist():
        fields = dict(zip(recorded, row, strict=True))
        known = {name: fields[key] for name, key in names.items() if key in fields}
        found.append(Balance(**{**unknown, **known, "unit": unit}))
    return found

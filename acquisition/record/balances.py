"""Balances as messages, and back."""

from typing import Any

from numpy.typing import NDArray

from acquisition.record.schemas import MessageType
from processing.balance import Balance, names_with_units
from processing.deflections import DeflectionUnit


def encode_balance(kind: MessageType, balance: Balance) -> bytes:
    """Message of type `BALANCE` or `BALANCE_UNCALIBRATED`, as the balance's unit is."""
    return kind.encode(*[getattr(balance, name) for name in names_with_units(balance.unit)])


def balances_of(table: NDArray[Any], unit: DeflectionUnit) -> list[Balance]:
    """Balances from a record's table, whose fields are those of `Balance` in order."""
    return [
        Balance(**dict(zip(names_with_units(unit), row, strict=True)), unit=unit) for row in table.tolist()
    ]

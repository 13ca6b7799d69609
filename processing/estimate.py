"""A value with its standard uncertainty."""

from collections.abc import Iterator
from dataclasses import dataclass
from enum import StrEnum
from math import nan

WELL_DETERMINED = 0.1
"""Relative standard uncertainty up to which value and uncertainty describe a parameter; above it the profile
likelihood is used."""


class Determinacy(StrEnum):
    """What the data say of a parameter: a value, an interval, a bound or nothing."""

    DETERMINED = "determined"
    INTERVAL = "interval"
    UPPER_BOUND = "upper bound"
    LOWER_BOUND = "lower bound"
    UNDETERMINED = "undetermined"


@dataclass(frozen=True, slots=True)
class Estimate:
    """A value and its standard uncertainty (infinite if the data do not determine it).

    It unpacks: ``value, u = estimate``.
    """

    value: float
    standard_uncertainty: float

    def __iter__(self) -> Iterator[float]:
        return iter((self.value, self.standard_uncertainty))


NOT_DETERMINED = Estimate(nan, nan)

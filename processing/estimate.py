"""A value with its standard uncertainty."""

from enum import StrEnum
from typing import NamedTuple

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


class Estimate(NamedTuple):
    """A value and its standard uncertainty (infinite if the data do not determine it)."""

    value: float
    standard_uncertainty: float

    @property
    def well_determined(self) -> bool:
        """Whether the relative uncertainty is at most `WELL_DETERMINED`."""
        return self.standard_uncertainty <= WELL_DETERMINED * abs(self.value)

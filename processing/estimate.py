"""A value with its standard uncertainty."""

from typing import NamedTuple

WELL_DETERMINED = 0.1
"""Relative standard uncertainty up to which a value and its uncertainty are reported as they are;
beyond it the likelihood is followed instead."""


class Estimate(NamedTuple):
    """A value and its standard uncertainty (infinite where the data do not determine it)."""

    value: float
    standard_uncertainty: float

    @property
    def well_determined(self) -> bool:
        """Whether the uncertainty is a small part of the value (`WELL_DETERMINED`)."""
        return self.standard_uncertainty <= WELL_DETERMINED * abs(self.value)

"""Estimate of a quantity, kinds of verdict on a parameter, and the methods by which a law is fitted."""

from collections.abc import Iterator
from dataclasses import dataclass
from enum import StrEnum
from math import nan

WELL_DETERMINED = 0.1
"""Relative standard uncertainty above which the profile likelihood describes a parameter."""


class Determinacy(StrEnum):
    """Kind of result that the data give for a parameter: a value, an interval, a bound or nothing."""

    DETERMINED = "determined"
    INTERVAL = "interval"
    UPPER_BOUND = "upper bound"
    LOWER_BOUND = "lower bound"
    UNDETERMINED = "undetermined"


@dataclass(frozen=True, slots=True)
class Estimate:
    """Value and standard uncertainty (infinite if the data do not determine it).

    An estimate can be unpacked: ``value, u = estimate``.
    """

    value: float
    standard_uncertainty: float

    def __iter__(self) -> Iterator[float]:
        return iter((self.value, self.standard_uncertainty))


NOT_DETERMINED = Estimate(nan, nan)


class FitMethod(StrEnum):
    """A method of fitting; the value is its key in results.json and its name in legends.

    Members are strings, so that ``fits[FitMethod.EXACT]`` works for the contents of a results.json. Iteration
    gives the order of columns in tables.
    """

    heading: str
    """Heading of its column in a table."""
    description: str
    """The method in a few words."""

    def __new__(cls, key: str, heading: str, description: str) -> "FitMethod":
        member = str.__new__(cls, key)
        member._value_ = key
        member.heading = heading
        member.description = description
        return member

    ASYMPTOTIC = (
        "asymptotic", "Eqs. 5 and 6", "asymptotic decay, then asymptotic period, one after the other"
    )  # fmt: skip
    EXACT = "exact", "exact map", "half-swing map of the equation of motion, amplitudes and times jointly"

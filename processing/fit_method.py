"""The ways in which a law is fitted to a decay, named once.

They stand outside `processing.fit` because colours and headings need the names, and not the fits.
"""

from enum import StrEnum


class FitMethod(StrEnum):
    """A way of fitting; the value is its key in results.json and its name in legends.

    Members are strings: ``fits[FitMethod.EXACT]`` finds what was read from a results.json. Iterating
    gives the order in which tables show them.
    """

    heading: str
    """Heading of its column in a table."""
    description: str
    """What is done, in a few words."""
    equations: str
    """The paper's equations that it solves."""

    def __new__(cls, key: str, heading: str, description: str, equations: str) -> "FitMethod":
        member = str.__new__(cls, key)
        member._value_ = key
        member.heading = heading
        member.description = description
        member.equations = equations
        return member

    ASYMPTOTIC = (
        "asymptotic",
        "Eqs. 5 and 6",
        "asymptotic decay, then asymptotic period, one after the other",
        "Eqs. 5 and 6",
    )
    EXACT = (
        "exact",
        "exact map",
        "half-swing map of the equation of motion, amplitudes and times jointly",
        "Eqs. 1, 3 and 4",
    )

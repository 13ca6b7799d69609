"""Names of the methods by which a law is fitted to a decay.

They are defined outside `processing.fit` because the presentation needs the names without importing the fits.
"""

from enum import StrEnum


class FitMethod(StrEnum):
    """A method of fitting; the value is its key in results.json and its name in legends.

    Members are strings, so that ``fits[FitMethod.EXACT]`` works for the contents of a results.json. Iteration
    gives the order of columns in tables.
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

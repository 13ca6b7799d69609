"""The two ways in which a law is fitted to a decay, named once."""

from enum import StrEnum


class FitMethod(StrEnum):
    """A way of fitting; the value is its key in results.json.

    Members are strings: ``fits[FitMethod.EXACT]`` finds what was read from a results.json.
    Iterating gives the order in which tables show them.
    """

    description: str
    """What is done, in a few words."""
    equations: str
    """The paper's equations it rests on."""

    def __new__(cls, key: str, description: str, equations: str) -> "FitMethod":
        member = str.__new__(cls, key)
        member._value_ = key
        member.description = description
        member.equations = equations
        return member

    ASYMPTOTIC = (
        "asymptotic",
        "asymptotic decay, then asymptotic period",
        "Eqs. 5 and 6",
    )
    EXACT = (
        "exact",
        "half-swing map of the equation of motion, amplitudes and times jointly",
        "Eqs. 1, 3 and 4",
    )


DEFAULT_METHOD = FitMethod.EXACT
"""The fit whose numbers are reported where one is asked for."""

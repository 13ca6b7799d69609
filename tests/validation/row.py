"""A row: a claim, what it is tested by, the number that comes out, the limit that the number must keep."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from math import inf, sqrt
from typing import NamedTuple


class Missing(Exception):
    """Something that a measurement needs is not on this machine: its message says what."""


class Found(NamedTuple):
    """Numbers of one kind that a measurement gives, and what should be said beside them."""

    values: tuple[float, ...]
    detail: str = ""


Measurement = Callable[[], Mapping[str, Found]]
"""Measures; what it returns holds the numbers of one row or of several, by name. Raises `Missing`."""


@dataclass(frozen=True)
class Limit:
    """Where every value must be, both ends included."""

    low: float = -inf
    high: float = inf

    def holds(self, values: tuple[float, ...]) -> bool:
        return bool(values) and all(self.low <= value <= self.high for value in values)

    @property
    def text(self) -> str:
        if self.low == self.high:
            return f"{self.low:g}"
        if self.low == -inf:
            return f"≤ {self.high:g}"
        if self.high == inf:
            return f"≥ {self.low:g}"
        return f"{self.low:g} to {self.high:g}"


def limit_of_share(cases: int, percent: float = 68.27) -> Limit:
    """Where the share that so many independent cases give must be: three binomial standard deviations."""
    share = percent / 100.0
    three = 300.0 * sqrt(share * (1.0 - share) / cases)
    return Limit(round(max(0.0, percent - three), 1), round(min(100.0, percent + three), 1))


@dataclass(frozen=True)
class Row:
    """One claim.

    Attributes
    ----------
    name
        Words joined by hyphens. The command line takes it, and every beginning of it up to a hyphen.
    means
        How it is tested, and by what that shares nothing with the code.
    measure, number
        What is called, and which of its numbers is meant. Rows with the same function share one call.
    quick
        It takes seconds, and a test asks whether it still holds.
    share
        Its number is a share of cases that an interval holds, drawn in the figure of all of them.
    """

    name: str
    group: str
    claim: str
    means: str
    measure: Measurement
    number: str
    unit: str
    limit: Limit
    quick: bool = False
    share: bool = False

    def is_meant_by(self, word: str) -> bool:
        """Whether a word of the command line means this row."""
        return self.name == word or self.name.startswith(word + "-")


@dataclass(frozen=True)
class NotTested:
    """What has no row, and why."""

    what: str
    why: str

"""What is to be turned, why nothing can be, and what a turn may have been instead of what was stated."""

import math
from enum import StrEnum
from typing import NamedTuple


class Doubt(StrEnum):
    """What a turn of a weight shows instead of what was stated."""

    STUCK = "does not move"
    REVERSED = "was turned the other way"
    OPEN = "may have been turned either way"


class Turn(NamedTuple):
    """The next adjustment: the weight, the number of turns (positive: clockwise) and the reason (`why`).

    `then` is a second part, the other way, which takes the play out of the screw; 0: none. `swing_arcsec` is
    the largest amplitude with which the spot will stay on the sensor afterwards (inf: not known).
    """

    weight: str
    turns: float
    why: str
    then: float = 0.0
    swing_arcsec: float = math.inf

    @property
    def parts(self) -> tuple[float, ...]:
        """The turns in sequence."""
        return (self.turns, self.then) if self.then else (self.turns,)


class Unreachable(NamedTuple):
    """No turn of the weights leads to balance; `why` says what is wrong with them."""

    why: str

"""A drag that grows with the 3/2 power of the speed, as the data of one fit have it."""

from dataclasses import dataclass
from math import nan
from typing import Annotated

from processing.estimate import NOT_DETERMINED, Estimate
from processing.quantity import PLAIN, Quantity

_SIGNIFICANT = 0.003
"""Chance of three standard deviations to either side."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SteeperDrag:
    """The moment ``-m g R steeper |phi'|^0.5 phi'`` beside what was fitted.

    `share` is its loss over that of the linear drag at the first amplitude, `p_value` the probability of so
    large a value without it. `relative_shift_b` and `shift_drag_s` are the changes of b and of the linear
    drag with it, `shift` those of all values of the fit, in their order.
    """

    steeper: Annotated[Estimate, Quantity("drag 3/2", "drag with the 3/2 power", unit="s^1.5")] = (
        NOT_DETERMINED
    )
    p_value: float = nan
    share: float = nan
    relative_shift_b: float = nan
    shift_drag_s: float = nan
    shift: Annotated[tuple[float, ...], PLAIN] = ()

    @property
    def seen(self) -> bool:
        """Whether the data ask for it."""
        return self.p_value < _SIGNIFICANT
